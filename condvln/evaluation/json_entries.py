"""The entries of a JSON file one by one: of one huge object, one huge array, or of JSON lines; plain or gzip.

A prediction file holds a pose of every step of every episode; parsed whole it takes gigabytes, entry by entry what one
episode takes.
"""

from __future__ import annotations

import gzip
import json
import re
import zlib
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import BinaryIO, Final, NoReturn, cast

import numpy as np
import orjson

from condvln.evaluation.kernels.json_scan import DEPTH, IN_STRING, new_state, scan
from schemas.errors import FormatError, MissingFileError

__all__ = ["entries", "first_character", "json_lines", "nonstandard_number", "opened", "parsed"]

_BLOCK: Final = 1 << 20
_GZIP_MAGIC: Final = b"\x1f\x8b"

# What may stand before an entry of an object: a comma (not before the first), a key, a colon.
_KEY: Final = re.compile(rb'\s*(,?)\s*("(?:[^"\\]|\\.)*")\s*:\s*(?=[\[{])', re.DOTALL)
_COMMA: Final = re.compile(rb"\s*(,?)\s*(?=[\[{])")


@contextmanager
def opened(path: Path) -> Iterator[BinaryIO]:
    """A file of bytes, unpacked where it is gzip.

    Raises
    ------
    MissingFileError : there is none
    FormatError : a gzip file that is cut or damaged
    """
    try:
        with path.open("rb") as file:
            packed = file.read(2) == _GZIP_MAGIC
            file.seek(0)
            if packed:
                with gzip.GzipFile(fileobj=file) as unpacked:
                    yield cast(BinaryIO, unpacked)
            else:
                yield file
    except (FileNotFoundError, IsADirectoryError, NotADirectoryError) as error:
        raise MissingFileError("no such file", where=path, remedy="Check the path") from error
    except (EOFError, zlib.error, gzip.BadGzipFile) as error:
        raise FormatError(f"damaged gzip ({error})", where=path, remedy="Copy or write the file again") from error


def first_character(path: Path) -> str:
    """First character that is not white space; empty for a file of none."""
    with opened(path) as file:
        while block := file.read(_BLOCK):
            text = block.lstrip(b" \t\r\n\xef\xbb\xbf")
            if text:
                return chr(text[0])
    return ""


def entries(path: Path) -> Iterator[tuple[str | None, bytes]]:
    """Key and bytes of each entry of the one object in a file, or None and bytes of each entry of the one array.

    Every entry must itself be an object or an array.

    Raises
    ------
    FormatError : not such a file, or cut; the message says at which entry
    """
    state = new_state()
    pending = bytearray()
    keyed: bool | None = None
    count = 0
    closed = False
    with opened(path) as file:
        while block := file.read(_BLOCK):
            if keyed is None:
                block = block.lstrip(b" \t\r\n\xef\xbb\xbf")
                if not block:
                    continue
                if block[:1] not in b"{[":
                    _refuse(path, "the start", "is neither a JSON object nor an array")
                keyed = block[:1] == b"{"
            if closed and block.strip():
                _refuse(path, f"after entry {count}", "has something after its end")
            begin = 0
            for end in scan(np.frombuffer(block, np.uint8), state).tolist():
                pending += block[begin:end]
                begin = end
                if count == 0 and not closed:
                    pending = pending.lstrip(b" \t\r\n")
                key_and_value = bytes(pending[1:] if count == 0 else pending)
                pending.clear()
                if key_and_value.strip() == (b"}" if keyed else b"]"):
                    closed = True
                    if block[begin:].strip():
                        _refuse(path, f"after entry {count}", "has something after its end")
                    break
                yield _entry(path, key_and_value, keyed, count)
                count += 1
            pending += block[begin:]
    if keyed is None:
        _refuse(path, "the start", "is empty")
    if not closed or state[DEPTH] != 0 or state[IN_STRING]:
        _refuse(path, f"after entry {count}", "is cut short or its brackets do not match")


def _entry(path: Path, text: bytes, keyed: bool | None, count: int) -> tuple[str | None, bytes]:
    found = (_KEY if keyed else _COMMA).match(text)
    if found is None or (found[1] == b",") != (count > 0):
        _refuse(path, f"entry {count}", "has something other than an object or an array, or a comma is amiss")
    value = text[found.end() :]
    if not keyed:
        return None, value
    return str(parsed(found[2], path, f"the key of entry {count}")), value


def json_lines(path: Path) -> Iterator[tuple[int, bytes]]:
    """Number (from 1) and bytes of each line that is not blank."""
    with opened(path) as file:
        for number, line in enumerate(file, start=1):
            if line.strip():
                yield number, line


def parsed(data: bytes, path: Path, place: str) -> object:
    """The value in ``data``.

    Raises
    ------
    FormatError : not JSON; NaN and infinities are named
    """
    try:
        return orjson.loads(data)
    except orjson.JSONDecodeError as error:
        name = nonstandard_number(data)
        why = f"it holds {name}, which no position can be" if name else str(error)
        _refuse(path, place, f"is not JSON ({why})")


def nonstandard_number(data: bytes) -> str:
    """The first NaN or infinity in ``data``, which Python writes and JSON does not know; empty where there is none."""
    seen: list[str] = []
    with suppress(ValueError, RecursionError):
        json.loads(data, parse_constant=seen.append)
    return seen[0] if seen else ""


def _refuse(path: Path, place: str, what: str) -> NoReturn:
    raise FormatError(f"{place} {what}", where=path, remedy="Write the predictions again, one entry an episode")
