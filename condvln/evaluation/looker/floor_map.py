"""The looker agent's own map: a grid of free floor, obstacles and unseen cells."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from scipy.sparse import csr_array
from scipy.sparse.csgraph import dijkstra

from condvln.arrays import F64, Bools
from condvln.evaluation.looker.eyes import Look, SeenView

__all__ = ["CELL", "HALF", "FloorMap", "Ground", "Ways", "least_costs", "open_areas"]


CELL: Final = 0.1
"""Cell size and agent radius in metres."""
HALF: Final = 320
"""Cells from the start to the map's edge."""
CLIMB: Final = 0.2
"""Metres above the floor up to which obstacles can be stepped over."""
HEIGHT: Final = 1.5
"""Metres above the floor from which obstacles can be walked under. Both values are those of VLN-CE's agent."""
TALL: Final = 1.0
"""Metres above the floor from which obstacles hide what is behind them from the agent's eyes."""
UNSEEN_COST: Final = 2.0
"""Cost of a cell of unseen floor, if it is assumed to be open."""
SURE: Final = 2
"""Evidence added by a view of an obstacle; a view of open floor adds −1."""
MOST: Final = 6
"""Largest accumulated evidence for an obstacle."""
CLEARANCE: Final = 0.15
"""Distance in metres to obstacles below which the agent goes only if there is no other path."""
WIDE: Final = 0.3
"""Distance in metres to obstacles beyond which the cost no longer decreases."""
FLOOR_SPAN: Final = (-0.5, 0.2)
"""Range of heights in metres above the feet in which the floor is expected: a navmesh is up to a voxel above it."""
FLOOR_BIN: Final = 0.02
"""Resolution in metres of the estimated floor height."""
LEAST_FRONTIER: Final = 3
"""Least number of cells of a frontier that is worth exploring."""


@dataclass(frozen=True, eq=False, slots=True)
class Ground:
    """The rectangle of the map that contains all cells seen so far, valid until the next view. All arrays are (n, m)
    with rows along x; `corner` is the cell of the whole map at which the arrays begin.

    passable : cells that the agent can enter; cost : cost of walking in them, infinite elsewhere
    shut : cells with obstacles; tall : those with obstacles that the agent can't look over
    unseen : cells of which nothing is known; frontier : passable cells next to them
    region : room number, -1 if unknown; guess : that of the nearest cell whose room is known
    near : least distance in metres from which the cell was seen
    """

    corner: tuple[int, int]
    passable: Bools
    cost: NDArray[np.float32]
    shut: Bools
    tall: Bools
    unseen: Bools
    frontier: Bools
    region: NDArray[np.int16]
    guess: NDArray[np.int16]
    near: NDArray[np.float32]

    def cell(self, x: float, z: float) -> tuple[int, int]:
        """Return the cell of a position, clamped to the map."""
        a, b = math.floor(x / CELL) + HALF - self.corner[0], math.floor(z / CELL) + HALF - self.corner[1]
        return min(max(a, 0), self.cost.shape[0] - 1), min(max(b, 0), self.cost.shape[1] - 1)

    @property
    def edge(self) -> Bools:
        """Mask (n, m) of the passable cells next to unseen ones, in gaps however narrow."""
        return np.asarray(self.passable & ndimage.binary_dilation(self.unseen))

    def places(self, rows: NDArray[np.intp], columns: NDArray[np.intp]) -> F64:
        """Return the centres (k, 2) of cells, x and z in metres."""
        return np.stack([rows + self.corner[0] - HALF + 0.5, columns + self.corner[1] - HALF + 0.5], axis=1) * CELL

    def ways_from(self, x: float, z: float) -> Ways:
        """Return the cheapest paths from a position to all cells."""
        a, b = self.cell(x, z)
        start = a * self.cost.shape[1] + b
        return Ways(self, *least_costs(self.cost, start), start)

    def hopeful_ways_from(self, ways: Ways, room: int) -> Ways:
        """Return the cheapest paths from the start of `ways`, as they would be if all unseen cells of a room were open
        floor.
        """
        cost = np.where(self.unseen & ((self.guess == room) | (room < 0)), UNSEEN_COST, self.cost).astype(np.float32)
        return Ways(self, *least_costs(cost, ways.start), ways.start)

    def open_between(self, one: F64, other: F64, ignored: float = 0.0, *, among: Bools | None = None) -> bool:
        """Return whether no obstacle is between two positions (2,). The last `ignored` metres of the line are not
        tested.

        among : cells (n, m) that count as obstacles; those that the agent can't enter if None
        """
        begin, end = (np.asarray(place) / CELL - (np.array(self.corner) - HALF) for place in (one, other))
        length = float(np.hypot(*(end - begin)))
        tested = length - ignored / CELL
        steps = 0.5 * np.arange(math.ceil(2 * tested) + 1)
        along = np.minimum(steps, max(tested, 0.0)) / max(length, 1e-9)
        rows, columns = np.floor(begin + along[:, None] * (end - begin)).astype(np.intp).T
        shut = ~self.passable if among is None else among
        inside = (rows >= 0) & (columns >= 0) & (rows < shut.shape[0]) & (columns < shut.shape[1])
        return bool(inside.all()) and not shut[rows, columns].any()


