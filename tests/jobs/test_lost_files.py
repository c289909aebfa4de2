"""Files of the store that are lost or damaged: what is published and exported never shrinks for it."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest

from condvln.samples import make_samples
from factory.snapshot import Snapshot
from jobs.generate import run_generate
from jobs.plan import make_plan
from jobs.query import run_query
from jobs.rebuild import run_rebuild
from jobs.workspace import open_store
from schemas.config import Config, InstructionsConfig, SourceConfig
from schemas.errors import CorruptShardError

HOUSES = 2


@pytest.fixture(scope="module")
def houses(tmp_path_factory: pytest.TempPathFactory) -> Config:
    """Two made houses whose navmeshes are built, published and exported; read only."""
    folder = tmp_path_factory.mktemp("houses")
    make_samples(folder / "dataset", family="procthor", scenes=HOUSES, seed=3)
    config = Config(
        name="made",
        store=folder / "store",
        export=folder / "export",
        sources=(SourceConfig(family="procthor", root=folder / "dataset"),),
        instructions=InstructionsConfig(per_category={"simple": 3, "nested": 2}),
    )
    assert run_generate(config, inline=True).exit_code == 0
    return config


@pytest.fixture
def corpus(houses: Config, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Config:
    """A copy of it to damage."""
    monkeypatch.setattr("jobs.generate.warm_up", lambda *arguments, **settings: None)
    assert houses.export is not None
    shutil.copytree(houses.store, tmp_path / "store")
    shutil.copytree(houses.export, tmp_path / "export")
    return houses.model_copy(update={"store": tmp_path / "store", "export": tmp_path / "export"})


def files(folder: Path | None) -> dict[str, bytes]:
    """Bytes of every file of an export; the changelog tells the folder's history and is left out."""
    assert folder is not None
    return {
        str(path.relative_to(folder)): path.read_bytes()
        for path in folder.rglob("*")
        if path.is_file() and path.name != "CHANGELOG.md"
    }


def store_of(config: Config) -> Path:
    assert isinstance(config.store, Path)
    return config.store


def snapshot_id(config: Config) -> str:
    return Snapshot.open(open_store(config), config.name).snapshot_id


LOSSES = {
    "one scene unit": lambda store: shutil.rmtree(next((store / "units" / "scene").glob("*/*"))),
    "all units": lambda store: shutil.rmtree(store / "units"),
    "the snapshot": lambda store: shutil.rmtree(store / "snapshots"),
    "units and snapshot": lambda store: [shutil.rmtree(store / name) for name in ("units", "snapshots")],
}


@pytest.mark.parametrize("loss", LOSSES)
def test_generate_makes_lost_files_again_and_exports_the_same(corpus: Config, loss: str) -> None:
    before, exported = snapshot_id(corpus), files(corpus.export)
    assert json.loads((corpus.export / "export.json").read_bytes())["episodes"], "there is something to lose"
    LOSSES[loss](store_of(corpus))
    report = run_generate(corpus, inline=True)
    assert (report.exit_code, report.document["snapshot_id"]) == (0, before)
    assert snapshot_id(corpus) == before
    assert files(corpus.export) == exported


def test_a_plan_names_scenes_whose_files_are_lost(corpus: Config) -> None:
    LOSSES["one scene unit"](store_of(corpus))
    found = make_plan(corpus)
    assert (found.document["counts"], found.document["reasons"]) == ({"FRESH": HOUSES - 1, "STALE": 1}, {"damaged": 1})
    LOSSES["all units"](store_of(corpus))
    assert make_plan(corpus).document["counts"] == {"STALE": HOUSES}
    LOSSES["the snapshot"](store_of(corpus))
    assert any("manifest.json" in line for line in make_plan(corpus).lines)


@pytest.mark.parametrize("loss", LOSSES)
@pytest.mark.parametrize("if_changed", [False, True])
def test_a_rebuild_makes_lost_files_again(corpus: Config, loss: str, if_changed: bool) -> None:
    before, exported = snapshot_id(corpus), files(corpus.export)
    for _ in range(2):
        run_rebuild(corpus, inline=True, if_changed=if_changed)
    LOSSES[loss](store_of(corpus))
    report = run_rebuild(corpus, inline=True, if_changed=if_changed)
    assert (report.exit_code, report.document["snapshot_id"]) == (0, before)
    assert make_plan(corpus).document["counts"] == {"FRESH": HOUSES}
    assert files(corpus.export) == exported


def overwrite(path: Path) -> None:
    """Other bytes in the middle, the size as before."""
    data = path.read_bytes()
    third = len(data) // 3
    path.write_bytes(data[:third] + b"\xa5" * third + data[2 * third :])


def test_a_corrupt_snapshot_file_is_named_by_a_query_and_made_again_by_generate(corpus: Config) -> None:
    before, exported = snapshot_id(corpus), files(corpus.export)
    (path,) = Snapshot.open(open_store(corpus), "made").local_paths("episodes")
    overwrite(path)
    with pytest.raises(CorruptShardError, match=rf"{path.name}.*condvln rebuild CONFIG --verify"):
        run_query(corpus, "SELECT count(*) FROM episodes")
    report = run_generate(corpus, inline=True)
    assert (report.exit_code, report.document["snapshot_id"]) == (0, before)
    assert files(corpus.export) == exported
    assert run_query(corpus, "SELECT count(*) FROM episodes").document["rows"][0][0] > 0
