"""Files of predictions and results of every shape, sound and broken: each is scored by the laws of the metrics, or
refused by an error of ours.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from condvln.evaluation.aggregate import MEASURES, by_axis, estimate, summary
from condvln.evaluation.episode_stats import NAMES
from condvln.evaluation.evaluate import Evaluation
from condvln.evaluation.reading import ReadRules
from condvln.evaluation.render import as_csv, as_document, as_latex, as_markdown
from condvln.evaluation.split import Export, SplitOptions, evaluate_split
from condvln.evaluation.tables import all_tables
from condvln.evaluation.task import Task
from condvln.navigation.scene_navmesh import NavmeshFolder
from schemas.errors import CondVLNError

EPISODES = 5
ROUNDING = 1e-12

NOT_NUMBERS = ["null", "x", True, [], {}, None, math.nan, math.inf, -math.inf]
strange = st.sampled_from([*NOT_NUMBERS, 1e300, -1e300, 10**400, 1e-320, -0.0])


@dataclass(frozen=True)
class Place:
    """What files are written about: a folder and a split, and the ids and paths of its episodes."""

    folder: Path
    split: str
    options: Callable[..., SplitOptions]
    paths: dict[str, list[Any]]


@pytest.fixture(autouse=True)
def few_draws(monkeypatch: pytest.MonkeyPatch) -> None:
    """Intervals take most of the time, and no law is about them."""
    monkeypatch.setitem(cast(dict[str, Any], estimate.__kwdefaults__), "replicates", 10)


@pytest.fixture(scope="module")
def space(made: tuple[Export, Path]) -> Iterator[Place]:
    """Five episodes of an export, read once."""
    export, root = made
    tasks: list[Task] = export.tasks("train")[:EPISODES]
    folder = NavmeshFolder((export.folder, root))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("condvln.evaluation.split.split_tasks", lambda *_: tasks)
        patch.setattr("condvln.evaluation.split.NavmeshFolder", lambda _: folder)
        paths = {task.episode_id: task.reference.tolist() for task in tasks}
        yield Place(export.folder, "train", SplitOptions, paths)


@pytest.fixture(scope="module")
def stock(tmp_path_factory: pytest.TempPathFactory) -> Place:
    """A split of a file without a manifest."""
    folder = tmp_path_factory.mktemp("stock")
    episodes = [{"episode_id": k, "scene_id": f"mp3d/{k % 2}/{k % 2}.glb"} for k in range(EPISODES)]
    (folder / "val.json.gz").write_text(json.dumps({"episodes": episodes}))
    return Place(folder, "val", SplitOptions, {str(k): [] for k in range(EPISODES)})


@pytest.fixture(scope="module")
def viewpoints(tmp_path_factory: pytest.TempPathFactory) -> Place:
    """Paths along a ring of ten viewpoints; an eleventh has no edge."""
    folder = tmp_path_factory.mktemp("viewpoints")
    count = 10
    rows = [
        {
            "image_id": f"v{k}",
            "pose": [1, 0, 0, 4 * math.cos(k), 0, 1, 0, 4 * math.sin(k), 0, 0, 1, 1.5, 0, 0, 0, 1],
            "height": 1.5,
            "included": True,
            "unobstructed": [k < count and j < count and (k - j) % count in (1, 9) for j in range(count + 1)],
            "visible": [True] * (count + 1),
        }
        for k in range(count + 1)
    ]
    (folder / "s_connectivity.json").write_text(json.dumps(rows))
    paths = {f"{k}_0": [f"v{(k + j) % count}" for j in range(1 + 2 * k)] for k in range(EPISODES - 1)}
    paths["4_0"] = ["v0", "v10"]  # a goal that no way leads to
    items = [
        {"path_id": name.split("_")[0], "scan": "s", "path": path, "instructions": ["Go."]}
        for name, path in paths.items()
    ]
    (folder / "R2R_val.json").write_text(json.dumps(items))
    return Place(folder, "val", lambda **rules: SplitOptions(connectivity=(folder,), **rules), paths)


def named(draw: st.DrawFn, name: str) -> Any:
    """An id as agents write it."""
    forms: list[Any] = [name, name, name, f"{name}.0", "nobody"]
    if name.isdigit():
        forms += [int(name), int(name), float(name)]
    return draw(st.sampled_from([*forms, *NOT_NUMBERS] if draw(st.integers(0, 30)) == 0 else forms[:4] + forms[5:]))


def rarely(draw: st.DrawFn, often: int = 12) -> bool:
    return draw(st.integers(0, often)) == 0


def walked(draw: st.DrawFn, path: list[Any]) -> list[Any]:
    """Points of a path, some of them missing, repeated, moved or far away."""
    kind = draw(st.sampled_from(["whole", "whole", "part", "ends", "thin", "stray", "empty"]))
    points = [list(point) for point in path]
    if kind == "part":
        points = points[: draw(st.integers(1, len(points)))]
    elif kind == "ends":
        points = [points[0], points[-1]]
    elif kind == "thin":
        points = points[:: draw(st.integers(2, 5))] + points[-1:]
    elif kind == "empty":
        points = []
    elif kind == "stray":
        at = draw(st.integers(1, len(points)))
        far = st.sampled_from([0.1, 0.3, 5.0, 99.0, 1e5, 2e5])
        shift = np.multiply(draw(far), draw(st.sampled_from([(1, 0, 0), (0, 1, 0), (0, 0, -1)])))
        points[at:at] = [(np.add(points[0], shift)).tolist()] * draw(st.integers(1, 2))
    if points and rarely(draw):
        points[draw(st.integers(0, len(points) - 1))][draw(st.integers(0, 2))] = draw(strange)
    return points


def posed(draw: st.DrawFn, points: list[Any]) -> list[Any]:
    stop = draw(st.sampled_from([(False, True), (0, 1), (None, True), (False, False), (None, None), (False, 1.0)]))
    heading = draw(st.sampled_from([0.5, 0, math.nan, math.inf, None, "north"]))
    poses = [{"position": p, "heading": heading, "stop": stop[k == len(points) - 1]} for k, p in enumerate(points)]
    if draw(st.booleans()):
        poses = [{key: value for key, value in pose.items() if value is not None} for pose in poses]
    if draw(st.booleans()):
        poses = [{**pose, "collision": draw(st.sampled_from([True, False, 0, 1, None]))} for pose in poses]
    if poses and rarely(draw):
        poses[-1]["stop"] = draw(strange)
    return poses


def stepped(draw: st.DrawFn, path: list[Any]) -> list[Any]:
    """Viewpoints in steps of several, with or without headings, some of them left out or added."""
    path = list(path)
    if rarely(draw, 3):
        path[draw(st.integers(1, len(path))) :] = draw(st.lists(st.sampled_from([f"v{k}" for k in range(11)])))
    if rarely(draw, 4):
        path = path[:1] + path[-1:]
    steps: list[Any] = []
    while path:
        size = draw(st.sampled_from([1, 1, 1, 2, 3, 0]))
        step, path = path[:size], path[size:]
        heading = draw(st.sampled_from([0.1, math.nan]))
        steps.append(
            draw(st.sampled_from([step, [[v, heading, 0.0] for v in step], [*step, heading, 0.0][: size + 2]]))
        )
        if size == 1 and draw(st.booleans()):
            steps[-1] = step[0]
    if rarely(draw):
        steps.append(draw(strange))
    return steps


THEIRS = {ours: [theirs for theirs, name in NAMES.items() if name == ours] for ours in NAMES.values()}
YES_OR_NO = ("success", "oracle_success", "csr_all")


def measured(draw: st.DrawFn) -> dict[str, Any]:
    """Results of an episode: sound, undefined, contradictory, or of the wrong kind."""
    share = st.sampled_from([0, 1, 0.0, 1.0, 0.5, 0.25, 1 + 1e-9, -1e-9, True, False, math.nan, math.inf, None])
    yes = st.sampled_from([0, 1, 1.0, 0.0, True, False, math.nan, None])
    found: dict[str, Any] = {} if rarely(draw) else {"success": draw(yes)}
    for ours in draw(st.lists(st.sampled_from([*THEIRS]), max_size=8, unique=True)):
        names = [draw(st.sampled_from(THEIRS[ours]))] if draw(st.integers(0, 40)) else THEIRS[ours]
        found |= {name: draw(yes if ours in YES_OR_NO else share) for name in names}
    if draw(st.booleans()):
        found["collisions"] = {"count": draw(st.integers(0, 9)), "is_collision": False}
    if found and draw(st.integers(0, 60)) == 0:
        found[draw(st.sampled_from(sorted(found)))] = draw(strange)
    return found


@st.composite
def files(draw: st.DrawFn, kind: str, paths: dict[str, list[Any]]) -> tuple[bytes, dict[str, Any]]:
    """The bytes of a file, and the options with which it is read."""
    ids = draw(st.lists(st.sampled_from([*paths]), min_size=1, max_size=2 * EPISODES, unique=not rarely(draw, 4)))
    entries = []
    for name in ids:
        if kind == "viewpoints":
            way: Any = stepped(draw, paths[name])
        elif kind == "results":
            way = measured(draw)
        else:
            points = walked(draw, paths[name])
            way = posed(draw, points) if kind == "poses" else points
        entries.append((named(draw, name), way))
    shape = draw(st.sampled_from(["object", "object", "lines", "array", "pretty"]))
    if kind == "viewpoints" or (kind == "points" and shape == "object"):
        shape = "lines" if shape == "object" else shape
    key = draw(st.sampled_from(["instruction_id", "episode_id", "instr_id"]))
    where = draw(st.sampled_from(["path", "trajectory"]))
    rows = [
        {"scene_id": "s", "episode_id": name, **way} if kind == "results" else {key: name, where: way}
        for name, way in entries
    ]
    if kind == "results" and rarely(draw, 3):
        rows.insert(draw(st.sampled_from([0, len(rows)])), {"sucs_all": 0.5, "length": len(rows)})
    if shape == "object":
        text = "{" + ", ".join(f"{json.dumps(str(name))}: {json.dumps(way)}" for name, way in entries) + "}"
    elif shape == "lines":
        text = "\n".join(json.dumps(row) for row in rows) + "\n"
    else:
        text = json.dumps(rows, indent=2 if shape == "pretty" else None)
    if rarely(draw, 10):
        text = text[: draw(st.integers(len(text) // 2, len(text)))]
    reading = ReadRules(
        assume_stop=kind in ("poses", "points") and draw(st.booleans()),
        duplicates=draw(st.sampled_from(["refuse", "keep-last", "keep-last"])),
        allow_partial=draw(st.booleans()),
    )
    radii = (2.0,) if kind != "results" and draw(st.booleans()) else ()
    return text.encode(), {"reading": reading, "radii": radii}


def check_rows(found: Evaluation) -> None:
    """The laws that hold of every episode; a comparison with NaN, an undefined value, is passed over."""
    scores = found.scores
    assert not any(np.isinf(values).any() for values in scores.values())
    for smaller, larger in (
        ("spl", "success"),
        ("spl_route", "success"),
        ("sdtw", "success"),
        ("sdtw", "ndtw"),
        ("csr_all", "success"),
        ("csr_all", "bsa_all"),
        ("success", "oracle_success"),
    ):
        assert not (scores[smaller] > scores[larger] + ROUNDING).any(), (smaller, larger)
    for name in (
        "success",
        "oracle_success",
        "spl",
        "spl_route",
        "ndtw",
        "sdtw",
        "cls",
        "bsa_all",
        "csr_all",
        "bsa",
        "csr",
    ):
        assert not ((scores[name] < 0) | (scores[name] > 1)).any(), name
    absent = scores["missing"] == 1
    for name in ("success", "spl", "ndtw", "sdtw"):
        assert not (scores[name][absent] > 0).any(), name


def check_means(found: Evaluation) -> None:
    """The laws that hold of every group, and that what is counted is there."""
    for group in (summary(found), *by_axis(found, "scene")):
        where = np.ones(len(found), bool)
        if group.group:
            where = found.axes["scene"] == group.group["scene"]
        means = group.estimates
        for name in MEASURES:
            assert means[name].n == int((~np.isnan(found.scores[name][where])).sum()), name
            assert means[name].total == group.episodes == int(where.sum())
            assert math.isfinite(means[name].mean) == bool(means[name].n), name
        for smaller, larger in (
            ("spl", "success"),
            ("sdtw", "success"),
            ("csr_all", "success"),
            ("csr_all", "bsa_all"),
            ("success", "oracle_success"),
        ):
            assert not means[smaller].mean > means[larger].mean + ROUNDING, (smaller, larger)
        assert not means["ndtw"].mean > 1


def check_file(place: Place, path: Path, data: bytes, options: dict[str, Any]) -> bool:
    """Score a file and check the laws; return whether it was scored rather than refused."""
    path.write_bytes(data)
    refused: CondVLNError | None = None
    try:
        (found,), tasks = evaluate_split(place.folder, place.split, [path], place.options(**options))
    except CondVLNError as error:
        refused = error
    if refused is not None:
        assert refused.what
        assert refused.remedy
        assert len(str(refused)) < 1000
        return False
    check_rows(found)
    check_means(found)
    for table in all_tables([found], tasks):
        json.dumps(as_document(table), allow_nan=False)
        for text in (as_markdown(table), as_latex(table), as_csv(table)):
            assert "nan" not in text.lower()
    json.dumps(found.rows(), allow_nan=False)
    return True


KINDS = {"poses": "space", "points": "space", "results": "space", "stock results": "stock", "viewpoints": "viewpoints"}


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize(
    "count", [pytest.param(80, marks=pytest.mark.costly), pytest.param(500, marks=pytest.mark.soak)]
)
def test_a_file_is_scored_by_the_laws_or_refused(
    request: pytest.FixtureRequest, tmp_path: Path, kind: str, count: int
) -> None:
    place, scored = request.getfixturevalue(KINDS[kind]), 0

    @settings(max_examples=count, suppress_health_check=[HealthCheck.data_too_large, HealthCheck.too_slow])
    @given(files(kind.split()[-1], place.paths))
    def check(file: tuple[bytes, dict[str, Any]]) -> None:
        nonlocal scored
        scored += check_file(place, tmp_path / "agent.json", *file)

    check()
    assert scored > count / 10, "nearly all files would be refused, and the laws not be tried"
