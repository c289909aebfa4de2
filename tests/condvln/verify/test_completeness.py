"""An export is whole or its faults are named: each file of it, damaged in each way."""

from __future__ import annotations

import gzip
import json
import shutil
from collections.abc import Callable
from pathlib import Path

import orjson
import pytest

from condvln.export.contents import INDEX, ORIGIN, document_digest
from condvln.export.snapshot import export_snapshot
from condvln.verify.files import find_faults, row_counts
from schemas.config import SplitsConfig
from tests.made_snapshot import made_snapshot

CONFIG = SplitsConfig(bias="off")
SCENES = ["apt_0", "v3_sc0_staging_00", "v3_sc1_staging_00"]


def with_origin(folder: Path, snapshot: str) -> Path:
    origin = {"snapshot": snapshot, "scenes": {"replicacad/apt_0": {"status": "ok"}}}
    (folder / ORIGIN).write_bytes(orjson.dumps({**origin, "digest": document_digest(origin)}))
    return folder


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("whole")
    tables = made_snapshot({"replicacad": SCENES}, per_category=4)
    export_snapshot(tables, out, CONFIG)
    return with_origin(out, tables.id)


@pytest.fixture(scope="module")
def older(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("older")
    tables = made_snapshot({"replicacad": SCENES[:2]}, per_category=3)
    export_snapshot(tables, out, CONFIG)
    return with_origin(out, tables.id + "older")


@pytest.fixture
def folder(whole: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(whole, tmp_path / "export"))


def without_a_row(data: bytes, name: str) -> bytes:
    """A row, an episode or a member less; the file stays well formed."""
    if name.endswith(".gz"):
        return gzip.compress(without_a_row(gzip.decompress(data), name.removesuffix(".gz")), mtime=0)
    if name.endswith((".jsonl", ".md", ".yaml")):
        return b"".join(data.splitlines(keepends=True)[1:])
    if not name.endswith(".json"):
        return data[:-1]
    document = orjson.loads(data)
    within = document
    for key in ("episodes", "files", "scenes"):
        if isinstance(document, dict) and document.get(key):
            within = document[key]
            break
    within.pop(next(iter(within)) if isinstance(within, dict) else 0)
    return orjson.dumps(document)


DAMAGES: dict[str, Callable[[Path, Path], None]] = {
    "removed": lambda path, old: path.unlink(),
    "emptied": lambda path, old: path.write_bytes(b"") and None,
    "truncated": lambda path, old: path.write_bytes(path.read_bytes()[: path.stat().st_size // 2]) and None,
    "a row less": lambda path, old: path.write_bytes(without_a_row(path.read_bytes(), path.name)) and None,
    "older": lambda path, old: shutil.copyfile(old, path) and None,
}


def test_a_whole_export_has_no_fault(whole: Path) -> None:
    assert [*find_faults(whole)] == []
    index = json.loads((whole / INDEX).read_text())
    assert row_counts(whole) == index["episodes"]
    assert min(index["episodes"].values()) == 0 < max(index["episodes"].values())


@pytest.mark.parametrize("damage", DAMAGES)
def test_each_file_damaged_in_each_way_is_named(whole: Path, older: Path, folder: Path, damage: str) -> None:
    names = sorted(path.relative_to(whole).as_posix() for path in whole.rglob("*") if path.is_file())
    assert len(names) > 40
    tried = 0
    for name in names:
        path, before = folder / name, (whole / name).read_bytes()
        if damage == "older" and not (older / name).exists():
            continue
        try:
            DAMAGES[damage](path, older / name)
        except (IndexError, StopIteration):
            continue  # an empty document has no row to lose
        after = path.read_bytes() if path.exists() else None
        if after != before:
            tried += 1
            faults = [*find_faults(folder)]
            assert faults, f"{name} {damage}"
            assert any(fault.file == name for fault in faults) or name in (INDEX, ORIGIN), faults
        path.write_bytes(before)
    assert tried > len(names) // 2


def test_files_that_the_record_does_not_list_are_named(folder: Path) -> None:
    (folder / "notes.txt").write_text("the user's own files are no fault")
    assert [*find_faults(folder)] == []
    shutil.copyfile(folder / "manifest" / "train.jsonl", folder / "manifest" / "more.jsonl")
    assert [str(fault) for fault in find_faults(folder)] == ["manifest/more.jsonl: is not listed in export.json"]


def test_a_row_less_in_manifest_and_record_is_still_a_fault_of_the_counts(folder: Path) -> None:
    """One who repairs the hash of a file and forgets the counts is found out too."""
    index = json.loads((folder / INDEX).read_text())
    split = next(split for split, count in index["episodes"].items() if count)
    index["episodes"][split] += 1
    index["digest"] = document_digest(index)
    (folder / INDEX).write_text(json.dumps(index))
    (fault,) = find_faults(folder)
    assert str(fault) == (
        f"manifest/{split}.jsonl: holds {index['episodes'][split] - 1} episodes, "
        f"export.json says {index['episodes'][split]}"
    )
