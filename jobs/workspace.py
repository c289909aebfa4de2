"""The store of one configuration: its address, what is published in it, its lock, and the caches of this machine."""

from __future__ import annotations

import errno
import fcntl
import hashlib
import os
import subprocess
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Final

from pydantic import ValidationError

from factory.files import FileHashes
from factory.snapshot import Snapshot, local_copy
from factory.store import Store
from factory.store import open_store as open_address
from jobs.configuration import load_config
from schemas.config import Config
from schemas.errors import StoreError, UsageError
from schemas.snapshot import Pin

if TYPE_CHECKING:  # a rebuild that finds nothing to do loads no science
    from condvln.sources.source import HashFile

__all__ = [
    "CACHE_VARIABLE",
    "CONNECTIVITY",
    "Target",
    "alone",
    "alone_in_store",
    "file_hashes",
    "find_target",
    "git_revision",
    "graph_folders",
    "hasher",
    "local_state",
    "open_store",
    "pins_of",
    "published",
    "snapshot_folder",
    "source_paths",
]

HASHES: Final = ".hashes.sqlite"
"""Cache of input hashes, in the local state of a store; without it, files are hashed again."""

VERIFIED: Final = ".verified.sqlite"
"""Cache of the hashes of published files, in the local state of a store; without it, files are read once more."""

CONNECTIVITY: Final = "connectivity"
"""Folder of viewpoint graphs in a Matterport3D dataset."""

CACHE_VARIABLE: Final = "CONDVLN_CACHE"
"""Variable that names the folder for this machine's data about remote stores; ``~/.cache/condvln`` by default."""


def open_store(config: Config) -> Store:
    """Open the store that `config` names: a folder or an object store."""
    return open_address(config.store)


def local_state(address: Path | str) -> Path:
    """Return the folder on this machine for hashes, copies and locks of the store at `address`; for a store in a
    folder, this is the same folder.
    """
    if "://" not in str(address):
        return Path(address)
    base = os.environ.get(CACHE_VARIABLE) or Path(os.environ.get("XDG_CACHE_HOME") or "~/.cache", "condvln")
    return Path(base).expanduser() / "stores" / hashlib.sha256(str(address).encode()).hexdigest()[:16]


def published(config: Config) -> Snapshot:
    """Open the snapshot that is published under the configuration's name. Raises StoreError when nothing is
    published.
    """
    return Snapshot.open(open_store(config), config.name)


def snapshot_folder(address: Path | str, snapshot: Snapshot, tables: Iterable[str] | None = None) -> Path:
    """Return the snapshot as a folder on this disk. If the store is elsewhere, the snapshot is fetched (only `tables`,
    if given).
    """
    state = local_state(address)
    return local_copy(snapshot, state, tables, FileHashes(state / VERIFIED))


def pins_of(store: Store) -> Iterator[tuple[str, Pin]]:
    """Yield (ref, its pinned tables) of a store, by ref."""
    for entry in sorted(store.list("pins"), key=lambda entry: entry.path):
        with suppress(FileNotFoundError, ValidationError):
            yield entry.path.rsplit("/", 1)[1].removesuffix(".json"), Pin.model_validate_json(store.read(entry.path))


def source_paths(config: Config) -> list[Path]:
    """Return the folders and files that hold all inputs of the scenes."""
    return [
        path for source in config.sources for path in (source.root, source.regions, source.houses) if path is not None
    ]


def graph_folders(config: Config) -> list[Path]:
    """Return the folders of Matterport3D's connectivity graphs: as configured, else in the dataset's folder."""
    sources = [source for source in config.sources if source.family == "mp3d"]
    return [source.connectivity or source.root / CONNECTIVITY for source in sources]


def file_hashes(config: Config, *, trust: bool = True) -> FileHashes:
    """Open the cache of input hashes; call ``save`` when done.

    trust : False: every file is hashed again
    """
    return FileHashes(local_state(config.store) / HASHES, trust=trust)


def hasher(hashes: FileHashes) -> HashFile:
    """Return a function that takes the path of a file and returns its size and SHA-256, looked up in the cache
    `hashes`.
    """

    def hash_file(path: Path) -> tuple[int, str]:
        found = hashes.file(path.parent, path.name)
        return found.size, found.sha256

    return hash_file


def git_revision() -> str:
    """Return the git revision of this code in a checkout, else an empty text. It is recorded, but is not part of any
    key.
    """
    try:
        run = subprocess.run(
            ["git", "-C", str(Path(__file__).parent), "describe", "--always", "--dirty"],
            capture_output=True,
            text=True,
            timeout=10,
            check=False,
        )
    except (OSError, subprocess.TimeoutExpired):
        return ""
    return run.stdout.strip() if run.returncode == 0 else ""


