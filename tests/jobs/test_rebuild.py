"""The scheduled rebuild: what changed is redone and exported, nothing to do ends at once, two at once do no harm."""

from __future__ import annotations

import fcntl
import json
import os
import shutil
import subprocess
import sys
import time
from contextlib import nullcontext
from pathlib import Path
from typing import Any

import pytest

from factory.snapshot import Snapshot
from jobs.generate import run_generate
from jobs.progress import RunProgress
from jobs.rebuild import run_rebuild
from jobs.report import Report
from jobs.status import target_status
from jobs.watch import Watch
from jobs.workspace import CACHE_VARIABLE, Target, open_store
from schemas.config import Config, InstructionsConfig, KeepConfig, SourceConfig, SplitsConfig
from tests.once import made_once

UNCHANGED = "no name, size or time of a file changed"


def configuration(folder: Path, **changes: object) -> Config:
    return Config(
        name="made",
        store=folder / "store",
        sources=(SourceConfig(family="replicacad", root=folder / "dataset"),),
        instructions=InstructionsConfig(per_category={"simple": 2}),
    ).model_copy(update=changes)


def settle(folder: Path) -> None:
    """Let every file look as if it was written a minute ago."""
    then = time.time() - 60
    for path in folder.rglob("*"):
        os.utime(path, (then, then))


@pytest.fixture(scope="module")
def first(made_dataset: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[Config, Report]:
    """Two scenes, published and exported by a first rebuild; read only."""

    def make(folder: Path) -> tuple[Config, Report]:
        shutil.copytree(made_dataset, folder / "dataset")
        settle(folder / "dataset")
        config = configuration(folder, export=folder / "export")
        return config, run_rebuild(config, inline=True, if_changed=True)

    return made_once(tmp_path_factory, "first rebuild", make)


@pytest.fixture
def corpus(first: tuple[Config, Report], tmp_path: Path) -> Config:
    """A copy of it to change, without an export."""
    config, _ = first
    for name in ("dataset", "store"):
        shutil.copytree(folder_of(config).parent / name, tmp_path / name)
    return configuration(tmp_path)


def folder_of(config: Config) -> Path:
    assert isinstance(config.store, Path)
    return config.store


def scene_file(config: Config, scene: str) -> Path:
    (path,) = config.sources[0].root.rglob(f"{scene}.scene_instance.json")
    return path


def change(config: Config, scene: str = "made_001") -> None:
    """Take one object out of a scene."""
    path = scene_file(config, scene)
    document = json.loads(path.read_text())
    document["object_instances"].pop()
    path.write_text(json.dumps(document))
    settle(config.sources[0].root)


def files(folder: Path) -> dict[str, bytes]:
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def rebuild(config: Config, **how: Any) -> Report:
    return run_rebuild(config, inline=True, if_changed=True, **how)


def test_the_first_rebuild_publishes_exports_and_leaves_a_log(first: tuple[Config, Report]) -> None:
    config, report = first
    assert (report.exit_code, report.document["published"]) == (0, True)
    assert report.document["plan"]["counts"] == {"MISSING": 2}
    assert report.document["export"]["snapshot"] == report.document["snapshot_id"]
    (record,) = (folder_of(config) / "runs").iterdir()
    (log,) = (folder_of(config) / "logs").iterdir()
    assert log.stem == record.stem
    lines = [json.loads(line) for line in log.read_text().splitlines()]
    made = {line["unit"] for line in lines if line["event"] == "unit" and line["status"] == "ok"}
    assert made == {"replicacad/made_000", "replicacad/made_001"}
    assert (lines[-1]["event"], lines[-1]["snapshot_id"]) == ("end", report.document["snapshot_id"])


def test_nothing_to_do_ends_at_once_and_says_so(corpus: Config, monkeypatch: pytest.MonkeyPatch) -> None:
    before = {path: data for path, data in files(folder_of(corpus)).items() if not path.startswith(".")}
    # By contents, and then by times alone, when nothing is even listed.
    for said in ("2 scenes are as published", UNCHANGED):
        report = rebuild(corpus)
        assert (report.exit_code, report.document["changed"]) == (0, False)
        assert said in report.lines[0]
        monkeypatch.setattr("jobs.pipeline.listed_units", None)
    after = {path: data for path, data in files(folder_of(corpus)).items() if not path.startswith(".")}
    assert after == before, "neither record nor log"


def test_looking_whether_anything_changed_loads_no_science(corpus: Config, tmp_path: Path) -> None:
    rebuild(corpus)
    (tmp_path / "run.yaml").write_text(corpus.model_dump_json())
    script = (
        "import sys; from pathlib import Path; from jobs.configuration import load_config;"
        "from jobs.rebuild import run_rebuild; config = load_config(Path('run.yaml'));"
        "print(run_rebuild(config, if_changed=True).lines[0]);"
        "print([name for name in ('ray', 'numba', 'scipy', 'trimesh', 'shapely') if name in sys.modules])"
    )
    command = [sys.executable, "-c", script]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=True)
    said, loaded = done.stdout.strip().splitlines()
    assert (UNCHANGED in said, loaded) == (True, "[]")


