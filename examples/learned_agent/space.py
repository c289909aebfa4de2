"""What a laser scanner measures around the agent, the map that remembers it, and the ways through its free cells."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from condvln.sensors import Renderer
from schemas.config import CameraConfig

BAND = 0.2, 1.4
"""Heights in metres above the agent's feet between which a surface is in the way."""
REACH = 6.0
"""Metres that the scanner measures."""
CELL = 0.125
WIDE = 400
"""Cells of the map's side; the start is in its middle."""
RAYS = 16
"""Directions in which the network gets the free distance; the first is straight ahead, the next to its left."""
SPACE = 3 * RAYS
UNKNOWN, FREE, TAKEN = range(3)
ACROSS = np.array([1, -1, 0, 0, 1, -1, 1, -1])
DOWN = np.array([0, 0, 1, -1, 1, 1, -1, -1]) * WIDE
MARGIN = 16
"""Cells beyond the known free ones through which a way may go."""
AHEAD = 24
"""Cells along a way within which its bearing is measured."""

_SIDES = [CameraConfig(width=64, height=32, normalized=False, turn=turn) for turn in (0, 90, 180, 270)]
_ACROSS = (np.arange(64) + 0.5) / 32 - 1  # tangents of the columns' angles
_DOWN = ((np.arange(32) + 0.5) / 16 - 1)[:, None] / 2
_ANGLES = np.concatenate([math.radians(side.turn) - np.arctan(_ACROSS) for side in _SIDES])
_STEPS = np.arange(0.5, REACH / CELL) * CELL


def scan(renderer: Renderer, position: np.ndarray, heading: float) -> np.ndarray:
    """Return the metres to the nearest surface at body height in 256 directions, at most `REACH`."""
    found = []
    for side in _SIDES:
        depth = renderer.look(side, position, heading, rgb=False, objects=False).depth
        height = side.eye_height - _DOWN * depth
        hit = (depth > 0) & (BAND[0] < height) & (height < BAND[1])
        found.append(np.where(hit, depth, np.inf).min(axis=0) * np.hypot(1, _ACROSS))
    return np.minimum(np.concatenate(found), REACH)


