"""The store in a folder on a local or network disk."""

from __future__ import annotations

import contextlib
import errno
import fcntl
import os
import secrets
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any, BinaryIO

from factory.store import Entry, token_of
from schemas.errors import PathEscapeError, PublishConflictError, StoreError

__all__ = ["LocalStore"]

_FULL = {errno.ENOSPC, errno.EDQUOT}
_CHUNK = 1 << 18
"""Bytes of a file that are copied at a time."""
_NO_LINKS = {errno.EPERM, errno.EOPNOTSUPP, errno.ENOSYS, errno.EMLINK}
"""Errors of file systems without hard links (FAT, many network mounts)."""


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

    @property
    def lists_cheaply(self) -> bool:
        return True

    def _at(self, path: str) -> Path:
        parts = path.split("/")
        if path.startswith("/") or "\0" in path or any(part in ("", ".", "..") for part in parts):
            raise PathEscapeError("not a path inside the store", where=path)
        return self.root.joinpath(*parts)

    def read(self, path: str) -> bytes:
        with self._errors(path):
            return self._at(path).read_bytes()

    def open(self, path: str) -> BinaryIO:
        with self._errors(path):
            return open(self._at(path), "rb")

    def exists(self, path: str) -> bool:
        return self._at(path).is_file()

    def write(self, path: str, data: Any, *, settle: bool = True) -> None:
        place = self._at(path)
        with self._errors(path), self._temporary(place, data) as temporary:
            os.replace(temporary, place)
            if settle:
                self._flush(place.parent)

    def create(self, path: str, data: Any) -> bool:
        place = self._at(path)
        with self._errors(path), self._temporary(place, data) as temporary:
            try:
                os.link(temporary, place)
            except FileExistsError:
                return False
            except OSError as error:
                if error.errno not in _NO_LINKS:
                    raise
                with self._locked(place.parent):
                    if place.exists():
                        return False
                    os.replace(temporary, place)
            self._flush(place.parent)
        return True

    def swap(self, path: str, data: Any, token: str | None) -> None:
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
        folder = self._at(prefix) if prefix else self.root
        stack = [folder]
        while stack:
            try:
                entries = [*os.scandir(stack.pop())]
            except (FileNotFoundError, NotADirectoryError):
                continue
            for entry in entries:
                if entry.is_dir(follow_symlinks=False):
                    stack.append(Path(entry.path))
                elif not entry.name.startswith("."):
                    with contextlib.suppress(FileNotFoundError):  # deleted meanwhile
                        stat = entry.stat()
                        yield Entry(
                            os.path.relpath(entry.path, self.root).replace(os.sep, "/"), stat.st_size, stat.st_mtime
                        )

    def folders(self, prefix: str) -> Iterator[tuple[str, dict[str, int]]]:
        root = str(self._at(prefix))
        stack = [""]
        while stack:
            below = stack.pop()
            files: dict[str, int] = {}
            try:
                with os.scandir(f"{root}/{below}" if below else root) as entries:
                    for entry in entries:
                        if entry.is_dir(follow_symlinks=False):
                            stack.append(f"{below}/{entry.name}" if below else entry.name)
                        elif not entry.name.startswith("."):
                            with contextlib.suppress(FileNotFoundError):  # deleted meanwhile
                                files[entry.name] = entry.stat().st_size
            except (FileNotFoundError, NotADirectoryError):
                continue
            if files:
                yield below, files

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
    def _temporary(self, place: Path, data: Any) -> Iterator[Path]:
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
                if hasattr(data, "read"):
                    data.seek(0)
                    shutil.copyfileobj(data, handle, _CHUNK)
                else:
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
