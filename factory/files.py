"""Hashes of input files, cached by (path, size, mtime), so that planning an unchanged corpus reads no file twice.

The memory is one SQLite file beside the store, or anywhere local; losing it costs time only. A file that changed while
keeping its size and its modification time to the nanosecond is missed, unless ``trust`` is False. Files touched within
the last two seconds are not remembered, since a second write may fall into the same tick of a coarse clock.
"""

from __future__ import annotations

import hashlib
import os
import sqlite3
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Final

from factory.stage import InputFile
from schemas.errors import MissingFileError, TransientIOError

__all__ = ["FileHashes", "hash_file"]

_CHUNK: Final = 1 << 20
_SETTLED: Final = 2.0
"""Least age of a file in seconds for its hash to be cached: the resolution of the coarsest common file system (FAT)."""


def hash_file(path: Path) -> str:
    """Return the SHA-256 of a file's bytes. Raises ``MissingFileError``, or ``TransientIOError`` when reading fails."""
    state = hashlib.sha256()
    try:
        with open(path, "rb") as handle:
            while block := handle.read(_CHUNK):
                state.update(block)
    except (FileNotFoundError, IsADirectoryError, NotADirectoryError) as error:
        raise MissingFileError("the file is not there", where=path) from error
    except PermissionError as error:
        raise MissingFileError(
            "there is no permission to read the file", where=path, remedy="Correct its permissions."
        ) from error
    except OSError as error:
        raise TransientIOError(f"reading failed: {error.strerror}", where=path) from error
    return state.hexdigest()


class FileHashes:
    """A local cache of file hashes.

    path : the SQLite file; None keeps it in memory
    trust : use what it holds; False: hash every file once more, and write the new hashes
    """

    def __init__(self, path: Path | None = None, *, trust: bool = True) -> None:
        self._path = path
        self._known: dict[str, tuple[int, int, str]] = {}
        self._new: dict[str, tuple[int, int, str]] = {}
        if trust and path is not None and path.exists():
            try:
                with _database(path) as database:
                    rows = database.execute("SELECT path, size, mtime_ns, sha256 FROM hashes")
                    self._known = {name: (size, mtime, sha) for name, size, mtime, sha in rows}
            except sqlite3.DatabaseError as error:
                # Damaged, and only a memory; but one that another process is writing to is sound.
                if "locked" not in str(error) and "readonly" not in str(error):
                    with suppress(OSError):
                        path.unlink()

    def file(self, root: Path, relative: str) -> InputFile:
        """Return the path, size and hash of the file ``root/relative``. Raises as ``hash_file`` does."""
        place = os.path.join(root, relative)
        try:
            stat = os.stat(place)
        except OSError as error:
            raise MissingFileError("the file is not there", where=place) from error
        known = self._known.get(place)
        if known is not None and known[:2] == (stat.st_size, stat.st_mtime_ns):
            return InputFile(relative, stat.st_size, known[2])
        found = hash_file(Path(place))
        entry = (stat.st_size, stat.st_mtime_ns, found)
        if time.time() - stat.st_mtime > _SETTLED:
            self._known[place] = self._new[place] = entry
        return InputFile(relative, stat.st_size, found)

    def save(self) -> None:
        """Write new hashes to disk. If the cache can't be written, no error is raised."""
        if self._path is None or not self._new:
            return
        try:
            self._path.parent.mkdir(parents=True, exist_ok=True)
            with _database(self._path) as database:
                database.executemany(
                    "INSERT OR REPLACE INTO hashes VALUES (?, ?, ?, ?)",
                    ((path, *entry) for path, entry in self._new.items()),
                )
        except (sqlite3.Error, OSError):
            return
        self._new.clear()


@contextmanager
def _database(path: Path) -> Iterator[sqlite3.Connection]:
    database = sqlite3.connect(path, timeout=10)
    try:
        with database:
            database.execute(
                "CREATE TABLE IF NOT EXISTS hashes"
                " (path TEXT PRIMARY KEY, size INTEGER, mtime_ns INTEGER, sha256 TEXT) WITHOUT ROWID"
            )
            yield database
    finally:
        database.close()
