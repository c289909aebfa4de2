"""A smaller export needs a reason in the configuration, the code or the sources; else the one in place is kept."""

from __future__ import annotations

import json
import re
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import orjson
import pytest

from condvln.export.contents import INDEX, ORIGIN
from jobs.export import run_export
from jobs.export_origin import LOST_NAVMESH, Origin, SceneOrigin, refuse_losses
from jobs.generate import run_generate
from jobs.rebuild import run_rebuild
from jobs.report import Report
from schemas.config import Config, SplitsConfig
from schemas.errors import SmallerExportError

REF = "/store/refs/made.json"


def scene(**changes: Any) -> SceneOrigin:
    return SceneOrigin(status="ok", data="d1", key="k1", episodes=10).model_copy(update=changes)


def origin(**changes: Any) -> Origin:
    made = Origin(
        snapshot="s1",
        configuration={"seed": 0, "sources.replicacad": [{}]},
        code={"scene": 1, "select": 1},
        priors={"priors": "p1"},
        scenes={"replicacad/a": scene(), "replicacad/b": scene()},
    )
    return made.model_copy(update=changes)


def with_b(**changes: Any) -> dict[str, SceneOrigin]:
    return {"replicacad/a": scene(), "replicacad/b": scene(**changes)}


def placed(folder: Path, former: Origin | None, episodes: dict[str, int]) -> Path:
    (folder / INDEX).write_bytes(orjson.dumps({"episodes": episodes, "files": {}}))
    if former is not None:
        (folder / ORIGIN).write_bytes(former.as_bytes())
    return folder


ONLY_A = {"replicacad/a": scene()}


@pytest.mark.parametrize(
    ("now", "known", "said"),
    [
        (origin(configuration={"seed": 1, "sources.replicacad": [{}]}), {}, r"the configuration changed \(seed\)"),
        (origin(code={"scene": 2, "select": 1}), {}, r"the code changed \(scene\)"),
        (origin(code={"scene": 1, "select": 2}), {}, r"the code changed \(select\)"),
        (origin(scenes=ONLY_A), {}, r"no longer in their source: 1 scene \(replicacad/b\)"),
        (origin(scenes=with_b(data="d2", key="k2", episodes=4)), {}, "their files in the source changed: 1 scene"),
        (
            origin(scenes=with_b(data="d2", key="", episodes=0, status="quarantined")),
            {},
            "their files in the source changed: 1 scene",
        ),
        (origin(scenes=with_b(key="", episodes=0, status="skipped")), {}, "skipped now: 1 scene"),
        (origin(scenes=with_b(data="d2", key="k2")), {}, "their files in the source changed: 1 scene"),
        (origin(scenes={**with_b(), "replicacad/c": scene()}), {}, "new in the source: 1 scene"),
        (
            origin(scenes=with_b(key="k2", episodes=4), priors={"priors": "p2"}),
            {"renewed": True},
            "priors were renewed",
        ),
    ],
)
def test_reasons_that_are_accepted_and_said(tmp_path: Path, now: Origin, known: dict[str, Any], said: str) -> None:
    folder = placed(tmp_path, origin(), {"train": 12, "test": 8})
    (line,) = refuse_losses(folder, REF, now, {"train": 5, "test": 8}, {}, **known)
    assert line.startswith("the export is smaller than the one before, 20 → 13 episodes (train 12 → 5): ")
    assert re.search(said, line), line


@pytest.mark.parametrize(
    ("now", "known", "said"),
    [
        (origin(), {}, "neither the configuration nor the code nor a source changed"),
        (
            origin(snapshot="s2", scenes=with_b(episodes=4)),
            {},
            "fewer episodes in the snapshot although their inputs did not change: 1 scene",
        ),
        (
            origin(scenes=with_b(episodes=4), configuration={"seed": 1}),
            {},
            "fewer episodes in the snapshot although their inputs",
        ),
        (origin(scenes=with_b(key="", episodes=0, status="quarantined")), {}, "in quarantine although their files"),
        (
            origin(scenes=with_b(key="k2", episodes=4), priors={"priors": "p2"}),
            {},
            "fewer episodes although their files",
        ),
        (
            origin(scenes={}, configuration={"seed": 1, "sources.replicacad": [{}]}),
            {},
            "the source replicacad has no scene any more",
        ),
        (origin(scenes={}), {}, "the source replicacad has no scene any more; is its folder mounted"),
        (
            origin(scenes=ONLY_A),
            {"listed": lambda: {"replicacad/a", "replicacad/b"}},
            r"in their source and not in the snapshot: 1 scene \(replicacad/b\)",
        ),
        (
            origin(scenes=ONLY_A),
            {"listed": lambda: None},
            r"can't be listed here, so it is not known whether they hold 1 scene \(replicacad/b\)",
        ),
    ],
)
def test_what_is_refused(tmp_path: Path, now: Origin, known: dict[str, Any], said: str) -> None:
    folder = placed(tmp_path, origin(), {"train": 12, "test": 8})
    with pytest.raises(SmallerExportError, match=said) as caught:
        refuse_losses(folder, REF, now, {"train": 12, "test": 7}, {}, **known)
    assert "20 → 19 episodes (test 8 → 7)" in str(caught.value)
    assert "condvln export CONFIG --allow-shrink" in str(caught.value)
    assert REF in str(caught.value)
    assert caught.value.exit_code == 3


def test_an_empty_export_and_a_lost_navmesh_are_never_accepted(tmp_path: Path) -> None:
    folder = placed(tmp_path, origin(), {"train": 12, "test": 8})
    changed = origin(configuration={"seed": 1})
    with pytest.raises(SmallerExportError, match="it would be empty"):
        refuse_losses(folder, REF, changed, {"train": 0, "test": 0}, {})
    with pytest.raises(SmallerExportError, match="2 episodes are left out: the navmesh built for its scene is missing"):
        refuse_losses(folder, REF, changed, {"train": 12, "test": 9}, {LOST_NAVMESH: 2})


