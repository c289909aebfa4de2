"""The starts of a scene: which of them a program may have, and the first one that meets all of its rules."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import accumulate, pairwise
from typing import Final, NamedTuple

import numpy as np

from condvln.arrays import F64, I64, Bools
from condvln.episodes.footprint import Footprints
from condvln.episodes.kernels.distances import apart_objects
from condvln.episodes.kernels.starts import (
    DETOUR,
    FITS,
    FULL,
    OUT_OF_RANGE,
    TOO_FAR,
    Bounds,
    KnownWays,
    Places,
    first_fit,
    possible_starts,
    put_keys,
)
from condvln.kept import kept
from condvln.navigation.kernels.projection import ANY_ISLAND, project
from condvln.navigation.pathfinder import Pathfinder
from condvln.navigation.points import many_points

__all__ = [
    "FoundLeaf",
    "FoundStart",
    "GoalField",
    "Leaves",
    "Route",
    "Starts",
]


@dataclass(frozen=True, eq=False, slots=True)
class Route:
    """The path from a start through a leaf's stops.

    stops : (m, 3) the chosen point of each move, the last one the goal
    path : (n, 3) corner points rounded to 1 mm
    length : metres along the path through the stops
    """

    stops: F64
    path: F64
    length: float


class GoalField:
    """The goal points of a scene's objects.

    Attributes
    ----------
    goals : goal points (k, 3) by object id
    points : (p, 3) those of all objects, in the order of ``goals``
    first : (n + 1,) index of the first point of each of the n objects
    """

    def __init__(self, pathfinder: Pathfinder, goals: Mapping[str, F64]) -> None:
        self.pathfinder = pathfinder
        self.goals = dict(goals)
        self.points = np.concatenate([*self.goals.values(), np.empty((0, 3))])
        counts = [len(points) for points in self.goals.values()]
        self.first = np.cumsum([0, *counts], dtype=np.int64)

    @kept
    def apart(self, least: float) -> Bools:
        """Return a mask (n, n) of the pairs of objects, in the order of ``goals``, whose goal points are at least
        `least` metres apart, by the geodesic distances in both directions. No object is apart from itself.

        Both directions count: Detour's path from a to b may be up to 2 m longer than its path from b to a on real
        navmeshes.
        """
        mesh, asked = self.pathfinder.query_mesh, many_points(self.points)
        return apart_objects(mesh, asked, *project(mesh, asked, ANY_ISLAND), self.first, least)

    def gap(self, one: int, other: int) -> float:
        """Return the least geodesic distance in metres between the goal points of two objects, in either direction."""
        here, there = (self.points[self.first[k] : self.first[k + 1]] for k in (one, other))
        ways = (self.pathfinder.distance_table(*ends) for ends in ((here, there), (there, here)))
        return min(float(np.where(np.isnan(table), np.inf, table).min()) for table in ways)


WAYS, CORNERS = 4096, 1 << 15
"""Room for ways and their corners at first; it is doubled when it is full."""

ANY_LENGTH: Final = (-math.inf, math.inf)


UNMET: Final = {OUT_OF_RANGE: "no_start_in_range", DETOUR: "detour", TOO_FAR: "route_missed"}
"""Rejection reasons: the rule that no start meets."""


class Leaves:
    """The leaves of a program.

    Attributes
    ----------
    moves : (m,) the targets of each leaf's stops, leads first, the last one its goal, of all leaves
    first : (l + 1,) where each of the l leaves begins; leads : (l,) number of its leads
    """

    def __init__(self, leaves: Sequence[Sequence[int]], leads: Sequence[int] | None = None) -> None:
        self.leads = np.array(leads or [0] * len(leaves), np.int64)
        self.ends = list(accumulate(map(len, leaves), initial=0))
        self.moves = np.array([move for leaf in leaves for move in leaf], np.int64)
        self.first = np.array(self.ends, np.int64)


class FoundLeaf(NamedTuple):
    """What was found for one leaf from a start: its route; the geodesic distance in metres from the start to the
    nearest goal point; and all goal points (k, 3), that one first, then the others in their order.

    Stock sensors measure the distance to the first goal, stock measures to the nearest one; with this order both
    agree at the start. A route through stops may end at another goal point.
    """

    route: Route
    distance: float
    goals: F64


class FoundStart(NamedTuple):
    """The first start that fits: the number of starts refused before it, and what was found for each leaf."""

    refused: int
    leaves: tuple[FoundLeaf, ...]


class Starts:
    """The start positions of one scene. Their geodesic distances to its objects, and the ways between places, are found
    when they are first needed, and kept.

    Parameters
    ----------
    positions : (s, 3) metres
    solid : footprints that no path may cross
    """

    def __init__(self, pathfinder: Pathfinder, field: GoalField, positions: F64, solid: Footprints) -> None:
        self.positions, self._field, self._mesh = positions, field, pathfinder.query_mesh
        exact = np.array(np.concatenate([positions, field.points]), np.float64, order="C")
        asked = many_points(exact)
        polys, at = project(self._mesh, asked, ANY_ISLAND)
        count = len(positions)
        objects, self._first = len(field.first) - 1, field.first.tolist()
        distance, nearest = np.full((count, objects), np.nan), np.zeros((count, objects), np.int64)
        self._places = Places(asked, polys, at, exact, field.first, distance, nearest, *solid.boxes)
        self._known = KnownWays(
            np.full(4 * WAYS, -1, np.int64),
            np.empty(4 * WAYS, np.int64),
            np.empty(WAYS, np.int64),
            np.empty(WAYS),
            np.empty(WAYS, np.int64),
            np.empty(WAYS, np.int64),
            np.empty(WAYS, np.bool_),
            np.empty((CORNERS, 3)),
            np.zeros(2, np.int64),
        )

    def possible(self, leaves: Leaves, bounds: Bounds) -> I64 | str:
        """Return the starts (k,), ascending, that are within the `bounds` of a program, or why there is none: the rule
        that no start meets which meets the rules before it.
        """
        found = np.empty(len(self.positions), np.int64)
        while True:
            count, outcome = possible_starts(
                self._mesh, self._places, self._known, leaves.moves, leaves.first, leaves.leads, bounds, found
            )
            if outcome != FULL:
                return found[:count] if outcome == FITS else UNMET[outcome]
            self._make_room()

    def first_fit(
        self, leaves: Leaves, order: I64, apart: float, lengths: tuple[float, float] | None, refused: I64
    ) -> FoundStart | None:
        """Return the first start of `order` from which the routes of all leaves exist, cross no solid footprint, keep
        `apart` metres from the goal points of all other leaves, and have `lengths` (inclusive bounds in metres).

        Parameters
        ----------
        refused : (4,) to which the number of starts refused for each reason of ``REFUSALS`` is added
        """
        least, most = lengths or ANY_LENGTH
        tried = 0
        while True:
            outcome, count, corners, sizes, stops, found, direct, nearest = first_fit(
                self._mesh, self._places, self._known, leaves.moves, leaves.first, order[tried:], apart, least, most,
                refused,
            )  # fmt: skip
            tried += count
            if outcome != FULL:
                break
            self._make_room()
        if outcome != FITS:
            return None
        ends, points = self._field.points[stops], list(accumulate(sizes.tolist(), initial=0))
        routes = [
            Route(ends[i:j], corners[begin:end], length)
            for (i, j), (begin, end), length in zip(
                pairwise(leaves.ends), pairwise(points), found.tolist(), strict=True
            )
        ]
        goals = leaves.moves[leaves.first[1:] - 1].tolist()
        return FoundStart(
            tried,
            tuple(
                FoundLeaf(route, distance, self._ordered_goals(goal, point))
                for route, distance, goal, point in zip(routes, direct.tolist(), goals, nearest.tolist(), strict=True)
            ),
        )

    def _ordered_goals(self, goal: int, nearest: int) -> F64:
        """Return the goal points (k, 3) of an object, point number `nearest` of the scene first."""
        begin, end = self._first[goal], self._first[goal + 1]
        return self._field.points[[nearest, *range(begin, nearest), *range(nearest + 1, end)]]

    def _make_room(self) -> None:
        """Double the room for ways and corners."""
        known = self._known
        keys, ways = np.full(2 * len(known.keys), -1, np.int64), np.empty(2 * len(known.keys), np.int64)
        put_keys(known.keys, known.ways, keys, ways)
        larger = {
            name: np.concatenate([values, np.empty_like(values)])
            for name, values in known._asdict().items()
            if name not in ("keys", "ways", "used")
        }
        self._known = known._replace(keys=keys, ways=ways, **larger)
