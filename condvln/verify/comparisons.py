"""Decide whether an object is the closest of several, the bigger of two, or between two others."""

from __future__ import annotations

import math
from collections.abc import Sequence

from condvln.verify.judgement import UNDECIDED, Judgement, judged
from condvln.verify.surroundings import Surroundings, Thing, box_gap, shared_sides, whole_mm
from schemas.config import Thresholds

__all__ = ["compare_sizes", "is_closest", "lies_between"]


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
