"""The surroundings of an object in its room: the height above the floor, the objects that it rests on or is inside of,
and the distances to other objects. Judgements, which are made of these.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence, Set
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from condvln.scene import SceneObject
from schemas.config import Thresholds
from schemas.config.constants import GROUP_RUG, GROUP_TABLE

__all__ = [
    "FALSE",
    "TRUE",
    "UNDECIDED",
    "Judgement",
    "Point",
    "Said",
    "Surroundings",
    "Thing",
    "box_gap",
    "footprint_gap",
    "judged",
    "shared_sides",
    "whole_mm",
]

TRUE, FALSE, UNDECIDED = 1, -1, 0


class Judgement(NamedTuple):
    """A verdict (true, false, or undecided), and the metres, degrees and shares that the verdict is based on."""

    verdict: int
    numbers: Mapping[str, float | None]


def judged(
    true: bool, false: bool, shares: Mapping[str, float | None] | None = None, **millimetres: float | None
) -> Judgement:
    """Return the judgement that follows from `true` and `false`; it is undecided if neither is set. `shares` are stored
    unchanged, all other numbers are converted from millimetres to metres.
    """
    verdict = TRUE if true else FALSE if false else UNDECIDED
    metres = {k: None if v is None else round(v / 1000.0, 3) for k, v in millimetres.items()}
    return Judgement(verdict, {**metres, **(shares or {})})


Point = tuple[int, int, int]

Said = Mapping[str, Sequence[tuple[str, bool]]]
"""By object id, what the source states that it is in (True) and on (False)."""


@dataclass(frozen=True, eq=False, slots=True)
class Thing:
    """An object with its label, its centre, and the corners (low, high) of its box in whole millimetres; `box` is None
    if unknown.

    pieces : its boxes if it has several (an L-shaped counter)
    """

    item: SceneObject
    label: str
    centre: Point
    box: tuple[Point, Point] | None
    pieces: tuple[Thing, ...] = ()

    @classmethod
    def of(cls, item: SceneObject, label: str) -> Thing:
        """Return an object from its scene record."""
        box = item.box
        corners = None if box is None else (_whole(box[0]), _whole(box[1]))
        thing = cls(item, label, _whole(item.center), corners)
        arms = []
        for part in item.parts:
            reach = np.abs(part.rotation) @ part.half_extents
            low, high = _whole(part.center - reach), _whole(part.center + reach)
            x, y, z = (round((a + b) / 2) for a, b in zip(low, high, strict=True))
            arms.append(replace(thing, centre=(x, y, z), box=(low, high)))
        return replace(thing, pieces=tuple(arms))

    def solids(self) -> tuple[Thing, ...]:
        """Return the pieces of an object, or the object itself if it is a single box."""
        return self.pieces or (self,)

    @property
    def object_id(self) -> str:
        """The object's id in the scene."""
        return self.item.object_id

    def ground_sides(self) -> tuple[int, int]:
        """Sides of the object's footprint in millimetres along x and z; the object must have a box."""
        assert self.box is not None
        return self.box[1][0] - self.box[0][0], self.box[1][2] - self.box[0][2]

    def volume(self) -> int:
        """Volume of the object's box in cubic millimetres; the object must have a box."""
        assert self.box is not None
        return math.prod(high - low for low, high in zip(*self.box, strict=True))

    def sides(self) -> list[float]:
        """Sides of an object's oriented box, else of its axis-aligned box, the longest last; empty if it has no box."""
        if self.item.obb is not None:
            return sorted(float(round(2.0 * float(half) * 1000.0)) for half in self.item.obb.half_extents)
        if self.box is None:
            return []
        return sorted(float(high - low) for low, high in zip(*self.box, strict=True))


