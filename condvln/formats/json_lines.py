"""Read all lines, or a single line, of a file with one JSON document per line, plain or gzip, in bounded memory."""

from __future__ import annotations

import zlib
from bisect import bisect_right
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, BinaryIO, Final

from condvln.formats.dataset_root import DatasetRoot
from condvln.formats.json_entries import FREE_BYTES, GZIP_MAGIC, MAX_RATIO
from condvln.formats.regular_file import open_regular
from schemas.errors import FormatError, MissingFileError

__all__ = ["MAX_LINE_BYTES", "JsonLines"]

MAX_LINE_BYTES: Final = 16 << 20
"""Size limit in bytes of a line. A ProcTHOR house has 80 kB."""

MAX_LINES: Final = 500_000
"""Largest number of lines. The largest set of ProcTHOR houses has 12,000."""

_PIECE: Final = 1 << 16
_UNPACKED_PIECE: Final = 1 << 20
_CHECKPOINT_BYTES: Final = 4 << 20
_GZIP_WINDOW: Final = 31
_REMEDY = "Take the file from its dataset again"


@dataclass(frozen=True)
class _Checkpoint:
    """A position at which reading can go on: the number of the line, the part of it that was read, the offset in the
    text and in the file, and the decompressor's state, which further reading does not change.
    """

    line: int = 0
    begun: bytes = b""
    text: int = 0
    file: int = 0
    unpacker: Any = None


class JsonLines:
    """A file of JSON lines under a dataset root; gzip if its name ends in ``.gz``.

    trailing : whether bytes after the end of the gzip data were ignored, as gzip does
    """

    def __init__(self, root: DatasetRoot, path: str) -> None:
        self._root = root
        self.path = path
        self.where = str(root.folder / path)
        self._packed = path.endswith(".gz")
        self._signature = (-1, -1)
        self._checkpoints = [_Checkpoint()]
        self.trailing = False

    def lines(self) -> Iterator[tuple[int, bytes]]:
        """Yield the number (from 0) and bytes of each line that is not blank, without its line end.

        Raises
        ------
        FormatError : not gzip, truncated, or too large after decompression; a line longer than `MAX_LINE_BYTES`
        MissingFileError : the file does not exist
        """
        self._forget_changed()
        yield from self._lines(self._checkpoints[0])

    def line(self, number: int) -> bytes:
        """Return the bytes of one line, without its line end.

        Raises
        ------
        InputError : as for `lines`; the line does not exist
        """
        self._forget_changed()
        start = bisect_right(self._checkpoints, number, key=lambda checkpoint: checkpoint.line) - 1
        for found, line in self._lines(self._checkpoints[max(start, 0)]):
            if found == number:
                return line
            if found > number:
                break
        raise MissingFileError(
            "this line is empty", where=self.where, place=f"line {number + 1}", remedy="Correct the scene's id"
        )

    def _forget_changed(self) -> None:
        signature = self._root.signature(self.path)
        if signature != self._signature:
            self._signature, self._checkpoints = signature, [_Checkpoint()]

    def _lines(self, start: _Checkpoint) -> Iterator[tuple[int, bytes]]:
        """Yield the lines from a checkpoint on, and keep a checkpoint every few megabytes."""
        number, begun = start.line, bytearray(start.begun)
        with self._open() as stream:
            for piece, text, file, unpacker in self._pieces(stream, start):
                *whole, rest = piece.split(b"\n")
                for part in whole:
                    line = bytes(begun) + part
                    begun.clear()
                    if line.strip():
                        yield number, line
                    number += 1
                begun += rest
                if number > MAX_LINES:
                    raise FormatError(f"the file has more than {MAX_LINES} lines", where=self.where, remedy=_REMEDY)
                if len(begun) > MAX_LINE_BYTES:
                    what, place = f"a line is longer than {MAX_LINE_BYTES} bytes", f"line {number + 1}"
                    raise FormatError(what, where=self.where, place=place, remedy=_REMEDY)
                if file and text - self._checkpoints[-1].text >= _CHECKPOINT_BYTES:
                    state = None if unpacker is None else unpacker.copy()
                    self._checkpoints.append(_Checkpoint(number, bytes(begun), text, file, state))
        if begun.strip():
            yield number, bytes(begun)

    def _open(self) -> BinaryIO:
        path = self._root.path(self.path)
        try:
            return open_regular(path)
        except OSError as error:
            raise MissingFileError(
                f"the file can't be opened ({error.strerror})",
                where=path,
                remedy="Check its permissions, or download it again",
            ) from None

    def _pieces(self, stream: BinaryIO, start: _Checkpoint) -> Iterator[tuple[bytes, int, int, Any]]:
        """Yield pieces of the text from `start` on, each with the offset of its end in the text and in the file, and
        the decompressor. The offset in the file is 0 where reading can't go on, since bytes are pending.
        """
        stream.seek(start.file)
        text, file = start.text, start.file
        if not self._packed:
            while data := stream.read(_PIECE):
                text, file = text + len(data), file + len(data)
                yield data, text, file, None
            return
        limit = FREE_BYTES + MAX_RATIO * self._signature[0]
        unpacker = zlib.decompressobj(_GZIP_WINDOW) if start.unpacker is None else start.unpacker.copy()
        try:
            while data := stream.read(_PIECE):
                file += len(data)
                while data:
                    if unpacker.eof:
                        if not GZIP_MAGIC.startswith(data[:2]):
                            self.trailing = self.trailing or bool(data.strip(b"\0"))
                            return
                        unpacker = zlib.decompressobj(_GZIP_WINDOW)
                    piece = unpacker.decompress(data, _UNPACKED_PIECE)
                    data = unpacker.unconsumed_tail or unpacker.unused_data
                    text += len(piece)
                    if text > limit:
                        what = f"{file} bytes of gzip decompress to more than the allowed {limit} bytes"
                        raise FormatError(what, where=self.where, remedy=_REMEDY)
                    yield piece, text, 0 if data else file, unpacker
        except zlib.error as error:
            raise FormatError(
                f"not a valid gzip file ({error})", where=self.where, place=f"byte {file}", remedy=_REMEDY
            ) from None
        if not unpacker.eof:
            raise FormatError("the gzip file is truncated", where=self.where, remedy=_REMEDY)
