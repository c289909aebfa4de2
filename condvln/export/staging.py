"""Write an export beside the existing one and exchange the two atomically.

An export folder ``NAME`` may temporarily have three siblings: ``.NAME.new`` is being written or removed;
``.NAME.ready`` is complete (and holds the former export after the exchange); ``.NAME.old`` is the former export on file
systems that can't exchange two folders. A killed process leaves some of them, and the next export removes them, see
:func:`recover`.

The user's own files in the export's folder are kept: they are linked into the new one before the exchange. One command
at a time writes to a folder: it takes the lock (:func:`alone_in`) before its work begins.
"""

from __future__ import annotations

import ctypes
import errno
import fcntl
import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from condvln.export.contents import file_hashes, owned_files, stale_proofs
from condvln.formats.streams import sync
from schemas.errors import StoreError

__all__ = ["alone_in", "check_place", "placed", "recover", "staged"]

_AT_FDCWD: Final = -100
_RENAME_EXCHANGE: Final = 2
_NO_EXCHANGE: Final = {errno.ENOSYS, errno.EINVAL, errno.ENOTSUP}
"""Errors of systems that can't exchange two names atomically (NFS, kernels before 3.15)."""
_NO_LINK: Final = {errno.EPERM, errno.ENOTSUP, errno.ENOSYS, errno.EMLINK, errno.EACCES}
_TRIES: Final = 100
_REMEDY: Final = "The existing export is unchanged. Free some space or choose another export folder, then export again."


@dataclass(frozen=True)
class _Place:
    """The export's folder and its temporary siblings."""

    here: Path
    new: Path
    ready: Path
    old: Path

    @classmethod
    def of(cls, out: Path) -> _Place:
        here = placed(out)
        new, ready, old = (here.with_name(f".{here.name}.{state}") for state in ("new", "ready", "old"))
        return cls(here, new, ready, old)


def placed(out: Path) -> Path:
    """Return the folder that an export to ``out`` replaces: ``out`` itself, or its target if ``out`` is a symbolic
    link.
    """
    return Path(os.path.realpath(out))


def check_place(out: Path) -> None:
    """Create the parent of an export's folder, and check that the folder can be replaced.

    Raises
    ------
    StoreError : the parent can't be written, or the folder is a file or a mount point, or contains a mount point
    """
    here = placed(out)
    try:
        here.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise StoreError(
            f"can't be created: {error.strerror or error}", where=here.parent, remedy="Choose another export folder."
        ) from error
    if here.exists() and not here.is_dir():
        raise StoreError("the export folder is a file", where=here, remedy="Choose another export folder.")
    if not os.access(here.parent, os.W_OK | os.X_OK):
        raise StoreError(
            "the parent of the export folder is not writable, but a new export must be written there",
            where=here.parent,
            remedy="Choose an export folder whose parent can be written.",
        )
    mounted = next((path for path in (here, *_folders(here)) if os.path.ismount(path)), None)
    if mounted is not None:
        where = "is" if mounted == here else f"holds, at {mounted},"
        raise StoreError(
            f"the export folder {where} a mount point, which can't be exchanged for a new folder",
            where=here,
            remedy=f"Choose a folder below the mount, such as {here / 'export'}"
            if mounted == here
            else "Unmount it or choose another export folder.",
        )


@contextmanager
def staged(out: Path) -> Iterator[Path]:
    """Return a context manager that yields a new folder beside ``out``. If the block succeeds, the folder replaces
    ``out``.

    If the block fails, ``out`` is unchanged. The caller ensures that only one process at a time writes an ``out``.
    Everything is flushed to disk before the exchange.

    Raises
    ------
    StoreError : a file can't be written, or the folder can't be replaced (see :func:`check_place`)
    """
    check_place(out)
    recover(out)
    place = _Place.of(out)
    try:
        with _refusals(place.here):
            place.new.mkdir()
        yield place.new
        with _refusals(place.here):
            if place.here.exists():
                _keep_foreign(place.here, place.new)
                _copy_attributes(place.here, place.new)
            _sync_folders(place.new)
            os.rename(place.new, place.ready)
            _take_place(place)
    finally:
        recover(out)


def recover(out: Path) -> None:
    """Remove what a killed export left beside ``out``; if it was killed between two renames, restore ``out``.

    Raises
    ------
    StoreError : a folder can't be renamed or removed
    """
    place = _Place.of(out)
    with _refusals(place.here):
        if place.old.exists() and not place.here.exists():
            os.rename(place.old, place.here)
    _clear(place)


