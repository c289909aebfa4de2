"""Entries of a JSON file one by one: equal to parsing it whole, or one clear error."""

from __future__ import annotations

import gzip
import json
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from condvln.formats import json_entries
from condvln.formats.json_entries import entries, first_character, json_lines, parsed
from schemas.errors import FormatError, MissingFileError, TruncatedError

scalars = st.none() | st.booleans() | st.integers(-(10**6), 10**6) | st.floats(allow_nan=False, allow_infinity=False)
texts = st.text(max_size=12) | st.sampled_from(['"', "\\", '\\"', "[", "]", "{", "}", ",", ":", "\\\\"])
values = st.recursive(
    scalars | texts,
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(texts, inner, max_size=4),
    max_leaves=12,
)
containers = st.lists(values, max_size=4) | st.dictionaries(texts, values, max_size=4)


def read(path: Path) -> Any:
    found = list(entries(path))
    if found and found[0][0] is None:
        return [parsed(data, path, "") for _, data in found]
    return {key: parsed(data, path, "") for key, data in found}


@pytest.mark.costly
@given(
    st.lists(containers, min_size=1, max_size=5) | st.dictionaries(texts, containers, max_size=5),
    st.sampled_from([None, 1]),
    st.booleans(),
    st.integers(1, 40),
    st.booleans(),
)
def test_equal_to_parsing_the_whole(
    tmp_path_factory: pytest.TempPathFactory, document: Any, indent: int | None, packed: bool, block: int, ascii: bool
) -> None:
    path = tmp_path_factory.getbasetemp() / "entries.json"
    data = ("\n " + json.dumps(document, indent=indent, ensure_ascii=ascii) + " \n").encode()
    path.write_bytes(gzip.compress(data) if packed else data)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(json_entries, "_BLOCK", block)
        assert read(path) == document


@pytest.mark.parametrize("text", ["[]", "{}", " [ ] ", "\ufeff{}"])
def test_nothing_inside(tmp_path: Path, text: str) -> None:
    path = tmp_path / "a.json"
    path.write_text(text)
    assert list(entries(path)) == []


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("", "the file is empty"),
        ("\ufeff", "the file is empty"),
        ('"text"', "neither a JSON object nor an array"),
        ("[1]", "entry 0"),
        ('{"a": 1}', "entry 0"),
        ('{"a": [1]', "truncated"),
        ('{"a": [1, tru', "truncated"),
        ('{"a": ["\\ud83', "truncated"),
        ('{"a": [1}', "entry 0: not JSON"),
        ('{"a": [1}' + " " * 99 + ', "b": [2]}', "entry 0: not JSON"),
        ('{"a": ' + "[" * 100_000, "entry 0: the document is nested more than 64 levels deep"),
        ('{"a": ["x]}', "truncated"),
        ('{"a": [1]}}', "after the end of the JSON document"),
        ('{"a": [1] "b": [2]}', "entry 1"),
        ("[,[1]]", "entry 0"),
        ("[[1]}", "entry 1"),
    ],
)
def test_what_is_amiss_is_said(tmp_path: Path, text: str, says: str) -> None:
    path = tmp_path / "bad.json"
    path.write_text(text)
    with pytest.raises(FormatError, match=says) as caught:
        list(entries(path))
    assert "bad.json" in str(caught.value)


def test_a_cut_gzip_and_no_file(tmp_path: Path) -> None:
    path = tmp_path / "cut.json.gz"
    path.write_bytes(gzip.compress(b'{"a": [1, 2, 3]}')[:-12])
    with pytest.raises(TruncatedError, match="the gzip file ends early"):
        list(entries(path))
    path.write_bytes(b"\x1f\x8bnot really")
    with pytest.raises(FormatError, match="the gzip file is damaged"):
        list(entries(path))
    with pytest.raises(MissingFileError, match="no such file"):
        list(entries(tmp_path / "none.json"))
    with pytest.raises(MissingFileError, match="this is a folder, not a file"):
        first_character(tmp_path)


@pytest.mark.parametrize(
    ("text", "found"),
    [
        ('{"episodes": [{"a": 1}, {"b": [2]}], "more": 1}', ['{"a": 1}', '{"b": [2]}']),
        (' { "episodes" : [ ] }', []),
        ('[{"a": 1}]', "does not begin with the key 'episodes'"),
        ('{"other": [], "episodes": []}', "does not begin with the key 'episodes'"),
        ('{"episodes": 1}', "neither a JSON object nor an array"),
        ('{"episodes": [{"a": 1}, ', "truncated"),
    ],
)
def test_entries_inside_of_the_first_value(tmp_path: Path, text: str, found: list[str] | str) -> None:
    path = tmp_path / "episodes.json.gz"
    path.write_bytes(gzip.compress(text.encode()))
    if isinstance(found, list):
        assert [entry for _, entry in entries(path, inside="episodes")] == found
        return
    with pytest.raises(FormatError, match=found):
        list(entries(path, inside="episodes"))


def test_a_list_may_hold_scalars(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "list.json"
    path.write_text('[12345, null, {"a": 1}, "x", -1.5e3]')
    for block in (1, 3, 64):
        monkeypatch.setattr(json_entries, "_BLOCK", block)
        assert [text for _, text in entries(path, scalars=True)] == ["12345", "null", '{"a": 1}', '"x"', "-1.5e3"]


def test_lines(tmp_path: Path) -> None:
    path = tmp_path / "lines.jsonl"
    path.write_text('{"a": 1}\n\n  {"b": 2}')
    assert [(number, parsed(line, path, "")) for number, line in json_lines(path)] == [(1, {"a": 1}), (3, {"b": 2})]


def test_entries_are_handed_out_before_the_end_is_read(tmp_path: Path) -> None:
    path = tmp_path / "long.json"
    path.write_text('{"a": [1], ' + '"b": [' + "1," * (1 << 20) + "1]")  # never closed
    stream = entries(path)
    assert next(stream) == ("a", "[1]")


def test_the_byte_order_mark_is_passed_over_however_the_blocks_fall(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "bom.json"
    path.write_bytes(b'\xef\xbb\xbf {"a": [1]}')
    for block in range(1, 8):
        monkeypatch.setattr(json_entries, "_BLOCK", block)
        assert list(entries(path)) == [("a", "[1]")]
    assert [line for _, line in json_lines(path)] == [b' {"a": [1]}']
    assert first_character(path) == "{"


def test_a_gzip_bomb_is_stopped_at_its_bound(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "bomb.json"
    path.write_bytes(gzip.compress(b'{"a": [' + b" " * (8 << 20) + b"]}"))
    assert list(entries(path))
    monkeypatch.setattr(json_entries, "FREE_BYTES", 1 << 20)
    for read_all in (lambda: list(entries(path)), lambda: list(json_lines(path)), lambda: json_entries.document(path)):
        with pytest.raises(FormatError, match="the gzip file decompresses to more than"):
            read_all()


def test_an_entry_and_a_line_without_end_are_stopped(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(json_entries, "MAX_ENTRY_BYTES", 1000)
    monkeypatch.setattr(json_entries, "_BLOCK", 100)
    path = tmp_path / "long.json"
    path.write_text('{"a": [1], "b": [' + "1," * 1000)
    with pytest.raises(FormatError, match="entry 1: the entry is longer than 1000 bytes"):
        list(entries(path))
    with pytest.raises(FormatError, match="line 1: the line is longer than 1000 bytes"):
        list(json_lines(path))
