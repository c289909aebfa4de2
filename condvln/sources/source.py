"""What all source families name a scene by: its handle, its input files and their hashes, and what it counted."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, TypeAlias

from condvln.formats.dataset_root import DatasetRoot
from condvln.formats.regular_file import open_regular, refuse_pointer
from schemas.canonical import canonical_json
from schemas.errors import InputError, MissingFileError

__all__ = [
    "MAX_OBJECTS",
    "UNKNOWN_LABEL",
    "HashFile",
    "InputLedger",
    "SceneCounts",
    "SceneHandle",
    "SceneInput",
    "hash_file",
]

HashFile: TypeAlias = Callable[[Path], tuple[int, str]]
"""Returns size in bytes and SHA-256 (hex) of a file; may be cached by the caller."""

UNKNOWN_LABEL: Final = "unknown"
"""Raw label of objects that their dataset does not name; a catch-all label, so never used in text."""

MAX_OBJECTS: Final = 100_000
"""Largest number of objects of a scene. The largest real buildings have three thousand; relations grow
quadratically.
"""

_READ_BYTES = 1 << 20


@dataclass(frozen=True, slots=True)
class SceneInput:
    """One input of a scene.

    path : relative to the dataset root, '/'-separated; an entry of a shared file as ``file#entry``
    size : bytes of the file, or of the entry's canonical JSON
    sha256 : SHA-256 of the same bytes, hex
    """

    path: str
    size: int
    sha256: str


@dataclass(frozen=True, slots=True)
class SceneCounts:
    """The size of a scene as known from the listing; used to estimate the cost of a run.

    objects, rooms : counted if the listing reads them, else estimated from the bytes of the annotation
    navmesh_bytes : size of its largest shipped navmesh; 0 if there is none
    mesh_bytes : total size of its meshes
    """

    objects: float = 0.0
    rooms: float = 1.0
    navmesh_bytes: int = 0
    mesh_bytes: int = 0


@dataclass(frozen=True, slots=True)
class SceneHandle:
    """A scene that can be read.

    inputs : everything that reading it would open, sorted by path
    counts : approximate size, for cost estimates only
    fault : why it can't be read, if the listing already found out; such a scene is quarantined, not dropped
    """

    family: str
    scene_id: str
    inputs: tuple[SceneInput, ...]
    counts: SceneCounts
    fault: InputError | None = None


def hash_file(path: Path) -> tuple[int, str]:
    """Return size and SHA-256 of a file, read in blocks."""
    digest = hashlib.sha256()
    size = 0
    with open_regular(path) as stream:
        while piece := stream.read(_READ_BYTES):
            digest.update(piece)
            size += len(piece)
    return size, digest.hexdigest()


class InputLedger:
    """The files, and entries of shared files, that one scene depends on.

    objects, rooms : numbers of the scene's objects and rooms, if the listing has counted them; otherwise None
    """

    def __init__(self) -> None:
        self._files: set[str] = set()
        self._entries: dict[str, Any] = {}
        self._records: dict[str, bytes] = {}
        self.objects: int | None = None
        self.rooms: int | None = None

    def file(self, path: str) -> None:
        """Record a whole file, by its path relative to the root."""
        self._files.add(path)

    def entry(self, path: str, name: str, value: Any) -> None:
        """Record one entry of a shared file, so that changes of other entries do not affect this scene."""
        self._entries[f"{path}#{name}"] = value

    def record(self, name: str, data: bytes) -> None:
        """Add an input by its bytes: one record of a shared file (named ``file#record``), or a whole file."""
        self._records[name] = data

    def inputs(self, root: DatasetRoot, hash_file: HashFile) -> tuple[SceneInput, ...]:
        """Return all recorded inputs, sorted by path; files that no longer exist are left out.

        Raises
        ------
        MissingFileError : a file exists but can't be read, or is a pointer to one that was not downloaded
        """
        entries = {name: canonical_json(value) for name, value in self._entries.items()} | self._records
        found = [SceneInput(p, len(v), hashlib.sha256(v).hexdigest()) for p, v in entries.items()]
        for path in sorted(self._files):
            if root.has(path):
                try:
                    refuse_pointer(root.path(path))
                    size, sha256 = hash_file(root.path(path))
                except OSError as error:
                    what = f"the file can't be read ({error.strerror})"
                    raise MissingFileError(what, where=root.folder / path, remedy="Correct its permissions") from None
                found.append(SceneInput(path, size, sha256))
        return tuple(sorted(found, key=lambda i: i.path))
