"""Read the meshes of a dataset on demand, with a bounded cache; transforms of glTF nodes and texture coordinates."""

from __future__ import annotations

import math
from collections import OrderedDict
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from condvln.arrays import F64
from condvln.formats.dataset_root import DatasetRoot
from condvln.formats.glb import MAX_GLB_BYTES, GlbGeometry, read_glb
from condvln.formats.glb_part import GlbPart
from condvln.scene.boxes import placement, transform_points
from condvln.scene.rotations import to_matrix
from condvln.scene.scene import MeshPart, SceneObject

__all__ = [
    "CACHE_BYTES",
    "MeshLibrary",
    "WorldMesh",
    "coordinates_of",
    "shared_library",
    "world_transforms",
]

CACHE_BYTES: Final = 192 << 20
"""Size limit of the cache of decoded geometry; all of ReplicaCAD's objects take 40 MB, and a worker has 1 GiB."""

BODIES_KEPT: Final = 64
"""Number of bodies of several or scaled parts that are kept in one piece; ReplicaCAD has seven."""

PLACE_DIGITS: Final = 10
"""Decimals to which a part's place in its body's frame is rounded: 0.1 nm, so that a body has the same shape wherever
it is placed.
"""

RIGID_TOLERANCE: Final = 1e-12
"""Tolerance of R·Rᵀ against the identity for rotations that keep lengths: 0.01 nm at 10 m."""


@dataclass(frozen=True, eq=False, slots=True)
class WorldMesh:
    """Triangles in the scene's frame: vertices (n, 3) metres, not rounded; faces (m, 3), counter-clockwise from
    outside.

    watertight : all parts are closed surfaces, so that "inside" is defined
    asset, pose : the triangles in their own frame and the rigid placement (4, 4) that they were moved by; None for what
        is stretched or mirrored. All scenes of a process share the asset, also that of a body of several or scaled
        parts: in the body's frame, the places of its parts are rounded to `PLACE_DIGITS`.
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
        self._assembled = lru_cache(maxsize=BODIES_KEPT)(_assembled)

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
        return _placed(self.geometry(part.path), part.transform)

    def world_mesh(self, item: SceneObject) -> WorldMesh | None:
        """Return all parts of an object as one mesh; None if the object has no mesh."""
        if not item.mesh:
            return None
        assets = [self.geometry(part.path) for part in item.mesh]
        if len(assets) == 1:
            alone = _placed(assets[0], item.mesh[0].transform)
            if alone.asset is not None:
                return alone
        transforms = np.array([part.transform for part in item.mesh])
        pose = _pose_of(transforms)
        if pose is None:
            parts = [_placed(asset, part.transform) for asset, part in zip(assets, item.mesh, strict=True)]
            faces = _all_faces([p.faces for p in parts], [len(p.vertices) for p in parts])
            return WorldMesh(np.concatenate([p.vertices for p in parts]), faces, all(p.watertight for p in parts))
        vertices = [transform_points(p.transform, a.vertices) for p, a in zip(item.mesh, assets, strict=True)]
        places = np.round(np.linalg.inv(pose) @ transforms, PLACE_DIGITS) + 0.0
        body = self._assembled(tuple(assets), places.tobytes())
        return WorldMesh(np.concatenate(vertices), body.faces, body.watertight, body, pose)


def _placed(asset: GlbGeometry, transform: NDArray[np.float64]) -> WorldMesh:
    """Return the triangles of an asset that are moved by a transform (4, 4) into the scene's frame."""
    vertices, faces, turned = transform_points(transform, asset.vertices), asset.faces, transform[:3, :3]
    if np.linalg.det(turned) < 0:
        return WorldMesh(vertices, faces[:, ::-1], asset.watertight)
    if not _is_rotation(turned):
        return WorldMesh(vertices, faces, asset.watertight)
    return WorldMesh(vertices, faces, asset.watertight, asset, transform)


