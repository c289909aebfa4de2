"""The leaves of all episodes of a scene as arrays."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import chain
from typing import Final

import numpy as np
from numpy.typing import NDArray

from condvln.verify.footprints import Reach
from condvln.verify.geodesics import Geodesics, Point
from schemas.episode import EpisodeLeaf
from schemas.evaluation import ManifestEpisode

__all__ = ["ROUNDING", "SceneLeaves", "Target", "ranges"]

F64 = NDArray[np.float64]
I64 = NDArray[np.int64]

ROUNDING: Final = 1e-6
"""Tolerance in metres by which a distance may violate a bound because of rounding."""


class Target:
    """An object, and the places from which an agent reaches it: the goals of a leaf, or one subgoal. Many leaves of a
    scene share it, so that what holds of it alone is found once.

    points (n,) : index of each place
    is_goal : a leaf ends here
    away, here : for each place, metres from the object, and whether it is on its floor and in its room; empty if the
        object does not exist
    nearest : indices of the places nearest to the object. Several may be nearest within rounding.
    """

    def __init__(self, object_id: str, places: tuple[Point, ...], points: list[int]) -> None:
        self.object_id, self.places = object_id, places
        self.points = points
        self.is_goal = False
        self.away: tuple[float, ...] = ()
        self.here: tuple[bool, ...] = ()
        self.nearest: list[int] = []

    def measure(self, reach: Reach) -> None:
        """Find out how the places lie to the object."""
        self.away, self.here = reach.around(self.object_id, self.places)
        least = min(self.away, default=0.0) + ROUNDING
        self.nearest = [one for one, metres in zip(self.points, self.away or (0.0,), strict=False) if metres <= least]


class SceneLeaves:
    """The l leaves of a scene's r rows, in the order of the rows, and all their points.

    Attributes
    ----------
    leaves : the leaves; row (l,) : the index of each leaf's row; row_ends (r,) : end index of each row's leaves
    start (r,) : each row's start, as an index among the points
    targets : all different targets
    goals_of (l,) : index of each leaf's target; goals (g,), goal_ends (l,) : indices of the points of all goals
    stops_of (s,), stops (s,), stop_ends (l,) : likewise for the subgoals, which have one point each
    corners (n, 3), corner_ends (l,) : corners of the leaves' paths
    """

    def __init__(self, rows: Sequence[ManifestEpisode], walks: Geodesics) -> None:
        self._known: dict[tuple[str, tuple[Point, ...]], int] = {}
        self._walks = walks
        self.targets: list[Target] = []
        self.leaves: list[EpisodeLeaf] = []
        starts, goals_of, stops_of, stop_counts = [], [], [], []
        for row in rows:
            starts.append(walks.point(row.start_position))
            for leaf in row.leaves:
                self.leaves.append(leaf)
                goals_of.append(self._target(leaf.object_id, leaf.goals))
                stops_of += [self._target(subgoal.object_id, (subgoal.position,)) for subgoal in leaf.subgoals]
                stop_counts.append(len(leaf.subgoals))
        walks.locate()
        sizes = np.array([len(row.leaves) for row in rows], dtype=np.int64)
        self.row_ends: I64 = np.cumsum(sizes)
        self.row: I64 = np.repeat(np.arange(len(rows)), sizes)
        self.start: I64 = np.array(starts, dtype=np.int64)
        self.goals_of: I64 = np.array(goals_of, dtype=np.int64)
        for number in set(goals_of):
            self.targets[number].is_goal = True
        counts = np.array([len(target.points) for target in self.targets], dtype=np.int64)
        points = np.fromiter(chain.from_iterable([target.points for target in self.targets]), np.int64)
        first = np.cumsum(counts) - counts
        self.goal_ends: I64 = np.cumsum(counts[self.goals_of])
        self.goals: I64 = points[ranges(first[self.goals_of], counts[self.goals_of])]
        self.stops_of: I64 = np.array(stops_of, dtype=np.int64)
        self.stops: I64 = points[first[self.stops_of]]
        self.stop_ends: I64 = np.cumsum(np.array(stop_counts, dtype=np.int64))
        paths = [leaf.reference_path for leaf in self.leaves]
        lengths = np.array([len(path) for path in paths], dtype=np.int64)
        self.corner_ends: I64 = np.cumsum(lengths)
        corners = chain.from_iterable(chain.from_iterable(paths))
        self.corners: F64 = np.fromiter(corners, np.float64, 3 * int(lengths.sum())).reshape(-1, 3)

    def _target(self, object_id: str, places: tuple[Point, ...]) -> int:
        number = self._known.setdefault((object_id, places), len(self.targets))
        if number == len(self.targets):
            self.targets.append(Target(object_id, places, [self._walks.point(place) for place in places]))
        return number

    def ends_of_paths(self) -> I64:
        """Return for each leaf the index in `goals` of the goal at which the leaf's path ends."""
        counts = np.diff(self.goal_ends, prepend=0)
        last = np.repeat(self.corners[self.corner_ends - 1], counts, axis=0)
        away = np.linalg.norm(self._walks.points[self.goals] - last, axis=1)
        first = self.goal_ends - counts
        nearest = np.flatnonzero(away == np.repeat(np.minimum.reduceat(away, first), counts))
        # The first of the goals that are equally near.
        return np.asarray(nearest[np.searchsorted(nearest, first)], dtype=np.int64)


def ranges(first: I64, counts: I64) -> I64:
    """Return the numbers from each of `first` (n,) on, as many as `counts` (n,) says, concatenated."""
    ends = np.cumsum(counts)
    total = int(ends[-1]) if len(ends) else 0
    return np.asarray(np.arange(total) + np.repeat(first - (ends - counts), counts), dtype=np.int64)
