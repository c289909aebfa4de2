"""What is around a thing in its room: the floor, what carries it, and who else could be meant."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from condvln.scene import SceneObject
from schemas.config import Thresholds

__all__ = ["Point", "Surroundings", "Thing", "box_gap", "footprint_gap", "shared_sides", "whole_mm"]

Point = tuple[int, int, int]


@dataclass(frozen=True, eq=False, slots=True)
class Thing:
    """An object by its numbers: centre and box corners (low, high) in whole millimetres, None where not known."""

    item: SceneObject
    label: str
    centre: Point
    box: tuple[Point, Point] | None

    @classmethod
    def of(cls, item: SceneObject, label: str) -> Thing:
        """A thing from its record."""
        box = item.box
        corners = None if box is None else (_whole(box[0]), _whole(box[1]))
        return cls(item, label, _whole(item.center), corners)

    @property
    def object_id(self) -> str:
        """Its id in the scene."""
        return self.item.object_id

    def ground_sides(self) -> tuple[int, int]:
        """Sides of its footprint along x and z; it must have a box."""
        assert self.box is not None
        return self.box[1][0] - self.box[0][0], self.box[1][2] - self.box[0][2]

    def sides(self) -> list[float]:
        """Sides of its oriented box, else of its axis-aligned one, the longest last; empty without either."""
        if self.item.obb is not None:
            return sorted(float(round(2.0 * float(half) * 1000.0)) for half in self.item.obb.half_extents)
        if self.box is None:
            return []
        return sorted(float(high - low) for low, high in zip(*self.box, strict=True))


class Surroundings:
    """A room around its things.

    Parameters
    ----------
    things : all things of the room
    floor : height of its floor in metres
    """

    def __init__(self, things: Sequence[Thing], floor: float, thresholds: Thresholds) -> None:
        self._things = things
        self._floor = None if math.isnan(floor) else round(floor * 1000.0)
        self._lift, self._slack = whole_mm(thresholds.on_gap_true), whole_mm(thresholds.on_gap_false)
        self._carriers: dict[str, frozenset[str]] = {}

    def off_floor(self, thing: Thing) -> int | None:
        """Millimetres of its bottom above the floor."""
        return None if thing.box is None or self._floor is None else thing.box[0][1] - self._floor

    def may_rest(self, upper: Thing, lower: Thing) -> bool:
        """Whether boxes leave it open that `upper` rests on `lower`: footprints meet, and its bottom lies clearly above
        that of `lower` and not clearly above its top."""
        if upper is lower or upper.box is None or lower.box is None or footprint_gap(upper, lower) > 0.0:
            return False
        bottom = upper.box[0][1]
        return bottom - lower.box[0][1] > self._lift and bottom - lower.box[1][1] < self._slack

    def may_carry(self, lower: Thing, upper: Thing) -> bool:
        """Whether `upper` may rest on `lower`, perhaps with things in between."""
        return lower.object_id in self._carriers_of(upper)

    def _carriers_of(self, thing: Thing) -> frozenset[str]:
        if thing.object_id not in self._carriers:
            found: dict[str, Thing] = {}
            ahead = [thing]
            while ahead:
                upper = ahead.pop()
                new = [x for x in self._things if x.object_id not in found and self.may_rest(upper, x)]
                found.update((lower.object_id, lower) for lower in new)
                ahead += new
            self._carriers[thing.object_id] = frozenset(found)
        return self._carriers[thing.object_id]


def whole_mm(metres: float) -> float:
    """Millimetres. 1.15 · 1000 is not a whole number in binary; a millionth of a millimetre decides nothing."""
    return round(metres * 1000.0, 6)


def footprint_gap(one: Thing, other: Thing) -> float:
    """Horizontal millimetres between two footprints; both must have a box."""
    return _beyond(one, other, (0, 2))


def box_gap(one: Thing, other: Thing) -> float:
    """Millimetres between two boxes; both must have one."""
    return _beyond(one, other, (0, 1, 2))


def _beyond(one: Thing, other: Thing, axes: tuple[int, ...]) -> float:
    assert one.box is not None
    assert other.box is not None
    total = 0
    for k in axes:
        gap = max(one.box[0][k] - other.box[1][k], other.box[0][k] - one.box[1][k], 0)
        total += gap * gap
    return math.sqrt(total)


def shared_sides(one: Thing, other: Thing) -> tuple[int, int, int]:
    """Lengths along x, y and z that two boxes share."""
    assert one.box is not None
    assert other.box is not None
    x, y, z = (max(min(one.box[1][k], other.box[1][k]) - max(one.box[0][k], other.box[0][k]), 0) for k in range(3))
    return x, y, z


def _whole(point: object) -> Point:
    x, y, z = (round(float(value) * 1000.0) for value in point)  # type: ignore[attr-defined]
    return x, y, z