def test_a_larger_export_and_a_first_one_need_no_reason(tmp_path: Path) -> None:
    assert refuse_losses(tmp_path / "none", REF, origin(), {"train": 0}, {}) == []
    folder = placed(tmp_path, origin(), {"train": 12, "test": 8})
    assert refuse_losses(folder, REF, origin(), {"train": 12, "test": 8}, {}) == []
    assert refuse_losses(folder, REF, origin(snapshot="s2"), {"train": 12, "test": 9}, {}) == []


@pytest.mark.parametrize("state", ["missing", "cut", "changed"])
def test_without_a_record_of_the_former_one_nothing_smaller_is_accepted(tmp_path: Path, state: str) -> None:
    folder = placed(tmp_path, origin(), {"train": 12})
    path = folder / ORIGIN
    data = path.read_bytes()
    if state == "missing":
        path.unlink()
    else:
        path.write_bytes(data[:-30] if state == "cut" else data.replace(b'"k1"', b'"k2"'))
    with pytest.raises(SmallerExportError, match=r"no readable origin\.json"):
        refuse_losses(folder, REF, origin(configuration={}), {"train": 5}, {})
    assert refuse_losses(folder, REF, origin(), {"train": 12}, {}) == []


def test_the_size_of_one_without_a_record_is_that_of_its_manifests(tmp_path: Path) -> None:
    (tmp_path / "manifest").mkdir()
    (tmp_path / "manifest" / "train.jsonl").write_text("{}\n{}\n")
    with pytest.raises(SmallerExportError, match="2 → 1 episodes"):
        refuse_losses(tmp_path, REF, origin(), {"train": 1}, {})


# -- the commands ------------------------------------------------------------------------------------------------------


def files(folder: Path) -> dict[str, bytes]:
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def drop_scene(root: Path, name: str = "made_001") -> None:
    (path,) = root.rglob(f"{name}.scene_instance.json")
    path.unlink()


def test_a_ref_put_back_to_less_is_refused_and_a_removed_scene_is_not(
    dataset: Path, tmp_path: Path, configured: Callable[..., Config]
) -> None:
    """The first is a loss: the scene is in the source. The second is what the source says."""
    out = tmp_path / "out"
    config = configured(dataset, export=out, splits=SplitsConfig(bias="off"))
    assert run_generate(config, inline=True).exit_code == 0
    before, ref = files(out), Path(config.store) / "refs" / "made.json"
    full = ref.read_bytes()
    less = shutil.copytree(dataset, tmp_path / "less")
    drop_scene(less)
    other = configured(less, export=None, splits=SplitsConfig(bias="off"))
    run_generate(other, inline=True)
    with pytest.raises(SmallerExportError, match="in their source and not in the snapshot"):
        run_export(config)
    assert files(out) == before
    report = run_export(config, allow_shrink=True)
    assert any(line.startswith("allowed by --allow-shrink: an export of the snapshot") for line in report.lines)
    assert sum(report.document["episodes"].values()) < sum(json.loads(before[INDEX])["episodes"].values())
    # back to all of it: the same bytes, but for the history
    ref.write_bytes(full)
    run_export(config)
    after = files(out)
    assert {name for name in {*before, *after} if before.get(name) != after.get(name)} <= {"CHANGELOG.md"}
    drop_scene(dataset)
    report = run_generate(config, inline=True)
    assert report.exit_code == 0
    (line,) = report.document["export"]["smaller"]
    assert "no longer in their source: 1 scene (replicacad/made_001)" in line
    assert line in report.lines


def test_a_refused_export_ends_a_run_with_3_every_time(
    made_run: tuple[Config, Report], made_dataset: Path, tmp_path: Path, configured: Callable[..., Config]
) -> None:
    shutil.copytree(made_run[0].store, tmp_path / "store")
    config = configured(made_dataset, export=tmp_path / "out", splits=SplitsConfig(bias="off"))
    run_export(config)
    index = tmp_path / "out" / INDEX
    document = json.loads(index.read_text())
    document["episodes"]["train"] += 100
    index.write_text(json.dumps(document))
    before = files(tmp_path / "out")
    for run in (run_generate, run_rebuild, run_generate):
        report = run(config, inline=True)
        assert report.exit_code == 3
        assert "neither the configuration nor the code nor a source changed" in report.document["export_refused"]
        assert any(line.startswith("REFUSED: ") for line in report.lines)
        assert files(tmp_path / "out") == before
    assert run_rebuild(config, inline=True, if_changed=True).exit_code == 3


def test_empty_splits_are_said_with_their_reason(made_run: tuple[Config, Report], tmp_path: Path) -> None:
    config = made_run[0].model_copy(
        update={"export": tmp_path / "out", "splits": SplitsConfig(bias="off", per_cell=2, scenes={"test": ("*/*",)})}
    )
    report = run_export(config)
    assert set(report.document["empty_splits"]) == {"train", "val_seen", "val_unseen"}
    for split in ("train", "val_unseen"):
        why = "a scene is in one split only, and all scenes with episodes (2) are in test"
        assert any(line.startswith(f"note: split {split} has no episodes: {why}") for line in report.lines)
        assert f"* `{split}` is empty: {why}" in (tmp_path / "out" / "README.md").read_text()
    left = report.document["left_out"]
    total = sum(left.values())
    assert total
    assert any(line.startswith(f"{total} of ") and "episodes are in no split: " in line for line in report.lines)
