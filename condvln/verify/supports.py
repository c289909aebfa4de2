"""Decide whether an object is on, in, under, above or higher than another one. The decision uses boxes, which object
may support which, and the source's statements. For an object of several pieces, each piece is tested separately.
"""

from __future__ import annotations

import math

from condvln.verify.judgement import FALSE, TRUE, UNDECIDED, Judgement, judged
from condvln.verify.surroundings import Surroundings, Thing, box_gap, footprint_gap, shared_sides, whole_mm
from condvln.verify.words import words
from schemas.config import Thresholds
from schemas.config.constants import OPEN_SHARE

__all__ = ["as_said_in", "as_said_on", "is_above", "is_higher", "is_in", "is_on", "is_under"]

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
    volume = math.prod(high - low for low, high in zip(*subject.box, strict=True))
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