def _pose_of(transforms: NDArray[np.float64]) -> NDArray[np.float64] | None:
    """Return the rigid placement (4, 4) of a body, given the transforms (n, 4, 4) of its parts: that of its first part,
    without the scale. None if that part is stretched, or one of the parts is mirrored.
    """
    volumes = np.linalg.det(transforms[:, :3, :3])
    if not (volumes > 0).all():
        return None
    pose = transforms[0].copy()
    pose[:3, :3] /= np.cbrt(volumes[0])
    return pose if _is_rotation(pose[:3, :3]) else None


def _is_rotation(turned: NDArray[np.float64]) -> bool:
    """Return whether a matrix (3, 3) keeps lengths."""
    return bool(np.abs(turned @ turned.T - np.eye(3)).max() <= RIGID_TOLERANCE)


def _assembled(assets: Sequence[GlbGeometry], places: bytes) -> GlbGeometry:
    """Return the parts of a body as one. `places` are the transforms (n, 4, 4) float64 of the parts into its frame."""
    matrices = np.frombuffer(places).reshape(-1, 4, 4)
    return GlbGeometry(
        np.concatenate([transform_points(m, asset.vertices) for m, asset in zip(matrices, assets, strict=True)]),
        _all_faces([asset.faces for asset in assets], [len(asset.vertices) for asset in assets]),
        all(asset.watertight for asset in assets),
    )


def _all_faces(faces: Sequence[NDArray[np.int32]], counts: Sequence[int]) -> NDArray[np.int32]:
    """Return the faces of parts as those of one mesh. The parts have so many vertices each, which follow each other."""
    starts = np.cumsum([0, *counts[:-1]])
    return np.concatenate([own + start for own, start in zip(faces, starts, strict=True)]).astype(np.int32)


def _bytes(geometry: GlbGeometry) -> int:
    return geometry.vertices.nbytes + geometry.faces.nbytes


def shared_library(root: Path) -> MeshLibrary:
    """Return the library of a dataset's meshes, shared within this process so that each file is read once. A link that
    leads elsewhere later is another dataset.
    """
    return _library(root, root.resolve())


@lru_cache(maxsize=4)
def _library(root: Path, resolved: Path) -> MeshLibrary:
    return MeshLibrary(root)


_TRANSFORM: Final = "KHR_texture_transform"


def world_transforms(part: GlbPart) -> list[F64]:
    """Return for each node the (4, 4) transform from its frame to the root's. In `part.nodes`, parents come before
    their children.
    """
    world = [_local(node.transform) for node in part.nodes]
    for number, node in enumerate(part.nodes):
        for child in node.children:
            world[child] = world[number] @ world[child]
    return world


def _local(transform: dict[str, list[float]]) -> F64:
    if "matrix" in transform:
        matrix: F64 = np.array(transform["matrix"], np.float64).reshape(4, 4).T
        return matrix
    rotation = to_matrix(transform["rotation"]) if "rotation" in transform else None
    return placement(rotation, transform.get("translation"), transform.get("scale"))


def coordinates_of(slot: dict[str, Any]) -> tuple[str, F64]:
    """Return the attribute with the texture coordinates that a material's texture uses, and the (3, 3) transform of
    these coordinates (``KHR_texture_transform``).
    """
    moved = slot.get("extensions", {}).get(_TRANSFORM, {})
    return f"TEXCOORD_{moved.get('texCoord', slot.get('texCoord', 0))}", _moved(moved)


def _moved(transform: dict[str, Any]) -> F64:
    """Return the (3, 3) matrix of KHR_texture_transform: scale, then rotate counter-clockwise in the image, then
    translate.
    """
    angle = float(transform.get("rotation", 0.0))
    cosine, sine = math.cos(angle), math.sin(angle)
    across, down = transform.get("scale", (1.0, 1.0))
    matrix = np.eye(3)
    matrix[:2, :2] = np.array([[cosine, sine], [-sine, cosine]]) @ np.diag([across, down])
    matrix[:2, 2] = transform.get("offset", (0.0, 0.0))
    return matrix
