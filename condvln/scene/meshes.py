"""Read the meshes of a dataset on demand, with a bounded cache."""

from __future__ import annotations

from collections import OrderedDict
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from condvln.formats.dataset_root import DatasetRoot
from condvln.formats.glb import MAX_GLB_BYTES, GlbGeometry, read_glb
from condvln.scene.boxes import transform_points
from condvln.scene.scene import MeshPart, SceneObject

__all__ = ["CACHE_BYTES", "MeshLibrary", "WorldMesh", "shared_library"]

CACHE_BYTES: Final = 192 << 20
"""Size limit of the cache of decoded geometry; all of ReplicaCAD's objects take 40 MB, and a worker has 1 GiB."""

RIGID_TOLERANCE: Final = 1e-12
"""Tolerance of R·Rᵀ against the identity for rotations that keep lengths: 0.01 nm at 10 m."""


@dataclass(frozen=True, eq=False, slots=True)
class WorldMesh:
    """Triangles in the scene's frame: vertices (n, 3) metres, not rounded; faces (m, 3), counter-clockwise from
    outside.

    watertight : all parts are closed surfaces, so that "inside" is defined
    asset, pose : the triangles in their own frame and the rigid placement (4, 4) that they were moved by; None for what
        has several parts or is scaled
    """

    vertices: NDArray[np.float64]
    faces: NDArray[np.int32]
    watertight: bool
    asset: GlbGeometry | None = None
    pose: NDArray[np.float64] | None = None


class MeshLibrary:
    """The mesh files under one dataset root, by relative path."""

    def __init__(self, root: Path, cache_bytes: int = CACHE_BYTES) -> None:
        self._root = DatasetRoot(root)
        self._cache: OrderedDict[tuple[str, int, int], GlbGeometry] = OrderedDict()
        self._cache_bytes = cache_bytes
        self._used_bytes = 0

    def geometry(self, path: str) -> GlbGeometry:
        """Return the triangles of a file in its own frame.

        Raises
        ------
        MissingFileError : the file does not exist
        FormatError : it can't be read; see `read_glb`
        """
        key = (path, *self._root.signature(path))
        if key in self._cache:
            self._cache.move_to_end(key)
            return self._cache[key]
        geometry = read_glb(self._root.read(path, MAX_GLB_BYTES), str(self._root.folder / path))
        self._cache[key] = geometry
        self._used_bytes += _bytes(geometry)
        while self._used_bytes > self._cache_bytes and len(self._cache) > 1:
            self._used_bytes -= _bytes(self._cache.popitem(last=False)[1])
        return geometry

    def placed(self, part: MeshPart) -> WorldMesh:
        """Return the triangles of a mesh part, in the scene's frame."""
        geometry = self.geometry(part.path)
        faces = geometry.faces
        turned = part.transform[:3, :3]
        rigid = bool(np.abs(turned @ turned.T - np.eye(3)).max() <= RIGID_TOLERANCE)
        if np.linalg.det(turned) < 0:
            faces, rigid = faces[:, ::-1], False
        vertices = transform_points(part.transform, geometry.vertices)
        if not rigid:
            return WorldMesh(vertices, faces, geometry.watertight)
        return WorldMesh(vertices, faces, geometry.watertight, geometry, part.transform)

    def world_mesh(self, item: SceneObject) -> WorldMesh | None:
        """Return all parts of an object as one mesh; None if the object has no mesh."""
        parts = [self.placed(part) for part in item.mesh]
        if len(parts) <= 1:
            return parts[0] if parts else None
        starts = np.cumsum([0, *(len(p.vertices) for p in parts[:-1])])
        return WorldMesh(
            vertices=np.concatenate([p.vertices for p in parts]),
            faces=np.concatenate([p.faces + start for p, start in zip(parts, starts, strict=True)]).astype(np.int32),
            watertight=all(p.watertight for p in parts),
        )


def _bytes(geometry: GlbGeometry) -> int:
    return geometry.vertices.nbytes + geometry.faces.nbytes


@lru_cache(maxsize=4)
def shared_library(root: Path) -> MeshLibrary:
    """Return the library of a dataset's meshes, shared within this process so that each file is read once."""
    return MeshLibrary(root)
