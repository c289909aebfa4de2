"""Choose where the looker agent stops beside an object, or from where it looks for a place to stop."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from scipy.spatial import cKDTree

from condvln.arrays import F64, Bools
from condvln.evaluation.looker.floor_map import CELL, Ground, Ways
from condvln.evaluation.looker.memory import Thing
from schemas.config.constants import FURNITURE_DETOUR

__all__ = ["REACH", "Approach", "approach"]

Ints = NDArray[np.intp]

REACH: Final = 0.5
"""Distance in metres at which an object counts as reached."""
SURE_REACH: Final = 0.4
"""The same in metres where the map's cells and the unseen part of the object leave no doubt."""
FAR_REACH: Final = 1.5
"""Largest distance in metres at which an object counts as reached if it can't be approached further."""
LEAST_UNSEEN: Final = 3
"""Least number of unseen cells beside an object that are worth a look."""
KEPT: Final = 5.0
"""Advantage in cells of a path's cost for which a chosen place is not changed."""
GIVEN_UP: Final = 0.3
"""Distance in metres to places that could not be reached within which no other is chosen."""
THICKNESS: Final = 0.35
"""Length in metres of the end of a line of sight that is not tested: the object itself may hide it."""


@dataclass(frozen=True, eq=False, slots=True)
class Approach:
    """A position (2,) to go to. `final` says whether the agent may stop at the position; if not, it looks around from
    it.
    """

    place: F64
    final: bool


def approach(
    thing: Thing,
    ground: Ground,
    ways: Ways,
    last: F64,
    *,
    kept: F64 | None = None,
    given_up: Sequence[F64] = (),
    looked: Sequence[F64] | None = (),
) -> Approach | None:
    """Return where to go to reach an object: the place beside it that is nearest to the previous stop, or a place from
    which unseen floor beside the object can be seen; None if nothing near it can be reached.

    Parameters
    ----------
    ways : paths from the agent; last (2,) : the previous stop, at first the start
    kept : the place chosen before, which is changed only for a much better one
    given_up : places that could not be reached
    looked : places from which the agent looked at the floor beside the object; None if it must not look again
    """
    flat = thing.points[:, [0, 2]]
    low = ground.cell(*(flat.min(axis=0) - FAR_REACH).tolist())
    high = ground.cell(*(flat.max(axis=0) + FAR_REACH).tolist())
    part = slice(low[0], high[0] + 1), slice(low[1], high[1] + 1)
    rows, columns = np.nonzero(_in_room(ground, part, thing.room))
    rows, columns = rows + low[0], columns + low[1]
    places = ground.places(rows, columns)
    away, nearest = (np.asarray(found) for found in cKDTree(flat).query(places))
    fits = away <= FAR_REACH
    for place in given_up:
        fits &= np.hypot(*(places - place).T) > GIVEN_UP
    rows, columns, places, away = rows[fits], columns[fits], places[fits], away[fits]
    faces = flat[nearest[fits]]

    def seen_from(k: int) -> bool:
        return ground.open_between(places[k], faces[k], THICKNESS, among=ground.tall)

    known = ground.passable[rows, columns] & np.isfinite(ways.distance[rows, columns])
    beside = [k for k in np.flatnonzero(known & (away <= REACH)).tolist() if seen_from(k)]
    closest = float(away[beside].min()) if beside else np.inf
    if looked is not None and closest > SURE_REACH:
        view = _unseen_floor(thing, ground, ways, rows, columns, away, seen_from, looked)
        if view is not None:
            return Approach(view, False)
    if not beside:
        beside = [k for k in np.flatnonzero(known).tolist() if seen_from(k)] or np.flatnonzero(known).tolist()
        if not beside:
            return None
        closest = float(away[beside].min())
        beside = [k for k in beside if away[k] <= closest + CELL]
    elif closest <= SURE_REACH:
        beside = [k for k in beside if away[k] <= SURE_REACH]
    chosen = np.array(beside, np.intp)
    before = ground.ways_from(float(last[0]), float(last[1]))
    cost = before.distance[rows[chosen], columns[chosen]]
    cost = np.where(np.isfinite(cost), cost, ways.distance[rows[chosen], columns[chosen]] + 1e6)
    # Only places on the side of the object that can be approached most closely.
    nearly = np.flatnonzero(away[chosen] <= closest + CELL)
    first = chosen[nearly[np.argmin(cost[nearly])]]
    around = float(np.ptp(flat, axis=0).sum()) + FURNITURE_DETOUR
    same = ground.ways_from(*places[first].tolist()).distance[rows[chosen], columns[chosen]] * CELL <= around
    chosen, cost = chosen[same], cost[same]
    best = int(np.argmin(cost))
    if kept is not None:
        apart = np.hypot(*(places[chosen] - kept).T)
        old = int(np.argmin(apart))
        if apart[old] < CELL / 2 and cost[old] <= cost[best] + KEPT:
            best = old
    return Approach(np.asarray(places[chosen[best]], np.float64), True)


def _in_room(ground: Ground, part: tuple[slice, slice], room: int) -> Bools:
    """Return the cells of a part of the map that are in a room, or of which nothing is known.

    A cell beside a wall may take the number of the room behind it, so most of the floor around it must be of the room.
    """
    own, floor = ground.region[part], ground.passable[part]
    if room < 0:
        return np.ones_like(floor)
    inside = (own == room) | (own < 0)
    around = np.ones((3, 3), np.int64)
    of_room = ndimage.convolve((inside & floor).astype(np.int64), around, mode="constant")
    every = ndimage.convolve(floor.astype(np.int64), around, mode="constant")
    return np.asarray(inside & (~floor | (2 * of_room >= every)))


def _unseen_floor(
    thing: Thing,
    ground: Ground,
    ways: Ways,
    rows: Ints,
    columns: Ints,
    away: F64,
    seen_from: Callable[[int], bool],
    looked: Sequence[F64],
) -> F64 | None:
    """Return the last place on known floor along the shortest path to unseen floor beside the object; None if there is
    too little such floor, or if the agent has already looked from near that place.
    """
    hoped = ground.hopeful_ways_from(ways, thing.room)
    cost = hoped.distance[rows, columns]
    unseen = np.flatnonzero(ground.unseen[rows, columns] & (away <= REACH) & np.isfinite(cost))
    unseen = np.array([k for k in unseen.tolist() if seen_from(k)], np.intp)
    if len(unseen) < LEAST_UNSEEN:
        return None
    nearest = unseen[int(np.argmin(cost[unseen]))]
    path = hoped.to((int(rows[nearest]), int(columns[nearest])))
    place = path[0]
    for point in path[1:]:
        cell = ground.cell(*point.tolist())
        # A hopeful path may pass a corner of unseen floor diagonally, where no known path does.
        if ground.unseen[cell] or not np.isfinite(ways.distance[cell]):
            break
        place = point
    if any(np.hypot(*(place - other)) <= GIVEN_UP for other in looked):
        return None
    return np.asarray(place, np.float64)
