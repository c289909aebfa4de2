"""Surface distances of objects whose boxes are close. Boxes are measured in closed form, meshes by their triangles."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from condvln.relations.box_distances import box_distances
from condvln.relations.solids import BoxSolid, Solid, is_its_aabb, solid_of
from condvln.scene import RoomArrays, SceneObject, round_mm
from condvln.scene.meshes import WorldMesh

__all__ = ["MeshOf", "solid_distance", "surface_distances"]

F64 = NDArray[np.float64]
Indices = NDArray[np.intp]

MeshOf = Callable[[SceneObject], WorldMesh | None]
"""Returns an object's mesh in the scene's frame, or None if it has none, e.g. `MeshLibrary.world_mesh`."""

TOUCHING: Final = 1e-9
"""Metres at most between surfaces that touch; far below the millimetre that is published."""


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
        solids[k] = solid_of(arrays.objects[k], np.array([arrays.aabb_min[k], arrays.aabb_max[k]]), found[k])
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
    pairs = list(zip(rows.tolist(), columns.tolist(), strict=True))
    found = np.empty(len(pairs))
    ones: list[BoxSolid] = []
    others: list[BoxSolid] = []
    boxed = np.zeros(len(pairs), dtype=np.bool_)
    for k, (i, j) in enumerate(pairs):
        one, other = solids[i], solids[j]
        if isinstance(one, BoxSolid) and isinstance(other, BoxSolid):
            ones.append(one)
            others.append(other)
            boxed[k] = True
        else:
            found[k] = one.surface.distance(other.surface)
    if ones:
        found[boxed] = _between_boxes(ones, others)
    # Between an object and the box that it lies in, surfaces have a gap, so containment is tested separately.
    unsure = np.flatnonzero(~boxed & (found > TOUCHING))
    extents = np.empty((1 + max(solids, default=0), 2, 3))
    for k in {*rows[unsure].tolist(), *columns[unsure].tolist()}:
        extents[k] = solids[k].surface.extent
    (low, high), (other_low, other_high) = (extents[ends[unsure]].transpose(1, 0, 2) for ends in (rows, columns))
    unsure = unsure[~((low > other_high) | (other_low > high)).any(axis=1)]
    for one, other in ((rows[unsure], columns[unsure]), (columns[unsure], rows[unsure])):
        for k in np.unique(one).tolist():
            if solids[k].has_inside:
                mine = one == k
                pieces = [solids[n].pieces for n in other[mine].tolist()]
                inside = solids[k].contains(np.concatenate(pieces))
                begins = np.cumsum([0, *map(len, pieces[:-1])])
                found[unsure[mine][np.logical_or.reduceat(inside, begins)]] = 0.0
    return found


def _between_boxes(first: Sequence[BoxSolid], second: Sequence[BoxSolid]) -> F64:
    one, other = (
        (
            np.array([box.center for box in boxes]),
            np.array([box.half_extents for box in boxes]),
            np.array([box.rotation for box in boxes]),
        )
        for boxes in (first, second)
    )
    return box_distances(one, other)
