"""The lock of an export's folder: only one command at a time writes into the folder; it takes the lock before its work
begins.
"""

from __future__ import annotations

import fcntl
import os
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext, suppress
from pathlib import Path
from typing import Final

from condvln.export.staging import check_place, placed, recover
from schemas.config import Config
from schemas.errors import StoreError

__all__ = ["alone_in", "alone_in_export"]

_TRIES: Final = 100


def alone_in_export(config: Config) -> AbstractContextManager[None]:
    """Hold the lock of the configured export folder for a whole run; without such a folder, do nothing.

    Raises
    ------
    StoreError : see :func:`alone_in`
    """
    return nullcontext() if config.export is None else alone_in(config.export)


@contextmanager
def alone_in(folder: Path) -> Iterator[None]:
    """Hold the lock of an export's folder on this machine, and remove what a killed export left beside it.

    The lock is the file ``.NAME.lock`` beside the folder, since the folder itself is replaced. It goes with its holder:
    one that is killed leaves the file and blocks nobody. A file system that knows no locks is taken as it is.

    Raises
    ------
    StoreError : another command holds it, or an export can't be written there
    """
    check_place(folder)
    here = placed(folder)
    path = here.with_name(f".{here.name}.lock")
    held = _held(path, here)
    try:
        recover(folder)
        yield
    finally:
        with suppress(OSError):
            path.unlink()
        os.close(held)


def _held(path: Path, here: Path) -> int:
    """Open and lock the lock file; return its descriptor. If the former holder has removed the file meanwhile, create
    it again.
    """
    for _ in range(_TRIES):
        try:
            opened = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC | os.O_NOFOLLOW, 0o666)
        except OSError as error:
            raise StoreError(
                f"can't be written: {error.strerror or error}", where=path, remedy="Choose another export folder."
            ) from error
        try:
            fcntl.flock(opened, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            os.close(opened)
            raise StoreError(
                "another generate, rebuild or export is writing this folder",
                where=here,
                remedy="Wait until it is done, or choose another export folder: --set export=FOLDER.",
            ) from error
        except OSError:
            return opened
        if _is(path, opened):
            return opened
        os.close(opened)
    raise StoreError("can't be locked: it keeps being removed", where=path, remedy="Try again.")


def _is(path: Path, opened: int) -> bool:
    with suppress(OSError):
        return os.path.samestat(os.stat(path, follow_symlinks=False), os.fstat(opened))
    return False
