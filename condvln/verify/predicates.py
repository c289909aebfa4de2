"""Decide whether one object is near, above or east of another: true with margin, false with margin, or undecided.

Pairs are decided on whole millimetres, in which sums and squares are exact. Only the few objects that the words of a
statement can mean are tested.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final

from condvln.verify.comparisons import compare_sizes, is_closest, lies_between
from condvln.verify.judgement import FALSE, TRUE, UNDECIDED, Judgement, judged
from condvln.verify.supports import as_said_in, as_said_on, is_above, is_higher, is_in, is_on, is_under
from condvln.verify.surfaces import SurfaceGauge
from condvln.verify.surroundings import Surroundings, Thing, footprint_gap, whole_mm
from condvln.verify.words import words
from schemas.config import Thresholds

__all__ = ["DIRECTIONS", "FALSE", "TRUE", "UNDECIDED", "Judge", "Judgement", "Thing"]

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

SOME: Final = frozenset(("on", "under", "in", "near", "above", "below"))
"""Predicates that are true of an object of several pieces if they are true of one of them."""


class Judge:
    """Evaluates predicates under one set of thresholds."""

    def __init__(self, thresholds: Thresholds, gauge: SurfaceGauge) -> None:
        self._t = thresholds
        self._gauge = gauge

    def __call__(
        self,
        predicate: str,
        subject: Thing,
        anchors: Sequence[Thing],
        room: Surroundings,
        rivals: Sequence[Thing] = (),
        asked: bool = False,
    ) -> Judgement:
        """Return whether "`subject` `predicate` `anchors`" holds.

        rivals : the other objects that the subject's label might mean; "closest to" and "the bigger" compare with them
        asked : a condition asks for it, which is false of a direction only where another is clearly meant; otherwise it
            distinguishes rivals, and "far from" is false only of what is near
        """
        if predicate in ("bigger", "smaller"):
            return compare_sizes(subject, rivals, self._t, 1 if predicate == "bigger" else -1)
        if predicate == "between":
            return lies_between(subject, anchors, room, self._t)
        (anchor,) = anchors
        if predicate == "closest to":
            found = is_closest(subject, anchor, rivals, self._t)
            held = room.holds(anchor, subject) or room.holds(subject, anchor)
            return found._replace(verdict=UNDECIDED) if held and found.verdict == TRUE else found
        found = self._of_pieces(predicate, subject, anchor, room, asked)
        if predicate == "near":
            return _beside_each_other(found, subject, anchor, room)
        if predicate == "on":
            return as_said_on(found, subject, anchor, room)
        return as_said_in(found, subject, anchor, room) if predicate == "in" else found

    def _of_pieces(self, predicate: str, subject: Thing, anchor: Thing, room: Surroundings, asked: bool) -> Judgement:
        """Return the judgement on objects of several pieces, derived from the judgements on each pair of pieces."""
        found = [self._of_one(predicate, a, b, room, asked) for a in subject.solids() for b in anchor.solids()]
        when_true, when_false = (
            (any, all) if predicate in SOME else (all, any) if predicate == "far from" else (all, all)
        )
        if when_true(how.verdict == TRUE for how in found):
            return next(how for how in found if how.verdict == TRUE)
        if when_false(how.verdict == FALSE for how in found):
            return next(how for how in found if how.verdict == FALSE)
        return found[0]._replace(verdict=UNDECIDED)

    def _of_one(self, predicate: str, subject: Thing, anchor: Thing, room: Surroundings, asked: bool) -> Judgement:
        if predicate in ("near", "far from"):
            return self._near(subject, anchor) if predicate == "near" else self._far(subject, anchor, asked)
        if predicate in ("on", "under", "in"):
            by_support = {"on": is_on, "under": is_under, "in": is_in}[predicate]
            return by_support(subject, anchor, room, self._t)
        if predicate in ("lower than", "below"):
            subject, anchor = anchor, subject
        if predicate in ("higher than", "lower than"):
            return is_higher(subject, anchor, room, self._t)
        if predicate in ("above", "below"):
            return is_above(subject, anchor, room, self._t)
        return self._beside(predicate, subject, anchor, self._t.sector_denied if asked else self._t.sector_false)

    def _near(self, one: Thing, other: Thing) -> Judgement:
        used, along_ground = _used(one, other), _along_ground(one, other)
        surface = None
        if one.box is not None and other.box is not None:
            air = max(one.box[0][1] - other.box[1][1], other.box[0][1] - one.box[1][1])
            if used <= whole_mm(self._t.near_true) and air <= whole_mm(self._t.near_over):
                surface = self._gauge.millimetres(one.item, other.item)
        true = surface is not None and surface <= whole_mm(self._t.near_true)
        false = along_ground is not None and along_ground >= whole_mm(self._t.near_false)
        return judged(true, false, distance=used, surface=surface, footprints_apart=along_ground)

    def _far(self, one: Thing, other: Thing, asked: bool) -> Judgement:
        used, close = _used(one, other), self._t.far_false if asked else self._t.near_true
        return judged(used >= whole_mm(self._t.far_true), used <= whole_mm(close), distance=used)

    def _beside(self, predicate: str, one: Thing, other: Thing, elsewhere: float) -> Judgement:
        east, north = one.centre[0] - other.centre[0], other.centre[2] - one.centre[2]
        towards = DIRECTIONS[predicate]
        apart = math.hypot(east, north)
        if not apart or _is_over(one, other) or _is_over(other, one):
            return Judgement(UNDECIDED, {"horizontal": apart / 1000.0})
        off = _degrees_off((east, north), towards)
        from_edges = [_degrees_off(way, towards) for way in (_from_edge(one, other), _to_edge(one, other))]
        elevation = math.degrees(math.atan2(abs(one.centre[1] - other.centre[1]), apart))
        clear = elevation < self._t.level and apart >= whole_mm(self._t.sector_horizontal_true)
        true = off <= self._t.sector_true and max(from_edges) <= self._t.sector_edge and clear
        judgement = judged(true, min(off, *from_edges) > elsewhere, horizontal=apart)
        angles = {"degrees_off": off, "degrees_off_edges": max(from_edges), "elevation": elevation}
        return judgement._replace(numbers={**judgement.numbers, **{name: round(x, 3) for name, x in angles.items()}})


def _beside_each_other(found: Judgement, subject: Thing, anchor: Thing, room: Surroundings) -> Judgement:
    """Return the judgement on "near". It is `found`, the judgement by the distances, with three exceptions, which are
    undecided: one object is on or in the other; `found` is true and one of the two objects is in a container for
    storage; or `found` is false and the two form a group.
    """
    if room.holds(anchor, subject) or room.holds(subject, anchor):
        return found._replace(verdict=UNDECIDED)
    containers = words().containers
    if found.verdict == TRUE and any(room.is_put_away(thing, containers) for thing in (subject, anchor)):
        return found._replace(verdict=UNDECIDED)
    if found.verdict == FALSE and room.forms_a_group(subject, anchor, words().roles):
        return found._replace(verdict=UNDECIDED)
    return found


def _used(one: Thing, other: Thing) -> float:
    """Return the distance in millimetres between the boxes of two objects; if a box is unknown, between their bounding
    spheres, or else between their centres.
    """
    if one.box is not None and other.box is not None:
        gaps = [max(one.box[0][k] - other.box[1][k], other.box[0][k] - one.box[1][k], 0) for k in range(3)]
        return math.sqrt(sum(gap * gap for gap in gaps))
    centres = math.dist(one.centre, other.centre)
    if one.item.radius is not None and other.item.radius is not None:
        return max(centres - 1000.0 * (one.item.radius + other.item.radius), 0.0)
    return centres


def _along_ground(one: Thing, other: Thing) -> float | None:
    """Return a lower bound in millimetres of the horizontal distance between two objects; None if only their centres
    are known.
    """
    if one.box is not None and other.box is not None:
        return footprint_gap(one, other)
    if one.item.radius is None or other.item.radius is None:
        return None
    centres = math.hypot(one.centre[0] - other.centre[0], one.centre[2] - other.centre[2])
    return max(centres - 1000.0 * (one.item.radius + other.item.radius), 0.0)


def _degrees_off(way: tuple[int, int], towards: tuple[int, int]) -> float:
    """Return the angle in degrees between two directions, (east, north) each."""
    cross = way[0] * towards[1] - way[1] * towards[0]
    return math.degrees(math.atan2(abs(cross), way[0] * towards[0] + way[1] * towards[1]))


def _from_edge(one: Thing, other: Thing) -> tuple[int, int]:
    """Return the way (east, north) in millimetres to the centre of `one` from the nearest point of the footprint of
    `other`, or from its centre if it has no box.
    """
    east, north = one.centre[0] - other.centre[0], other.centre[2] - one.centre[2]
    if other.box is None:
        return east, north
    (west_side, _, north_side), (east_side, _, south_side) = other.box
    x, z = one.centre[0], one.centre[2]
    east = x - east_side if x > east_side else x - west_side if x < west_side else 0
    north = north_side - z if z < north_side else south_side - z if z > south_side else 0
    return east, north


def _to_edge(one: Thing, other: Thing) -> tuple[int, int]:
    """Return the way (east, north) in millimetres to the nearest point of the footprint of `one` from the centre of
    `other`.
    """
    east, north = _from_edge(other, one)
    return -east, -north


def _is_over(one: Thing, other: Thing) -> bool:
    """Return whether the centre of `one` is inside the footprint of `other`."""
    if other.box is None:
        return False
    return all(other.box[0][k] <= one.centre[k] <= other.box[1][k] for k in (0, 2))