class Surroundings:
    """The objects of one room, to find out which of them support, surround or contain others.

    Parameters
    ----------
    things : all things of the room
    floor : height of its floor in metres
    said : the source's statements about where objects are
    """

    def __init__(self, things: Sequence[Thing], floor: float, thresholds: Thresholds, said: Said | None = None) -> None:
        self._things = things
        self._floor = None if math.isnan(floor) else round(floor * 1000.0)
        self._lift, self._slack = whole_mm(thresholds.on_gap_true), whole_mm(thresholds.on_gap_false)
        self._carriers: dict[str, set[str]] = {}
        self._holders: dict[str, set[str]] = {}
        self._share, self._most = thresholds.held_footprint, thresholds.held_inside
        self._said = said or {}

    def off_floor(self, thing: Thing) -> int | None:
        """Return the height in millimetres of the object's bottom above the floor; None if one of the two heights is
        unknown.
        """
        return None if thing.box is None or self._floor is None else thing.box[0][1] - self._floor

    def is_said_on(self, upper: Thing, lower: Thing) -> bool:
        """Return whether the source states that `upper` rests on `lower`."""
        return (lower.object_id, False) in self._said.get(upper.object_id, ())

    def is_said_in(self, inner: Thing, outer: Thing) -> bool:
        """Return whether the source states that `outer` contains `inner`."""
        return (outer.object_id, True) in self._said.get(inner.object_id, ())

    def is_said_elsewhere(self, thing: Thing, other: Thing) -> bool:
        """Return whether the source states a place for `thing` that is not in or on `other`, directly or through
        further objects.
        """
        if not self._said.get(thing.object_id):
            return False
        receptacles = {x.object_id: x.item.receptacles or () for x in self._things}
        seen: set[str] = set()
        ahead = list(receptacles.get(thing.object_id, ()))
        while ahead:
            name = ahead.pop()
            if name not in seen:
                seen.add(name)
                ahead += receptacles.get(name, ())
        return other.object_id not in seen

    def may_rest(self, upper: Thing, lower: Thing) -> bool:
        """Return whether `upper` may rest on `lower`.

        This is so if the source states it, or if their footprints meet and the bottom of `upper` is clearly above that
        of `lower` and not clearly above its top.
        """
        if upper.object_id == lower.object_id:
            return False
        if lower.object_id in (upper.item.receptacles or ()):
            return True
        return any(self._meets(above, below) for above in upper.solids() for below in lower.solids())

    def _meets(self, upper: Thing, lower: Thing) -> bool:
        if upper.box is None or lower.box is None or footprint_gap(upper, lower) > 0.0:
            return False
        bottom = upper.box[0][1]
        return bottom - lower.box[0][1] > self._lift and bottom - lower.box[1][1] < self._slack

    def may_carry(self, lower: Thing, upper: Thing) -> bool:
        """Return whether `upper` may rest on `lower`, directly or through other objects."""
        return lower.object_id in self._reached(upper, self._carriers, lambda x, above: self.may_rest(above, x))

    def holds(self, outer: Thing, thing: Thing) -> bool:
        """Return whether `outer` supports `thing` or surrounds most of `thing`, directly or through other objects.

        Footprints must overlap: an object that only touches another one is beside it.
        """
        return outer.object_id in self._reached(thing, self._holders, self._has)

    def is_put_away(self, thing: Thing, containers: Mapping[str, str]) -> bool:
        """Return whether an object is in a container for storage."""
        return any(
            bool(containers.get(x.label)) and (self.is_said_in(thing, x) or self._surrounds(x, thing))
            for x in self._things
            if x.object_id != thing.object_id
        )

    def forms_a_group(self, one: Thing, other: Thing, roles: Mapping[str, Set[str]]) -> bool:
        """Return whether two objects stand at the same rug, or around the same coffee table."""
        if one.box is None or other.box is None:
            return False
        for role, reach in (("carpet", GROUP_RUG), ("low table", GROUP_TABLE)):
            for middle in self._things:
                if middle.label not in roles[role] or middle.box is None:
                    continue
                if middle.object_id in (one.object_id, other.object_id):
                    continue
                if max(footprint_gap(middle, thing) for thing in (one, other)) <= 1000.0 * reach:
                    return True
        return False

    def _has(self, outer: Thing, inner: Thing) -> bool:
        if outer.object_id == inner.object_id:
            return False
        if self._share > 0.0 and _apart(outer, inner):
            return outer.object_id in (inner.item.receptacles or ())
        if outer.object_id in (inner.item.receptacles or ()) or self._surrounds(outer, inner):
            return True
        return any(self._bears(below, above) for above in inner.solids() for below in outer.solids())

    def _bears(self, lower: Thing, upper: Thing) -> bool:
        """Return whether, by their boxes, `lower` bears `upper`: the bottom of `upper` is level with the top of `lower`
        or between the bottom and the top of `lower`, and enough of the footprint of `upper` is above `lower`.
        """
        area = 0 if upper.box is None else math.prod(upper.ground_sides())
        if upper.box is None or lower.box is None or not area:
            return False
        bottom = upper.box[0][1]
        at_height = bottom - lower.box[0][1] > self._lift or bottom - lower.box[1][1] >= -self._lift
        if not at_height or bottom - lower.box[1][1] >= self._slack:
            return False
        x, _, z = shared_sides(upper, lower)
        return x * z / area >= self._share

    def _surrounds(self, outer: Thing, inner: Thing) -> bool:
        """Return whether most of a piece of `inner` is inside a piece of `outer`."""
        for a in inner.solids():
            for b in outer.solids():
                if a.box is None or b.box is None:
                    continue
                volume = a.volume()
                if volume > 0 and math.prod(shared_sides(a, b)) / volume > self._most:
                    return True
        return False

    def _reached(self, thing: Thing, known: dict[str, set[str]], leads: Callable[[Thing, Thing], bool]) -> set[str]:
        """Return the ids of the objects x for which `leads` (x, thing), or (x, y) with a y that is found so itself.
        What is `known` already is not sought again. Of a piece, its whole object is meant.
        """
        if thing.object_id not in known:
            found = known[thing.object_id] = set()
            ahead = [x for x in self._things if x.object_id == thing.object_id] or [thing]
            while ahead:
                before = ahead.pop()
                new = [x for x in self._things if x.object_id not in found and leads(x, before)]
                found.update(x.object_id for x in new)
                ahead += new
        return known[thing.object_id]


