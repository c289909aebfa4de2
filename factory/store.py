"""The interface of stores, which a folder (``local_store``) and a bucket (``object_store``) implement.

A path is relative, with '/' between folders. A file is there whole or not at all; ``create`` and ``swap`` are the two
conditional writes that publishing rests on.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO, Protocol

__all__ = ["Entry", "Store", "token_of"]


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

    @property
    def lists_cheaply(self) -> bool:
        """Whether asking for files one by one is as cheap as listing them. This is true on a disk, but not in an object
        store.
        """
        ...

    def read(self, path: str) -> bytes:
        """Return all bytes of a file."""
        ...

    def open(self, path: str) -> BinaryIO:
        """Open a file that is too long for memory; where it is not on this disk, a temporary copy is opened."""
        ...

    def exists(self, path: str) -> bool:
        """Whether the file exists and is complete."""
        ...

    def write(self, path: str, data: Any, *, settle: bool = True) -> None:
        """Write a whole file atomically; an older file of this path is replaced.

        data : bytes, or an open file that is read from its beginning
        settle : make its name outlast a power cut; not needed where another write into the same folder follows
        """
        ...

    def create(self, path: str, data: Any) -> bool:
        """Write a whole file atomically and return True if no file has this path; else return False and change
        nothing.
        """
        ...

    def swap(self, path: str, data: Any, token: str | None) -> None:
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

    def folders(self, prefix: str) -> Iterator[tuple[str, dict[str, int]]]:
        """Yield every folder below ``prefix`` that has files, as (path, size of each file by name). This is faster than
        ``list`` for many small folders. Unfinished writes are left out.
        """
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
