"""The starts of a scene: their distances to all objects, and the first start that meets a program's rules."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from condvln.compiled import register_warm_up
from condvln.episodes.footprint import Footprints
from condvln.episodes.kernels.distances import nearest_points
from condvln.episodes.kernels.starts import (
    FITS,
    FULL,
    REFUSALS,
    KnownWays,
    Places,
    first_fit,
    put_keys,
    route_lengths,
)
from condvln.episodes.routes import GoalField, Route
from condvln.navigation.kernels.projection import ANY_ISLAND, project
from condvln.navigation.pathfinder import Pathfinder
from condvln.navigation.points import many_points

__all__ = ["FoundStart", "Starts"]

F64 = NDArray[np.float64]
I64 = NDArray[np.int64]

WAYS, CORNERS = 4096, 1 << 15
"""Room for ways and their corners at first; it is doubled when it is full."""

ANY_LENGTH: Final = (-math.inf, math.inf)


@dataclass(frozen=True, eq=False, slots=True)
class FoundStart:
    """The first start that fits: the number of starts refused before it, and the route to each leaf."""

    refused: int
    routes: tuple[Route, ...]


class Starts:
    """The start positions of one scene, with their geodesic distances to its objects. Distances and ways are found when
    they are first needed, and kept.

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
        objects = len(field.first) - 1
        self._measured: set[int] = set()
        self._distances = np.full((objects, count), np.nan)
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

    def distances(self, objects: Sequence[int]) -> F64:
        """Return the geodesic distances (k, s) in metres from each start to the nearest goal point of each of k
        objects; infinite without a path.
        """
        self._measure(objects)
        return self._distances[list(objects)]

    def _measure(self, objects: Sequence[int]) -> None:
        """Find the nearest goal points of objects from all starts, unless they are known."""
        if not self._measured.issuperset(objects):
            new, places = np.array(sorted({*objects} - self._measured), np.int64), self._places
            nearest_points(
                self._mesh, places.asked, places.polys, places.at, places.first, new, places.distance, places.nearest
            )
            self._distances[new] = places.distance[:, new].T
            self._measured.update(new.tolist())

    def route_lengths(self, starts: I64, moves: Sequence[int]) -> F64:
        """Return the lengths (k,) in metres of the routes from k of the starts through the objects of `moves`, each
        time to the nearest goal point of the next object; infinite without a path.
        """
        self._measure(moves)
        lengths, through = np.empty(len(starts)), np.array(moves, np.int64)
        while not route_lengths(self._mesh, self._places, self._known, through, starts, lengths):
            self._make_room()
        return lengths

    def first_fit(
        self,
        leaves: Sequence[Sequence[int]],
        order: I64,
        apart: float,
        lengths: tuple[float, float] | None,
        refused: I64,
    ) -> FoundStart | None:
        """Return the first start of `order` from which the routes of all leaves exist, cross no solid footprint, keep
        `apart` metres from the goal points of all other leaves, and have `lengths` (inclusive bounds in metres).

        Parameters
        ----------
        leaves : the objects of each leaf's stops, the last one its goal
        refused : (4,) to which the number of starts refused for each reason of ``REFUSALS`` is added
        """
        moves = np.array([move for leaf in leaves for move in leaf], np.int64)
        self._measure(moves.tolist())
        first_move = np.cumsum([0, *map(len, leaves)], dtype=np.int64)
        tried = 0
        while True:
            outcome, count, corners, sizes, stops, found = first_fit(
                self._mesh, self._places, self._known, moves, first_move, order[tried:], apart,
                *(lengths or ANY_LENGTH), refused,
            )  # fmt: skip
            tried += count
            if outcome != FULL:
                break
            self._make_room()
        if outcome != FITS:
            return None
        points = self._field.points
        paths = np.split(corners, np.cumsum(sizes)[:-1])
        ends = np.split(stops, first_move[1:-1])
        return FoundStart(
            tried,
            tuple(
                Route(points[end], path, length) for end, path, length in zip(ends, paths, found.tolist(), strict=True)
            ),
        )

    def ordered_goals(self, start: int, goal: int) -> F64:
        """Return an object's goal points (k, 3): first the one geodesically nearest to the start, then the others in
        their order.

        Stock sensors measure the distance to the first goal, stock measures to the nearest one; with this order both
        agree at the start. A route through stops may end at another goal point.
        """
        points = self._field.points[self._field.first[goal] : self._field.first[goal + 1]]
        self._measure([goal])
        nearest = int(self._places.nearest[start, goal] - self._field.first[goal])
        return np.concatenate([points[nearest : nearest + 1], points[:nearest], points[nearest + 1 :]])

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


def _warm_up() -> None:
    from condvln.navigation.polygon_tile import tile_of_polygons

    square = np.array([[0, 0, 0], [1, 0, 0], [1, 0, 1], [0, 0, 1]], np.float32)
    pathfinder = Pathfinder.from_tile(tile_of_polygons(square, [[0, 1, 2], [0, 2, 3]]))
    goals = GoalField(pathfinder, {"a": np.array([[0.9, 0, 0.5]]), "b": np.array([[0.1, 0, 0.1]])})
    goals.apart(0.1)
    starts = Starts(pathfinder, goals, np.array([[0.1, 0.0, 0.5]]), Footprints([]))
    starts.first_fit([[0, 1]], np.zeros(1, np.int64), 0.1, None, np.zeros(len(REFUSALS), np.int64))
    starts.route_lengths(np.zeros(1, np.int64), [0, 1])
    starts._make_room()


register_warm_up("starts of episodes", _warm_up)
