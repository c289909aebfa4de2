"""Temporary files of the driver: what is said when their disk is full, and how they are closed."""

from __future__ import annotations

import errno
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import Any

from schemas.errors import StoreError

__all__ = ["close_files", "temporary_space"]


@contextmanager
def temporary_space() -> Iterator[None]:
    """Context in which temporary files are written. Raises ``StoreError``, which names their folder, when there is no
    space left for them: the store may well have some.
    """
    try:
        yield
    except OSError as error:
        if error.errno not in (errno.ENOSPC, errno.EDQUOT):
            raise
        raise StoreError(
            "no space left for temporary files",
            where=tempfile.gettempdir(),
            remedy="Free some space there, or set TMPDIR to another folder; what was committed stays.",
        ) from error


def close_files(*files: Any) -> None:
    """Close temporary files. What could not be written to them is lost with them, and needs no word."""
    for file in files:
        with suppress(OSError):
            file.close()
