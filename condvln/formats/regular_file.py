"""Open files that may be hostile: only regular files, since a FIFO never opens and a device never ends."""

from __future__ import annotations

import errno
import os
import stat
from pathlib import Path
from typing import BinaryIO, Final

__all__ = ["open_regular", "read_regular", "refuse_special"]

_KINDS: Final = (
    (stat.S_ISFIFO, "a FIFO"),
    (stat.S_ISSOCK, "a socket"),
    (stat.S_ISCHR, "a character device"),
    (stat.S_ISBLK, "a block device"),
)


def open_regular(path: Path | str) -> BinaryIO:
    """Open a file for reading bytes.

    Raises
    ------
    OSError : it can't be opened; or it, or the target of a link, is a FIFO, a socket or a device
    """
    refuse_special(path)
    return open(path, "rb")


def read_regular(path: Path) -> bytes:
    """Return all bytes of a file. Raises OSError as `open_regular` does."""
    with open_regular(path) as file:
        return file.read()


def refuse_special(path: Path | str) -> int:
    """Return the mode of a path or of the target of a link. Raise OSError if it is neither a file nor a folder, or does
    not exist.
    """
    mode = os.stat(path).st_mode
    if not stat.S_ISREG(mode):
        for is_kind, kind in _KINDS:
            if is_kind(mode):
                raise OSError(errno.EINVAL, f"it is {kind}, not a file", str(path))
    return mode
