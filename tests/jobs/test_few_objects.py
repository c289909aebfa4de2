"""A flat with few objects in each room: what `sources` foretells, what a run says at its end, and its page."""

from __future__ import annotations

import io
import json
from collections import Counter
from pathlib import Path
from typing import Any

import pytest
from rich.console import Console

from condvln.instructions.predicates import PREDICATES, sayable
from condvln.scene import Scene
from jobs.explore import Exploration, explore
from jobs.explore_scenes import ExploredScene
from jobs.explore_statistics import scene_yield
from jobs.generate import run_generate
from jobs.report import Report
from jobs.sources import survey
from jobs.workspace import published
from schemas.config import Config, SourceConfig
from schemas.program import asked_in
from tests.site_chunks import chunk_content

FLAT: dict[str, tuple[tuple[int, int], list[tuple[str, float, float]]]] = {
    "living room": (
        (0, 0),
        [
            ("sofa", 1.0, 0.6),
            ("coffee table", 1.2, 1.8),
            ("bookshelf", 0.4, 3.3),
            ("plant", 4.6, 3.6),
            ("tv", 3.6, 0.4),
        ],
    ),
    "kitchen": ((5, 0), [("fridge", 8.6, 0.4), ("sink", 7.4, 0.4), ("dining table", 7.5, 2.6), ("stool", 5.4, 3.6)]),
    "bedroom": ((0, 4), [("bed", 1.1, 7.0), ("wardrobe", 4.6, 7.4), ("nightstand", 0.4, 5.8)]),
}
"""Rooms of 5 m × 4 m (the kitchen: 4 m × 4 m): their corner, and what stands where."""


def flat(folder: Path) -> Config:
    """A configuration over one flat of family `boxes`."""
    rooms = [
        {"label": name, "polygon": [[x, z], [x1, z], [x1, z + 4], [x, z + 4]]}
        for name, ((x, z), _) in FLAT.items()
        for x1 in [x + (4 if name == "kitchen" else 5)]
    ]
    things = [
        {"label": label, "center": [x, 0.4, z], "size": [0.6, 0.8, 0.6]}
        for _, own in FLAT.values()
        for label, x, z in own
    ]
    doors = [{"from": [5, 1.5], "to": [5, 2.5]}, {"from": [2, 4], "to": [3, 4]}]
    (folder / "data").mkdir()
    (folder / "data" / "flat.json").write_text(json.dumps({"rooms": rooms, "doors": doors, "objects": things}))
    return Config(
        name="flat",
        store=folder / "store",
        export=folder / "export",
        sources=(SourceConfig(family="boxes", root=folder / "data"),),
    )


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> tuple[Config, Report]:
    config = flat(tmp_path_factory.mktemp("flat"))
    return config, run_generate(config, inline=True, console=Console(quiet=True))


def test_sources_promise_nothing_of_rooms_with_few_objects(run: tuple[Config, Report]) -> None:
    report = survey(run[0])
    tables = {section.title: section for section in report.sections}
    shown = dict(zip(tables["Will yield"].columns, tables["Will yield"].rows[0], strict=True))
    assert shown["scenes with a room of six objects"] == 0
    assert shown["with fewer"] == 1
    assert shown["no instructions"] == 0
    ((family, scene, most, why),) = tables["May yield nothing"].rows
    assert (family, scene, most) == ("boxes", "flat", 5)
    assert "put about 6 in a room" in why
    (told,) = report.document["sources"][0]["yields"]
    assert (told["nothing"], told["most"]) == ("", 5)


def test_a_run_without_episodes_says_what_each_room_lacks(run: tuple[Config, Report]) -> None:
    _, report = run
    assert report.exit_code == 0
    (scene,) = report.document["funnel"]["scenes"]
    why = scene["why"]
    assert why.startswith("nothing_to_ask: ")
    nothing = "no statement about it is both possible as true and as false"
    for k, (name, (_, own)) in enumerate(FLAT.items()):
        assert f"{name} {k}: {len(own)} objects, {len(own)} of them seen; {nothing}" in why
    assert "Put about six objects in a room" in why
    printed = io.StringIO()
    Console(width=500, file=printed).print(report)
    last = printed.getvalue().rstrip().splitlines()[-1]
    assert last.startswith("WARNING: nothing was made: none of 1 scenes has an instruction (nothing_to_ask 1)")