def _take_place(place: _Place) -> None:
    if not place.here.exists():
        os.rename(place.ready, place.here)
    elif not _exchange(place.ready, place.here):
        os.rename(place.here, place.old)
        os.rename(place.ready, place.here)
    with suppress(OSError):  # the new export is in place, even if the parent folder can't be synced
        sync(place.here.parent)


def _clear(place: _Place) -> None:
    """Remove the temporary siblings of the export's folder. Files that the user added to the former export during the
    exchange are moved into the new one.
    """
    _remove(place.new)
    for former in (place.ready, place.old):
        if former.exists():
            with suppress(OSError):  # the export is in place; the next one removes what is left
                if place.here.exists():
                    _move_foreign(former, place.here)
                # renamed first, so that a half-removed export is never taken for a complete one
                os.rename(former, place.new)
                _remove(place.new)


def _remove(folder: Path) -> None:
    shutil.rmtree(folder, ignore_errors=True)
    if folder.exists():  # folders without write permission
        for path in (folder, *_folders(folder)):
            with suppress(OSError):
                path.chmod(0o700)
        shutil.rmtree(folder, ignore_errors=True)


def _foreign(folder: Path, new: Path) -> Iterator[str]:
    """Yield the paths in ``folder`` to keep when ``new`` replaces it: the user's files and links, certificates that
    hold for the files of ``new`` too, and empty folders.
    """
    owned = owned_files(folder) | stale_proofs(folder, file_hashes(new))
    for parent, folders, files in os.walk(folder):
        base = Path(parent).relative_to(folder)
        links = [name for name in folders if Path(parent, name).is_symlink()]
        for name in sorted([*files, *links]):
            path = (base / name).as_posix()
            if path not in owned:
                yield path
        if not folders and not files and base != Path():
            yield base.as_posix()


def _keep_foreign(former: Path, new: Path) -> None:
    """Link the user's files of the former export into the new export, except where the new export has a file of the
    same name.
    """
    for path in _foreign(former, new):
        source, target = former / path, new / path
        if os.path.lexists(target) or not _parent_made(new, target):
            continue
        if source.is_dir() and not source.is_symlink():
            target.mkdir()
            continue
        try:
            os.link(source, target, follow_symlinks=False)
        except OSError as error:
            if error.errno not in _NO_LINK:
                raise
            shutil.copy2(source, target, follow_symlinks=False)
            sync(target)


def _move_foreign(former: Path, here: Path) -> None:
    for path in [*_foreign(former, here)]:
        if not os.path.lexists(here / path) and _parent_made(here, here / path):
            os.rename(former / path, here / path)


def _parent_made(root: Path, target: Path) -> bool:
    """Create the folders above ``target``; return False if the new export has a file in their place."""
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
    except (FileExistsError, NotADirectoryError):
        return False
    return target.parent.resolve().is_relative_to(root.resolve())


def _copy_attributes(former: Path, new: Path) -> None:
    """Copy the folder's mode, group and access lists, so that readers of the former export can read the new one."""
    with suppress(OSError):
        os.chown(new, -1, former.stat().st_gid)
    with suppress(OSError):
        shutil.copystat(former, new)


def _folders(folder: Path) -> Iterator[Path]:
    for parent, folders, _ in os.walk(folder):
        yield from (Path(parent, name) for name in folders)


def _sync_folders(folder: Path) -> None:
    """Sync all folders to disk, since new file names are on disk only then. The files themselves were synced when they
    were closed.
    """
    for parent in [*_folders(folder), folder]:
        if not parent.is_symlink():
            sync(parent)


def _exchange(one: Path, other: Path) -> bool:
    """Exchange two names atomically (Linux's ``renameat2``); return False if the system does not support it."""
    renameat2 = getattr(ctypes.CDLL(None, use_errno=True), "renameat2", None)
    if renameat2 is None:
        return False
    names = os.fsencode(one), os.fsencode(other)
    if renameat2(_AT_FDCWD, names[0], _AT_FDCWD, names[1], _RENAME_EXCHANGE) == 0:
        return True
    number = ctypes.get_errno()
    if number in _NO_EXCHANGE:
        return False
    raise OSError(number, os.strerror(number), str(other))


@contextmanager
def _refusals(where: Path) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        raise StoreError(
            f"the export can't replace the old one: {error.strerror or error}", where=where, remedy=_REMEDY
        ) from error


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
