"""Decide whether one object is near, on, above, between or east of others: true with margin, false with margin, or
undecided.

Pairs are decided on whole millimetres, in which sums and squares are exact. Only the few objects that the words of a
statement can mean are tested. For an object of several pieces, each piece is tested separately.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final

from condvln.verify.surfaces import SurfaceGauge
from condvln.verify.surroundings import (
    FALSE,
    TRUE,
    UNDECIDED,
    Judgement,
    Surroundings,
    Thing,
    box_gap,
    footprint_gap,
    judged,
    shared_sides,
    whole_mm,
)
from condvln.verify.words import words
from schemas.config import Thresholds
from schemas.config.constants import OPEN_SHARE

__all__ = [
    "DIRECTIONS",
    "FALSE",
    "TRUE",
    "UNDECIDED",
    "Judge",
    "Judgement",
    "Thing",
    "is_in",
]

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
        return self._beside(predicate, subject, anchor, asked)

    def _near(self, one: Thing, other: Thing) -> Judgement:
        used, along_ground = _used(one, other), _along_ground(one, other)
        surface, enough = None, whole_mm(self._t.near_true)
        if one.box is not None and other.box is not None:
            air = max(one.box[0][1] - other.box[1][1], other.box[0][1] - one.box[1][1])
            if used <= enough and air <= whole_mm(self._t.near_over):
                surface = self._gauge.at_most(one.item, other.item, enough)
        true = surface is not None and surface <= enough
        false = along_ground is not None and along_ground >= whole_mm(self._t.near_false)
        return judged(true, false, distance=used, surface_at_most=surface, footprints_apart=along_ground)

    def _far(self, one: Thing, other: Thing, asked: bool) -> Judgement:
        used, close = _used(one, other), self._t.far_false if asked else self._t.near_true
        return judged(used >= whole_mm(self._t.far_true), used <= whole_mm(close), distance=used)

    def _beside(self, predicate: str, one: Thing, other: Thing, asked: bool) -> Judgement:
        elsewhere = self._t.sector_denied if asked else self._t.sector_false
        east, north = one.centre[0] - other.centre[0], other.centre[2] - one.centre[2]
        towards = DIRECTIONS[predicate]
        apart = math.hypot(east, north)
        if not apart or _is_over(one, other) or _is_over(other, one):
            return Judgement(UNDECIDED, {"horizontal": apart / 1000.0})
        off = _degrees_off((east, north), towards)
        from_edges = [_degrees_off(way, towards) for way in (_from_edge(one, other), _to_edge(one, other))]
        elevation = math.degrees(math.atan2(abs(one.centre[1] - other.centre[1]), apart))
        close = apart <= whole_mm(self._t.sector_within)
        clear = elevation < self._t.level and close and apart >= whole_mm(self._t.sector_horizontal_true)
        true = off <= self._t.sector_true and max(from_edges) <= self._t.sector_edge and clear
        false = min(off, *from_edges) > elsewhere and (close or not asked)
        judgement = judged(true, false, horizontal=apart)
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
        return box_gap(one, other)
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


_UNKNOWN = Judgement(UNDECIDED, {"box": None})


def is_on(subject: Thing, anchor: Thing, room: Surroundings, t: Thresholds) -> Judgement:
    """Return the judgement on "on": the subject's bottom is at the anchor's top, and the anchor's footprint is the
    larger one and covers most of the subject's footprint.
    """
    if subject.box is None or anchor.box is None:
        return _UNKNOWN
    step = subject.box[0][1] - anchor.box[1][1]
    apart, covered = footprint_gap(subject, anchor), _covered(subject, anchor)
    true = (
        abs(step) <= whole_mm(t.on_gap_true)
        and covered is not None
        and covered >= t.on_footprint_true
        and math.prod(anchor.ground_sides()) > math.prod(subject.ground_sides())
        and subject.centre[1] > anchor.centre[1]
    )
    false = apart > 0.0 or step >= whole_mm(t.on_gap_false)
    return judged(true, false, {"covered": covered}, step=step, footprints_apart=apart)


def as_said_on(found: Judgement, subject: Thing, anchor: Thing, room: Surroundings) -> Judgement:
    """Return the judgement on "on". It is `found`, the judgement by the boxes, with two exceptions. If the source
    states that the subject is on the anchor, the verdict is true, but undecided if `found` is false. If `found` is
    undecided and the source states another place, the verdict is false.
    """
    if room.is_said_on(subject, anchor):
        return found._replace(verdict=UNDECIDED if found.verdict == FALSE else TRUE)
    if found.verdict == UNDECIDED and room.is_said_elsewhere(subject, anchor):
        return found._replace(verdict=FALSE)
    return found


def as_said_in(found: Judgement, subject: Thing, anchor: Thing, room: Surroundings) -> Judgement:
    """Return the judgement on "in". It is `found`, the judgement by the boxes, unless the source states that the
    subject is in the anchor, and the anchor can be looked into. In this case the verdict is true, but undecided if
    `found` is false.
    """
    if room.is_said_in(subject, anchor) and _can_be_looked_into(anchor):
        return found._replace(verdict=UNDECIDED if found.verdict == FALSE else TRUE)
    return found


def is_under(subject: Thing, anchor: Thing, room: Surroundings, t: Thresholds) -> Judgement:
    """Return the judgement on "under": the subject is on the floor below the anchor's underside."""
    if subject.box is None or anchor.box is None:
        return _UNKNOWN
    lift, air, covered = room.off_floor(subject), anchor.box[0][1] - subject.box[1][1], _covered(subject, anchor)
    apart = footprint_gap(subject, anchor)
    true = (
        lift is not None
        and lift <= whole_mm(t.on_floor)
        and air >= 0
        and covered is not None
        and covered >= t.under_footprint_true
    )
    false = apart >= whole_mm(t.over_apart_false)
    return judged(true, false, {"covered": covered}, off_floor=lift, air=air, footprints_apart=apart)


