"""Distances between the surfaces of objects, measured with FCL where boxes are close enough for it to matter."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

import fcl
import numpy as np
from numpy.typing import NDArray

from condvln.relations.solids import Solid, is_its_aabb, solid_of
from condvln.scene import RoomArrays, SceneObject, round_mm
from condvln.scene.meshes import WorldMesh

__all__ = ["MeshOf", "solid_distance", "surface_distances"]

F64 = NDArray[np.float64]

MeshOf = Callable[[SceneObject], WorldMesh | None]
"""Gives an object's mesh in the scene's frame, None where it has none; `MeshLibrary.world_mesh` is one."""

_REQUEST: Final = fcl.DistanceRequest()


def surface_distances(arrays: RoomArrays, aabb_distance: F64, within: float, meshes: MeshOf | None) -> F64:
    """(n, n) surface distances in metres, rounded to 1 mm; NaN where not asked, 0 for an object and itself.

    aabb_distance : (n, n) metres; pairs beyond `within` are not asked (AABB distance never exceeds surface distance)
    meshes : where None, boxes stand for all objects

    Each unordered pair is measured once, in order of object id, so that (i, j) and (j, i) are one number.
    """
    distance = np.where(aabb_distance <= within, aabb_distance, np.nan)
    met = (~np.isnan(distance)).sum(axis=1) > 1  # itself and another
    found = [
        meshes(item) if meshes is not None and asked else None for item, asked in zip(arrays.objects, met, strict=True)
    ]
    boxes = np.array(
        [is_its_aabb(item, mesh) for item, mesh in zip(arrays.objects, found, strict=True)], dtype=np.bool_
    )
    # Between two axis-aligned boxes the closed form stands; all other pairs are measured.
    measured = np.triu(~np.isnan(distance) & ~(boxes[:, None] & boxes[None, :]), k=1)
    rows, columns = np.nonzero(measured)
    solids: dict[int, Solid] = {}
    for k in np.unique(np.concatenate([rows, columns])).tolist():
        solids[k] = solid_of(arrays.objects[k], np.array([arrays.aabb_min[k], arrays.aabb_max[k]]), found[k])
    for i, j in zip(rows.tolist(), columns.tolist(), strict=True):
        distance[i, j] = distance[j, i] = solid_distance(solids[i], solids[j])
    np.fill_diagonal(distance, 0.0)
    return round_mm(distance)


def solid_distance(first: Solid, second: Solid) -> float:
    """Distance of two solids in metres; 0 where they overlap or one holds a piece of the other.

    FCL's bounding volume hierarchies know surfaces only and give the gap between a thing and the box it lies in, so
    containment is asked apart.
    """
    result = fcl.DistanceResult()
    distance = max(float(fcl.distance(first.surface, second.surface, _REQUEST, result)), 0.0)
    if distance == 0.0 or not _extents_overlap(first, second):
        return distance
    holds = first.contains(second.pieces).any() or second.contains(first.pieces).any()
    return 0.0 if holds else distance


def _extents_overlap(first: Solid, second: Solid) -> bool:
    return bool((first.extent[0] <= second.extent[1]).all() and (second.extent[0] <= first.extent[1]).all())
