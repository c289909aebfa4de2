"""The solid used for an object in surface distances: its mesh, else its oriented box, else its axis-aligned box."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from condvln.formats.distinct_points import distinct_points
from condvln.formats.glb import GlbGeometry
from condvln.relations.box_distances import SIGNS
from condvln.relations.triangle_trees import TriangleTree, tree_order
from condvln.scene import SceneObject
from condvln.scene.meshes import WorldMesh

__all__ = ["BoxSolid", "CompoundSolid", "MeshSolid", "Solid", "is_its_aabb", "solid_of"]

F64 = NDArray[np.float64]

# Triangles between a box's corners, with outward normals.
_BOX_FACES: Final = np.array(
    [
        [0, 1, 3],
        [0, 3, 2],
        [4, 6, 7],
        [4, 7, 5],
        [0, 4, 5],
        [0, 5, 1],
        [2, 3, 7],
        [2, 7, 6],
        [0, 2, 6],
        [0, 6, 4],
        [1, 5, 7],
        [1, 7, 3],
    ]
)

AXIS_TOLERANCE: Final = 1e-9
"""A rotation whose entries are within this of 0 or ±1 counts as axis-aligned; 1e-9 rad moves a point at 10 m by 10
nm.
"""

_WINDING_CHUNK: Final = 1 << 20
"""Number of point–triangle pairs processed at once: about 100 MB of temporaries."""


ASSETS_KEPT: Final = 256
"""Number of assets whose faces are kept in the order of their tree; real assets have 100 kB each or less."""


@lru_cache(maxsize=ASSETS_KEPT)
def _ordered_faces(asset: GlbGeometry) -> NDArray[np.int32]:
    """Return the faces (m, 3) of an asset in the order of their tree. All scenes that contain the asset share it."""
    return asset.faces[tree_order(asset.vertices[asset.faces])]


@lru_cache(maxsize=ASSETS_KEPT)
def _pieces_of(asset: GlbGeometry) -> NDArray[np.intp]:
    """Return one vertex (p,) of each connected piece of an asset."""
    return _one_of_each_piece(asset.vertices, asset.faces)


def _one_of_each_piece(vertices: F64, faces: NDArray[np.int32]) -> NDArray[np.intp]:
    """Return one vertex (p,) of each connected piece of a surface; vertices at equal positions are merged."""
    first, merged = distinct_points(vertices)
    corner = merged[faces]
    ends = np.concatenate([corner[:, [0, 1]], corner[:, [1, 2]]])
    graph = coo_array((np.ones(len(ends), dtype=bool), (ends[:, 0], ends[:, 1])), shape=(len(first), len(first)))
    piece = connected_components(graph, directed=False)[1]
    # Vertices that no face uses would be pieces of their own, but are no part of the surface.
    used = np.unique(corner)
    _, one_each = np.unique(piece[used], return_index=True)
    chosen: NDArray[np.intp] = first[used[one_each]]
    return chosen


@dataclass(frozen=True, eq=False)
class BoxSolid:
    """A box: center (3,), half_extents (3,) metres, rotation (3, 3) with the box's axes as columns."""

    center: F64
    half_extents: F64
    rotation: F64

    @cached_property
    def vertices(self) -> F64:
        """(8, 3) corners in the scene's frame."""
        corners: F64 = self.center + (SIGNS * self.half_extents) @ self.rotation.T
        return corners

    @cached_property
    def surface(self) -> TriangleTree:
        """The surface as 12 triangles, for distances to meshes."""
        return TriangleTree.of(self.vertices[_BOX_FACES])

    @property
    def has_inside(self) -> bool:
        """Whether points can lie inside."""
        return True

    @property
    def pieces(self) -> F64:
        """(1, 3) one point on each connected piece of the surface."""
        return self.vertices[:1]

    def contains(self, points: F64) -> NDArray[np.bool_]:
        """Return whether each of the points (n, 3) lies inside or on the box."""
        local = (points - self.center) @ self.rotation
        return np.asarray((np.abs(local) <= self.half_extents).all(axis=-1), dtype=np.bool_)