def test_the_page_of_a_snapshot_without_episodes_shows_the_scene_and_why(
    run: tuple[Config, Report], tmp_path: Path
) -> None:
    config, _ = run
    report = explore(Exploration(tmp_path / "page", None, config, ()))
    assert (report.document["scenes"], report.document["episodes"]) == (1, 0)
    found: dict[str, Any] = dict(chunk_content(path.read_bytes()) for path in (tmp_path / "page/data").glob("*.js"))
    (scene,) = found["index"]["scenes"]
    assert (scene["id"], scene["rooms"], scene["objects"], scene["episodes"]) == ("flat", 3, 12, 0)
    assert scene["reason"] == "nothing_to_ask"
    assert len(found["scene-0"]["rooms"]) == 3
    rules = {row[4] for row in found["scene-0"]["made"]["rejections"]}
    assert any("too few of its objects" in rule for rule in rules)


def of_cell(wanted: int, placed: int, *counts: tuple[str, str, int]) -> dict[str, Any]:
    """What the page says of a scene with one cell: counts are (stage, reason, rejected)."""
    rejected = sum(n for stage, _, n in counts if stage == "episodes")
    flow = {"cell": "simple", "wanted": wanted, "candidates": placed + rejected, "rejected": rejected, "placed": placed}
    rows = [{"cell": "simple", "stage": stage, "reason": reason, "count": n} for stage, reason, n in counts]
    scene = Scene("made", "a", Path(), (), ())
    found = scene_yield(ExploredScene(scene, None, (), tables={"funnel": [flow], "rejections": rows}))
    assert found is not None
    return found


def test_a_full_quota_is_no_reason_for_too_few_episodes() -> None:
    drawn = ("programs", "no_waypoint", 30)
    full = [("episodes", "quota_full", 50), ("episodes", "gold_leaf_full", 40)]
    found = of_cell(10, 4, *full, ("episodes", "detour", 9), drawn)
    assert found["reason"] == "detour"
    assert [row[2] for row in found["rejections"][:2]] == ["detour", "no_waypoint"]
    assert found["rejections"][-1][4] == "these leaves already have their share; candidates of other leaves are lacking"
    # All candidates that failed would not have filled the gap: what ended draws is the reason.
    assert of_cell(10, 4, *full, ("episodes", "detour", 1), drawn)["reason"] == "no_waypoint"
    assert of_cell(10, 4, *full)["reason"] == "too_few_candidates"
    assert of_cell(4, 4, *full, drawn)["reason"] == ""


def test_a_run_names_the_asked_predicates_that_no_condition_has(
    made_run: tuple[Config, Report], target_predicates: Counter[str]
) -> None:
    config, report = made_run
    asked = asked_in("replicacad") & sayable(config.instructions.directions) - {"far from"}
    unasked = [name for name in PREDICATES if name in asked and not target_predicates[name]]
    assert report.document["unasked_predicates"] == unasked
    assert 0 < len(unasked) < len(asked), "some are asked, and some are not"
    note = f"asked predicates without a condition: {', '.join(unasked)} ("
    assert report.notes[-1].startswith(note)
    assert not any("nothing was made" in line for line in report.notes)


@pytest.fixture(scope="module")
def target_predicates(made_run: tuple[Config, Report]) -> Counter[str]:
    """How many conditions of the made run ask for each predicate."""
    rows = published(made_run[0]).table("instructions").to_pylist()
    qualifiers = [one["qualifier"] for row in rows for one in row["conditions"]]
    return Counter(one["predicate"] for one in qualifiers if one is not None)
