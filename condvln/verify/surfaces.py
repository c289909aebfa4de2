"""Prove that two surfaces are near each other: by points of both that are no farther apart.

The distance between two points, one on or in each object, is never less than the distance of the objects, whatever way
the points were found; so that what is accepted is proven, and a search that finds no such points accepts nothing. The
relation graph measures the same distance with FCL's hierarchies, which this module does not use.

The search begins at pairs of small triangles whose middles are close, and then moves each pair of points to and fro:
a point of one convex set is replaced by the nearest point of the other set, which ends at the nearest points of both
sets (Cheney and Goldstein, 1959).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Final

import numpy as np
import trimesh
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from condvln.arrays import F64
from condvln.scene import SceneObject
from condvln.scene.boxes import transform_points
from condvln.scene.meshes import shared_library

__all__ = ["Shapes", "SurfaceGauge"]

Rows = NDArray[np.intp]

LONGEST_EDGE: Final = 0.1
"""Metres. Triangles are halved until their edges are no longer, so that their middles are close to all their points."""

FINEST: Final = 0.01
"""Edges are halved no further than to this share of a mesh's diagonal, so that a huge triangle costs no more."""

PAIRS: Final = 256
"""Number of pairs of triangles from which the nearest points are searched."""

NEIGHBOURS: Final = 8
"""Number of triangles that each triangle of the other mesh is paired with."""

FEW: Final = 500
"""The first search looks at so many triangles of an object."""

ROUNDS: Final = 500
SETTLED: Final = 1e-7
"""The search ends after so many rounds, or with a round that moves no point by so many metres."""


@dataclass(frozen=True, eq=False)
class _Boxes:
    """k boxes: centers (k, 3), half extents (k, 3), rotations (k, 3, 3) with the boxes' axes as columns."""

    centers: F64
    half_extents: F64
    rotations: F64

    def nearest(self, rows: Rows, points: F64) -> F64:
        """Return the points (n, 3) of the boxes `rows` (n,) that are nearest to `points` (n, 3): their own, inside."""
        axes, half = self.rotations[rows], self.half_extents[rows]
        local = np.einsum("nij,ni->nj", axes, points - self.centers[rows])
        found: F64 = self.centers[rows] + np.einsum("nij,nj->ni", axes, np.clip(local, -half, half))
        return found

    def bounds(self) -> tuple[F64, F64]:
        """Return the lowest and the highest corner (3,) of what they fill."""
        reach = np.einsum("nij,nj->ni", np.abs(self.rotations), self.half_extents)
        return (self.centers - reach).min(axis=0), (self.centers + reach).max(axis=0)

    def few(self) -> _Boxes:
        """Return all boxes, which are few."""
        return self

    def within(self, other: _Boxes | _Triangles, reach: float) -> _Boxes:
        """Return all boxes, which are few."""
        return self

    def near(self, other: _Boxes | _Triangles) -> tuple[Rows, Rows]:
        """Return the pairs to search, as rows of both: all boxes, or for each box the triangles closest to it."""
        mine = np.arange(len(self.centers))
        if isinstance(other, _Boxes):
            first, second = np.meshgrid(mine, np.arange(len(other.centers)), indexing="ij")
            return first.reshape(-1), second.reshape(-1)
        rows: list[Rows] = []
        closest: list[Rows] = []
        for k in mine:
            row = np.full(len(other.centers), k)
            best = _least(np.linalg.norm(self.nearest(row, other.centers) - other.centers, axis=1))
            rows.append(row[best])
            closest.append(best)
        return np.concatenate(rows), np.concatenate(closest)