@dataclass(frozen=True, eq=False)
class MeshSolid:
    """A triangle mesh in the scene's frame; it has an interior only if it is watertight."""

    mesh: WorldMesh

    @cached_property
    def surface(self) -> TriangleTree:
        """The triangles as a tree."""
        mesh = self.mesh
        if mesh.asset is not None:
            return TriangleTree.of(mesh.vertices.take(_ordered_faces(mesh.asset), axis=0))  # faster than an index
        triangles = mesh.vertices[mesh.faces]
        return TriangleTree.of(triangles[tree_order(triangles)])

    @property
    def has_inside(self) -> bool:
        """Whether points can lie inside."""
        return self.mesh.watertight

    @cached_property
    def pieces(self) -> F64:
        """(p, 3) one point on each connected piece of the surface; vertices at equal positions are merged."""
        mesh = self.mesh
        chosen = _one_of_each_piece(mesh.vertices, mesh.faces) if mesh.asset is None else _pieces_of(mesh.asset)
        points: F64 = mesh.vertices[chosen]
        return points

    def contains(self, points: F64) -> NDArray[np.bool_]:
        """Return whether each of the points (n, 3) lies inside the mesh. None does if the mesh is not watertight.

        Uses the winding number: the triangles' solid angles seen from a point sum to 4π inside and 0 outside
        (van Oosterom and Strackee, 1983). Unlike ray casting it has no grazing cases.
        """
        inside = np.zeros(len(points), dtype=np.bool_)
        if not self.mesh.watertight:
            return inside
        triangles = self.surface.triangles
        low, high = self.surface.extent
        candidates = np.nonzero(((points >= low) & (points <= high)).all(axis=-1))[0]
        step = max(1, _WINDING_CHUNK // len(triangles))
        for start in range(0, len(candidates), step):
            chunk = candidates[start : start + step]
            inside[chunk] = np.abs(_winding_number(points[chunk], triangles)) > 0.5
        return inside


@dataclass(frozen=True, eq=False)
class CompoundSolid:
    """Several boxes that overlap or touch, such as an L-shaped counter."""

    parts: tuple[BoxSolid, ...]

    @cached_property
    def surface(self) -> TriangleTree:
        """The surfaces of all parts, 12 triangles each."""
        return TriangleTree.of(np.concatenate([part.surface.triangles for part in self.parts]))

    @property
    def has_inside(self) -> bool:
        """Whether points can lie inside."""
        return True

    @cached_property
    def pieces(self) -> F64:
        """(p, 3) one point on each part."""
        return np.concatenate([part.pieces for part in self.parts])

    def contains(self, points: F64) -> NDArray[np.bool_]:
        """Return whether each of the points (n, 3) lies inside or on a part."""
        return np.asarray(np.any([part.contains(points) for part in self.parts], axis=0), dtype=np.bool_)


Solid = BoxSolid | MeshSolid | CompoundSolid


def _winding_number(points: F64, triangles: F64) -> F64:
    """Return the winding number of triangles (m, 3, 3) about points (n, 3); an integer for a closed surface."""
    a, b, c = (triangles[None, :, corner] - points[:, None] for corner in range(3))
    la, lb, lc = (np.linalg.norm(side, axis=-1) for side in (a, b, c))
    numerator = np.einsum("nmi,nmi->nm", a, np.cross(b, c))
    denominator = (
        la * lb * lc
        + np.einsum("nmi,nmi->nm", a, b) * lc
        + np.einsum("nmi,nmi->nm", b, c) * la
        + np.einsum("nmi,nmi->nm", c, a) * lb
    )
    winding: F64 = np.arctan2(numerator, denominator).sum(axis=-1) / (2.0 * np.pi)
    return winding


def solid_of(item: SceneObject, aabb: F64, mesh: WorldMesh | None) -> Solid:
    """Return the best known solid of an object whose `aabb` (2, 3) is known."""
    if mesh is not None and len(mesh.faces) > 0:
        return MeshSolid(mesh)
    if item.parts:
        return CompoundSolid(tuple(BoxSolid(part.center, part.half_extents, part.rotation) for part in item.parts))
    if item.obb is not None:
        return BoxSolid(item.obb.center, item.obb.half_extents, item.obb.rotation)
    return BoxSolid((aabb[0] + aabb[1]) / 2, (aabb[1] - aabb[0]) / 2, np.eye(3))


def is_its_aabb(item: SceneObject, mesh: WorldMesh | None) -> bool:
    """Return whether an object's solid is its axis-aligned box: no better solid is known, or the oriented box is the
    same box.
    """
    if (mesh is not None and len(mesh.faces) > 0) or item.parts:
        return False
    if item.obb is None:
        return True
    size = np.abs(item.obb.rotation)
    return bool((np.minimum(size, np.abs(1.0 - size)) <= AXIS_TOLERANCE).all())
