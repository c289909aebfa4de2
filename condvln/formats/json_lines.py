"""Read all lines, or a single line, of a file with one JSON document per line, plain or gzip, in bounded memory."""

from __future__ import annotations

import zlib
from bisect import bisect_right
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any, BinaryIO, Final

from condvln.formats.dataset_root import DatasetRoot
from condvln.formats.regular_file import open_regular
from schemas.errors import FormatError, MissingFileError

__all__ = ["MAX_LINE_BYTES", "JsonLines"]

MAX_LINE_BYTES: Final = 16 << 20
"""Size limit in bytes of a line. A ProcTHOR house has 80 kB."""

MAX_LINES: Final = 500_000
"""Largest number of lines. The largest set of ProcTHOR houses has 12,000."""

MAX_RATIO: Final = 200
FREE_BYTES: Final = 256 << 20
"""A gzip file may decompress to this many bytes, or to `MAX_RATIO` times its size if that is more: houses compress 7:1,
decompression bombs 1000:1.
"""

_PIECE: Final = 1 << 16
_UNPACKED_PIECE: Final = 1 << 20
_CHECKPOINT_BYTES: Final = 4 << 20
_GZIP_WINDOW: Final = 31
_REMEDY = "Take the file from its dataset again"


@dataclass(frozen=True)
class _Checkpoint:
    """A position at which reading can be resumed: the offset in the text, the offset in the file, and the
    decompressor's state at this position.
    """

    text: int
    file: int
    unpacker: Any

    def kept(self) -> _Checkpoint:
        """Return a copy of this checkpoint that further reading does not change."""
        return self if self.unpacker is None else replace(self, unpacker=self.unpacker.copy())


class JsonLines:
    """A file of JSON lines under a dataset root; gzip if its name ends in ``.gz``."""

    def __init__(self, root: DatasetRoot, path: str) -> None:
        self._root = root
        self.path = path
        self.where = str(root.folder / path)
        self._packed = path.endswith(".gz")
        self._signature = (-1, -1)
        self._starts: list[int] = []
        self._last: tuple[int, bytes] | None = None
        self._checkpoints: list[_Checkpoint] = []

    def lines(self) -> Iterator[tuple[int, bytes]]:
        """Yield the number (from 0) and bytes of each line that is not blank, without its line end.

        Raises
        ------
        FormatError : not gzip, truncated, or too large after decompression; a line longer than `MAX_LINE_BYTES`
        MissingFileError : the file does not exist
        """
        signature = self._root.signature(self.path)
        starts, checkpoints = [0], [_Checkpoint(0, 0, None)]
        number, length = 0, 0
        begun: list[bytes] = []  # the part of a line whose end has not been read yet
        with self._open() as stream:
            for piece, checkpoint in self._pieces(stream, checkpoints[0]):
                *whole, rest = piece.split(b"\n")
                for part in whole:
                    line = b"".join([*begun, part])
                    begun, length = [], 0
                    starts.append(starts[-1] + len(line) + 1)
                    if line.strip():
                        yield number, line
                    number += 1
                if number > MAX_LINES:
                    raise FormatError(f"the file has more than {MAX_LINES} lines", where=self.where, remedy=_REMEDY)
                begun.append(rest)
                length += len(rest)
                if length > MAX_LINE_BYTES:
                    raise FormatError(
                        f"a line is longer than {MAX_LINE_BYTES} bytes",
                        where=self.where,
                        place=f"line {number + 1}",
                        remedy=_REMEDY,
                    )
                if checkpoint is not None and checkpoint.text - checkpoints[-1].text >= _CHECKPOINT_BYTES:
                    checkpoints.append(checkpoint.kept())
        last = b"".join(begun)
        if last.strip():
            yield number, last
        self._signature, self._starts, self._checkpoints, self._last = signature, starts, checkpoints, None

    def line(self, number: int) -> bytes:
        """Return the bytes of one line, without its line end.

        Raises
        ------
        InputError : as for `lines`; the line does not exist
        """
        if self._signature != self._root.signature(self.path):
            for _ in self.lines():
                pass
        if self._last is not None and self._last[0] == number:
            return self._last[1]
        if not 0 <= number < len(self._starts):
            raise self._no_line(number)
        start = self._starts[number]
        at = self._checkpoints[bisect_right(self._checkpoints, start, key=lambda c: c.text) - 1]
        got = b""
        with self._open() as stream:
            skip = start - at.text
            for piece, _ in self._pieces(stream, at):
                if skip >= len(piece):
                    skip -= len(piece)
                    continue
                end = piece.find(b"\n", skip)
                got += piece[skip:] if end < 0 else piece[skip:end]
                skip = 0
                if end >= 0:
                    break
        if not got.strip():
            raise self._no_line(number)
        self._last = number, got
        return got

    def _no_line(self, number: int) -> MissingFileError:
        return MissingFileError(
            "this line is empty",
            where=self.where,
            place=f"line {number + 1}",
            remedy="Correct the scene's id",
        )

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

    def _pieces(self, stream: BinaryIO, start: _Checkpoint) -> Iterator[tuple[bytes, _Checkpoint | None]]:
        """Yield pieces of the text from `start` on, each with the checkpoint at its end. The checkpoint is None where
        reading can't be resumed.
        """
        stream.seek(start.file)
        text, file = start.text, start.file
        if not self._packed:
            while data := stream.read(_PIECE):
                text, file = text + len(data), file + len(data)
                yield data, _Checkpoint(text, file, None)
            return
        limit = FREE_BYTES + MAX_RATIO * self._root.signature(self.path)[0]
        unpacker = zlib.decompressobj(_GZIP_WINDOW) if start.unpacker is None else start.unpacker.copy()
        try:
            while data := stream.read(_PIECE):
                file += len(data)
                while data:
                    if unpacker.eof:
                        if not data.strip(b"\0"):
                            break
                        unpacker = zlib.decompressobj(_GZIP_WINDOW)
                    piece = unpacker.decompress(data, _UNPACKED_PIECE)
                    data = unpacker.unconsumed_tail or unpacker.unused_data
                    text += len(piece)
                    if text > limit:
                        what = f"{file} bytes of gzip decompress to more than the allowed {limit} bytes"
                        raise FormatError(what, where=self.where, remedy=_REMEDY)
                    # Reading can resume only where no bytes are pending.
                    yield piece, None if data else _Checkpoint(text, file, unpacker)
        except zlib.error as error:
            raise FormatError(
                f"not a valid gzip file ({error})", where=self.where, place=f"byte {file}", remedy=_REMEDY
            ) from None
        if not unpacker.eof:
            raise FormatError("the gzip file is truncated", where=self.where, remedy=_REMEDY)
