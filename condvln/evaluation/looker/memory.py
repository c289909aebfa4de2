"""The looker agent's memory of objects: the positions of their surfaces, in its own frame."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Final

import numpy as np
from numpy.typing import NDArray

from condvln.evaluation.looker.eyes import Look

__all__ = ["GRAIN", "Memory", "Thing"]

F64 = NDArray[np.float64]

GRAIN: Final = 0.05
"""Edge in metres of the voxels that store an object's surface."""
_SPAN: Final = 1 << 14
_MOST: Final = 600
"""Largest number of voxels of an object used for distances; larger objects are subsampled."""


@dataclass(eq=False, slots=True)
class Thing:
    """An object: its label, the number of its room, and the seen part of its surface.

    nearest : least horizontal distance in metres from which it was seen; seen : step at which it was last seen
    """

    number: int
    label: str
    room: int
    cubes: NDArray[np.int64]
    nearest: float
    seen: int
    _points: F64 | None = field(default=None, repr=False)

    @property
    def points(self) -> F64:
        """Centres (n, 3) of the object's surface voxels in metres: x, height above the agent's feet at the start, z."""
        if self._points is None:
            keys = self.cubes
            keys = keys[:: max(1, -(-len(keys) // _MOST))] if len(keys) > 4 * _MOST else keys
            axes = np.stack([keys // (_SPAN * _SPAN), keys // _SPAN % _SPAN, keys % _SPAN], axis=1)
            self._points = np.asarray((axes - _SPAN // 2 + 0.5) * GRAIN, np.float64)
        return self._points

    @property
    def box(self) -> F64:
        """[min, max] (2, 3) of the seen points, in metres."""
        points = self.points
        return np.array([points.min(axis=0) - GRAIN / 2, points.max(axis=0) + GRAIN / 2])

    @property
    def middle(self) -> F64:
        """Centre (3,) of the box of the seen points, in metres."""
        return np.asarray(self.box.mean(axis=0), np.float64)


class Memory:
    """All objects seen so far, by number, in the order in which they were first seen.

    span : number of steps after which an object is forgotten if not seen again; None for never
    """

    def __init__(self, span: int | None = None) -> None:
        self._things: dict[int, Thing] = {}
        self._span = span
        self.rooms: dict[int, str] = {}

    def __iter__(self) -> Iterator[Thing]:
        return iter(self._things.values())

    def add(self, look: Look, place: F64, heading: float, step: int) -> None:
        """Add a view from a position (3,) with a heading in radians counter-clockwise from −z."""
        self.rooms.update(look.rooms)
        right, up, ahead = look.points.T
        c, s = math.cos(heading), math.sin(heading)
        x, z = place[0] + c * right - s * ahead, place[2] - s * right - c * ahead
        cubes = np.floor(np.stack([x, up + place[1], z]) / GRAIN).astype(np.int64) + _SPAN // 2
        keys = (cubes[0] * _SPAN + cubes[1]) * _SPAN + cubes[2]
        numbers, rank = np.unique(look.owner, return_inverse=True)
        nearest = np.full(len(numbers), np.inf)
        np.minimum.at(nearest, rank, np.hypot(right, ahead))
        # Sorted by object, then by cube; each cube of an object once.
        owned = np.sort(rank * _SPAN**3 + keys)
        owned = owned[np.diff(owned, prepend=-1) > 0]
        ends = np.searchsorted(owned, (np.arange(len(numbers)) + 1) * _SPAN**3).tolist()
        start = 0
        for k, (number, end, distance) in enumerate(zip(numbers.tolist(), ends, nearest.tolist(), strict=True)):
            label, room = look.things[number]
            found, start = owned[start:end] - k * _SPAN**3, end
            known = self._things.get(number)
            if known is None:
                self._things[number] = Thing(number, label, room, found, distance, step)
                continue
            at = np.searchsorted(known.cubes, found)
            new = known.cubes[np.minimum(at, len(known.cubes) - 1)] != found
            if new.any():
                known.cubes, known._points = np.insert(known.cubes, at[new], found[new]), None
            known.nearest, known.seen = min(known.nearest, distance), step
        if self._span is not None:
            self._things = {k: one for k, one in self._things.items() if step - one.seen <= self._span}
