"""The store and the hash memory of one configuration."""

from __future__ import annotations

import subprocess
from pathlib import Path
from typing import Final

from condvln.sources.source import HashFile
from factory.files import FileHashes
from factory.snapshot import Snapshot
from factory.store import LocalStore, Store
from schemas.config import Config

__all__ = ["file_hashes", "git_revision", "hasher", "open_store", "published"]

HASHES: Final = ".hashes.sqlite"
"""Memory of input hashes, in the store's folder; losing it costs time only."""


def open_store(config: Config) -> Store:
    """The store that `config` names."""
    return LocalStore(config.store)


def published(config: Config) -> Snapshot:
    """What is published under the configuration's name. Raises StoreError when nothing is."""
    return Snapshot.open(open_store(config), config.name)


def file_hashes(config: Config) -> FileHashes:
    """The memory of input hashes; call ``save`` when done."""
    return FileHashes(config.store / HASHES)


def hasher(hashes: FileHashes) -> HashFile:
    """The memory in the form that sources ask for."""

    def hash_file(path: Path) -> tuple[int, str]:
        found = hashes.file(path.parent, path.name)
        return found.size, found.sha256

    return hash_file


def git_revision() -> str:
    """Revision of this code where it runs from a checkout, else empty. Recorded, never keyed."""
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