@dataclass(frozen=True, eq=False, slots=True)
class Ways:
    """The cheapest paths from one position to all cells. `distance` (n, m) has their costs, in cells; a path near
    obstacles costs more than its length.
    """

    ground: Ground
    distance: F64
    before: NDArray[np.int32]
    start: int

    def start_at(self, x: float, z: float) -> bool:
        """Return whether the paths begin in the cell of a position, as they do for an agent that only turned."""
        a, b = self.ground.cell(x, z)
        return bool(self.start == a * self.distance.shape[1] + b)

    def to(self, cell: tuple[int, int]) -> F64:
        """Return the positions (k, 2) on the path to a cell, the start first."""
        width = self.distance.shape[1]
        at, found = cell[0] * width + cell[1], []
        while at >= 0:
            found.append(at)
            at = int(self.before[at])
        flat = np.array(found[::-1], np.intp)
        return self.ground.places(flat // width, flat % width)


class FloorMap:
    """The agent's grid map. Its centre is the start; x and z are in the frame of the agent's own pose estimates."""

    def __init__(self) -> None:
        size = 2 * HALF
        self._score = np.zeros((size, size), np.int8)
        self._seen = np.zeros((size, size), bool)
        self._tall = np.zeros((size, size), bool)
        self._bumped = np.zeros((size, size), bool)
        self._near = np.full((size, size), np.inf, np.float32)
        self._region = np.full((size, size), -1, np.int16)
        self._floor = 0.0

    def add(self, look: Look, x: float, z: float, heading: float, reach: float) -> None:
        """Add to the map what was seen up to `reach` metres from a position, with a heading in radians
        counter-clockwise from −z.
        """
        hit, clear = np.zeros_like(self._seen), np.zeros_like(self._seen)
        self._floor = _floor_below(look, self._floor)
        for view in look.views:
            self._add_view(view, np.array([x, z]), heading + view.turn, reach, hit, clear)
        score = self._score + SURE * hit.astype(np.int8) - (clear & ~hit).astype(np.int8)
        self._score = np.clip(score, -1, MOST).astype(np.int8)
        self._seen |= hit | clear

    def _add_view(self, view: SeenView, place: F64, heading: float, reach: float, hit: Bools, clear: Bools) -> None:
        """Mark the cells in which a view shows obstacles in `hit`, and those of which it shows floor in `clear`, both
        masks of the whole map.
        """
        slant = np.hypot(1.0, view.columns)
        ahead = np.array([-math.sin(heading), -math.cos(heading)])
        aside = np.array([math.cos(heading), -math.sin(heading)])
        rays = (ahead + view.columns[:, None] * aside) / slant[:, None]
        eye = view.eye - self._floor
        # Pixels by column, so that of several points in a cell the lowest of the rightmost column names its room.
        depth = view.depth.T.astype(np.float64)
        away, up = depth * slant[:, None], eye + view.rows * depth
        shown = (depth > 0) & (away <= reach) & (up < HEIGHT)
        a, b = self._cells(place + rays[:, None] * away[..., None])
        shown &= a >= 0
        obstacle = shown & (np.abs(up) > CLIMB)
        hit[a[obstacle], b[obstacle]] = True
        tall = shown & (up > TALL)
        self._tall[a[tall], b[tall]] = True
        floor = shown & ~obstacle
        clear[a[floor], b[floor]] = True
        np.minimum.at(self._near, (a[floor], b[floor]), away[floor].astype(np.float32))
        named = floor & (view.regions.T >= 0)
        self._region[a[named], b[named]] = view.regions.T[named]
        # The camera does not see the floor around the agent's feet; it is assumed open up to the next obstacle.
        far = np.max(away, axis=1, where=floor, initial=eye / -float(view.rows[-1]))
        stop = np.minimum(np.min(away, axis=1, where=obstacle, initial=np.inf) - CELL, far)
        walked = np.arange(0.0, max(float(stop.max()), 0.0) + CELL / 2, CELL / 2)
        a, b = self._cells(place + rays[:, None] * walked[:, None])
        assumed = (walked <= stop[:, None]) & (a >= 0)
        clear[a[assumed], b[assumed]] = True
        np.minimum.at(
            self._near, (a[assumed], b[assumed]), np.broadcast_to(walked, a.shape)[assumed].astype(np.float32)
        )

    @staticmethod
    def _cells(places: F64) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
        """Return the rows and columns (...) of the cells of positions (..., 2); -1 both for one off the map."""
        cells = np.floor(places / CELL).astype(np.intp) + HALF
        cells[((cells < 0) | (cells >= 2 * HALF)).any(axis=-1)] = -1
        return cells[..., 0], cells[..., 1]

    def reveal(self, places: F64, regions: NDArray[np.int16]) -> None:
        """Mark the unseen cells at k positions (k, 2) as open floor, and assign each to its room in `regions` (k,)."""
        a, b = self._cells(places)
        fits = a >= 0
        self._seen[a[fits], b[fits]] = True
        self._region[a[fits], b[fits]] = regions[fits]

    def bump(self, x: float, z: float) -> None:
        """Record that the agent was blocked at a position."""
        a, b = self._cells(np.array([x, z]))
        if a >= 0:
            self._bumped[a, b] = self._seen[a, b] = True

    def ground(self, x: float, z: float) -> Ground:
        """Return the rectangle of the map that contains all cells seen so far, for an agent at (x, z). The agent can
        always leave its own cell.
        """
        known = np.nonzero(self._seen)
        low = [max(int(axis.min()) - 2, 0) for axis in known]
        high = [min(int(axis.max()) + 3, 2 * HALF) for axis in known]
        part = slice(low[0], high[0]), slice(low[1], high[1])
        shut = (self._score[part] > 0) | self._bumped[part]
        seen = self._seen[part]
        clearance = CELL * ndimage.distance_transform_edt(~shut) if shut.any() else np.full(shut.shape, np.inf)
        passable = seen & (clearance >= CELL)
        cost = np.where(passable, np.where(clearance >= WIDE, 1.0, np.where(clearance >= CLEARANCE, 1.5, 6.0)), np.inf)
        unseen = ~seen
        frontier = passable & ndimage.binary_dilation(unseen) & (clearance >= CLEARANCE)
        borders, count = ndimage.label(frontier, np.ones((3, 3)))
        if count:
            sizes = np.bincount(borders.ravel())
            frontier &= sizes[borders] >= LEAST_FRONTIER
        region = guess = self._region[part]
        if (region >= 0).any():
            index = ndimage.distance_transform_edt(region < 0, return_distances=False, return_indices=True)
            guess = region[tuple(index)]
            region = np.where(seen, guess, -1).astype(np.int16)
        return Ground(
            (low[0], low[1]),
            passable,
            cost.astype(np.float32),
            shut,
            shut & self._tall[part],
            unseen,
            frontier,
            region,
            guess,
            self._near[part],
        )


def least_costs(cost: NDArray[np.float32], start: int) -> tuple[F64, NDArray[np.int32]]:
    """Return the least costs (n, m) from the cell `start` to all cells of a grid, in cells, infinite where there is no
    path; and for each cell (n·m,) the flat index of the one before it, negative at the start and where there is no
    path. Each cell has eight neighbours; diagonal steps do not cut corners.

    Parameters
    ----------
    cost (n, m) : cost of walking the width of a cell in it; infinite if it can't be entered
    start : flat index; it may be left even if its own cost is infinite, and diagonally past any corner
    """
    n, m = cost.shape
    number = np.arange(n * m, dtype=np.int32).reshape(n, m)
    enterable = np.isfinite(cost)
    leavable = enterable.copy()
    leavable.flat[start] = True
    starts, ends, weights = [], [], []
    for down, right in ((0, 1), (1, 0), (1, 1), (1, -1)):
        for way in (1, -1):
            here, there = _shifted(n, way * down), _shifted(m, way * right)
            one, other = (here[0], there[0]), (here[1], there[1])
            fits = leavable[one] & enterable[other]
            if down and right:
                corners = enterable[here[0], there[1]] & enterable[here[1], there[0]]
                fits &= corners | (number[one] == start)
            starts.append(number[one][fits])
            ends.append(number[other][fits])
            weights.append(cost[other][fits] * math.hypot(down, right))
    pairs = np.concatenate(starts), np.concatenate(ends)
    graph = csr_array((np.concatenate(weights).astype(np.float64), pairs), shape=(n * m, n * m))
    distance, before = dijkstra(graph, indices=start, return_predecessors=True)
    return distance.reshape(n, m), before


def _shifted(size: int, by: int) -> tuple[slice, slice]:
    """Return the slices of an axis that hold cells, and their neighbours `by` cells on."""
    return slice(max(0, -by), size - max(0, by)), slice(max(0, by), size + min(0, by))


def open_areas(
    wanted: Bools, shut: Bools, rows: NDArray[np.intp], columns: NDArray[np.intp], radius: int, rays: int
) -> F64:
    """Return for each of k cells the area, in cells, of the cells in the mask `wanted` that straight lines from the
    cell reach: up to `radius` cells long, in `rays` directions, as far as the first cell of the mask `shut`.
    """
    angles = 2 * np.pi * np.arange(rays) / rays
    found, going = np.zeros(len(rows)), np.ones((len(rows), rays), bool)
    for away in range(1, radius + 1):
        i = np.floor(rows[:, None] + 0.5 + np.cos(angles) * away).astype(np.intp)
        j = np.floor(columns[:, None] + 0.5 + np.sin(angles) * away).astype(np.intp)
        going &= (i >= 0) & (j >= 0) & (i < shut.shape[0]) & (j < shut.shape[1])
        i, j = np.where(going, i, 0), np.where(going, j, 0)
        going &= ~shut[i, j]
        found += 2 * np.pi * away / rays * (going & wanted[i, j]).sum(axis=1)
    return found


def _floor_below(look: Look, before: float) -> float:
    """Return the height in metres of the floor relative to the agent's feet: the most frequent height in the view, or
    `before` if nothing near is seen.
    """
    heights = [
        (view.eye + view.rows[:, None] * view.depth)[(view.depth > 0) & (view.depth <= 4)] for view in look.views
    ]
    bins = round((FLOOR_SPAN[1] - FLOOR_SPAN[0]) / FLOOR_BIN)
    counts, edges = np.histogram(np.concatenate(heights), bins, FLOOR_SPAN)
    return float(edges[counts.argmax()]) + FLOOR_BIN / 2 if counts.max() > 0 else before