class Space:
    """A map of cells that are free, taken or unknown."""

    def __init__(self) -> None:
        self._cells = np.zeros(WIDE * WIDE, np.uint8)
        self._middle: tuple[float, float] | None = None
        self._box = np.array([WIDE, WIDE, 0, 0])

    def see(self, scanned: np.ndarray, x: float, z: float, heading: float, collided: bool) -> np.ndarray:
        """Add a scan, and return (SPACE,): for each ray how far it is to a taken cell, twice, and to an unknown one."""
        if self._middle is None:
            self._middle = x, z
        cells, angles = self._cells, heading + _ANGLES
        passed = self._along(x, z, angles, _STEPS)[scanned[:, None] - CELL > _STEPS]
        cells[passed[cells[passed] == UNKNOWN]] = FREE
        self._here = self.cell(x, z)
        known = np.stack(np.divmod(np.append(passed, self._here), WIDE))
        self._box[:2] = np.minimum(self._box[:2], known.min(1) - MARGIN).clip(2)
        self._box[2:] = np.maximum(self._box[2:], known.max(1) + MARGIN).clip(0, WIDE - 3)
        cells[self._along(x, z, angles, scanned[:, None])[scanned < REACH, 0]] = TAKEN
        if collided:
            cells[self._along(x, z, np.array([heading]), np.array([0.3]))] = TAKEN
        self._costs, self._before, self._queue = _flood(cells, self._here, self._box)
        along = cells[self._along(x, z, heading + np.arange(RAYS) * math.tau / RAYS, _STEPS)]
        along[:, :2] = FREE
        taken, ended = along == TAKEN, along != FREE
        to_taken = np.where(taken.any(1), _STEPS[taken.argmax(1)], REACH)
        to_end = np.where(ended.any(1), _STEPS[ended.argmax(1)], REACH)
        unknown = np.where(to_end < to_taken, to_end, REACH)
        return np.concatenate([to_taken / REACH, np.exp(-2 * to_taken), unknown / REACH])

    def cell(self, x: np.ndarray | float, z: np.ndarray | float) -> np.ndarray:
        """Return the cells of places."""
        column, row = (np.floor((v - m) / CELL) + WIDE // 2 for v, m in zip((x, z), self._middle, strict=True))
        return (np.clip(row, 1, WIDE - 2) * WIDE + np.clip(column, 1, WIDE - 2)).astype(np.int64)

    def edges(self) -> list[tuple[float, float]]:
        """Return up to four places where the known free cells end, 1.5 m or more apart, the nearest first."""
        found = _edges(self._cells, self._costs, self._queue)
        rows, columns = np.divmod(found, WIDE)
        x, z = ((v - WIDE // 2 + 0.5) * CELL + m for v, m in zip((columns, rows), self._middle, strict=True))
        return [*zip(x.tolist(), z.tolist(), strict=True)]

    def ways(self, x: np.ndarray, z: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the known ways to places: their lengths (inf for none), and the bearings to go, as x and z."""
        costs, to = _ways(self._cells, self._costs, self._before, self._here, self.cell(x, z))
        column, row = to % WIDE - self._here % WIDE, to // WIDE - self._here // WIDE
        far = np.maximum(np.hypot(column, row), 1e-3)
        return costs * CELL, column / far, row / far

    def _along(self, x: float, z: float, angles: np.ndarray, far: np.ndarray) -> np.ndarray:
        return self.cell(x - np.sin(angles)[:, None] * far, z - np.cos(angles)[:, None] * far)


@njit(cache=True)
def _tight(cells, at):
    return cells[at + 1] == 2 or cells[at - 1] == 2 or cells[at + WIDE] == 2 or cells[at - WIDE] == 2


@njit(cache=True)
def _flood(cells, start, box):
    """Return for each cell the cost of the way from the start and the cell before it, and all cells that were reached.
    An unknown cell costs twice as much, and a free one beside a taken one four times.
    """
    prices = np.zeros(len(cells), np.float32)
    for row in range(box[0], box[2] + 1):
        for at in range(row * WIDE + box[1], row * WIDE + box[3] + 1):
            if cells[at] != 2:
                tight = _tight(cells, at)
                prices[at] = (0 if tight else 2) if cells[at] == 0 else 4 if tight else 1
    costs = np.full(len(cells), np.inf, np.float32)
    before = np.full(len(cells), -1, np.int32)
    waits = np.zeros(len(cells), np.bool_)
    queue = np.empty(9 * len(cells), np.int32)
    queue[0], costs[start], k, end = start, 0, 0, 1
    while k < end:
        at = queue[k]
        k += 1
        waits[at] = False
        for n in range(8):
            down, across = DOWN[n], ACROSS[n]
            to = at + down + across
            if prices[to] == 0 or (n > 3 and (cells[at + down] == 2 or cells[at + across] == 2)):
                continue
            cost = costs[at] + (1.0 if n < 4 else 1.4142) * prices[to]
            if cost < costs[to] - 1e-3:
                costs[to], before[to] = cost, at
                if not waits[to]:
                    waits[to], queue[end], end = True, to, end + 1
    return costs, before, queue[:end].copy()


@njit(cache=True)
def _edges(cells, costs, queue):
    found = [queue[0] for _ in range(0)]
    for _ in range(4):
        best, least = -1, np.inf
        for at in queue:
            if 4 < costs[at] < least and cells[at] == 1:
                near = cells[at + 1] and cells[at - 1] and cells[at + WIDE] and cells[at - WIDE]
                unknown = 0
                for k in range(25):
                    unknown += cells[at + k % 5 - 2 + (k // 5 - 2) * WIDE] == 0
                for one in found:
                    near = near or abs(one % WIDE - at % WIDE) + abs(one // WIDE - at // WIDE) < 12
                if not near and unknown >= 8:
                    best, least = at, costs[at]
        if best < 0:
            break
        found.append(best)
    return np.array(found)


@njit(cache=True)
def _clear(cells, start, to):
    across, down = to % WIDE - start % WIDE, to // WIDE - start // WIDE
    steps = 2 * max(abs(across), abs(down), 1)
    for k in range(1, steps):
        at = start + round(across * k / steps) + WIDE * round(down * k / steps)
        if cells[at] == 2 or (k > 4 and _tight(cells, at)):
            return False
    return True


@njit(cache=True)
def _ways(cells, costs, before, start, to):
    """Return for each cell the cost of the way to the best cell within a metre of it, and the farthest of the way's
    first cells that is in a straight line from the start.
    """
    found = np.full(len(to), np.inf, np.float32)
    first = np.full(len(to), start)
    for k in range(len(to)):
        best, least = -1, np.inf
        for row in range(-8, 9):
            for column in range(-8, 9):
                at = to[k] + row * WIDE + column
                if 0 <= at < len(cells):
                    cost = costs[at] + 3 * math.hypot(row, column)
                    if cost < least:
                        best, least = at, cost
        if best < 0:
            continue
        found[k] = costs[best]
        at = best
        while at != start:
            if costs[at] < 4 * AHEAD and _clear(cells, start, at):
                break
            at = before[at]
            if costs[at] <= 2:
                break
        first[k] = at
    return found, first
