"""Open files that may be hostile: only regular files, since a FIFO never opens and a device never ends.

A pointer of Git LFS or git-annex, which stands in place of a file that was not downloaded, is refused by its name.
"""

from __future__ import annotations

import errno
import os
import stat
from pathlib import Path
from typing import BinaryIO, Final

from schemas.errors import PointerError

__all__ = ["open_regular", "read_regular", "refuse_pointer", "refuse_special"]

_KINDS: Final = (
    (stat.S_ISFIFO, "a FIFO"),
    (stat.S_ISSOCK, "a socket"),
    (stat.S_ISCHR, "a character device"),
    (stat.S_ISBLK, "a block device"),
)
MAX_POINTER_BYTES: Final = 1024
"""Largest pointer in bytes, as Git LFS's specification has it."""
_POINTERS: Final = (
    (b"version https://git-lfs.github.com/spec/", "Git LFS", "git lfs pull"),
    (b"version https://hawser.github.com/spec/", "Git LFS", "git lfs pull"),
    (b"/annex/objects/", "git-annex", "git annex get"),
)
"""Begin of each kind of pointer, the tool that wrote it, and the command that downloads the file."""


def open_regular(path: Path | str) -> BinaryIO:
    """Open a file for reading bytes.

    Raises
    ------
    OSError : it can't be opened; or it, or the target of a link, is a FIFO, a socket or a device
    PointerError : it is a pointer to a file that was not downloaded
    """
    refuse_special(path)
    refuse_pointer(path)
    return open(path, "rb")


def refuse_pointer(path: Path | str) -> None:
    """Raise a PointerError if a file is a pointer to one that was not downloaded."""
    if os.path.getsize(path) > MAX_POINTER_BYTES:
        return
    with open(path, "rb") as file:
        head = file.read(MAX_POINTER_BYTES)
    for begin, tool, command in _POINTERS:
        if head.startswith(begin):
            raise PointerError(
                f"this is a pointer of {tool}, not the file itself",
                where=path,
                remedy=f"Run '{command}' in its repository to download the file",
            )


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
