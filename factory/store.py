"""The interface of stores, and the store in a folder; a bucket is in ``object_store``.

A path is relative, with '/' between folders. A file is there whole or not at all; ``swap`` is the
conditional write that publishing rests on.
"""

from __future__ import annotations

import contextlib
import errno
import fcntl
import hashlib
import os
import secrets
import shutil
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from schemas.errors import PathEscapeError, PublishConflictError, StoreError

__all__ = ["Entry", "LocalStore", "Store", "open_store", "token_of"]


_FULL = {errno.ENOSPC, errno.EDQUOT}


class LocalStore:
    """A folder on a local disk, or on a network disk that supports ``flock``.

    Files are written beside their place, flushed, and renamed; the folder is flushed after that. ``durable=False``
    leaves out the flushes: safe against killed processes, not against power cuts.
    """

    _TEMPORARY = ".tmp-"

    def __init__(self, root: str | Path, *, durable: bool = True) -> None:
        self.root = Path(root).absolute()
        self.durable = durable

    @property
    def url(self) -> str:
        return str(self.root)

    def _at(self, path: str) -> Path:
        parts = path.split("/")
        if path.startswith("/") or "\0" in path or any(part in ("", ".", "..") for part in parts):
            raise PathEscapeError("not a path inside the store", where=path)
        return self.root.joinpath(*parts)

    def read(self, path: str) -> bytes:
        with self._errors(path):
            return self._at(path).read_bytes()

    def write(self, path: str, data: bytes, *, settle: bool = True) -> None:
        place = self._at(path)
        with self._errors(path), self._temporary(place, data) as temporary:
            os.replace(temporary, place)
            if settle:
                self._flush(place.parent)

    def swap(self, path: str, data: bytes, token: str | None) -> None:
        place = self._at(path)
        with self._errors(path), self._locked(place.parent):
            now = token_of(place.read_bytes()) if place.exists() else None
            if now != token:
                raise PublishConflictError("another publisher moved this ref", where=path, remedy="Run again.")
            self.write(path, data)

    def copy(self, source: str, target: str) -> None:
        place = self._at(target)
        with self._errors(target):
            self._make(place.parent)
            temporary = place.parent / f"{self._TEMPORARY}{secrets.token_hex(8)}"
            try:
                try:
                    os.link(self._at(source), temporary)
                except OSError as error:
                    if isinstance(error, FileNotFoundError) or error.errno in _FULL:
                        raise
                    shutil.copyfile(self._at(source), temporary)  # no hard links here
                # A link has the age of its source; to a sweep it must look as young as it is.
                os.utime(temporary)
                os.replace(temporary, place)
            finally:
                # Renaming a link onto the same file does nothing, and would leave the temporary name.
                temporary.unlink(missing_ok=True)
            self._flush(place.parent)

    def list(self, prefix: str) -> Iterator[Entry]:
        stack = [prefix]
        while stack:
            below = stack.pop()
            try:
                entries = [*os.scandir(self._at(below) if below else self.root)]
            except (FileNotFoundError, NotADirectoryError):
                continue
            for entry in entries:
                path = f"{below}/{entry.name}" if below else entry.name
                if entry.is_dir(follow_symlinks=False):
                    stack.append(path)
                elif not entry.name.startswith("."):
                    with contextlib.suppress(FileNotFoundError):  # deleted meanwhile
                        stat = entry.stat()
                        yield Entry(path, stat.st_size, stat.st_mtime)

    def delete(self, path: str) -> None:
        place = self._at(path)
        with self._errors(path):
            place.unlink(missing_ok=True)
            # Empty folders are swept away on the way up; a sibling may be writing, and then rmdir refuses.
            for folder in place.parents:
                if folder == self.root:
                    break
                try:
                    folder.rmdir()
                except OSError:
                    break

    def local_path(self, path: str) -> Path | None:
        return self._at(path)

    def unfinished(self) -> Iterator[Path]:
        """List files that a killed writer left behind."""
        yield from self.root.rglob(f"{self._TEMPORARY}*")

    @contextlib.contextmanager
    def _temporary(self, place: Path, data: bytes) -> Iterator[Path]:
        temporary = place.parent / f"{self._TEMPORARY}{secrets.token_hex(8)}"
        for attempt in range(4):
            try:
                handle = open(temporary, "xb")  # noqa: SIM115 - closed below
                break
            except FileNotFoundError:
                # The folder is new; or a sibling swept it away, empty, between the two calls.
                if attempt == 3:
                    raise
                self._make(place.parent)
        try:
            with handle:
                handle.write(data)
                handle.flush()
                if self.durable:
                    os.fsync(handle.fileno())
            yield temporary
        finally:
            temporary.unlink(missing_ok=True)

    @contextlib.contextmanager
    def _locked(self, folder: Path) -> Iterator[None]:
        """Hold the exclusive lock of `folder`. The lock is released when the process that holds it ends, so that a
        killed publisher blocks nobody.
        """
        self._make(folder)
        lock = os.open(folder / ".lock", os.O_RDWR | os.O_CREAT, 0o644)
        try:
            fcntl.flock(lock, fcntl.LOCK_EX)
            yield
        finally:
            os.close(lock)

    def _make(self, folder: Path) -> None:
        """Create a folder and sync its parents, so that the folder survives a power cut, as the files in it do."""
        new = []
        at = folder
        while not at.exists():
            new.append(at)
            at = at.parent
        folder.mkdir(parents=True, exist_ok=True)
        for made in new:
            self._flush(made.parent)

    def _flush(self, folder: Path) -> None:
        if not self.durable:
            return
        handle = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(handle)
        finally:
            os.close(handle)

    @contextlib.contextmanager
    def _errors(self, path: str) -> Iterator[None]:
        try:
            yield
        except FileNotFoundError:
            raise
        except OSError as error:
            remedy = "Free some space and run again; what was committed stays." if error.errno in _FULL else ""
            raise StoreError(
                f"the store failed: {error.strerror or error}", where=f"{self.url}/{path}", remedy=remedy
            ) from error


