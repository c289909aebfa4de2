"""One export at a time writes a folder: the provisional names of two would be the same files."""

from __future__ import annotations

import fcntl
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from schemas.errors import StoreError

__all__ = ["alone_in"]


@contextmanager
def alone_in(folder: Path) -> Iterator[None]:
    """Hold `folder`, which is made where it is missing, against other exports on this machine.

    The folder itself is locked, so that nothing is left in it and one that is killed blocks nobody. A file system that
    knows no locks is taken as it is.

    Raises
    ------
    StoreError : another export holds it, or it can't be made
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        held = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    except OSError as error:
        raise StoreError(
            f"can't be written: {error.strerror or error}", where=folder, remedy="Choose another export folder."
        ) from error
    try:
        try:
            fcntl.flock(held, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            raise StoreError(
                "another export is writing this folder",
                where=folder,
                remedy="Run condvln export when it is done, or choose another export folder.",
            ) from error
        except OSError:
            pass
        yield
    finally:
        os.close(held)