def test_one_changed_scene_is_redone_alone(corpus: Config) -> None:
    rebuild(corpus)
    # Touched, yet the same bytes: read once more, and then trusted again.
    os.utime(scene_file(corpus, "made_000"), (time.time() - 30, time.time() - 30))
    assert "as published" in rebuild(corpus).lines[0]
    assert UNCHANGED in rebuild(corpus).lines[0]
    change(corpus)
    report = rebuild(corpus)
    assert report.document["plan"] == {"counts": {"FRESH": 1, "STALE": 1}, "reasons": {"data": 1}}
    assert (report.document["counts"]["made"], report.document["counts"]["fresh"]) == (1, 1)
    assert "changed: data of 1" in report.lines[0]


def test_scenes_go_and_come_back(corpus: Config) -> None:
    before = Snapshot.open(open_store(corpus), "made").snapshot_id
    path = scene_file(corpus, "made_001")
    path.rename(path.with_suffix(".away"))
    gone = rebuild(corpus)
    assert (gone.document["counts"]["made"], gone.document["counts"]["fresh"]) == (0, 1)
    assert "1 removed" in gone.lines[0]
    path.with_suffix(".away").rename(path)
    back = rebuild(corpus)
    assert back.document["snapshot_id"] == before
    assert (back.document["counts"]["made"], back.document["counts"]["reused"]) == (0, 1)


def test_an_export_is_written_again_when_it_is_lost_cut_or_asked_for_otherwise(
    corpus: Config, first: tuple[Config, Report], tmp_path: Path
) -> None:
    wanted = corpus.model_copy(update={"export": tmp_path / "export"})
    assert first[0].export is not None
    whole = files(first[0].export)
    assert rebuild(wanted).document["export"]
    assert files(tmp_path / "export") == whole
    assert UNCHANGED in rebuild(wanted).lines[0]
    (tmp_path / "export" / "README.md").write_text("cut")
    report = rebuild(wanted)
    assert (report.exit_code, report.document["published"]) == (0, False)
    assert files(tmp_path / "export") == whole
    other = rebuild(wanted.model_copy(update={"splits": SplitsConfig(per_cell=1)}))
    assert other.document["counts"]["made"] == 0
    assert other.document["export"]["episodes"] != report.document["export"]["episodes"]


