"""Houses as other tools write them: each is read as it is meant, or costs itself alone and is named."""

from __future__ import annotations

import gzip
import json
from pathlib import Path
from typing import Any

import pytest

from condvln.sources.registry import open_source
from schemas.errors import ConfigError, InputError
from tests.condvln.sources.procthor_houses import DATABASE, house


def door(**fields: Any) -> dict[str, Any]:
    """The door of a house with other fields; only these say whether it is open."""
    kept = {key: value for key, value in house()["doors"][0].items() if key not in ("openness", "open")}
    return {**kept, "assetId": "Doorway_1", **fields}


@pytest.fixture
def root(tmp_path: Path) -> Path:
    (tmp_path / "asset-database.json").write_text(json.dumps(DATABASE))
    (tmp_path / "sound.json").write_text(json.dumps(house()))
    return tmp_path


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"doors": None}, ""),
        ({"windows": None}, ""),
        ({"objects": None}, ""),
        ({"metadata": None}, ""),
        ({"metadata": {"schema": None, "warnings": None}}, ""),
        ({"rooms": None}, "rooms: an array is expected, not null"),
        ({"walls": None}, "walls: an array is expected, not null"),
        ({"doors": [door(openness="open")]}, "doors[0].openness: a number is expected, not text"),
        ({"doors": [door(open=1)]}, "doors[0].open: true or false is expected, not a number"),
        ({"doors": [door(room0=None, room1=None)]}, "doors[0]: it names no room"),
        ({"doors": [None]}, "doors[0]: an object is expected, not null"),
        ({"objects": [[]]}, "objects[0]: an object is expected, not an array"),
        ({"metadata": {"schema": "2.0.0"}}, "houses of schema '2.0.0' are not read"),
    ],
)
def test_nulls_in_place_of_lists(root: Path, change: dict[str, Any], says: str) -> None:
    (root / "odd.json").write_text(json.dumps(house() | change))
    source = open_source("procthor", root)
    handles = {handle.scene_id: handle.fault for handle in source.handles()}
    assert handles["sound"] is None
    if says:
        with pytest.raises(InputError) as caught:
            source.read("odd")
        assert says in str(caught.value)
        return
    assert handles["odd"] is None
    assert len(source.read("odd").rooms) == len(house()["rooms"])


def lists() -> dict[str, tuple[str, list[str], str]]:
    """Text of a file, the houses that are read from it, and words of the fault of the file or of a house."""
    one = json.dumps(house())
    return {
        "lines": (f"[\n{one},\n{one}\n]\n", ["odd-0", "odd-1"], ""),
        "null": (f"[{one}, null, {one}]", ["odd-0", "odd-2"], "odd.json#1"),
        "nested": (f"[[{one}], {one}]", ["odd-1"], "odd.json#0"),
        "comma": (f"[{one}, {one},]", ["odd-0", "odd-1"], "entry 2"),
        "two lists": (f"[{one}][{one}]", ["odd-0"], "text after the end"),
        "infinite": (f"[{one}, {one.replace('4', '1e999', 1)}]", ["odd-0"], "is not finite"),
        "deep": (f"[{one}, {'[' * 300 + ']' * 300}]", ["odd-0"], "nested more than 64 levels deep"),
        "not UTF-8": (f"[{one}, {one}]".replace("Table", "T\udcff"), [], "not UTF-8"),
    }


@pytest.mark.parametrize("kind", lists())
def test_lists_of_houses_with_something_odd(root: Path, kind: str) -> None:
    text, sound, says = lists()[kind]
    (root / "odd.json").write_bytes(text.encode(errors="surrogateescape"))
    source = open_source("procthor", root)
    handles = {handle.scene_id: handle.fault for handle in source.handles()}
    read, faults = [], [str(fault) for fault in handles.values() if fault is not None]
    for scene_id in sorted(name for name, fault in handles.items() if fault is None):
        try:
            source.read(scene_id)
            read.append(scene_id)
        except InputError as error:
            faults.append(str(error))
    assert read == [*sound, "sound"]
    assert bool(faults) == bool(says)
    assert any(says in fault for fault in faults) or not says


@pytest.mark.parametrize("lost", [1, 8, 9, 200])
def test_files_of_lines_that_end_early(root: Path, lost: int) -> None:
    """The houses before the end are read: those of whose text nothing is missing."""
    lines = [json.dumps(house() | {"seed": f"{k:x}" * 40_000}) for k in range(6)]
    data = gzip.compress("\n".join(lines).encode(), mtime=0)[:-lost]
    (root / "odd.jsonl.gz").write_bytes(data)
    source = open_source("procthor", root)
    handles = {handle.scene_id: handle.fault for handle in source.handles()}
    assert handles["sound"] is None
    assert "truncated" in str(handles["odd"])
    sound = [name for name, fault in handles.items() if fault is None]
    assert len(sound) >= 6  # the last line has no end
    assert all(len(source.read(name).objects) == 3 for name in sound)


def test_files_that_are_no_houses_are_passed_over_or_named(root: Path) -> None:
    for name, data in {
        "number.json": b"1",
        "text.json": b'"rooms walls"',
        "empty list.json": b"[]",
        "empty lines.jsonl": b"\n\n\n",
        "strings.jsonl": b'"a"\n"b"\n',
    }.items():
        (root / name).write_bytes(data)
    for name, data in {"nothing.json": b"", "half.json": b'{"rooms": [', "binary.jsonl": bytes(range(256))}.items():
        (root / name).write_bytes(data)
    source = open_source("procthor", root)
    faults = {handle.scene_id: handle.fault for handle in source.handles()}
    assert {name for name, fault in faults.items() if fault is not None} == {"nothing", "half", "binary"}
    assert {path for path, _ in source.passed_over()} == {
        "number.json", "text.json", "empty list.json", "empty lines.jsonl", "strings.jsonl"
    }  # fmt: skip
    assert faults["sound"] is None


def test_a_folder_of_nothing_else_is_refused(tmp_path: Path) -> None:
    (tmp_path / "asset-database.json").write_text(json.dumps(DATABASE))
    (tmp_path / "notes.json").write_text("[]")
    with pytest.raises(ConfigError, match=r"notes\.json was passed over"):
        open_source("procthor", tmp_path).handles()
