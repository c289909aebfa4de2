"""``condvln verify`` of an export that is not whole, empty, or not the published one."""

from __future__ import annotations

import gzip
import json
import os
import re
import shutil
import socket
from collections.abc import Callable, Iterator
from contextlib import nullcontext
from pathlib import Path
from typing import Any

import pytest

import jobs.verify
from condvln.export.contents import CERTIFICATES, INDEX, SUMMARY
from condvln.formats.regular_file import open_regular
from condvln.verify import Certificate
from jobs.export import run_export
from jobs.report import Report
from jobs.verify import verify_export
from schemas.config import Config
from tests.jobs.test_full_disk import files_of_at_most
from tests.once import made_once


@pytest.fixture(scope="module")
def made(made_run: tuple[Config, Report], tmp_path_factory: pytest.TempPathFactory) -> Config:
    """The made configuration with an export; read only."""

    def make(folder: Path) -> Config:
        config = made_run[0].model_copy(update={"export": folder / "out"})
        assert run_export(config).exit_code == 0
        return config

    return made_once(tmp_path_factory, "verified", make)


@pytest.fixture
def folder(made: Config, tmp_path: Path) -> Path:
    assert made.export is not None
    return Path(shutil.copytree(made.export, tmp_path / "out"))


def faults(config: Config, folder: Path) -> list[str]:
    report = verify_export(config, folder)
    assert report.exit_code == (3 if report.document["faults"] else 0)
    summary = json.loads((folder / CERTIFICATES / SUMMARY).read_text())
    assert summary["faults"] == report.document["faults"]
    return [f"{fault['file']}: {fault['what']}" for fault in report.document["faults"]]


def largest(folder: Path) -> str:
    counts: dict[str, int] = json.loads((folder / INDEX).read_text())["episodes"]
    return max(counts, key=lambda split: counts[split])


def test_a_whole_export_is_proven(made: Config, folder: Path) -> None:
    assert faults(made, folder) == []


def test_an_empty_export_is_no_success(made: Config, folder: Path) -> None:
    for path in [*folder.glob("manifest/*.jsonl")]:
        path.write_bytes(b"")
    found = faults(made, folder)
    assert found[-1] == "manifest: the export holds no episodes, so nothing is proven"
    assert any(f"manifest/{largest(folder)}.jsonl: has 0 bytes" in fault for fault in found)


