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
from stat import S_ISDIR
from typing import Any, Final

from condvln.sources.file_listing import is_folder
from factory.commits import Commits
from factory.inventory import glance
from factory.store import Store
from jobs.workspace import graph_folders, source_paths
from schemas.base import Document
from schemas.canonical import digest
from schemas.config import Config
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

    def export_stands(self, snapshot_id: str | None) -> bool:
        """Whether the export was made of this snapshot with these settings, and all its files exist and have the
        recorded sizes.
        """
        if self.memory is None or self.memory.exported != digest([snapshot_id, self._exported]):
            return False
        return self._export_stats() is not None

    def remember(self, snapshot_id: str | None, quarantined: int) -> None:
        """Record a complete rebuild."""
        exported = None if self._config.export is None else digest([snapshot_id, self._exported])
        memory = Memory(
            inputs=self._inputs if self._settled else UNSETTLED,
            outputs=self._outputs(),
            exported=exported,
            quarantined=quarantined,
            looked_at=time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime()),
        )
        temporary = self._path.with_suffix(".tmp")
        with suppress(OSError):  # a store that is read-only is looked at in full every time
            temporary.write_text(memory.model_dump_json(), encoding="utf-8")
            os.replace(temporary, self._path)

    def _outputs(self) -> str:
        quarantined = sorted([*key] for key in Commits(self._store).quarantined())
        document: list[Any] = [glance(self._store, self._config.name), quarantined]
        if self._config.export is not None:
            document.append(self._export_stats())
        return digest(document)

    def _export_stats(self) -> list[Any] | None:
        """Return (path, size, time) of every file that the export lists; None when a file is missing or has another
        size.
        """
        assert self._config.export is not None
        found: list[Any] = []
        try:
            index = json.loads((self._config.export / EXPORT_INDEX).read_bytes())
            for path, listed in sorted(index["files"].items()):
                stat = (self._config.export / path).stat()
                if stat.st_size != listed["bytes"]:
                    return None
                found.append([path, stat.st_size, stat.st_mtime_ns])
        except (OSError, ValueError, KeyError, TypeError, AttributeError):
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
    stack = [str(root) for root in roots]
    while stack:
        files, folders = _inside(stack.pop(), seen)
        # Sorted in each folder, since a list of all files would grow with the dataset.
        stack += sorted(folders)
        state.update(json.dumps(sorted(files)).encode())
        youngest = max([youngest, *(mtime for _, _, mtime in files)])
    return state.hexdigest(), time.time() - youngest / 1e9 >= SETTLED_SECONDS


def _inside(place: str, seen: set[tuple[int, int]]) -> tuple[list[list[Any]], list[str]]:
    """Return ([path, size, mtime_ns] of the files in a folder, the paths of its folders); of a file, itself. Nothing of
    a place that is in `seen`, to which it is added.
    """
    try:
        stat = os.stat(place)
        entries = [*os.scandir(place)] if S_ISDIR(stat.st_mode) else []
    except OSError:
        return [[place, -1, 0]], []
    if (stat.st_dev, stat.st_ino) in seen:
        return [], []
    seen.add((stat.st_dev, stat.st_ino))
    files = [] if S_ISDIR(stat.st_mode) else [_stat(place)]
    folders = []
    for entry in entries:
        if is_folder(entry):
            folders.append(entry.path)
        else:
            files.append(_stat(entry))
    return files, folders


def _stat(file: str | os.DirEntry[str]) -> list[Any]:
    path = file if isinstance(file, str) else file.path
    try:
        stat = os.stat(path) if isinstance(file, str) else file.stat()
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