@dataclass(frozen=True)
class Target:
    """A store, the requested ref, and the configuration by which the store was named, if any.

    address : folder, or ``s3://…``
    name : the ref; None where the store was named and not a ref
    config : the configuration, where one was named
    """

    address: Path | str
    name: str | None
    config: Config | None = None

    @classmethod
    def of(cls, config: Config, ref: str | None = None) -> Target:
        """Return the target of a configuration: the ref of its name, or another."""
        return cls(config.store, ref or config.name, config)

    def store(self) -> Store:
        """Return the open store."""
        return open_address(self.address)

    def refs(self) -> list[str]:
        """Return the names of all published refs, sorted."""
        return sorted(entry.path.split("/", 1)[1].removesuffix(".json") for entry in self.store().list("refs"))

    def ref(self) -> str:
        """Return the requested ref; if none was requested, the only ref of the store, or 'main'.

        Raises ``UsageError`` when it is not clear which is meant.
        """
        if self.name is not None:
            return self.name
        names = self.refs()
        if len(names) == 1:
            return names[0]
        if "main" in names or not names:
            return "main"
        raise UsageError(
            f"no ref is chosen, and {len(names)} are published: {', '.join(names)}",
            where=str(self.address),
            remedy="Choose one with --ref NAME.",
        )

    def snapshot(self) -> Snapshot:
        """Open the snapshot that is published under the requested ref; if no ref was requested, under the store's only
        ref or 'main'.

        Raises ``StoreError`` when nothing is published under it, ``UsageError`` when it is not clear which is meant.
        """
        return Snapshot.open(self.store(), self.ref())

    def folder(self, tables: Iterable[str] | None = None) -> Path:
        """Return the snapshot as a folder on this disk. If the store is elsewhere, the snapshot is fetched (only
        `tables`, if given).
        """
        return snapshot_folder(self.address, self.snapshot(), tables)


def find_target(text: str, overrides: Sequence[str] = (), ref: str | None = None) -> Target:
    """Return the target that the argument CONFIG|STORE names. Raises ``UsageError`` if it is neither a configuration
    nor a store, ``ConfigError`` if the configuration is faulty.
    """
    if "://" in text:
        open_address(text)
    path = Path(text)
    if "://" not in text and not path.is_dir():
        if not path.exists():
            raise UsageError("neither a configuration nor a store", where=text, remedy="Name a YAML file or a store.")
        return Target.of(load_config(path, overrides, check_roots=False), ref)
    if overrides:
        raise UsageError(
            "--set is only for a configuration, and this is a store",
            where=text,
            remedy="Name the YAML file, or leave --set out.",
        )
    if "://" not in text:
        path = path.resolve()
        if not any((path / name).is_dir() for name in ("refs", "units", "snapshots")):
            raise UsageError("no store is in this folder", where=path, remedy="A store holds refs/ and snapshots/.")
        return Target(path, ref)
    return Target(text, ref)


_READ_ONLY: Final = {errno.EROFS, errno.EACCES, errno.EPERM}


@contextmanager
def alone(state: Path, name: str) -> Iterator[bool]:
    """Try to lock `name` on this machine. Yields False if another generate or rebuild holds the lock, else True. A
    killed command leaves no lock behind.

    Where nothing can be written nobody else is writing: no lock is needed to find that there is nothing to do.
    """
    lock = _opened(state, name)
    if lock is None:
        yield True
        return
    try:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            yield False
        else:
            yield True
    finally:
        os.close(lock)


@contextmanager
def alone_in_store(config: Config) -> Iterator[None]:
    """Hold the lock on the configuration's name in its store. Raises ``StoreError`` when another command on this
    machine holds this lock.
    """
    with alone(local_state(config.store), config.name) as held:
        if not held:
            raise StoreError(
                f"another generate or rebuild of {config.name!r} is under way on this machine",
                where=str(config.store),
                remedy="Wait until it is done: condvln status CONFIG lists the runs.",
            )
        yield


def _opened(state: Path, name: str) -> int | None:
    """Open the lock file and return its descriptor; None if the folder is read-only and so no file can be made."""
    path = state / f".rebuild-{name}.lock"
    try:
        state.mkdir(parents=True, exist_ok=True)
        return os.open(path, os.O_RDWR | os.O_CREAT, 0o644)
    except OSError as error:
        if error.errno not in _READ_ONLY:
            raise StoreError(
                f"can't be written: {error.strerror}", where=path, remedy="Check the store's folder."
            ) from error
    with suppress(OSError):
        return os.open(path, os.O_RDONLY)
    return None
