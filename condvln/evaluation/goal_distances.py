"""Geodesic distances from a path to goals, computed only where they can matter.

A geodesic is never shorter than the straight line between the two snapped points, so a position whose straight line
is longer than the radius can be skipped. The exception is a position that snapping moved: habitat-sim measures from the
position as given.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np
import numpy.typing as npt

from condvln.arrays import F64

if TYPE_CHECKING:
    from condvln.navigation.pathfinder import Pathfinder

__all__ = [
    "ASTRAY",
    "OFF_FLOOR",
    "OFF_NAVMESH",
    "RISE",
    "SLACK",
    "SLIDE",
    "SNAPPED",
    "Nearness",
    "SnappedPath",
]


SLACK: Final = 0.01
"""Metres added to the radius before a position is skipped, for float32 sums and points up to 1 cm off the mesh."""

SNAPPED: Final = 0.01
"""If snapping moves a point farther than this (metres), its distance is always computed."""

OFF_NAVMESH: Final = 0.1
OFF_FLOOR: Final = 0.5
"""A pose farther than this (metres, horizontally and vertically) from the navmesh is not one that an agent can have.
Habitat's walks over 126 navmeshes stay within 1 mm and 0.25 m.
"""

SLIDE: Final = 1.25
RISE: Final = 2.0
"""A step's largest length on the ground and in height, as multiples of the action forward. Habitat's steps, which slide
along walls and climb stairs, reach 1.16 and 1.48 on the same navmeshes.
"""

ASTRAY: Final = 0.02
"""Metres that a step may be longer, or end elsewhere than Habitat's move of the same length, as files round
positions. That move ends within 1 mm of the end of every step of the same walks.
"""


@dataclass(frozen=True, eq=False)
class SnappedPath:
    """A path (n, 3), the snapped position of each point (NaN if there is none), and whether snapping moved the
    point.
    """

    positions: F64
    snapped: F64
    moved: npt.NDArray[np.bool_]

    @property
    def off_navmesh(self) -> int:
        """Number of positions off the navmesh: farther from it than `OFF_NAVMESH` or `OFF_FLOOR`."""
        x, y, z = np.abs(self.snapped - self.positions).T
        return int((~((np.hypot(x, z) <= OFF_NAVMESH) & (y <= OFF_FLOOR))).sum())


class Nearness:
    """Measures distances in one scene, in metres. The distance to an unreachable point is infinite, never NaN."""

    def __init__(self, pathfinder: Pathfinder, *, prune: bool = True) -> None:
        self._pathfinder = pathfinder
        self._prune = prune

    def snap(self, positions: F64) -> SnappedPath:
        """Return a path together with the snapped position of each point: the form in which the methods below accept
        paths.
        """
        # Turning does not change the position: equal consecutive positions are snapped once.
        fresh = np.concatenate(([True], (np.diff(positions, axis=0) != 0).any(axis=1)))
        once = np.asarray(self._pathfinder.snap_points(positions[fresh]), dtype=np.float64).reshape(-1, 3)
        snapped = once[np.cumsum(fresh) - 1]
        shift = np.sqrt(np.square(snapped - positions).sum(axis=1))
        return SnappedPath(positions, snapped, shift > SNAPPED)

    def distance(self, point: F64, goals: F64) -> float:
        """Return the distance in metres from ``point`` (3,) to the nearest of ``goals`` (k, 3), as habitat-sim's
        multi-goal query does.
        """
        found = float(self._pathfinder.geodesic_distance(point, goals))
        return found if np.isfinite(found) else float("inf")

    def steps(self, path: SnappedPath, forward: float) -> tuple[F64, npt.NDArray[np.bool_]]:
        """Return the length in metres of each step of a path (n − 1,), and which steps no single action can have made:
        those longer than the action ``forward`` (metres) allows, and those that a wall stops.

        A step of an action is as long as its straight line, as in VLN-CE; any other is as long as its geodesic
        distance, infinite where there is no way.
        """
        moves = np.diff(path.positions, axis=0)
        lengths = np.sqrt(np.square(moves).sum(axis=1))
        gaps = (np.hypot(moves[:, 0], moves[:, 2]) > SLIDE * forward + ASTRAY) | (np.abs(moves[:, 1]) > RISE * forward)
        close = np.flatnonzero(~gaps & (lengths > 0))
        astray = np.zeros(len(lengths), dtype=bool)
        if len(close):
            ends = path.positions[close + 1]
            missed = np.asarray(self._pathfinder.try_steps(path.positions[close], ends), np.float64) - ends
            astray[close] = ~(np.hypot(missed[:, 0], missed[:, 2]) <= ASTRAY)
        far = np.flatnonzero(gaps | astray)
        if len(far):
            ways = self._pathfinder.geodesic_distances(path.positions[far], path.positions[far + 1])
            found = np.maximum(lengths[far], np.asarray(ways, np.float64))
            found = np.where(np.isnan(found), np.inf, found)
            # A rounded step along the corner of a wall may be stopped by it, though the way is as long as the step.
            gaps[far] |= found > lengths[far] + ASTRAY
            lengths[far] = np.where(gaps[far], found, lengths[far])
        return lengths, gaps

    def ever_within(self, path: SnappedPath, goals: F64, radius: float) -> bool:
        """Return whether any position of ``path`` is less than ``radius`` metres from any of ``goals``."""
        candidates, straight = self._candidates(path, goals, radius)
        order = candidates[np.argsort(straight[candidates], kind="stable")]
        return any(self.distance(path.positions[at], goals) < radius for at in order)

    def first_within(self, path: SnappedPath, goal: F64, radius: float, begin: int = 0) -> int | None:
        """Return the index of the first position, from index ``begin`` on, that is less than ``radius`` metres from
        ``goal`` (3,); None if there is none.
        """
        candidates = self._candidates(path, goal[None], radius)[0]
        candidates = candidates[np.searchsorted(candidates, begin) :]
        if not len(candidates):
            return None
        distances = np.asarray(self._pathfinder.geodesic_distances(path.positions[candidates], goal[None]))
        near = candidates[distances < radius]
        return int(near[0]) if len(near) else None

    def _candidates(self, path: SnappedPath, goals: F64, radius: float) -> tuple[npt.NDArray[np.intp], F64]:
        """Return the indices of the positions on ``path`` whose geodesic distance to the goals must be computed, and
        the straight-line distance of every position on ``path`` to the nearest snapped goal.
        """
        targets = self.snap(goals)
        apart = path.snapped[:, None, :] - targets.snapped[None, :, :]
        lines = np.sqrt(np.square(apart).sum(axis=2))
        straight = np.where(np.isnan(lines), np.inf, lines).min(axis=1)
        if not self._prune:
            return np.arange(len(path.positions)), straight
        must = (straight < radius + SLACK) | path.moved | targets.moved.any()
        return np.flatnonzero(must), straight
