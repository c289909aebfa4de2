"""Surface distances of objects whose boxes are close: FCL's, but for pairs of axis-aligned boxes (closed form).

The solid used for an object is its mesh, else its oriented box, else its axis-aligned box.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from condvln.arrays import F64
from condvln.formats.glb import GlbGeometry
from condvln.relations.collision import CollisionBody, asset_body, body_of, box_body
from condvln.scene import OrientedBox, RoomArrays, SceneObject, round_mm
from condvln.scene.boxes import aabb_of, box_corners
from condvln.scene.meshes import WorldMesh

__all__ = [
    "BoxSolid",
    "MeshOf",
    "MeshSolid",
    "Solid",
    "is_its_aabb",
    "solid_distance",
    "solid_of",
    "surface_distances",
]


AXIS_TOLERANCE: Final = 1e-9
"""A rotation whose entries are within this of 0 or ±1 counts as axis-aligned; 1e-9 rad moves a point at 10 m by 10
nm.
"""

_WINDING_CHUNK: Final = 1 << 20
"""Number of point–triangle pairs processed at once: about 100 MB of temporaries."""


ASSETS_KEPT: Final = 256
"""Number of assets whose pieces are kept; real assets have a few."""


@lru_cache(maxsize=ASSETS_KEPT)
def _pieces_of(asset: GlbGeometry) -> NDArray[np.intp]:
    """Return one vertex (p,) of each connected piece of an asset."""
    return _one_of_each_piece(asset.vertices, asset.faces)


def _one_of_each_piece(vertices: F64, faces: NDArray[np.int32]) -> NDArray[np.intp]:
    """Return one vertex (p,) of each connected piece of a surface; vertices at equal positions are merged."""
    _, first, merged = np.unique(vertices, axis=0, return_index=True, return_inverse=True)
    corner = merged.reshape(-1)[faces]
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
    """A box, or several that overlap or touch, such as an L-shaped counter."""

    boxes: tuple[OrientedBox, ...]

    @cached_property
    def extent(self) -> F64:
        """(2, 3) [min, max] of all corners."""
        return aabb_of(np.concatenate([box_corners(box) for box in self.boxes]))

    @cached_property
    def bodies(self) -> tuple[CollisionBody, ...]:
        """The surfaces of all boxes, for distances."""
        return tuple(map(box_body, self.boxes))

    @property
    def pieces(self) -> F64:
        """(p, 3) one point on each box."""
        return np.array([box_corners(box)[0] for box in self.boxes])

    def contains(self, points: F64) -> NDArray[np.bool_]:
        """Return whether each of the points (n, 3) lies inside or on a box."""
        inside = np.zeros(len(points), dtype=np.bool_)
        for box in self.boxes:
            inside |= (np.abs((points - box.center) @ box.rotation) <= box.half_extents).all(axis=-1)
        return inside


@dataclass(frozen=True, eq=False)
class MeshSolid:
    """A triangle mesh in the scene's frame; it has an interior only if it is watertight."""

    mesh: WorldMesh

    @property
    def _triangles(self) -> F64:
        """(m, 3, 3) the triangles in the scene's frame."""
        triangles: F64 = self.mesh.vertices[self.mesh.faces]
        return triangles

    @cached_property
    def extent(self) -> F64:
        """(2, 3) [min, max] of all triangles."""
        triangles = self._triangles
        return np.array([triangles.min(axis=(0, 1)), triangles.max(axis=(0, 1))])

    @cached_property
    def bodies(self) -> tuple[CollisionBody, ...]:
        """The surface, for distances."""
        mesh = self.mesh
        if mesh.asset is not None and mesh.pose is not None:
            return (asset_body(mesh.asset, mesh.pose),)
        return (body_of(mesh.vertices, mesh.faces),)

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
        triangles = self._triangles
        low, high = self.extent
        candidates = np.nonzero(((points >= low) & (points <= high)).all(axis=-1))[0]
        step = max(1, _WINDING_CHUNK // len(triangles))
        for start in range(0, len(candidates), step):
            chunk = candidates[start : start + step]
            inside[chunk] = np.abs(_winding_number(points[chunk], triangles)) > 0.5
        return inside


Solid = BoxSolid | MeshSolid


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


def solid_of(item: SceneObject, mesh: WorldMesh | None) -> Solid:
    """Return the best known solid of an object that has a box."""
    if mesh is not None and len(mesh.faces) > 0:
        return MeshSolid(mesh)
    return BoxSolid(item.solids)


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


Indices = NDArray[np.intp]

MeshOf = Callable[[SceneObject], WorldMesh | None]
"""Returns an object's mesh in the scene's frame, or None if it has none, e.g. `MeshLibrary.world_mesh`."""


def surface_distances(arrays: RoomArrays, aabb_distance: F64, within: float, meshes: MeshOf | None) -> F64:
    """Return (n, n) surface distances in metres, rounded to 1 mm; NaN where not computed, 0 on the diagonal.

    aabb_distance : (n, n) metres; pairs beyond `within` are not computed (the AABB distance never exceeds the surface
        distance)
    meshes : if None, boxes are used for all objects

    Each unordered pair is measured once, in order of object id, so that (i, j) and (j, i) are equal.
    """
    distance = np.where(aabb_distance <= within, aabb_distance, np.nan)
    met = (~np.isnan(distance)).sum(axis=1) > 1  # the object itself and another one
    found = [
        meshes(item) if meshes is not None and asked else None for item, asked in zip(arrays.objects, met, strict=True)
    ]
    boxes = np.array(
        [is_its_aabb(item, mesh) for item, mesh in zip(arrays.objects, found, strict=True)], dtype=np.bool_
    )
    # Two axis-aligned boxes have the closed form; all other pairs are measured.
    measured = np.triu(~np.isnan(distance) & ~(boxes[:, None] & boxes[None, :]), k=1)
    rows, columns = np.nonzero(measured)
    solids: dict[int, Solid] = {}
    for k in np.unique(np.concatenate([rows, columns])).tolist():
        solids[k] = solid_of(arrays.objects[k], found[k])
    distance[rows, columns] = distance[columns, rows] = _distances(solids, rows, columns)
    np.fill_diagonal(distance, 0.0)
    return round_mm(distance)


def solid_distance(first: Solid, second: Solid) -> float:
    """Return the distance of two solids in metres; 0 where they overlap or one contains a piece of the other."""
    return float(_distances({0: first, 1: second}, np.array([0]), np.array([1]))[0])


def _distances(solids: Mapping[int, Solid], rows: Indices, columns: Indices) -> F64:
    """Return the distances (p,) of pairs of solids in metres; 0 where two overlap or one contains a piece of the other.

    rows, columns : (p,) the keys of each pair's solids
    """
    pairs = zip(rows.tolist(), columns.tolist(), strict=True)
    found = np.array(
        [min(one.distance(other) for one in solids[i].bodies for other in solids[j].bodies) for i, j in pairs]
    )
    # Between an object and the box that it lies in, surfaces have a gap, so containment is tested separately.
    unsure = np.flatnonzero(found > 0.0)
    extents = np.empty((1 + max(solids, default=0), 2, 3))
    for k in {*rows[unsure].tolist(), *columns[unsure].tolist()}:
        extents[k] = solids[k].extent
    (low, high), (other_low, other_high) = (extents[ends[unsure]].transpose(1, 0, 2) for ends in (rows, columns))
    unsure = unsure[~((low > other_high) | (other_low > high)).any(axis=1)]
    for one, other in ((rows[unsure], columns[unsure]), (columns[unsure], rows[unsure])):
        for k in np.unique(one).tolist():
            mine = one == k
            pieces = [solids[n].pieces for n in other[mine].tolist()]
            inside = solids[k].contains(np.concatenate(pieces))
            begins = np.cumsum([0, *map(len, pieces[:-1])])
            found[unsure[mine][np.logical_or.reduceat(inside, begins)]] = 0.0
    return found
