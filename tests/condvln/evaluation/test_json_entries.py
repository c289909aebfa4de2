"""Entries of a JSON file one by one: equal to parsing it whole, or one clear error."""

from __future__ import annotations

import gzip
import json
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from condvln.evaluation import json_entries
from condvln.evaluation.json_entries import entries, first_character, json_lines, parsed
from schemas.errors import FormatError, MissingFileError

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
        ("", "is empty"),
        ("  \n", "is empty"),
        ('"text"', "neither a JSON object nor an array"),
        ("[1]", "entry 0"),
        ('{"a": 1}', "entry 0"),
        ('{"a": [1], "b": 2}', "entry 1"),
        ('{"a": [1]', "cut short"),
        ('{"a": [1', "cut short"),
        ('{"a": ["x]}', "cut short"),
        ('{"a": [1]}}', "after its end"),
        ('{"a": [1]} {"b": [2]}', "after its end"),
        ('{"a" [1]}', "entry 0"),
        ('{"a": [1] "b": [2]}', "entry 1"),
        ("[[1] [2]]", "entry 1"),
        ("[,[1]]", "entry 0"),
        ("[[1],]", "entry 1"),
        ("[[1]}", "entry 1"),
    ],
)
def test_what_is_amiss_is_said(tmp_path: Path, text: str, says: str) -> None:
    path = tmp_path / "bad.json"
    path.write_text(text)
    with pytest.raises(FormatError, match=says) as caught:
        list(entries(path))
    assert "bad.json" in str(caught.value)


@pytest.mark.parametrize("name", ["NaN", "Infinity", "-Infinity"])
def test_pythons_own_constants_are_named(tmp_path: Path, name: str) -> None:
    with pytest.raises(FormatError, match=f"it holds {name}"):
        parsed(f"[{name}]".encode(), tmp_path, "entry")


def test_a_cut_gzip_and_no_file(tmp_path: Path) -> None:
    path = tmp_path / "cut.json.gz"
    path.write_bytes(gzip.compress(b'{"a": [1, 2, 3]}' * 50)[:-12])
    with pytest.raises(FormatError, match="damaged gzip"):
        list(entries(path))
    path.write_bytes(b"\x1f\x8bnot really")
    with pytest.raises(FormatError, match="damaged gzip"):
        list(entries(path))
    with pytest.raises(MissingFileError, match="no such file"):
        list(entries(tmp_path / "none.json"))
    with pytest.raises(MissingFileError, match="no such file"):
        first_character(tmp_path)


def test_lines(tmp_path: Path) -> None:
    path = tmp_path / "lines.jsonl"
    path.write_text('{"a": 1}\n\n  {"b": 2}')
    assert [(number, parsed(line, path, "")) for number, line in json_lines(path)] == [(1, {"a": 1}), (3, {"b": 2})]


def test_entries_are_handed_out_before_the_end_is_read(tmp_path: Path) -> None:
    path = tmp_path / "long.json"
    path.write_text('{"a": [1], ' + '"b": [' + "1," * (1 << 20) + "1]")  # never closed
    stream = entries(path)
    assert next(stream) == ("a", b"[1]")