@dataclass(frozen=True, slots=True)
class Entry:
    """A stored file: its path, size in bytes, and time of the last write in seconds since 1970."""

    path: str
    size: int
    modified: float


class Store(Protocol):
    """Whole files under relative paths. Instances are picklable: each worker opens its own.

    Errors: ``StoreError`` when the store refuses (full, read-only, no permission), ``TransientIOError`` when another
    try may help, ``FileNotFoundError`` on reading what is not there.
    """

    @property
    def url(self) -> str:
        """Return the address of this store."""
        ...

    def read(self, path: str) -> bytes:
        """Return all bytes of a file."""
        ...

    def write(self, path: str, data: bytes, *, settle: bool = True) -> None:
        """Write a whole file atomically; an older file of this path is replaced.

        settle : make its name outlast a power cut; not needed where another write into the same folder follows
        """
        ...

    def swap(self, path: str, data: bytes, token: str | None) -> None:
        """Replace a file if ``token`` is still the token of its content. With None as token, the file must not exist.

        Raises ``PublishConflictError`` otherwise.
        """
        ...

    def copy(self, source: str, target: str) -> None:
        """Copy the immutable file ``source`` to the path ``target``, if possible without reading the file."""
        ...

    def list(self, prefix: str) -> Iterator[Entry]:
        """List all files below the folder ``prefix`` (``""``: all), in any order; unfinished writes are left out."""
        ...

    def delete(self, path: str) -> None:
        """Remove a file; a file that does not exist is not an error."""
        ...

    def local_path(self, path: str) -> Path | None:
        """Return the file's path on this machine's disk; None if the store is elsewhere."""
        ...


def token_of(data: bytes) -> str:
    """Return the token of a file's content, for ``Store.swap``."""
    return hashlib.sha256(data).hexdigest()


def open_store(address: str | Path) -> Store:
    """Open the store at ``address``: a folder, or ``s3://bucket/prefix[?endpoint=…&region=…]``."""
    from factory.object_store import ObjectStore

    if isinstance(address, str) and "://" in address:
        return ObjectStore.from_url(address)
    return LocalStore(address)
