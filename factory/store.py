"""Where files are kept: one small interface, which a folder (``local_store``) and a bucket (``object_store``) share.

A path is relative, with '/' between folders. A file is there whole or not at all; ``create`` and ``swap`` are the two
conditional writes that publishing rests on.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

__all__ = ["Entry", "Store", "token_of"]


@dataclass(frozen=True, slots=True)
class Entry:
    """A stored file: its path, size in bytes, and time of its last write in seconds since 1970."""

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
        """How a person names this store."""
        ...

    @property
    def lists_cheaply(self) -> bool:
        """Whether asking for single files costs no more than listing a folder (a disk, not an object store)."""
        ...

    def read(self, path: str) -> bytes:
        """All bytes of a file."""
        ...

    def exists(self, path: str) -> bool:
        """Whether the file is there (whole)."""
        ...

    def write(self, path: str, data: Any, *, settle: bool = True) -> None:
        """Write a whole file atomically, in place of an older one.

        settle : make its name outlast a power cut; not needed where another write into the same folder follows
        """
        ...

    def create(self, path: str, data: Any) -> bool:
        """Write a whole file atomically if there is none; False, and nothing changed, if there is one."""
        ...

    def swap(self, path: str, data: Any, token: str | None) -> None:
        """Replace the file if it is still the one ``token_of`` was taken of (None: still absent).

        Raises ``PublishConflictError`` otherwise.
        """
        ...

    def copy(self, source: str, target: str) -> None:
        """Make ``target`` the same immutable file as ``source``, without reading it where possible."""
        ...

    def list(self, prefix: str) -> Iterator[Entry]:
        """All files below the folder ``prefix`` (``""``: all), in no promised order; unfinished writes are left out."""
        ...

    def folders(self, prefix: str) -> Iterator[tuple[str, dict[str, int]]]:
        """Every folder below ``prefix`` with files in it, as (path, size of each file by name); faster than
        ``list`` for many small folders. Unfinished writes are left out."""
        ...

    def delete(self, path: str) -> None:
        """Remove a file; one that is not there is fine."""
        ...

    def local_path(self, path: str) -> Path | None:
        """Where the file lies on this machine's disk, if it does."""
        ...


def token_of(data: bytes) -> str:
    """The token of a file's content, for ``Store.swap``."""
    return hashlib.sha256(data).hexdigest()
