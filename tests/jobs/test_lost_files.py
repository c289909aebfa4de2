"""Files of the store that are lost or damaged: what is published and exported never shrinks for it."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from factory.snapshot import Snapshot
from jobs.generate import run_generate
from jobs.plan import make_plan
from jobs.rebuild import run_rebuild
from jobs.report import Report
from jobs.workspace import alone, open_store
from schemas.config import Config
from schemas.errors import StoreError
from tests.jobs.conftest import made_config
from tests.once import made_once

HOUSES = 2


@pytest.fixture(scope="module")
def houses(tmp_path_factory: pytest.TempPathFactory) -> Config:
    """Two made houses whose navmeshes are built, published and exported; read only."""

    def make(folder: Path) -> Config:
        config = made_config(folder, "procthor", HOUSES, episodes={"simple": 3, "nested": 2}, name="made")
        assert run_generate(config, inline=True).exit_code == 0
        return config

    return made_once(tmp_path_factory, "lost files", make)


@pytest.fixture
def corpus(houses: Config, tmp_path: Path) -> Config:
    """A copy of it to damage."""
    assert houses.export is not None
    shutil.copytree(houses.store, tmp_path / "store")
    shutil.copytree(houses.export, tmp_path / "export")
    return houses.model_copy(update={"store": tmp_path / "store", "export": tmp_path / "export"})


def files(folder: Path | None) -> dict[str, bytes]:
    """Bytes of every file of an export; the changelog tells the folder's history and is left out."""
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


def generate(config: Config) -> Report:
    return run_generate(config, inline=True)


def rebuild_if_changed(config: Config) -> Report:
    return run_rebuild(config, inline=True, if_changed=True)


@pytest.mark.parametrize("loss", ["one scene unit", "units and snapshot"])
@pytest.mark.parametrize("run", [generate, rebuild_if_changed])
def test_lost_files_are_made_again_and_the_export_stays(corpus: Config, run: Callable[..., Report], loss: str) -> None:
    before, exported = snapshot_id(corpus), files(corpus.export)
    assert json.loads((corpus.export / "export.json").read_bytes())["episodes"], "there is something to lose"
    for _ in range(2 * (run is not generate)):  # so that a rebuild remembers what it left
        run(corpus)
    LOSSES[loss](store_of(corpus))
    report = run(corpus)
    assert (report.exit_code, report.document["snapshot_id"], snapshot_id(corpus)) == (0, before, before)
    assert make_plan(corpus).document["counts"] == {"FRESH": HOUSES}
    assert files(corpus.export) == exported


def test_a_plan_names_scenes_whose_files_are_lost(corpus: Config) -> None:
    LOSSES["one scene unit"](store_of(corpus))
    found = make_plan(corpus)
    assert (found.document["counts"], found.document["reasons"]) == ({"FRESH": HOUSES - 1, "STALE": 1}, {"damaged": 1})
    LOSSES["all units"](store_of(corpus))
    assert make_plan(corpus).document["counts"] == {"STALE": HOUSES}
    LOSSES["the snapshot"](store_of(corpus))
    assert any("manifest.json" in line for line in make_plan(corpus).lines)


def test_the_second_of_two_generates_learns_it_before_any_work(corpus: Config, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("jobs.generate.listed_units", None)
    with alone(store_of(corpus), corpus.name) as held:
        assert held
        with pytest.raises(StoreError, match=r"another generate or rebuild of 'made'.*Wait"):
            run_generate(corpus, inline=True)


def test_a_read_only_store_does_not_refuse_where_nothing_is_to_be_done(corpus: Config, tmp_path: Path) -> None:
    """By times alone and by contents."""
    command = [sys.executable]
    if os.getuid() == 0:  # root writes where modes forbid it, unless it gives that up
        if shutil.which("setpriv") is None:
            pytest.skip("as root this needs setpriv")
        command = ["setpriv", "--bounding-set=-dac_override", sys.executable]
    run_rebuild(corpus, inline=True)
    (tmp_path / "run.yaml").write_text(corpus.model_dump_json())
    script = (
        "from pathlib import Path; from jobs.configuration import load_config; from jobs.rebuild import run_rebuild;"
        "from jobs.workspace import Target;"
        "from jobs.plan import make_plan; from jobs.query import query_target; from jobs.status import target_status;"
        "config = load_config(Path('run.yaml'));"
        "print(os.access('store', os.W_OK));"
        "print(run_rebuild(config, if_changed=True).lines[0]); print(run_rebuild(config).lines[0]);"
        "print(make_plan(config).lines[0]); print(target_status(Target.of(config)).exit_code);"
        "print(query_target(Target.of(config), 'SELECT count(*) > 0 FROM episodes').document['rows'])"
    )
    paths = [path for path in [tmp_path, *tmp_path.rglob("*")] if not path.is_symlink()]
    for path in paths:
        path.chmod(0o555 if path.is_dir() else 0o444)
    command += ["-c", f"import os; {script}"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    for path in paths:
        path.chmod(0o755 if path.is_dir() else 0o644)
    assert done.returncode == 0, done.stderr[-2000:]
    said = done.stdout.splitlines()
    assert said[0] == "False"
    assert said[1].startswith("nothing to do")
    assert said[2] == f"nothing to do: {HOUSES} scenes are as published"
    assert said[3:] == [f"{HOUSES} fresh", "0", "[[True]]"]
