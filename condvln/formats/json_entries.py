"""Read the entries of a JSON file, plain or gzip, one by one. The file is one large object, one large array, or JSON
lines.

A prediction file holds a pose for every step of every episode. Parsed as a whole it takes gigabytes; entry by entry,
the memory of one episode. Reading always ends with the last entry or with one error that names file and place: sizes of
entries and of decompressed files are limited, and so is the nesting.
"""

from __future__ import annotations

import gzip
import json
import re
import zlib
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, BinaryIO, Final, NoReturn, cast

import numpy as np
import orjson

from condvln.formats.json_document import MAX_DEPTH, is_shallow, nesting_depth
from condvln.formats.json_scan import DEPTH, IN_STRING, new_state, scan
from condvln.formats.regular_file import open_regular
from schemas.errors import FormatError, MissingFileError

__all__ = [
    "MAX_ENTRY_BYTES",
    "document",
    "entries",
    "first_character",
    "head",
    "json_lines",
    "nonstandard_number",
    "opened",
    "parsed",
]

MAX_ENTRY_BYTES: Final = 64 << 20
"""Size limit in bytes of one entry or line. An episode of 500 steps takes 50 kB."""

MAX_DOCUMENT_BYTES: Final = 1 << 30
"""Size limit in bytes of a file that is parsed as a whole (R2R files, results by episode). The largest known have 60
MB.
"""

MAX_RATIO: Final = 200
FREE_BYTES: Final = 256 << 20
"""A gzip file may decompress to this many bytes, or to `MAX_RATIO` times its size if that is more. Predictions compress
10:1, decompression bombs 1000:1.
"""

_BLOCK: Final = 1 << 20
_GZIP_MAGIC: Final = b"\x1f\x8b"
_BOM: Final = b"\xef\xbb\xbf"
_BLANKS: Final = b" \t\r\n"
_LONGEST_KEY: Final = 1 << 16
_REMEDY: Final = "Write the file again, as JSON in UTF-8"

# What may precede an entry of an object: a comma (not before the first), a key, a colon.
_KEY: Final = re.compile(rb'\s*(,?)\s*("[^"\\]*(?:\\.[^"\\]*)*")\s*:\s*(?=[\[{])', re.DOTALL)
_COMMA: Final = re.compile(rb"\s*(,?)\s*(?=[\[{])")
_ESCAPED_COLON: Final = b"\\u003"
_STRING: Final = re.compile(rb'"[^"\\]*(?:\\.[^"\\]*)*"', re.DOTALL)


class _Unpacked:
    """A gzip file read with a limit on its decompressed size."""

    def __init__(self, file: BinaryIO, path: Path) -> None:
        self._unpacked = cast(BinaryIO, gzip.GzipFile(fileobj=file))
        self._path = path
        self._limit = FREE_BYTES + MAX_RATIO * path.stat().st_size
        self._left = self._limit

    def read(self, size: int) -> bytes:
        return self._counted(self._unpacked.read(size))

    def readline(self, size: int) -> bytes:
        return self._counted(self._unpacked.readline(size))

    def _counted(self, data: bytes) -> bytes:
        self._left -= len(data)
        if self._left < 0:
            raise FormatError(
                f"the gzip file decompresses to more than {self._limit} bytes, {MAX_RATIO} times its own size",
                where=self._path,
                remedy="Write the file again; if it is valid, decompress it first",
            )
        return data


@contextmanager
def opened(path: Path) -> Iterator[BinaryIO]:
    """Return a context manager of a file opened for reading bytes, which are decompressed if the file is gzip. Callers
    must read pieces or lines of a limited size.

    Raises
    ------
    MissingFileError : the file does not exist, or can't be opened
    FormatError : a gzip file is truncated or damaged, or decompresses to more than the limit
    """
    try:
        with open_regular(path) as file:
            packed = file.read(2) == _GZIP_MAGIC
            file.seek(0)
            yield cast(BinaryIO, _Unpacked(file, path)) if packed else file
    except (EOFError, zlib.error, gzip.BadGzipFile) as error:
        raise FormatError(f"the gzip file is damaged ({error})", where=path, remedy="Copy or write it again") from error
    except (FileNotFoundError, NotADirectoryError) as error:
        raise MissingFileError("no such file", where=path, remedy="Check the path") from error
    except IsADirectoryError as error:
        raise MissingFileError("this is a folder, not a file", where=path, remedy="Name a file in it") from error
    except OSError as error:
        raise MissingFileError(
            f"the file can't be read ({error.strerror or error})", where=path, remedy="Check its path and permissions"
        ) from error


