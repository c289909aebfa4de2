"""Write files atomically: under a temporary name, renamed to the final name when complete.

gzip uses zlib, whose output depends only on input, level and version; faster implementations (ISA-L) choose their code
path by the processor. The header has no time and no file name, so equal rows give equal bytes.
"""

from __future__ import annotations

import errno
import hashlib
import io
import os
import shutil
import zlib
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import orjson

from schemas.errors import StoreError, UsageError

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = [
    "GZIP_LEVEL",
    "ByteStream",
    "JsonArrayStream",
    "atomic_copy",
    "atomic_path",
    "atomic_stream",
    "indented",
    "sync",
    "write_figure",
    "write_file",
]

GZIP_LEVEL: Final = 2
"""gzip level, measured on the files of 3,044 episodes of ReplicaCAD: 2 takes two thirds of the time of 4 and a third of
that of 6, for 17 and 34 % more bytes; 1 takes longer. These files are a fifth of an export. See benchmarks/export.py.
"""

_GZIP_WBITS: Final = 31
_BUFFER: Final = 1 << 18


class ByteStream:
    """An open file under a temporary name; plain or gzip by the suffix of its final name.

    Raises
    ------
    StoreError : raised by every method if the file can't be written
    """

    def __init__(self, path: Path, level: int) -> None:
        self.path = path
        self.size = 0
        self.digest = hashlib.sha256()
        self._part = path.with_name(f".{path.name}.part")
        self._compressor = zlib.compressobj(level, zlib.DEFLATED, _GZIP_WBITS) if path.suffix == ".gz" else None
        self._pending: list[bytes] = []
        self._pending_size = 0
        with _refusals(path):
            path.parent.mkdir(parents=True, exist_ok=True)
            self._file = self._part.open("wb")

    def write(self, data: bytes) -> None:
        """Append ``data`` (before compression)."""
        self._pending.append(data)
        self._pending_size += len(data)
        if self._pending_size >= _BUFFER:
            self._drain()

    def commit(self) -> None:
        """Write pending data and rename the file to its final name."""
        self._drain()
        if self._compressor is not None:
            self._put(self._compressor.flush())
        with _refusals(self.path):
            self._file.flush()
            os.fsync(self._file.fileno())
            self._file.close()
            os.replace(self._part, self.path)
            sync(self.path.parent)

    def abandon(self) -> None:
        """Remove the temporary file."""
        with suppress(OSError):
            self._file.close()
        with suppress(OSError):
            self._part.unlink()

    def _drain(self) -> None:
        data = b"".join(self._pending)
        self._pending.clear()
        self._pending_size = 0
        self._put(data if self._compressor is None else self._compressor.compress(data))

    def _put(self, data: bytes) -> None:
        if data:
            with _refusals(self.path):
                self._file.write(data)
            self.digest.update(data)
            self.size += len(data)


@contextmanager
def atomic_stream(path: Path, level: int = GZIP_LEVEL, *, closing: bytes = b"") -> Iterator[ByteStream]:
    """Return a context manager of a stream that becomes ``path`` if the block succeeds, and is removed if it fails.

    ``closing`` : bytes written at the end.

    Raises
    ------
    StoreError : the file can't be written (disk full, read-only, no such folder)
    """
    stream = ByteStream(path, level)
    try:
        yield stream
        stream.write(closing)
        stream.commit()
    except BaseException:
        stream.abandon()
        raise


def indented(document: Any, option: int = 0) -> bytes:
    """Return a JSON document as indented text, which ends with a line break; ``option`` is one of orjson's."""
    return orjson.dumps(document, option=orjson.OPT_INDENT_2 | option) + b"\n"


def write_file(path: Path, data: bytes) -> Path:
    """Write a file atomically, packed if its name ends in ``.gz``, and return its path.

    Raises
    ------
    StoreError : the file can't be written
    """
    with atomic_stream(path) as stream:
        stream.write(data)
    return path


@contextmanager
def atomic_path(path: Path, *, durable: bool = True) -> Iterator[Path]:
    """Return a context manager of a temporary path, for what writes a file by its name. The file becomes ``path`` if
    the block succeeds, and is removed if it fails.

    ``durable`` : whether the file is flushed to disk, so that it outlasts a power cut

    Raises
    ------
    StoreError : the file can't be written (disk full, read-only, no such folder)
    """
    part = path.with_name(f".{path.name}.part")
    try:
        with _refusals(path):
            path.parent.mkdir(parents=True, exist_ok=True)
            yield part
            if durable:
                sync(part)
            os.replace(part, path)
            if durable:
                sync(path.parent)
    except BaseException:
        with suppress(OSError):
            part.unlink()
        raise


def atomic_copy(source: Path, path: Path) -> None:
    """Copy a file atomically: ``path`` is complete or does not exist.

    Raises
    ------
    StoreError : the file can't be written
    """
    with atomic_path(path) as part:
        shutil.copyfile(source, part)


def sync(path: Path) -> None:
    """Flush a file's content, or a folder's entries, to disk. File systems that can't sync folders are accepted."""
    opened = os.open(path, os.O_RDONLY)
    try:
        os.fsync(opened)
    except OSError as error:
        if error.errno not in (errno.EINVAL, errno.ENOTSUP):
            raise
    finally:
        os.close(opened)


@contextmanager
def _refusals(path: Path) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        full = error.errno in (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
        mend = "Free some space" if full else "Check the path and its rights"
        raise StoreError(
            f"can't be written: {error.strerror or error}",
            where=path,
            remedy=f"{mend} or choose another folder, then run the command again; nothing half-written is left",
        ) from error


@dataclass
class JsonArrayStream:
    """Writes a JSON array or object entry by entry, with commas in between."""

    stream: ByteStream
    count: int = 0

    def entry(self, data: bytes) -> None:
        """Append one encoded entry."""
        self.stream.write(b"," + data if self.count else data)
        self.count += 1


def write_figure(figure: Figure, path: str | os.PathLike[str], *, dpi: int, metadata: Any = None) -> None:
    """Draw a figure in the format of the file's suffix (``.png`` if there is none), and write the file.

    Raises
    ------
    UsageError : no format has this suffix
    StoreError : the file can't be written
    """
    file = Path(path)
    form, drawn = file.suffix.removeprefix(".").lower() or "png", io.BytesIO()
    known = figure.canvas.get_supported_filetypes()
    if form not in known:
        raise UsageError(
            f"{file.suffix!r} is not a format of pictures", where=file, remedy=f"Write to .{', .'.join(sorted(known))}."
        )
    figure.savefig(drawn, format=form, dpi=dpi, metadata=metadata)
    write_file(file, drawn.getvalue())
