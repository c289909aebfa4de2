"""What every source family offers: a cheap listing of its scenes with all that each reads, and the reading of one."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Final, Protocol, TypeAlias

from condvln.scene import Scene
from condvln.scene.geometry import SceneGeometry
from schemas.errors import InputError

__all__ = [
    "MAX_OBJECTS",
    "UNKNOWN_LABEL",
    "HashFile",
    "SceneCounts",
    "SceneHandle",
    "SceneInput",
    "Source",
    "hash_file",
]

HashFile: TypeAlias = Callable[[Path], tuple[int, str]]
"""Size in bytes and SHA-256 (hex) of a file; the caller may cache it."""

UNKNOWN_LABEL: Final = "unknown"
"""Raw label of what its dataset does not name; catch-all, so never in text."""

MAX_OBJECTS: Final = 100_000
"""Objects of one scene. The largest real buildings have three thousand; relations grow with the square."""

_READ_BYTES = 1 << 20


@dataclass(frozen=True, slots=True)
class SceneInput:
    """One thing a scene is read from.

    path : relative to the dataset root, '/'-separated; an entry of a shared file as ``file#entry``
    size : bytes of the file, or of the entry's canonical JSON
    sha256 : of the same bytes, hex
    """

    path: str
    size: int
    sha256: str


@dataclass(frozen=True, slots=True)
class SceneCounts:
    """How big a scene is, as far as its listing knows: what the cost of a run is estimated from.

    objects, rooms : counted where the listing reads them, else estimated from the bytes of the annotation
    navmesh_bytes : of the biggest navmesh that is shipped for it; 0 where there is none
    mesh_bytes : of the meshes that it is put together from
    """

    objects: float = 0.0
    rooms: float = 1.0
    navmesh_bytes: int = 0
    mesh_bytes: int = 0


@dataclass(frozen=True, slots=True)
class SceneHandle:
    """A scene that can be asked for.

    inputs : all that reading it would open, sorted by path
    counts : how big it is; rough, for estimates of the cost only
    fault : why it can't be read, where listing it already showed that; such a scene is quarantined, never lost
    """

    family: str
    scene_id: str
    inputs: tuple[SceneInput, ...]
    counts: SceneCounts
    fault: InputError | None = None


class Source(Protocol):
    """A dataset on disk."""

    @property
    def family(self) -> str:
        """Name of the format, the ``source=`` partition of its tables."""
        ...

    @property
    def root(self) -> Path:
        """Folder that all relative paths of its scenes count from."""
        ...

    def handles(self) -> list[SceneHandle]:
        """The scenes asked for, sorted by id. Reads no geometry; a scene that can't be listed has a fault."""
        ...

    def scene_ids(self) -> list[str]:
        """Ids of the scenes that can be listed, sorted."""
        ...

    def passed_over(self) -> list[tuple[str, str]]:
        """Paths that the last `handles` left out without losing a scene, and why; sorted."""
        ...

    def read(self, scene_id: str) -> Scene:
        """One scene in Habitat's frame. A sound scene without objects is returned as it is.

        Raises
        ------
        InputError : the scene can't be read; says which file, where in it, and what to do
        LimitError : the scene is larger than the limits that the source was opened with
        """
        ...

    def geometry(self, scene: Scene) -> SceneGeometry | None:
        """The surfaces of a scene that `read` gave; None if the dataset on disk has neither meshes nor walls.

        Raises
        ------
        InputError : as `read`
        """
        ...

    def connectivity(self, scene_id: str) -> Path | None:
        """The file of the viewpoint graph that a scene is walked on for want of a mesh; None where there is none."""
        ...


def hash_file(path: Path) -> tuple[int, str]:
    """Size and SHA-256 of a file, read in pieces."""
    digest = hashlib.sha256()
    size = 0
    with path.open("rb") as stream:
        while piece := stream.read(_READ_BYTES):
            digest.update(piece)
            size += len(piece)
    return size, digest.hexdigest()
