"""File access below a dataset's root folder. A path that a file states can never lead out of this folder.

Download tools keep the content of files in a cache, and put symbolic links to it into the dataset's folder. Such a link
is followed if it is in the root folder and its target is a regular file in a cache beside the root; a link to anything
else outside the root is refused. Known caches:

* ``blobs/`` beside ``snapshots/`` (Hugging Face Hub), if the root is a snapshot or a folder in one
* ``.dvc/cache/`` (DVC) and ``.git/annex/objects/`` (git-annex, DataLad) of the root or of a folder above it
"""

from __future__ import annotations

import errno
import os
import posixpath
import re
import stat
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Final

from condvln.formats.regular_file import open_regular, refuse_special
from schemas.errors import (
    ConfigError,
    FormatError,
    InputError,
    MissingFileError,
    PathEscapeError,
    TransientIOError,
    shown_path,
)

__all__ = [
    "TRANSIENT",
    "DatasetRoot",
    "FileListing",
    "is_folder",
    "list_files",
]

CACHES: Final = (".dvc/cache", ".git/annex/objects")
"""Folders of caches, relative to the root folder or a folder above it."""
SNAPSHOTS, BLOBS = "snapshots", "blobs"

_DRIVE = re.compile(r"^[A-Za-z]:")
TRANSIENT: Final = frozenset({errno.EIO, errno.EAGAIN, errno.EBUSY, errno.ESTALE, errno.ETIMEDOUT, errno.EINTR})
"""Errors of the operating system that a retry may resolve."""
PATHS_KEPT: Final = 1 << 16
"""Number of checked paths that are remembered; when there are more, all are forgotten."""
_ESCAPE_REMEDY = "Paths must stay inside the dataset's root folder; correct the entry"


def _caches_beside(root: str) -> tuple[str, ...]:
    """Return the folders of caches beside a root folder, each with a separator at its end; whether they exist is not
    checked.
    """
    found = []
    folder = Path(root)
    for above in (folder, *folder.parents):
        found += [above / cache for cache in CACHES]
        if above.name == SNAPSHOTS:
            found.append(above.parent / BLOBS)
    return tuple(os.path.join(cache, "") for cache in found)