def is_in(subject: Thing, anchor: Thing, room: Surroundings, t: Thresholds) -> Judgement:
    """Return the judgement on "in": most of the subject's volume is inside the anchor, which can be looked into."""
    if subject.box is None or anchor.box is None or not _can_be_looked_into(anchor):
        return _UNKNOWN
    volume = subject.volume()
    inside = math.prod(shared_sides(subject, anchor)) / volume if volume > 0 else None
    apart = box_gap(subject, anchor)
    true = inside is not None and inside >= t.in_share_true
    return judged(true, apart > 0.0, {"inside": inside}, apart=apart)


def is_above(subject: Thing, anchor: Thing, room: Surroundings, t: Thresholds) -> Judgement:
    """Return the judgement on "above": the subject is over the anchor, with a vertical gap."""
    if subject.box is None or anchor.box is None:
        return _UNKNOWN
    up, air = subject.centre[1] - anchor.centre[1], subject.box[0][1] - anchor.box[1][1]
    away = math.hypot(subject.centre[0] - anchor.centre[0], subject.centre[2] - anchor.centre[2])
    apart, rests = footprint_gap(subject, anchor), room.may_carry(anchor, subject)
    areas = [math.prod(thing.ground_sides()) for thing in (subject, anchor)]
    x, _, z = shared_sides(subject, anchor)
    shared = x * z / min(areas) if min(areas) > 0 else None
    true = (
        up >= whole_mm(t.height_true)
        and away <= whole_mm(t.over_horizontal_true)
        and shared is not None
        and shared >= t.over_footprint_true
        and air >= whole_mm(t.over_gap_true)
        and not rests
    )
    false = (up <= whole_mm(t.height_false) or apart >= whole_mm(t.over_apart_false)) and not rests
    return judged(
        true, false, {"footprint_overlap": shared}, height=up, horizontal=away, air=air, footprints_apart=apart
    )


def is_higher(subject: Thing, anchor: Thing, room: Surroundings, t: Thresholds) -> Judgement:
    """Return the judgement on "higher": centre and top are higher, both objects are well above the floor, and neither
    supports the other. It is false only if centre and top are lower.
    """
    lifts = [room.off_floor(thing) for thing in (subject, anchor)]
    if subject.box is None or anchor.box is None or None in lifts:
        return _UNKNOWN
    up, tops = subject.centre[1] - anchor.centre[1], subject.box[1][1] - anchor.box[1][1]
    fit = min(lift for lift in lifts if lift is not None) >= whole_mm(t.off_floor)
    fit = fit and not (room.may_carry(anchor, subject) or room.may_carry(subject, anchor))
    true = fit and up >= whole_mm(t.height_true) and tops >= whole_mm(t.top_true)
    false = fit and max(up, tops) <= -whole_mm(t.other_way)
    return judged(true, false, height=up, tops=tops)


def _can_be_looked_into(holder: Thing) -> bool:
    kind, openness = words().containers.get(holder.label), holder.item.openness
    return kind == "open" or (kind == "shut" and openness is not None and openness >= OPEN_SHARE)


def _covered(subject: Thing, anchor: Thing) -> float | None:
    """Return the share of the subject's footprint that the anchor's footprint covers; None if the subject's footprint
    has no area.
    """
    area = math.prod(subject.ground_sides())
    x, _, z = shared_sides(subject, anchor)
    return x * z / area if area > 0 else None


def is_closest(subject: Thing, anchor: Thing, rivals: Sequence[Thing], t: Thresholds) -> Judgement:
    """Return whether the subject is closest to the anchor: true if all rivals are much farther from the anchor, false
    if some rival is much nearer. The verdict is undecided if no rival has the subject's label.
    """
    if subject.box is None or anchor.box is None or anchor in rivals or all(x.label != subject.label for x in rivals):
        return Judgement(UNDECIDED, {"box": None})
    own, gap = _nearest(subject, anchor), whole_mm(t.closest_gap)
    others = [None if rival.box is None else _nearest(rival, anchor) for rival in rivals]
    known = [away for away in others if away is not None]
    if not known:
        return Judgement(UNDECIDED, {"rivals": 0.0})
    nearest = min(known)
    true = len(known) == len(others) and nearest >= t.closest_ratio * own and nearest >= own + gap
    false = own >= t.closest_ratio * nearest and own >= nearest + gap
    return judged(true, false, distance=own, nearest_rival=nearest)