def head(path: Path, size: int) -> bytes:
    """Return the first ``size`` bytes of a file, after its byte order mark and leading white space."""
    with opened(path) as file:
        text = file.read(size).removeprefix(_BOM).lstrip(_BLANKS)
        while not text and (block := file.read(_BLOCK)):
            text = block.lstrip(_BLANKS)[:size]
    return text


def first_character(path: Path) -> str:
    """Return the first character that is not white space; empty if there is none."""
    text = head(path, 64)
    return chr(text[0]) if text else ""


def entries(path: Path) -> Iterator[tuple[str | None, bytes]]:
    """Yield (key, bytes) of each entry if the file is one object, or (None, bytes) of each entry if the file is one
    array.

    Every entry must itself be an object or an array.

    Raises
    ------
    FormatError : the file has another format or is truncated; the message names the entry
    """
    state = new_state()
    pending = bytearray()
    keyed: bool | None = None
    count = 0
    closed = False
    with opened(path) as file:
        first = True
        while block := file.read(_BLOCK):
            if keyed is None:
                block = bytes(pending + block).removeprefix(_BOM) if first else block
                pending.clear()
                if first and len(block) < len(_BOM) and _BOM.startswith(block):
                    pending += block  # part of a byte order mark
                    continue
                first = False
                block = block.lstrip(_BLANKS)
                if not block:
                    continue
                if block[:1] not in b"{[":
                    _refuse(path, "the start", "the file is neither a JSON object nor an array")
                keyed = block[:1] == b"{"
            if closed and block.strip():
                _refuse(path, f"after entry {count}", "there is text after the end of the JSON document")
            begin = 0
            for end in scan(np.frombuffer(block, np.uint8), state).tolist():
                pending += block[begin:end]
                begin = end
                if count == 0 and not closed:
                    pending = pending.lstrip(_BLANKS)
                key_and_value = bytes(pending[1:] if count == 0 else pending)
                pending.clear()
                if key_and_value.strip() == (b"}" if keyed else b"]"):
                    closed = True
                    if block[begin:].strip():
                        _refuse(path, f"after entry {count}", "there is text after the end of the JSON document")
                    break
                yield _entry(path, key_and_value, keyed, count)
                count += 1
            pending += block[begin:]
            if state[DEPTH] > MAX_DEPTH:
                _refuse(path, f"entry {count}", _too_deep(int(state[DEPTH])))
            if len(pending) > MAX_ENTRY_BYTES:
                _refuse(path, f"entry {count}", f"the entry is longer than {MAX_ENTRY_BYTES} bytes")
    if keyed is None:
        _refuse(path, "the start", "the file is empty")
    if not closed or state[DEPTH] != 0 or state[IN_STRING]:
        _refuse(path, f"after entry {count}", "the file is truncated, or its brackets do not match")


def _entry(path: Path, text: bytes, keyed: bool | None, count: int) -> tuple[str | None, bytes]:
    found = _KEY.match(text, 0, _LONGEST_KEY) if keyed else _COMMA.match(text)
    if found is None or (found[1] == b",") != (count > 0):
        _refuse(
            path, f"entry {count}", "the entry is neither an object nor an array, or a comma is missing or too many"
        )
    value = text[found.end() :]
    if not keyed:
        return None, value
    return str(parsed(found[2], path, f"the key of entry {count}")), value


def json_lines(path: Path) -> Iterator[tuple[int, bytes]]:
    """Yield the number (from 1) and bytes of each line that is not blank.

    Raises
    ------
    FormatError : a line is longer than `MAX_ENTRY_BYTES`
    """
    with opened(path) as file:
        number = 0
        while line := file.readline(MAX_ENTRY_BYTES + 1):
            number += 1
            if len(line) > MAX_ENTRY_BYTES:
                _refuse(path, f"line {number}", f"the line is longer than {MAX_ENTRY_BYTES} bytes")
            if number == 1:
                line = line.removeprefix(_BOM)
            if line.strip():
                yield number, line


def document(path: Path, *, nonfinite: bool = False) -> object:
    """Parse a file as one value.

    nonfinite : accept NaN and infinities, which Python's json module writes

    Raises
    ------
    MissingFileError, FormatError : as `opened` and `parsed`
    """
    pieces, size = [], 0
    with opened(path) as file:
        while block := file.read(_BLOCK):
            pieces.append(block)
            size += len(block)
            if size > MAX_DOCUMENT_BYTES:
                _refuse(path, "", f"the file is longer than {MAX_DOCUMENT_BYTES} bytes")
    return parsed(b"".join(pieces).removeprefix(_BOM), path, "", nonfinite=nonfinite)