def whole_mm(metres: float) -> float:
    """Convert metres to millimetres, rounded to a nanometre: without rounding, 2.01 m would not be exactly 2010 mm."""
    return round(metres * 1000.0, 6)


def footprint_gap(one: Thing, other: Thing) -> float:
    """Return the horizontal distance in millimetres between two footprints; both objects must have a box."""
    return _beyond(one, other, (0, 2))


def box_gap(one: Thing, other: Thing) -> float:
    """Return the distance in millimetres between the boxes of two objects; both objects must have a box."""
    return _beyond(one, other, (0, 1, 2))


def _beyond(one: Thing, other: Thing, axes: tuple[int, ...]) -> float:
    assert one.box is not None
    assert other.box is not None
    total = 0
    for k in axes:
        gap = max(one.box[0][k] - other.box[1][k], other.box[0][k] - one.box[1][k], 0)
        total += gap * gap
    return math.sqrt(total)


def _apart(one: Thing, other: Thing) -> bool:
    """Return whether two objects are single boxes whose footprints share no area."""
    if one.pieces or other.pieces or one.box is None or other.box is None:
        return False
    (x, _, z), (x1, _, z1) = one.box
    (u, _, w), (u1, _, w1) = other.box
    return x >= u1 or u >= x1 or z >= w1 or w >= z1


def shared_sides(one: Thing, other: Thing) -> tuple[int, int, int]:
    """Return the lengths (x, y, z) of the overlap of two boxes in millimetres; 0 along an axis on which they do not
    overlap.
    """
    assert one.box is not None
    assert other.box is not None
    (x, y, z), (x1, y1, z1) = one.box
    (u, v, w), (u1, v1, w1) = other.box
    return max(min(x1, u1) - max(x, u), 0), max(min(y1, v1) - max(y, v), 0), max(min(z1, w1) - max(z, w), 0)


def _whole(point: object) -> Point:
    x, y, z = (round(float(value) * 1000.0) for value in point)  # type: ignore[attr-defined]
    return x, y, z
