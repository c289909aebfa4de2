"""Read JSON files of users and agents, plain or gzip: as a whole, line by line, or entry by entry where the file is one
large object or array.

A prediction file holds a pose for every step of every episode. Parsed as a whole it takes gigabytes; entry by entry,
the memory of one episode. Reading always ends with the last entry or with one error that names file and place: sizes of
entries and of decompressed files are limited, and so is the nesting.
"""

from __future__ import annotations

import codecs
import gzip
import json
import re
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, BinaryIO, Final, NoReturn, cast

from condvln.formats.json_document import TOO_DEEP, parsed_value
from condvln.formats.regular_file import open_regular
from schemas.errors import FormatError, MissingFileError, TruncatedError

__all__ = [
    "MAX_ENTRY_BYTES",
    "document",
    "entries",
    "first_character",
    "head",
    "json_lines",
    "opened",
    "parsed",
    "read_unpacked",
]

MAX_ENTRY_BYTES: Final = 64 << 20
"""Size limit in bytes of one line, and in characters of one entry. An episode of 500 steps takes 50 kB."""

MAX_DOCUMENT_BYTES: Final = 1 << 30
"""Size limit in bytes of a file that is parsed as a whole (R2R files, results by episode). The largest known have 60
MB.
"""

LARGEST: Final = 2 << 30
"""Size limit in bytes of a split that is read as a whole."""

MAX_RATIO: Final = 200
FREE_BYTES: Final = 256 << 20
"""A gzip file may decompress to this many bytes, or to `MAX_RATIO` times its size if that is more. Houses compress 7:1,
predictions 10:1, decompression bombs 1000:1.
"""

GZIP_MAGIC: Final = b"\x1f\x8b"
_BLOCK: Final = 1 << 20
_BOM: Final = b"\xef\xbb\xbf"
_BLANKS: Final = b" \t\r\n"
_NOT_BLANK: Final = re.compile(r"[^ \t\r\n]")
_MARKS: Final = frozenset(",:[]{}")
_LONGEST_MARK: Final = 16
"""Characters of the longest token that is not a text: where less is left, a number or an error may be due to the end of
the block.
"""
_REMEDY: Final = "Write the file again, as JSON in UTF-8"