@dataclass(frozen=True, eq=False)
class _Triangles:
    """Triangles (m, 3, 3) in the scene's frame."""

    corners: F64

    @cached_property
    def centers(self) -> F64:
        """(m, 3) their middles."""
        middles: F64 = self.corners.mean(axis=1)
        return middles

    def nearest(self, rows: Rows, points: F64) -> F64:
        """Return the points (n, 3) of the triangles `rows` (n,) that are nearest to `points` (n, 3)."""
        found: F64 = trimesh.triangles.closest_point(self.corners[rows], points)
        return found

    def bounds(self) -> tuple[F64, F64]:
        """Return the lowest and the highest corner (3,) of what they fill."""
        return self.corners.min(axis=(0, 1)), self.corners.max(axis=(0, 1))

    def few(self) -> _Triangles:
        """Return some of them, for a first search."""
        return _Triangles(self.corners[:: -(-len(self.corners) // FEW)])

    def within(self, other: _Boxes | _Triangles, reach: float) -> _Triangles:
        """Return those whose bounds are within `reach` metres of the bounds of the other solid along every axis, in
        small triangles.
        """
        low, high = other.bounds()
        meet = (self.corners.min(axis=1) <= high + reach) & (self.corners.max(axis=1) >= low - reach)
        return _Triangles(_halved(self.corners[meet.all(axis=1)]))

    def near(self, other: _Boxes | _Triangles) -> tuple[Rows, Rows]:
        """Return the pairs to search, as rows of both: those whose middles are closest."""
        if isinstance(other, _Boxes):
            second, first = other.near(self)
            return first, second
        nearby = range(1, 1 + min(NEIGHBOURS, len(other.centers)))
        away, paired = cKDTree(other.centers).query(self.centers, k=nearby)
        best = _least(away.reshape(-1))
        return best // len(nearby), paired.reshape(-1)[best]


class Shapes:
    """The meshes under one dataset root. All scenes share them."""

    def __init__(self, root: Path) -> None:
        self._library = shared_library(root)

    def of(self, item: SceneObject) -> _Boxes | _Triangles | None:
        """Return an object's meshes, else its oriented boxes, else its axis-aligned box; None if its extent is
        unknown.
        """
        meshes = [(part.transform, self._library.geometry(part.path)) for part in item.mesh]
        corners = [transform_points(transform, its.vertices)[its.faces] for transform, its in meshes]
        if any(len(triangles) for triangles in corners):
            return _Triangles(np.concatenate(corners))
        boxes = boxes_of(item)
        return _Boxes(*map(np.array, zip(*boxes, strict=True))) if boxes else None


def boxes_of(item: SceneObject) -> list[tuple[F64, F64, F64]]:
    """Return centre, half extents and axes (as columns) of the boxes that stand for an object: those of its parts,
    otherwise its oriented box, otherwise its upright one. The verifier chooses them apart from ``SceneObject.solids``.
    """
    if known := item.parts or (() if item.obb is None else (item.obb,)):
        return [(box.center, box.half_extents, box.rotation) for box in known]
    if item.aabb is None:
        return []
    low, high = item.aabb
    return [((low + high) / 2, np.maximum(high - low, 0.0) / 2, np.eye(3))]


class SurfaceGauge:
    """Bounds of the distances between the surfaces of one scene, each found once."""

    def __init__(self, shapes: Shapes) -> None:
        self._shapes = shapes
        self._solids: dict[str, _Boxes | _Triangles | None] = {}
        self._found: dict[tuple[str, str, float], float | None] = {}

    def at_most(self, one: SceneObject, other: SceneObject, enough: float) -> float | None:
        """Return whole millimetres; the surfaces of two objects are no farther apart. None if an extent is unknown.

        enough : millimetres; no smaller bound is searched for once one is found that is no greater
        """
        first, second = sorted((one, other), key=lambda item: item.object_id)
        key = (first.object_id, second.object_id, enough)
        if key not in self._found:
            self._found[key] = self._search(first, second, enough)
        return self._found[key]

    def _search(self, first: SceneObject, second: SceneObject, enough: float) -> float | None:
        """Search among a few triangles, and only if that is not enough among all that may be nearer than those."""
        one, other = self._of(first), self._of(second)
        if one is None or other is None:
            return None
        found = _apart(one.few(), other.few(), enough / 1000.0)
        if np.rint(1000.0 * found) > enough:
            reach = found + SETTLED
            found = min(found, _apart(one.within(other, reach), other.within(one, reach), enough / 1000.0))
        return float(np.rint(1000.0 * found))

    def _of(self, item: SceneObject) -> _Boxes | _Triangles | None:
        if item.object_id not in self._solids:
            self._solids[item.object_id] = self._shapes.of(item)
        return self._solids[item.object_id]


def _apart(one: _Boxes | _Triangles, other: _Boxes | _Triangles, enough: float) -> float:
    """Return the least distance in metres found between a point of one solid and a point of the other one. The search
    ends early with one that is `enough`.
    """
    first, second = one.near(other)
    points, least = one.centers[first], np.inf
    before = points
    for number in range(ROUNDS):
        opposite = other.nearest(second, points)
        moved = one.nearest(first, opposite)
        least = min(least, float(np.linalg.norm(moved - opposite, axis=1).min()))
        if least <= enough or np.abs(moved - points).max() <= SETTLED:
            break
        # Nesterov's step: alternating projections alone creep between solids that are almost parallel.
        points, before = moved + number / (number + 3) * (moved - before), moved
    return least


def _least(values: F64) -> Rows:
    """Return the places of the `PAIRS` least values (n,)."""
    if len(values) <= PAIRS:
        return np.arange(len(values))
    return np.argpartition(values, PAIRS)[:PAIRS]


def _halved(triangles: F64) -> F64:
    """Return triangles (m, 3, 3) with their longest edges halved until none is longer than `LONGEST_EDGE`."""
    if not len(triangles):
        return triangles
    longest = max(LONGEST_EDGE, FINEST * float(np.linalg.norm(np.ptp(triangles, axis=(0, 1)))))
    done: list[F64] = []
    rest = triangles
    while len(rest):
        edges = np.linalg.norm(rest - np.roll(rest, -1, axis=1), axis=2)  # edge k from corner k to the next one
        is_small = edges.max(axis=1) <= longest
        done.append(rest[is_small])
        rest, at = rest[~is_small], edges[~is_small].argmax(axis=1)
        rows = np.arange(len(rest))
        a, b, c = (rest[rows, (at + k) % 3] for k in range(3))
        middle = (a + b) / 2
        rest = np.concatenate([np.stack([a, middle, c], axis=1), np.stack([middle, b, c], axis=1)])
    return np.concatenate(done)