def test_a_scene_that_nobody_proves_is_no_success(made: Config, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A fault of ours, not of the export: whatever is proven then, it is not all."""
    whole = verify_export(made, folder).document
    real = jobs.verify.prove_export

    def lossy(*arguments: Any) -> Iterator[Certificate]:
        found = list(real(*arguments))
        return (one for one in found if one.scene_id != found[0].scene_id)

    monkeypatch.setattr("jobs.verify.prove_export", lossy)
    report = verify_export(made, folder)
    assert report.exit_code == 3
    assert 0 < report.document["episodes"] < whole["episodes"]
    missing = whole["episodes"] - report.document["episodes"]
    told = [re.search(r"(\d+) got no certificate", fault["what"]) for fault in report.document["faults"]]
    assert sum(int(one[1]) for one in told if one) == missing


def test_nothing_of_nothing_is_no_success(made: Config, folder: Path) -> None:
    """Also where the export's own record says that it is empty, and no snapshot is at hand."""
    for path in [*folder.iterdir()]:
        shutil.rmtree(path) if path.is_dir() else path.unlink()
    (folder / "manifest").mkdir()
    (folder / "manifest" / "train.jsonl").touch()
    (folder / "vlnce" / "train").mkdir(parents=True)
    (folder / "vlnce" / "train" / "train.json.gz").write_bytes(gzip.compress(b'{"episodes":[]}'))
    (folder / "vlnce" / "train" / "train_gt.json.gz").write_bytes(gzip.compress(b"{}"))
    (folder / INDEX).write_text('{"files": {}, "episodes": {}}')
    report = verify_export(made, folder, without_store=True)
    assert report.exit_code == 3
    assert "INCOMPLETE: manifest: the export holds no episodes, so nothing is proven" in report.lines


def test_an_export_of_another_snapshot_is_named(made: Config, folder: Path) -> None:
    from condvln.export.contents import document_digest

    index = json.loads((folder / INDEX).read_text())
    index["snapshot"] = "f" * 32
    index["digest"] = document_digest(index)
    (folder / INDEX).write_text(json.dumps(index))
    found = faults(made, folder)
    assert any("export.json: the export is of snapshot ffff" in fault for fault in found)


def test_a_snapshot_that_is_damaged_or_gone_is_named(made: Config, folder: Path, tmp_path: Path) -> None:
    store = Path(shutil.copytree(Path(made.store), tmp_path / "store"))
    config = made.model_copy(update={"store": store})
    part = next(store.glob("snapshots/*/episodes/*/part-*.parquet"))
    part.write_bytes(part.read_bytes()[:-100])
    (fault,) = faults(config, folder)
    assert "the published snapshot can't be read" in fault
    assert part.name in fault
    (store / "refs" / "made.json").unlink()
    (fault,) = faults(config, folder)
    assert "nothing is published as 'made'" in fault
    assert verify_export(config, folder, without_store=True).exit_code == 0


def test_an_episode_that_the_snapshot_does_not_have_is_named(made: Config, folder: Path) -> None:
    path = folder / "manifest" / f"{largest(folder)}.jsonl"
    lines = path.read_bytes().splitlines(keepends=True)
    row = json.loads(lines[0])
    path.write_bytes(lines[0].replace(str(row["episode_id"]).encode(), b"123456789") + b"".join(lines[1:]))
    assert f"manifest/{path.name}: episode 123456789 is not in the snapshot" in faults(made, folder)


def test_an_export_of_a_file_a_scene_is_proven_too(made: Config, tmp_path: Path) -> None:
    splits = made.splits.model_copy(update={"sharded": True})
    config = made.model_copy(update={"export": tmp_path / "sharded", "splits": splits})
    run_export(config)
    assert faults(config, tmp_path / "sharded") == []
    assert verify_export(config, tmp_path / "sharded").document["proven"] > 0
    shard = next((tmp_path / "sharded").glob("vlnce/*/content/*.json.gz"))
    shard.unlink()
    assert any(
        fault.startswith(f"vlnce/{shard.parent.parent.name}/content/") for fault in faults(config, tmp_path / "sharded")
    )


@pytest.mark.parametrize("refusal", ["a file in the way", "no new files", "a full disk", "old certificates stay"])
def test_where_no_report_can_be_written_the_result_is_still_told(refusal: str, made: Config, folder: Path) -> None:
    """The result is printed, one line names the file, and the exit code is 1: not all was done, and no proof failed."""
    certificates, old = folder / CERTIFICATES, b'{"of": "an earlier run"}'
    if refusal == "a file in the way":
        certificates.write_text("here first")
    elif refusal == "no new files":
        certificates.symlink_to("/proc")  # for root, too
    elif refusal == "old certificates stay":
        certificates.mkdir()
        (certificates / "train.jsonl").write_bytes(old)
        (certificates / f".{largest(folder)}.jsonl.part").mkdir()
    with files_of_at_most(500) if refusal == "a full disk" else nullcontext():
        report = verify_export(made, folder)
    document = report.document
    assert document["proven"] == document["episodes"] > 0
    assert document["faults"] == []
    assert (document["unwritten"]["file"], report.exit_code) == (f"{CERTIFICATES}/{largest(folder)}.jsonl", 1)
    assert report.lines[0].startswith(f"{document['proven']:,} of {document['episodes']:,} episodes proven")
    (line,) = [line for line in report.lines if line.startswith("NOT WRITTEN: ")]
    assert line.startswith(f"NOT WRITTEN: {certificates / largest(folder)}.jsonl: can't be written: ")
    assert line.endswith("files of an earlier run lie there") == (refusal == "old certificates stay")
    assert not any(line.startswith("certificates in") for line in report.lines)
    if refusal == "a full disk":
        assert [*certificates.iterdir()] == []
    if refusal == "old certificates stay":
        assert (certificates / "train.jsonl").read_bytes() == old
        # A proof that fails is told by the exit code, whether the report can be written or not.
        (folder / "ansr" / largest(folder) / f"{largest(folder)}.json.gz").unlink()
        assert verify_export(made, folder).exit_code == 3


def fifo(path: Path) -> str:
    os.mkfifo(path)
    return "a FIFO"


def unix_socket(path: Path) -> str:
    with socket.socket(socket.AF_UNIX) as made:
        made.bind(os.path.relpath(path))  # a socket's whole path may be too long
    return "a socket"


def endless(path: Path) -> str:
    path.symlink_to("/dev/zero")
    return "a character device"


def own_target(path: Path) -> str:
    path.symlink_to(path.name)
    return "symbolic links"


SPECIAL = [fifo, unix_socket, endless, own_target]


@pytest.mark.parametrize(
    ("name", "spoil"),
    [
        ("export.json", fifo),
        ("origin.json", unix_socket),
        ("manifest/{}.jsonl", endless),
        ("vlnce/{0}/{0}.json.gz", own_target),
        ("ansr/{0}/{0}.json.gz", fifo),
    ],
)
def test_what_is_no_file_is_a_fault_that_names_it(
    name: str, spoil: Callable[[Path], str], made: Config, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Neither waited for nor read without end; every kind is refused where a file is opened, see the next test."""
    monkeypatch.chdir(folder)
    own = folder / name.format(largest(folder))
    own.unlink()
    spoil(own)
    report = verify_export(made, folder)
    assert report.exit_code == 3
    assert own.relative_to(folder).as_posix() in [fault["file"] for fault in report.document["faults"]]


@pytest.mark.parametrize("spoil", SPECIAL, ids=lambda f: f.__name__)
def test_a_file_that_is_opened_is_a_regular_file(
    spoil: Callable[[Path], str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    words = spoil(tmp_path / "x")
    with pytest.raises(OSError, match=words):
        open_regular(tmp_path / "x")


def test_a_name_that_is_not_utf_8_is_a_fault_that_can_be_printed(made: Config, folder: Path) -> None:
    name = os.fsencode(folder / "manifest") + b"/\xff.jsonl"
    shutil.copy(folder / "manifest" / f"{largest(folder)}.jsonl", os.fsdecode(name))
    assert faults(made, folder) == [r"manifest/\xff.jsonl: is not listed in export.json"]
