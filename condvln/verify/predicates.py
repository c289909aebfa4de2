"""Whether one thing is near, above or east of another: true with margin, false with margin, or too close to call.

Decided pair by pair on whole millimetres, in which sums and squares are exact; of a statement only the few things its
words can mean are asked.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final, NamedTuple

from condvln.scene import SceneObject
from condvln.verify.surfaces import SurfaceGauge
from schemas.config import Thresholds

__all__ = ["FALSE", "TRUE", "UNDECIDED", "Judge", "Judgement", "Thing"]

TRUE, FALSE, UNDECIDED = 1, -1, 0

DIRECTIONS: Final = {
    "east of": (1, 0),
    "north-east of": (1, 1),
    "north of": (0, 1),
    "north-west of": (-1, 1),
    "west of": (-1, 0),
    "south-west of": (-1, -1),
    "south of": (0, -1),
    "south-east of": (1, -1),
}
"""(east, north) of the centre of each sector."""


@dataclass(frozen=True, eq=False, slots=True)
class Thing:
    """An object by its numbers: centre and box corners (low, high) in whole millimetres, None where not known."""

    item: SceneObject
    label: str
    centre: tuple[int, int, int]
    box: tuple[tuple[int, int, int], tuple[int, int, int]] | None

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


class Judgement(NamedTuple):
    """A verdict, and the metres and degrees that it rests on."""

    verdict: int
    numbers: Mapping[str, float | None]


class Judge:
    """Predicates under one set of thresholds."""

    def __init__(self, thresholds: Thresholds, gauge: SurfaceGauge) -> None:
        self._t = thresholds
        self._gauge = gauge
        self._within = _mm(thresholds.surface_within)

    def __call__(self, predicate: str, subject: Thing, anchor: Thing) -> Judgement:
        """Does "`subject` `predicate` `anchor`" hold?"""
        if predicate == "near":
            return self._near(subject, anchor)
        if predicate == "far from":
            return self._far(subject, anchor)
        up = subject.centre[1] - anchor.centre[1]
        if predicate == "higher than":
            return self._higher(up)
        if predicate == "lower than":
            return self._higher(-up)
        if predicate == "above":
            return self._above(up, subject, anchor)
        if predicate == "below":
            return self._above(-up, subject, anchor)
        return self._beside(predicate, up, subject, anchor)

    def _near(self, one: Thing, other: Thing) -> Judgement:
        used, is_bound = _used(one, other)
        close, far = used <= _mm(self._t.near_true), used >= _mm(self._t.near_false)
        surface = None
        # Between the two the surfaces can't help.
        if one.box is not None and other.box is not None and (close or (far and used <= self._within)):
            surface = self._gauge.millimetres(one.item, other.item)
        # Boxes and bounding spheres hold their things, so that things are never closer than those; centres say nothing.
        least = surface if surface is not None else used if is_bound else None
        true = close and surface is not None and surface <= _mm(self._t.near_true)
        false = far and least is not None and least >= _mm(self._t.near_false)
        return _judgement(true, false, distance=used, surface=surface)

    def _far(self, one: Thing, other: Thing) -> Judgement:
        used, _ = _used(one, other)
        return _judgement(used >= _mm(self._t.far_true), used <= _mm(self._t.far_false), distance=used)

    def _higher(self, up: int) -> Judgement:
        return _judgement(up >= _mm(self._t.height_true), up <= _mm(self._t.height_false), height=up)

    def _above(self, up: int, one: Thing, other: Thing) -> Judgement:
        apart = math.hypot(one.centre[0] - other.centre[0], one.centre[2] - other.centre[2])
        shared = _shared_footprint(one, other)
        true = (
            up >= _mm(self._t.height_true)
            and apart <= _mm(self._t.over_horizontal_true)
            and shared is not None
            and shared >= self._t.over_footprint_true
        )
        false = up <= _mm(self._t.height_false) or apart >= _mm(self._t.over_horizontal_false)
        judgement = _judgement(true, false, height=up, horizontal=apart)
        return judgement._replace(numbers={**judgement.numbers, "footprint_overlap": shared})

    def _beside(self, predicate: str, up: int, one: Thing, other: Thing) -> Judgement:
        east, north = one.centre[0] - other.centre[0], other.centre[2] - one.centre[2]
        towards = DIRECTIONS[predicate]
        apart = math.hypot(east, north)
        if not apart:
            return Judgement(UNDECIDED, {"horizontal": 0.0})
        cross = east * towards[1] - north * towards[0]
        off = math.degrees(math.atan2(abs(cross), east * towards[0] + north * towards[1]))
        elevation = math.degrees(math.atan2(abs(up), apart))
        true = off <= self._t.sector_true and elevation < self._t.level and apart >= _mm(self._t.sector_horizontal_true)
        judgement = _judgement(true, off > self._t.sector_false, horizontal=apart)
        return judgement._replace(
            numbers={**judgement.numbers, "degrees_off": round(off, 3), "elevation": round(elevation, 3)}
        )


def _judgement(true: bool, false: bool, **millimetres: float | None) -> Judgement:
    verdict = TRUE if true else FALSE if false else UNDECIDED
    return Judgement(verdict, {k: None if v is None else round(v / 1000.0, 3) for k, v in millimetres.items()})


def _used(one: Thing, other: Thing) -> tuple[float, bool]:
    """Millimetres between boxes, else bounding spheres, else centres; and whether surfaces are at least so far."""
    if one.box is not None and other.box is not None:
        gaps = [max(one.box[0][k] - other.box[1][k], other.box[0][k] - one.box[1][k], 0) for k in range(3)]
        return math.sqrt(sum(gap * gap for gap in gaps)), True
    centres = math.dist(one.centre, other.centre)
    if one.item.radius is not None and other.item.radius is not None:
        return max(centres - 1000.0 * (one.item.radius + other.item.radius), 0.0), True
    return centres, False


def _shared_footprint(one: Thing, other: Thing) -> float | None:
    """Shared ground area over the smaller of both; None where unknown or flat."""
    if one.box is None or other.box is None:
        return None
    shared, areas = 1, [1, 1]
    for k in (0, 2):
        low, high = max(one.box[0][k], other.box[0][k]), min(one.box[1][k], other.box[1][k])
        shared *= max(high - low, 0)
        areas = [areas[0] * (one.box[1][k] - one.box[0][k]), areas[1] * (other.box[1][k] - other.box[0][k])]
    return shared / min(areas) if min(areas) > 0 else None


def _mm(metres: float) -> float:
    # 1.15 · 1000 is not a whole number in binary; a millionth of a millimetre decides nothing.
    return round(metres * 1000.0, 6)


def _whole(point: object) -> tuple[int, int, int]:
    x, y, z = (round(float(value) * 1000.0) for value in point)  # type: ignore[attr-defined]
    return x, y, z
