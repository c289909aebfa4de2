"""File access below a dataset's root folder. A path that a file states can never lead out of this folder."""

from __future__ import annotations

import errno
import os
import posixpath
import re
import stat
from pathlib import Path
from typing import Final

from condvln.formats.regular_file import open_regular, refuse_special
from schemas.errors import FormatError, MissingFileError, PathEscapeError, TransientIOError

__all__ = ["TRANSIENT", "DatasetRoot"]

_DRIVE = re.compile(r"^[A-Za-z]:")
TRANSIENT: Final = frozenset({errno.EIO, errno.EAGAIN, errno.EBUSY, errno.ESTALE, errno.ETIMEDOUT, errno.EINTR})
"""Errors of the operating system that a retry may resolve."""
PATHS_KEPT: Final = 1 << 16
"""Number of checked paths that are remembered; when there are more, all are forgotten."""
_ESCAPE_REMEDY = "Paths must stay inside the dataset's root folder; correct the entry"


class DatasetRoot:
    """Reads files by '/'-separated paths relative to `folder`."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._folder = os.fspath(folder)
        self._real = os.path.realpath(folder)
        self._below = self._real.rstrip(os.sep) + os.sep
        self._inside: set[str] = set()

    def join(self, base: str, path: str, *, where: str = "", place: str = "") -> str:
        """Normalise `path`, as written in a file of the folder `base`, and return it relative to the root.

        Raises
        ------
        PathEscapeError : the path is absolute or leads out of the root
        FormatError : the value is not a path
        """
        if "\0" in path or not path.strip():
            raise FormatError(f"{path!r} is not a path", where=where, place=place, remedy="Correct the entry")
        path = path.replace("\\", "/")
        if path.startswith("/") or _DRIVE.match(path):
            raise PathEscapeError(f"the path {path!r} is absolute", where=where, place=place, remedy=_ESCAPE_REMEDY)
        joined = posixpath.normpath(posixpath.join(base, path))
        if joined == ".." or joined.startswith("../"):
            raise PathEscapeError(
                f"the path {path!r} leads out of the dataset", where=where, place=place, remedy=_ESCAPE_REMEDY
            )
        return joined

    def path(self, relative: str) -> Path:
        """Return the full path of a file or folder, after checking that no symbolic link on it leads out of the root.

        Raises
        ------
        PathEscapeError : a symbolic link on the path leads out of the root
        """
        return Path(self._path(relative))

    def _path(self, relative: str) -> str:
        """Return what `path` returns, as text: most files are looked at more often than they are named."""
        path = os.path.join(self._folder, relative)
        if relative in self._inside:
            return path
        real = os.path.realpath(path)
        if real != self._real and not real.startswith(self._below):
            raise PathEscapeError(
                "a symbolic link leads out of the dataset",
                where=self.folder / relative,
                remedy="Put the file itself, not a link, inside the dataset's root folder",
            )
        if os.path.lexists(path):
            if len(self._inside) >= PATHS_KEPT:
                self._inside.clear()
            self._inside.add(relative)
        return path

    def has(self, relative: str) -> bool:
        """Return whether the file exists.

        Raises
        ------
        FormatError : a FIFO, a socket or a device is there, or a link that leads to itself
        """
        path = self._path(relative)
        try:
            return stat.S_ISREG(refuse_special(path))
        except OSError as error:
            if error.errno not in (errno.EINVAL, errno.ELOOP):
                return False
            raise FormatError(
                f"the file can't be read ({error.strerror})",
                where=self.folder / relative,
                remedy="Take the file from its dataset again",
            ) from None

    def signature(self, relative: str) -> tuple[int, int]:
        """Return the size and the modification time of a file, as a cache key; (0, 0) if the file does not exist."""
        try:
            status = os.stat(self._path(relative))
        except OSError:
            return 0, 0
        return status.st_size, status.st_mtime_ns

    def read(self, relative: str, limit: int) -> bytes:
        """Return the bytes of a file of at most `limit` bytes.

        Raises
        ------
        MissingFileError : the file does not exist, or can't be opened
        FormatError : the file is larger than `limit`
        TransientIOError : the disk or the network failed
        """
        path = self._path(relative)
        try:
            with open_regular(path) as stream:
                # Room for the whole limit is not asked for each time.
                size = min(limit, os.fstat(stream.fileno()).st_size) + 1
                data = stream.read(size)
                if len(data) == size:
                    data += stream.read(limit + 1 - size)
        except FileNotFoundError:
            raise MissingFileError(
                "the file is not there",
                where=self.folder / relative,
                remedy="Download it again, or remove what refers to it",
            ) from None
        except OSError as error:
            if error.errno in TRANSIENT:
                raise TransientIOError(
                    f"the file can't be read ({error.strerror})", where=self.folder / relative
                ) from error
            raise MissingFileError(
                f"the file can't be opened ({error.strerror})",
                where=self.folder / relative,
                remedy="Correct its name or its permissions",
            ) from None
        if len(data) > limit:
            raise FormatError(
                f"the file is larger than {limit} bytes",
                where=self.folder / relative,
                remedy="Valid files are smaller: take the file from its dataset again",
            )
        return data