def test_a_quarantined_scene_is_said_by_every_rebuild_until_it_is_corrected(corpus: Config) -> None:
    path = scene_file(corpus, "made_001")
    sound = path.read_bytes()
    path.write_bytes(sound[: len(sound) // 2])
    settle(corpus.sources[0].root)
    assert rebuild(corpus).exit_code == 3
    # By contents, by times alone, without --if-changed, with every file read again, and as often as it is asked.
    for how in ({}, {}, {"if_changed": False}, {"verify": True}, {}):
        again = run_rebuild(corpus, inline=True, **{"if_changed": True, **how})
        assert (again.exit_code, again.document["changed"], again.document["quarantined"]) == (3, False, 1)
        (line,) = again.lines
        assert "nothing to do" in line
        assert "1 still in quarantine" in line
    assert run_generate(corpus, inline=True).exit_code == 3
    (record,) = target_status(Target.of(corpus)).document["quarantine"]
    assert (record["unit_id"], record["attempts"], record["cause"]) == ("replicacad/made_001", 1, "input")
    # Tried again when someone asks, and when it is corrected.
    assert rebuild(corpus, retry_quarantined=True).exit_code == 3
    path.write_bytes(sound)
    settle(corpus.sources[0].root)
    corrected = rebuild(corpus)
    assert (corrected.exit_code, corrected.document["counts"]["ok"]) == (0, 2)
    assert target_status(Target.of(corpus)).document["quarantine"] == []


@pytest.mark.soak
def test_old_snapshots_are_swept_and_what_the_ref_names_stays(corpus: Config) -> None:
    keep = corpus.model_copy(update={"keep": KeepConfig(snapshots=2, grace_hours=0)})
    ids = [Snapshot.open(open_store(corpus), "made").snapshot_id]
    for _ in range(2):
        change(corpus)
        report = rebuild(keep)
        ids.append(report.document["snapshot_id"])
    assert {path.name for path in (folder_of(corpus) / "snapshots").iterdir()} == set(ids[1:])
    assert report.document["swept"]["snapshots"] == ids[:1]
    assert Snapshot.open(open_store(corpus), "made").table("episodes").num_rows
    assert "as published" in run_rebuild(keep, inline=True).lines[0], "no unit that is needed went"
    # Within the grace period, and when it is not wanted, nothing goes.
    change(corpus)
    assert rebuild(corpus).document["swept"]["files"] == 0
    change(corpus)
    assert "swept" not in rebuild(corpus.model_copy(update={"keep": KeepConfig(sweep=False)})).document


def test_priors_are_renewed_when_asked(corpus: Config) -> None:
    (pin,) = (folder_of(corpus) / "pins").rglob("made.json")
    before = pin.read_text()
    path = scene_file(corpus, "made_001")
    path.rename(path.with_suffix(".away"))
    rebuild(corpus)
    assert pin.read_text() == before, "one scene less does not make others stale"
    rebuild(corpus, renew_priors=True)
    assert json.loads(pin.read_text())["tables"]["priors"]["units"] == 1


def test_of_two_on_one_machine_the_second_leaves_it_to_the_first(corpus: Config) -> None:
    change(corpus)
    ref = (folder_of(corpus) / "refs" / "made.json").read_bytes()
    with open(folder_of(corpus) / ".rebuild-made.lock", "w") as held:
        fcntl.flock(held, fcntl.LOCK_EX)
        report = rebuild(corpus)
        assert (report.exit_code, report.document["changed"]) == (0, False)
        assert "under way" in report.lines[0]
        assert (folder_of(corpus) / "refs" / "made.json").read_bytes() == ref
    assert rebuild(corpus).document["published"]


def test_of_two_on_two_machines_one_publishes_and_the_other_says_so(
    corpus: Config, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The other machine publishes after this one's last scene and before its ref."""
    rival = corpus.model_copy(update={"sources": (SourceConfig(family="replicacad", root=tmp_path / "other"),)})
    shutil.copytree(corpus.sources[0].root, tmp_path / "other")
    scene_file(rival, "made_001").unlink()
    change(corpus)
    met: list[str] = []
    phase = RunProgress.phase

    def interrupted(self: RunProgress, name: str, total: int, seconds: float, workers: int = 1) -> None:
        phase(self, name, total, seconds, workers)
        if name == "files" and not met:
            met.append("")
            met[0] = run_generate(rival, inline=True).document["snapshot_id"]

    monkeypatch.setattr(RunProgress, "phase", interrupted)
    # Another machine does not see this one's lock.
    monkeypatch.setattr("jobs.generate.alone_in_store", lambda config: nullcontext())
    wanted = corpus.model_copy(update={"export": tmp_path / "export"})
    report = rebuild(wanted)
    assert (report.exit_code, report.document["published"]) == (0, False)
    assert "another run published" in report.lines[1]
    assert Snapshot.open(open_store(corpus), "made").snapshot_id == met[0]
    assert not (tmp_path / "export").exists(), "who publishes exports"
    # And the next time everything is there already; only publishing is left.
    again = rebuild(corpus)
    assert (again.document["published"], again.document["counts"]["made"]) == (True, 0)


def test_an_object_store_holds_and_exports_the_same(
    first: tuple[Config, Report], s3_bucket: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(CACHE_VARIABLE, str(tmp_path / "cache"))
    config, report = first
    away = config.model_copy(update={"store": s3_bucket, "export": tmp_path / "export"})
    done = rebuild(away)
    assert (done.exit_code, done.document["snapshot_id"]) == (0, report.document["snapshot_id"])
    assert config.export is not None
    assert files(tmp_path / "export") == files(config.export)
    assert UNCHANGED in rebuild(away).lines[0]
    assert len([*open_store(away).list("logs")]) == len([*open_store(away).list("runs")]) == 1
    assert not [*(tmp_path / "cache").rglob("*.jsonl")], "the log moved to the store"


def same_size_and_time(path: Path, data: bytes) -> None:
    """Write other bytes of the same length, and leave the file's times as they are."""
    stat = path.stat()
    assert len(data) == stat.st_size
    path.write_bytes(data)
    os.utime(path, ns=(stat.st_atime_ns, stat.st_mtime_ns))


def test_verify_finds_other_bytes_of_the_same_size_and_time_in_a_source(corpus: Config) -> None:
    rebuild(corpus)
    path = scene_file(corpus, "made_001")
    before = path.read_bytes()
    document = json.loads(before)
    document["object_instances"].pop()
    changed = json.dumps(document).encode()
    same_size_and_time(path, changed + b" " * (len(before) - len(changed)))
    unseen = rebuild(corpus)
    assert UNCHANGED in unseen.lines[0], "what --if-changed compares, it says"
    seen = run_rebuild(corpus, inline=True, verify=True)
    assert seen.document["plan"] == {"counts": {"FRESH": 1, "STALE": 1}, "reasons": {"data": 1}}
    assert (seen.document["counts"]["made"], seen.document["published"]) == (1, True)
    # The new hash is what is known from now on.
    assert "as published" in run_rebuild(corpus, inline=True).lines[0]
    same_size_and_time(path, before)
    assert run_rebuild(corpus, inline=True, verify=True).document["counts"]["reused"] == 1
    assert Snapshot.open(open_store(corpus), "made").snapshot_id != seen.document["snapshot_id"]


def test_verify_writes_an_export_again_whose_bytes_differ(
    corpus: Config, first: tuple[Config, Report], tmp_path: Path
) -> None:
    wanted = corpus.model_copy(update={"export": tmp_path / "export"})
    rebuild(wanted)
    whole = files(tmp_path / "export")
    path = tmp_path / "export" / "README.md"
    same_size_and_time(path, b"?" + whole["README.md"][1:])
    assert UNCHANGED in rebuild(wanted).lines[0]
    assert run_rebuild(wanted, inline=True, verify=True).exit_code == 0
    assert files(tmp_path / "export") == whole


def test_a_refused_export_is_said_by_every_rebuild(corpus: Config, tmp_path: Path) -> None:
    for path in (tmp_path / "export", tmp_path / "state"):
        path.mkdir()
    (tmp_path / "export" / "export.json").write_text('{"files": {}, "snapshot": "s"}')
    wanted = corpus.model_copy(update={"export": tmp_path / "export"})
    store = open_store(wanted)
    assert Watch(wanted, store, tmp_path / "state").remember("s", 0, "the bias gate refuses it") != ""
    for _ in range(2):  # an export that is not written again keeps its verdict
        assert Watch(wanted, store, tmp_path / "state").remember("s", 0) == "the bias gate refuses it"
    assert Watch(wanted, store, tmp_path / "state").remember("s", 0, "") == ""


@pytest.mark.parametrize("beside", [False, True])
def test_an_export_does_not_outlast_the_graphs_it_was_made_of(tmp_path: Path, beside: bool) -> None:
    """Connectivity is no input of a scene: only the export reads it, wherever it stands."""
    graphs = tmp_path / ("graphs" if beside else "dataset/connectivity")
    for folder in (graphs, tmp_path / "dataset", tmp_path / "export", tmp_path / "state"):
        folder.mkdir(parents=True, exist_ok=True)
    (graphs / "a_connectivity.json").write_text("[]")
    (tmp_path / "export" / "export.json").write_text('{"files": {}, "snapshot": "s"}')
    settle(tmp_path)
    source = SourceConfig(family="mp3d", root=tmp_path / "dataset", connectivity=graphs if beside else None)
    config = Config(name="x", store=tmp_path / "store", export=tmp_path / "export", sources=(source,))

    def watch() -> Watch:
        return Watch(config, open_store(config), tmp_path / "state")

    watch().remember("s", 0)
    assert watch().unchanged
    assert watch().export_stands("s")
    (graphs / "a_connectivity.json").write_text("[[]]")
    assert not watch().unchanged
    assert not watch().export_stands("s")
