"""List the files of a dataset's folder that match patterns, each real file once, whatever symbolic links lead to it."""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from fnmatch import fnmatchcase

from condvln.formats.dataset_root import TRANSIENT, DatasetRoot
from schemas.errors import ConfigError, FormatError, InputError, MissingFileError, PathEscapeError, TransientIOError
from schemas.file_name import shown_path

__all__ = ["FileListing", "is_folder", "list_files"]


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

        A link to a file outside the root is kept; reading it raises an error for that file only. Nothing is listed
        behind a link to a folder outside the root; the link is reported as one fault.
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
                inside = _is_inside(real, real_folder)
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
