"""Open files that may be hostile: only regular files, since a FIFO never opens and a device never ends."""

from __future__ import annotations

import errno
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


def open_regular(path: Path) -> BinaryIO:
    """Open a file for reading bytes.

    Raises
    ------
    OSError : it can't be opened; or it, or the target of a link, is a FIFO, a socket or a device
    """
    refuse_special(path)
    return path.open("rb")


def read_regular(path: Path) -> bytes:
    """Return all bytes of a file. Raises OSError as `open_regular` does."""
    with open_regular(path) as file:
        return file.read()


def refuse_special(path: Path) -> None:
    """Raise OSError if a path, or the target of a link, is neither a file nor a folder, or does not exist."""
    mode = path.stat().st_mode
    for is_kind, kind in _KINDS:
        if is_kind(mode):
            raise OSError(errno.EINVAL, f"it is {kind}, not a file", str(path))
