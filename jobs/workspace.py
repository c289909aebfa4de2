"""The store of one configuration, what is published in it, and the caches of this machine."""

from __future__ import annotations

import hashlib
import os
import subprocess
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Final

from factory.address import open_store as open_address
from factory.files import FileHashes
from factory.local_copy import local_copy
from factory.snapshot import Snapshot
from factory.store import Store
from schemas.config import Config

if TYPE_CHECKING:  # a rebuild that finds nothing to do loads no science
    from condvln.sources.source import HashFile

__all__ = [
    "CACHE_VARIABLE",
    "file_hashes",
    "git_revision",
    "graph_folders",
    "hasher",
    "local_state",
    "open_store",
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


def source_paths(config: Config) -> list[Path]:
    """Return the folders and files that hold all inputs of the scenes."""
    return [
        path for source in config.sources for path in (source.root, source.regions, source.houses) if path is not None
    ]


def graph_folders(config: Config) -> list[Path]:
    """Return the folders of Matterport3D's connectivity graphs: as configured, else in the dataset's folder."""
    sources = [source for source in config.sources if source.family == "mp3d"]
    return [source.connectivity or source.root / CONNECTIVITY for source in sources]


def file_hashes(config: Config) -> FileHashes:
    """Open the cache of input hashes; call ``save`` when done."""
    return FileHashes(local_state(config.store) / HASHES)


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
