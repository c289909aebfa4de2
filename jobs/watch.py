"""A record of the last rebuild's inputs (names, sizes, times), by which the next rebuild sees that nothing changed,
without reading any file.

Two digests are kept in the machine's local state. ``inputs`` covers the configuration, this code and every file below
the sources' folders; ``outputs`` the published ref and all files that it names (``factory.inventory``), the quarantine,
and the files of the export. When both are as remembered there is nothing to do; else the rebuild plans by content.
Losing the memory costs one such plan.
"""

from __future__ import annotations

import hashlib
import json
import os
import time
from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path
from typing import Any, Final

from factory.commits import Commits
from factory.files import hash_file
from factory.inventory import glance
from factory.store import Store
from jobs.settings import export_folder
from jobs.workspace import graph_folders, source_paths
from schemas.base import Document
from schemas.canonical import digest
from schemas.config import Config
from schemas.errors import MissingFileError, TransientIOError
from schemas.unit import Hash64

__all__ = ["Memory", "Watch", "code_digest", "look"]

SETTLED_SECONDS: Final = 2.0
"""Age in seconds below which a file may change again within the same tick of a coarse clock."""

UNSETTLED: Final = "0" * 64
"""Placeholder for inputs that are not recorded."""

EXPORT_INDEX: Final = "export.json"
"""File in which an export records its snapshot and files."""

_CODE: Final = {".py", ".lark", ".csv", ".yaml", ".json"}
_PACKAGES: Final = ("schemas", "condvln", "factory", "jobs")


class Memory(Document):
    """``.rebuild-<name>.json`` in the local state of a store: digests of what the last rebuild read and left behind."""

    inputs: Hash64
    outputs: Hash64
    exported: Hash64 | None = None
    """Record of what the export was made of."""
    quarantined: int = 0
    refused: str = ""
    """Why the export is not to be used; empty where it is sound."""
    looked_at: str = ""


class Watch:
    """Tells whether anything changed since the last rebuild. The inputs are listed on construction, so that the next
    rebuild notices changes that are made while the present one runs.
    """

    def __init__(self, config: Config, store: Store, state: Path) -> None:
        self._config = config
        self._store = store
        self._path = state / f".rebuild-{config.name}.json"
        code = code_digest()
        document = config.model_dump(mode="json")
        files, files_settled = look(source_paths(config))
        # No scene is made of these, but the export is.
        graphs, graphs_settled = look(graph_folders(config))
        self._settled = files_settled and graphs_settled
        self._inputs = digest([document, code, files, graphs])
        self._exported = digest(
            [code, {k: v for k, v in document.items() if k not in ("ray", "keep", "store")}, graphs]
        )
        self.memory = self._remembered()

    def _remembered(self) -> Memory | None:
        try:
            return Memory.model_validate_json(self._path.read_bytes())
        except (OSError, ValueError):
            return None

    @property
    def unchanged(self) -> bool:
        """Whether nothing changed since the last complete rebuild."""
        memory = self.memory
        return memory is not None and memory.inputs == self._inputs and memory.outputs == self._outputs()

    def export_stands(self, snapshot_id: str | None, *, verify: bool = False) -> bool:
        """Whether the export was made of this snapshot with these settings, and all its files exist and have the
        recorded sizes.

        verify : compare their hashes, too
        """
        if self.memory is None or self.memory.exported != digest([snapshot_id, self._exported]):
            return False
        return self._export_stats(verify=verify) is not None

    def remember(self, snapshot_id: str | None, quarantined: int, refused: str | None = None) -> str:
        """Record a complete rebuild; return why the export is not to be used, empty where it is sound.

        refused : None where the export is the one before
        """
        if refused is None:
            refused = self.memory.refused if self._config.export is not None and self.memory is not None else ""
        exported = None if self._config.export is None else digest([snapshot_id, self._exported])
        memory = Memory(
            inputs=self._inputs if self._settled else UNSETTLED,
            outputs=self._outputs(),
            exported=exported,
            quarantined=quarantined,
            refused=refused,
            looked_at=time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime()),
        )
        temporary = self._path.with_suffix(".tmp")
        with suppress(OSError):  # a store that is read-only is looked at in full every time
            temporary.write_text(memory.model_dump_json(), encoding="utf-8")
            os.replace(temporary, self._path)
        return refused

    def _outputs(self) -> str:
        quarantined = sorted([*key] for key in Commits(self._store).quarantined())
        document: list[Any] = [glance(self._store, self._config.name), quarantined]
        if self._config.export is not None:
            document.append(self._export_stats())
        return digest(document)

    def _export_stats(self, *, verify: bool = False) -> list[Any] | None:
        """Return (path, size, time) of every file that the export lists; None when a file is missing or has another
        size or, with ``verify``, another hash.
        """
        found: list[Any] = []
        try:
            index = json.loads((export_folder(self._config) / EXPORT_INDEX).read_bytes())
            for path, listed in sorted(index["files"].items()):
                stat = (self._config.export / path).stat()
                if stat.st_size != listed["bytes"]:
                    return None
                if verify and hash_file(self._config.export / path) != listed["sha256"]:
                    return None
                found.append([path, stat.st_size, stat.st_mtime_ns])
        except (OSError, ValueError, KeyError, TypeError, AttributeError, MissingFileError, TransientIOError):
            return None
        return [index.get("snapshot"), found]


def look(roots: Iterable[Path]) -> tuple[str, bool]:
    """Return (a digest of path, size and mtime_ns of every file at or below `roots`, whether all files are old enough).
    A file is old enough if any later change must give it another modification time.

    Links are followed, each folder once. A file touched just now may change once more without showing it, where clocks
    are coarse.
    """
    state = hashlib.sha256()
    youngest = 0
    seen: set[tuple[int, int]] = set()
    for root in roots:
        if not root.is_dir():
            file = _stat(str(root))
            state.update(json.dumps(file).encode())
            youngest = max(youngest, file[2])
        for folder, folders, files in os.walk(root, followlinks=True):
            own = os.stat(folder)
            if (own.st_dev, own.st_ino) in seen:
                folders.clear()
                continue
            seen.add((own.st_dev, own.st_ino))
            folders.sort()
            # A folder at a time, since a list of all files would grow with the dataset.
            found = [_stat(os.path.join(folder, name)) for name in sorted(files)]
            state.update(json.dumps(found).encode())
            youngest = max([youngest, *(mtime for _, _, mtime in found)])
    return state.hexdigest(), time.time() - youngest / 1e9 >= SETTLED_SECONDS


def _stat(path: str) -> list[Any]:
    try:
        stat = os.stat(path)
    except OSError:
        return [path, -1, 0]
    return [path, stat.st_size, stat.st_mtime_ns]


def code_digest() -> str:
    """Return a digest of this program's own files. It does not use their times, which change whenever an image is
    built.
    """
    state = hashlib.sha256()
    for package in _PACKAGES:
        root = Path(__file__).parents[1] / package
        for path in sorted(path for path in root.rglob("*") if path.suffix in _CODE):
            state.update(str(path.relative_to(root)).encode() + b"\0" + path.read_bytes())
    return state.hexdigest()