def parsed(data: bytes, path: Path, place: str, *, item: str = "", nonfinite: bool = False) -> object:
    """Parse ``data`` as one value.

    Parameters
    ----------
    item : what the elements of the array in ``data`` are called in messages, such as ``step``
    nonfinite : accept NaN and infinities

    Raises
    ------
    FormatError : not JSON, nested deeper than `MAX_DEPTH`, a repeated key, or NaN or infinity; the message names the
        element
    """
    # Checked first, so that no parser recurses without limit.
    if not is_shallow(data) and (depth := nesting_depth(data)) > MAX_DEPTH:
        _refuse(path, place, _too_deep(depth))
    try:
        value = orjson.loads(data)
    except orjson.JSONDecodeError as error:
        value = _python_parsed(data, path, place)
        found = _nonfinite(value)
        if found is None:
            _refuse(path, place, f"the text is not JSON ({error})")
        steps, number = found
        if not nonfinite:
            at = next((step for step in steps if isinstance(step, int)), None)
            within = f"{item} {at}" if item and at is not None else ".".join(map(str, steps))
            where = ", ".join(part for part in (place, within) if part)
            _refuse(path, where, f"the number {number} is not finite, and JSON has no such number")
    _refuse_repeated_keys(value, data, path, place)
    return value


def nonstandard_number(data: bytes) -> str:
    """Return the first NaN or infinity in ``data`` as it is written there; empty if ``data`` has none. Python writes
    such numbers, although JSON does not allow them.
    """
    seen: list[str] = []
    with suppress(ValueError, RecursionError):
        json.loads(data, parse_constant=seen.append)
    return seen[0] if seen else ""


def _python_parsed(data: bytes, path: Path, place: str) -> Any:
    """Parse ``data`` with Python's own parser, which accepts NaN."""
    try:
        return json.loads(data.decode("utf-8"))
    except json.JSONDecodeError as error:
        at = f"line {error.lineno} column {error.colno}"
        _refuse(path, place, f"the text is not JSON ({error.msg}: {at})")
    except UnicodeDecodeError as error:
        _refuse(path, place, f"the text is not UTF-8 ({error.reason} at byte {error.start})")
    except (ValueError, RecursionError) as error:
        _refuse(path, place, f"the text is not JSON ({error})")


def _nonfinite(value: Any) -> tuple[tuple[str | int, ...], float] | None:
    """Return the keys that lead to the first non-finite number in `value`, and that number; None if all numbers are
    finite. The nesting must not exceed `MAX_DEPTH`.
    """
    if isinstance(value, float) and not np.isfinite(value):
        return (), value
    inside = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    for key, item in inside:
        if (found := _nonfinite(item)) is not None:
            return (key, *found[0]), found[1]
    return None


def _refuse_repeated_keys(value: Any, data: bytes, path: Path, place: str) -> None:
    """Raise a FormatError if an object in `data` repeats a key. The parser keeps only the last of equal keys, so `data`
    then has more colons outside of texts than `value` has keys.
    """
    colons = data.count(b":")
    if colons == _own_keys(value) or colons == _colons_written(value, data):
        return
    if _STRING.sub(b"", data).count(b":") > _all_keys(value):
        pairs: list[str] = []
        json.loads(data, object_pairs_hook=lambda items: pairs.extend(_repeated([key for key, _ in items])))
        _refuse(path, place, f"the key {pairs[0]!r:.60} is there twice in one object" if pairs else "a key is repeated")


def _colons_written(value: Any, data: bytes) -> int | None:
    """Return the number of colons in `value` as JSON. It can't be that of `data` if a key is repeated in `data`; None
    where it could be, since `data` may spell colons of texts as escapes, and where `value` can't be written.
    """
    if _ESCAPED_COLON in data:
        return None
    try:
        return orjson.dumps(value).count(b":")
    except TypeError:
        return None


def _own_keys(value: Any) -> int:
    """Return the number of keys of `value` if it is an object; if it is an array, of all objects that are its direct
    elements.
    """
    if isinstance(value, dict):
        return len(value)
    return sum(len(item) for item in value if type(item) is dict) if isinstance(value, list) else 0


def _all_keys(value: Any) -> int:
    count, waiting = 0, [value]
    while waiting:
        item = waiting.pop()
        if isinstance(item, dict):
            count += len(item)
            waiting.extend(item.values())
        elif isinstance(item, list):
            waiting.extend(item)
    return count


def _repeated(keys: list[str]) -> list[str]:
    seen: set[str] = set()
    return [key for key in keys if key in seen or seen.add(key)]  # type: ignore[func-returns-value]


def _too_deep(depth: int) -> str:
    return f"the text is nested {depth} levels deep; at most {MAX_DEPTH} are read"


def _refuse(path: Path, place: str, what: str) -> NoReturn:
    raise FormatError(what, where=path, place=place, remedy=_REMEDY)