class _Unpacked:
    """A gzip file read with a limit on its decompressed size. Where it is cut off, all before the cut is read first."""

    def __init__(self, file: BinaryIO, path: Path) -> None:
        self._unpacked = gzip.GzipFile(fileobj=file)
        self._path = path
        self._limit = FREE_BYTES + MAX_RATIO * path.stat().st_size
        self._left = self._limit

    def read(self, size: int) -> bytes:
        pieces: list[bytes] = []
        while size > 0:
            try:
                pieces.append(self._unpacked.read1(size))
            except EOFError:
                if not pieces:
                    raise
                break
            size -= len(pieces[-1])
            if not pieces[-1]:
                break
        return self._counted(b"".join(pieces))

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
    TruncatedError : a gzip file ends early; what comes before the end was read
    FormatError : a gzip file is damaged, or decompresses to more than the limit
    """
    try:
        with open_regular(path) as file:
            packed = file.read(2) == GZIP_MAGIC
            file.seek(0)
            yield cast(BinaryIO, _Unpacked(file, path)) if packed else file
    except EOFError as error:
        raise TruncatedError("the gzip file ends early", where=path, remedy="Copy or write it again") from error
    except (zlib.error, gzip.BadGzipFile) as error:
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
        text = file.read(size + len(_BOM)).removeprefix(_BOM).lstrip(_BLANKS)[:size]
        while not text and (block := file.read(_BLOCK)):
            text = block.lstrip(_BLANKS)[:size]
    return text


def first_character(path: Path) -> str:
    """Return the first character that is not white space; empty if there is none."""
    text = head(path, 64)
    return chr(text[0]) if text else ""


def entries(path: Path, *, inside: str = "", scalars: bool = False) -> Iterator[tuple[str | None, str]]:
    """Yield (key, text) of each entry if the file is one object, or (None, text) of each entry if the file is one
    array. Only `parsed` checks keys and numbers inside an entry, so that a fault in one does not cost the others.

    Parameters
    ----------
    inside : the entries are those of the value of this key, which must be the first of the file's object; what follows
        is not parsed
    scalars : entries may also be numbers, texts, true, false and null

    Raises
    ------
    FormatError : the file has another format; the message names the entry
    TruncatedError : the file ends early, after the entries that were yielded
    """
    with opened(path) as file:
        text = _Text(file, path)
        if inside:
            if text.take_if("{") and text.next() == '"' and json.loads(text.value("the start")) == inside:
                text.take_if(":")
            else:
                _refuse(path, "the start", f"the file does not begin with the key {inside!r}")
        keyed = text.take_if("{")
        if not keyed and not text.take_if("["):
            _refuse(path, "the start", _kind_of_start(text.next()))
        end, count, place = "}" if keyed else "]", 0, "entry 0"
        while not text.take_if(end):
            key, place = None, f"entry {count}"
            sound = not count or text.take_if(",")
            if keyed and sound:
                sound = text.next() == '"'
                key = str(parsed(text.value(place), path, f"the key of {place}")) if sound else None
                sound = sound and text.take_if(":")
            mark = text.next()
            if not mark:
                raise _truncated(path, place)
            if not sound or mark in ",:]}" or not (scalars or mark in "[{"):
                what = "the entry is neither an object nor an array, or a comma is missing or too many"
                _refuse(path, place, what)
            yield key, text.value(place)
            count += 1
        if not inside and text.next():
            _refuse(path, f"after entry {count - 1}", "there is text after the end of the JSON document")
        while inside and file.read(_BLOCK):  # a damaged end is noticed only on reading it
            pass


def _kind_of_start(mark: str) -> str:
    return "the file is neither a JSON object nor an array" if mark else "the file is empty"


def _truncated(path: Path, place: str) -> TruncatedError:
    what = "the file is truncated, or its brackets do not match"
    return TruncatedError(what, where=path, place=place, remedy=_REMEDY)


class _Text:
    """The text of a file, read in blocks as far as its values need it."""

    def __init__(self, file: BinaryIO, path: Path) -> None:
        self._file, self._path = file, path
        self._utf8 = codecs.getincrementaldecoder("utf-8-sig")()
        self._skip = json.JSONDecoder(parse_int=len, parse_float=len, parse_constant=len)
        self._text, self._at, self._ended = "", 0, False

    def next(self) -> str:
        """Return the next character that is not blank; empty at the end of the file."""
        while True:
            found = _NOT_BLANK.search(self._text, self._at)
            if found is not None:
                self._at = found.start()
                return found[0]
            self._at = len(self._text)
            if not self._more():
                return ""

    def take_if(self, mark: str) -> bool:
        """Return whether `mark` is the next character that is not blank, and go past it."""
        taken = self.next() == mark
        self._at += taken
        return taken

    def value(self, place: str) -> str:
        """Return the text of the value that begins here, and go past it."""
        while True:
            fault, end = None, 0
            try:
                end = self._skip.raw_decode(self._text, self._at)[1]
            except json.JSONDecodeError as error:
                fault = error
            except RecursionError:
                _refuse(self._path, place, f"the document {TOO_DEEP}")
            cut = fault is not None and fault.msg.startswith("Unterminated string")
            at_end = cut or (end if fault is None else fault.pos) + _LONGEST_MARK >= len(self._text)
            if at_end and len(self._text) - self._at > MAX_ENTRY_BYTES:
                _refuse(self._path, place, f"the entry is longer than {MAX_ENTRY_BYTES} bytes")
            if at_end and self._more():
                continue
            if fault is None:
                found, self._at = self._text[self._at : end], end
                return found
            if cut or not _MARKS & set(self._text[fault.pos :]):
                raise _truncated(self._path, place)
            _refuse(self._path, place, f"not JSON: {fault.msg}")

    def _more(self) -> bool:
        """Read on; at least as much as is left, so that a long value is not parsed too often."""
        rest = self._text[self._at :]
        block = b"" if self._ended else self._file.read(max(_BLOCK, len(rest)))
        try:
            text = self._utf8.decode(block, final=not block)
        except UnicodeDecodeError as error:
            _refuse(self._path, "", f"the text is not UTF-8 ({error.reason})")
        if block:
            self._text, self._at = rest + text, 0
        self._ended = not block
        return not self._ended


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


def document(path: Path, *, nonfinite: bool = False) -> Any:
    """Parse a file as one value.

    Raises
    ------
    MissingFileError, FormatError : as `opened` and `parsed`
    """
    return parsed(read_unpacked(path, MAX_DOCUMENT_BYTES), path, "", nonfinite=nonfinite)


def read_unpacked(path: Path, limit: int = LARGEST) -> bytes:
    """Return all bytes of a file, decompressed if it is gzip.

    Parameters
    ----------
    limit : size limit in bytes after decompression; a few kilobytes of gzip can hold gigabytes

    Raises
    ------
    MissingFileError, FormatError : as `opened`, or the file is larger than ``limit``
    """
    data = bytearray()
    with opened(path) as file:
        while block := file.read(_BLOCK):
            data += block
            if len(data) > limit:
                _refuse(path, "", f"the file is longer than {limit} bytes")
    return bytes(data)


def parsed(data: bytes | str, path: Path, place: str, *, nonfinite: bool = False) -> Any:
    """Parse ``data``, which is at `place` in a file, as one value.

    nonfinite : accept NaN and infinities, which Python's json module writes

    Raises
    ------
    FormatError : not JSON, nested too deep, a repeated key, or NaN or infinity; the message names the element
    """
    return parsed_value(data, str(path), place, nonfinite=nonfinite, remedy=_REMEDY)


def _refuse(path: Path, place: str, what: str) -> NoReturn:
    raise FormatError(what, where=path, place=place, remedy=_REMEDY)
