"""The lock of a name in a store: one generate or rebuild at a time on this machine, checked before the work begins."""

from __future__ import annotations

import errno
import fcntl
import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Final

from jobs.workspace import local_state
from schemas.config import Config
from schemas.errors import StoreError

__all__ = ["alone", "alone_in_store"]

_READ_ONLY: Final = {errno.EROFS, errno.EACCES, errno.EPERM}


@contextmanager
def alone(state: Path, name: str) -> Iterator[bool]:
    """Try to lock `name` on this machine. Yields False if another generate or rebuild holds the lock, else True. A
    killed command leaves no lock behind.

    Where nothing can be written nobody else is writing: no lock is needed to find that there is nothing to do.
    """
    lock = _opened(state, name)
    if lock is None:
        yield True
        return
    try:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            yield False
        else:
            yield True
    finally:
        os.close(lock)


@contextmanager
def alone_in_store(config: Config) -> Iterator[None]:
    """Hold the lock on the configuration's name in its store. Raises ``StoreError`` when another command on this
    machine holds this lock.
    """
    with alone(local_state(config.store), config.name) as held:
        if not held:
            raise StoreError(
                f"another generate or rebuild of {config.name!r} is under way on this machine",
                where=str(config.store),
                remedy="Wait until it is done: condvln status CONFIG lists the runs.",
            )
        yield


def _opened(state: Path, name: str) -> int | None:
    """Open the lock file and return its descriptor; None if the folder is read-only and so no file can be made."""
    path = state / f".rebuild-{name}.lock"
    try:
        state.mkdir(parents=True, exist_ok=True)
        return os.open(path, os.O_RDWR | os.O_CREAT, 0o644)
    except OSError as error:
        if error.errno not in _READ_ONLY:
            raise StoreError(
                f"can't be written: {error.strerror}", where=path, remedy="Check the store's folder."
            ) from error
    with suppress(OSError):
        return os.open(path, os.O_RDONLY)
    return None