class DatasetRoot:
    """Reads files by '/'-separated paths relative to `folder`."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._folder = os.fspath(folder)
        self._real = os.path.realpath(folder)
        self._below = self._real.rstrip(os.sep) + os.sep
        self._caches = _caches_beside(self._real)
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
        """Return the full path of a file or folder, after checking that no symbolic link on it leads out of the root,
        except to a file in a cache beside it.

        Raises
        ------
        PathEscapeError : a symbolic link on the path leads out of the root
        MissingFileError : it leads to a cache that does not hold its content
        """
        return Path(self._path(relative))

    def _path(self, relative: str) -> str:
        """Return what `path` returns, as text: most files are looked at more often than they are named."""
        path = os.path.join(self._folder, relative)
        if relative in self._inside:
            return path
        real = os.path.realpath(path)
        if real != self._real and not real.startswith(self._below) and not self.is_cached(real):
            if real.startswith(self._caches) and not os.path.exists(real):
                raise MissingFileError(
                    "the link's content is not in the cache of the dataset",
                    where=self.folder / relative,
                    remedy="Download it: 'git annex get', 'dvc pull' or 'hf download', as the dataset has it",
                )
            raise PathEscapeError(
                f"a symbolic link leads out of the dataset, to {real}",
                where=self.folder / relative,
                remedy="Put the file itself, not a link, inside the dataset's root folder",
            )
        if os.path.lexists(path):
            if len(self._inside) >= PATHS_KEPT:
                self._inside.clear()
            self._inside.add(relative)
        return path

    def is_cached(self, real: str) -> bool:
        """Return whether a path without symbolic links is a regular file in a cache beside the root."""
        return real.startswith(self._caches) and os.path.isfile(real)

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


@dataclass
class FileListing:
    """The files of a dataset, and problems found while listing them.

    paths : relative to the root, '/'-separated, sorted
    passed_over : why a file or link was skipped, by its path; no data is lost
    faults : what could not be followed or opened, by its path; the data behind it is missing until this is fixed
    """

    paths: list[str] = field(default_factory=list)
    passed_over: dict[str, str] = field(default_factory=dict)
    faults: dict[str, InputError] = field(default_factory=dict)

    def take(self, root: DatasetRoot, paths: Iterable[str]) -> None:
        """Add paths to the listing. Of several paths to one real file, only one is added: the path without a symbolic
        link, or the first if all have links.

        A link to a file outside the root is kept: it leads to a cache beside the root (see `DatasetRoot`), or reading
        it raises an error for that file only. Nothing is listed behind a link to a folder outside the root; the link is
        reported as one fault.
        """
        real_folder = os.path.realpath(root.folder)
        folders: dict[str, tuple[str, bool]] = {}
        by_file: dict[str, list[str]] = {}
        for path in sorted(set(paths)):
            if not path.isprintable() and (shown := shown_path(path)) != path:
                self.faults[shown] = FormatError(
                    "the name is not UTF-8 text, so that nothing can refer to the file",
                    where=root.folder / path,
                    remedy="Rename it, or name it under 'exclude'",
                )
                continue
            folder, _, name = path.rpartition("/")
            if folder not in folders:
                real = os.path.realpath(root.folder / folder)
                folders[folder] = real.rstrip(os.sep) + os.sep, _is_inside(real, real_folder)
            begin, inside = folders[folder]
            if not inside:
                link = _outermost_link(root, path)
                self.faults[shown_path(link)] = PathEscapeError(
                    "the symbolic link leads out of the dataset's root folder; the files behind it are not read",
                    where=root.folder / link,
                    remedy="Put the folder itself inside the root, or name the link under 'exclude'",
                )
                continue
            real = begin + name
            if os.path.islink(real):
                real = os.path.realpath(real)
                # Files of equal content share one file of a cache, but each is a file of its own.
                inside = _is_inside(real, real_folder) and not root.is_cached(real)
            if inside:
                by_file.setdefault(real, []).append(path)
            else:
                self.paths.append(path)
        for real, same in by_file.items():
            if len(same) == 1:
                self.paths += same
                continue
            kept = next((path for path in same if os.path.join(real_folder, path) == real), same[0])
            self.paths.append(kept)
            for path in same:
                if path != kept:
                    link = _outermost_link(root, path)
                    target = os.readlink(root.folder / link) if os.path.islink(root.folder / link) else kept
                    self.passed_over[shown_path(link)] = (
                        f"a symbolic link to '{shown_path(target)}': its files are listed under their own names"
                    )
        self.paths.sort()


def list_files(root: DatasetRoot, patterns: Sequence[str]) -> FileListing:
    """List the files whose path matches a pattern; ``*`` and ``?`` do not match '/', hidden files are skipped.

    Raises
    ------
    ConfigError : the root folder can't be listed
    TransientIOError : the disk or the network failed
    """
    listing = FileListing()
    known: dict[str, list[os.DirEntry[str]]] = {}
    found = {path for pattern in patterns for path in _matching(root, "", pattern.split("/"), known, listing)}
    listing.take(root, found)
    return listing


def _matching(
    root: DatasetRoot, folder: str, parts: Sequence[str], known: dict[str, list[os.DirEntry[str]]], listing: FileListing
) -> Iterator[str]:
    if folder not in known:
        known[folder] = _entries(root, folder, listing)
    for entry in known[folder]:
        if not fnmatchcase(entry.name, parts[0]) or entry.name.startswith("."):
            continue
        path = f"{folder}/{entry.name}" if folder else entry.name
        if len(parts) > 1:
            if is_folder(entry):
                yield from _matching(root, path, parts[1:], known, listing)
        elif not is_folder(entry):
            yield path


def _entries(root: DatasetRoot, folder: str, listing: FileListing) -> list[os.DirEntry[str]]:
    try:
        with os.scandir(root.folder / folder) as entries:
            return list(entries)
    except OSError as error:
        if error.errno in TRANSIENT:
            raise TransientIOError(
                f"the folder can't be listed ({error.strerror})", where=root.folder / folder
            ) from error
        what, remedy = f"the folder can't be listed ({error.strerror})", "Check its permissions"
        if not folder:
            raise ConfigError(what, where=root.folder, remedy=remedy) from None
        listing.faults[shown_path(folder)] = MissingFileError(what, where=root.folder / folder, remedy=remedy)
        return []


def is_folder(entry: os.DirEntry[str]) -> bool:
    """Return whether an entry is a folder or a link to one; a link that leads nowhere, or to itself, is none."""
    try:
        return entry.is_dir()
    except OSError:  # a link that points to itself
        return False


def _is_inside(path: str, folder: str) -> bool:
    return path == folder or path.startswith(folder.rstrip(os.sep) + os.sep)


def _outermost_link(root: DatasetRoot, path: str) -> str:
    """Return the beginning of a path up to and including its first symbolic link; the whole path if no part of it is a
    link.
    """
    parts = path.split("/")
    heads = ("/".join(parts[: n + 1]) for n in range(len(parts)))
    return next((head for head in heads if os.path.islink(root.folder / head)), path)