def compare_sizes(subject: Thing, rivals: Sequence[Thing], t: Thresholds, sign: int) -> Judgement:
    """Return whether the subject is the bigger (`sign` 1) or the smaller (−1) of two objects with the same label. The
    verdict is undecided unless `rivals` is exactly one object with this label.
    """
    if len(rivals) != 1 or rivals[0].label != subject.label:
        return Judgement(UNDECIDED, {"rivals": float(len(rivals))})
    one, other = subject.sides(), rivals[0].sides()
    if (
        subject.pieces
        or rivals[0].pieces
        or not one
        or not other
        or (subject.item.obb is None) != (rivals[0].item.obb is None)
    ):
        return Judgement(UNDECIDED, {"box": None})
    volumes, faces = [a * b * c for a, b, c in (one, other)], [b * c for _, b, c in (one, other)]
    if min(volumes) <= 0.0:
        return Judgement(UNDECIDED, {"box": None})
    mine, its = _upright(subject), _upright(rivals[0])
    # How many times as tall, as deep and as wide the subject is.
    ratios = [a / b for a, b in zip(mine, its, strict=True)]
    no_less = not any(b > t.size_side * a for a, b in zip(mine, its, strict=True))
    no_more = not any(a > t.size_side * b for a, b in zip(mine, its, strict=True))
    bigger = volumes[0] >= t.size_ratio * volumes[1] and faces[0] > faces[1] and no_less
    smaller = volumes[1] >= t.size_ratio * volumes[0] and faces[1] > faces[0] and no_more
    true, false = (bigger, smaller) if sign > 0 else (smaller, bigger)
    return judged(
        true, false, {"volume_ratio": volumes[0] / volumes[1], "least_side": min(ratios), "greatest_side": max(ratios)}
    )


def _upright(thing: Thing) -> tuple[float, float, float]:
    """Return the height and the shorter and longer horizontal side of an object's oriented box in millimetres, else of
    its axis-aligned one; the object must have a box.
    """
    turned = thing.item.obb
    if turned is None:
        assert thing.box is not None
        height = float(thing.box[1][1] - thing.box[0][1])
        short, long = sorted(float(side) for side in thing.ground_sides())
        return height, short, long
    ways = [(-abs(float(turned.rotation[1][k])), k) for k in range(3)]
    up = min(ways)[1]
    sides = [float(round(2.0 * float(half) * 1000.0)) for half in turned.half_extents]
    height = sides.pop(up)
    short, long = sorted(sides)
    return height, short, long


def lies_between(subject: Thing, anchors: Sequence[Thing], room: Surroundings, t: Thresholds) -> Judgement:
    """Return whether the subject is between the two anchors: true if it is on the floor, near the line of the anchors'
    centres, about half way along this line; false if it is far from there, unless both anchors face it.
    """
    a, b = anchors
    if a.box is None or b.box is None or subject in anchors or any(x.pieces for x in (subject, a, b)):
        return Judgement(UNDECIDED, {"box": None})
    line = (b.centre[0] - a.centre[0], b.centre[2] - a.centre[2])
    away = (subject.centre[0] - a.centre[0], subject.centre[2] - a.centre[2])
    squared = line[0] * line[0] + line[1] * line[1]
    long = min(max(a.ground_sides()), max(b.ground_sides())) >= whole_mm(t.between_anchor)
    if not squared or squared > whole_mm(t.between_length) ** 2 or not long:
        return judged(False, False, anchors_apart=math.sqrt(squared))
    part = (away[0] * line[0] + away[1] * line[1]) / squared
    off = abs(away[0] * line[1] - away[1] * line[0]) / math.sqrt(squared)
    lift = room.off_floor(subject)
    true = (
        lift is not None
        and lift <= whole_mm(t.on_floor)
        and not any(x * z for x, _, z in (shared_sides(subject, a), shared_sides(subject, b)))
        and t.between_true <= part <= 1.0 - t.between_true
        and off <= whole_mm(t.between_off_true)
    )
    false = part < t.between_false or part > 1.0 - t.between_false or off >= whole_mm(t.between_off_false)
    false = false and not _faced_by_both(subject, a, b)
    return judged(true, false, {"part": round(part, 3)}, off_line=off, anchors_apart=math.sqrt(squared))


def _faced_by_both(subject: Thing, a: Thing, b: Thing) -> bool:
    """Return whether the straight way through the subject's centre, along one ground axis, leads from the one anchor's
    box to the other's; both must have a box.
    """
    assert a.box is not None
    assert b.box is not None
    for way, across in ((0, 2), (2, 0)):
        at, aside = subject.centre[way], subject.centre[across]
        if not all(box[0][across] <= aside <= box[1][across] for box in (a.box, b.box)):
            continue
        if any(one[1][way] <= at <= other[0][way] for one, other in ((a.box, b.box), (b.box, a.box))):
            return True
    return False


def _nearest(one: Thing, other: Thing) -> float:
    """Return the millimetres between the nearest pieces of two objects."""
    return min(box_gap(a, b) for a in one.solids() for b in other.solids())
