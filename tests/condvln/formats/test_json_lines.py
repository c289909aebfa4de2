"""Lines of plain and packed files, in turn and at random, and files that are broken or bombs."""

from __future__ import annotations

import gzip
import io
import tempfile
import tracemalloc
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from condvln.formats import json_lines
from condvln.formats.dataset_root import DatasetRoot
from condvln.formats.json_lines import MAX_LINE_BYTES, JsonLines
from schemas.errors import FormatError, MissingFileError


def lines_of(folder: Path, name: str, data: bytes) -> JsonLines:
    (folder / name).write_bytes(data)
    return JsonLines(DatasetRoot(folder), name)


@given(st.lists(st.binary(max_size=30).map(lambda b: b.replace(b"\n", b"")), max_size=8), st.booleans(), st.booleans())
def test_lines_in_turn_and_at_random_are_the_same(content: list[bytes], packed: bool, ended: bool) -> None:
    data = b"\n".join(content) + (b"\n" if ended else b"")
    expected = [(i, line) for i, line in enumerate(data.split(b"\n")) if line.strip()]
    with tempfile.TemporaryDirectory() as folder:
        name = "h.jsonl.gz" if packed else "h.jsonl"
        file = lines_of(Path(folder), name, gzip.compress(data) if packed else data)
        assert list(file.lines()) == expected
        fresh = JsonLines(DatasetRoot(Path(folder)), name)
        assert [(i, fresh.line(i)) for i, _ in expected[::-1]] == expected[::-1]


@pytest.mark.parametrize("packed", [False, True])
def test_a_large_file_is_read_from_its_checkpoints(tmp_path: Path, packed: bool) -> None:
    rng = np.random.default_rng(0)  # noise, so that the file stays large when packed
    content = [bytes(f"{i}:", "ascii") + rng.bytes(i % 2000).hex().encode() for i in range(9000)]
    data = b"\n".join(content)
    half = len(data) // 2
    # Two gzip members, as appended files have them, cut in the middle of a line.
    stored = gzip.compress(data[:half]) + gzip.compress(data[half:]) + b"\0" * 512 if packed else data
    file = lines_of(tmp_path, "h.jsonl.gz" if packed else "h.jsonl", stored)
    assert [line for _, line in file.lines()] == content
    assert len(file._checkpoints) >= 4
    for number in (8999, 0, 4500, 4499, 8998, 1, 7000):
        assert file.line(number) == content[number]
    with pytest.raises(MissingFileError, match="this line is empty"):
        file.line(9000)


def test_a_changed_file_is_seen(tmp_path: Path) -> None:
    file = lines_of(tmp_path, "h.jsonl", b"a\nb\n")
    assert file.line(1) == b"b"
    (tmp_path / "h.jsonl").write_bytes(b"longer\nthan before\n")
    assert file.line(1) == b"than before"


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (b"", "truncated"),
        (b"plain", "not a valid gzip"),
        (gzip.compress(b"abc\n" * 1000, mtime=0)[:-9], "truncated"),
        (gzip.compress(b"abc\n" * 1000, mtime=0)[:20] + b"\xff" * 40, "not a valid gzip"),
        (gzip.compress(b"abc", mtime=0) + gzip.compress(b"abc", mtime=0)[:10] + b"\xff" * 40, "not a valid gzip"),
    ],
)
def test_broken_gzip_is_refused(tmp_path: Path, data: bytes, message: str) -> None:
    file = lines_of(tmp_path, "h.jsonl.gz", data)
    with pytest.raises(FormatError, match=message) as caught:
        list(file.lines())
    assert caught.value.where == str(tmp_path / "h.jsonl.gz")
    with pytest.raises(FormatError, match=message):
        file.line(2000)


def test_lines_before_a_break_are_read(tmp_path: Path) -> None:
    content = [bytes([i]).hex().encode() * 40_000 for i in range(20)]
    noise = np.random.default_rng(0).bytes(300_000).hex().encode()
    data = gzip.compress(b"\n".join([*content, noise, b"after"]), mtime=0)
    file = lines_of(tmp_path, "h.jsonl.gz", data[: len(data) // 2])
    for _ in range(2):  # from the start, then with the lines known
        assert [file.line(number) for number in (19, 0)] == [content[19], content[0]]
        with pytest.raises(FormatError, match="truncated"):
            file.line(20)
        with pytest.raises(FormatError, match="truncated"):
            list(file.lines())


@pytest.mark.parametrize("more", [b"more", b"\0" * 600 + b"x", b"\0" * 600, b"\r\n"])
def test_bytes_after_the_gzip_data_are_ignored_and_noted(tmp_path: Path, more: bytes) -> None:
    file = lines_of(tmp_path, "h.jsonl.gz", gzip.compress(b"a\nb", mtime=0) + more)
    assert list(file.lines()) == [(0, b"a"), (1, b"b")]
    assert file.line(1) == b"b"
    assert file.trailing == bool(more.strip(b"\0"))


def bomb(pattern: bytes, size: int) -> bytes:
    """A gzip file that unpacks to `size` bytes of a pattern."""
    buffer = io.BytesIO()
    with gzip.GzipFile(fileobj=buffer, mode="wb", mtime=0) as stream:
        block = pattern * ((1 << 20) // len(pattern))
        for _ in range(size >> 20):
            stream.write(block)
    return buffer.getvalue()


def test_a_bomb_of_one_line_is_refused_in_bounded_memory(tmp_path: Path) -> None:
    file = lines_of(tmp_path, "bomb.jsonl.gz", bomb(b"x", 200 << 20))
    tracemalloc.start()
    try:
        with pytest.raises(FormatError, match="longer than"):
            list(file.lines())
        assert tracemalloc.get_traced_memory()[1] < 2 * MAX_LINE_BYTES
    finally:
        tracemalloc.stop()


def test_a_bomb_of_lines_is_refused(tmp_path: Path) -> None:
    with pytest.raises(FormatError, match="more than 500000 lines"):
        list(lines_of(tmp_path, "bomb.jsonl.gz", bomb(b"\n", 2 << 20)).lines())


def test_a_bomb_of_many_long_lines_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(json_lines, "FREE_BYTES", 4 << 20)
    file = lines_of(tmp_path, "bomb.jsonl.gz", bomb(b"x" * 4095 + b"\n", 40 << 20))
    with pytest.raises(FormatError, match="decompress to more than"):
        for _ in file.lines():
            pass


def test_a_missing_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(MissingFileError, match="can't be opened"):
        list(JsonLines(DatasetRoot(tmp_path), "none.jsonl").lines())
