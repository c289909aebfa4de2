"""Facts that compare objects: closest to an anchor, bigger or smaller of two, between two anchors."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from condvln.relations.metrics import millimetres
from condvln.relations.stacking import Stacking, exact_mm
from condvln.scene import RoomArrays, SceneObject
from schemas.config import Thresholds

__all__ = ["between_facts", "closest_facts", "size_facts"]

F64 = NDArray[np.float64]
Mask = NDArray[np.bool_]
Status = NDArray[np.int8]


def closest_facts(distance: F64, labels: Sequence[str], rival: Mask, held: Mask, t: Thresholds) -> tuple[Status, F64]:
    """Return the status and the margin of the statements "object i is the closest to object j", (n, n) each. Object i
    is compared with all other objects that the label of object i might mean.

    distance (n, n) : of the boxes, or of their nearest pieces, in millimetres; NaN where one is unknown
    rival (n, n) : j could be meant by i's label; an object without a rival of its own label gets status 0
    held (n, n) : one is on or in the other, which people say instead
    """
    n = len(rival)
    nearest, all_known = np.full((n, n), np.nan), np.zeros((n, n), dtype=np.bool_)
    for i in np.flatnonzero(rival.any(axis=1)):
        others = distance[rival[i]]
        nearest[i] = np.fmin.reduce(others, axis=0)
        all_known[i] = ~np.isnan(others).any(axis=0)
    gap = exact_mm(t.closest_gap)
    own = distance
    true = all_known & ~held & (nearest >= t.closest_ratio * own) & (nearest >= own + gap)
    false = (own >= t.closest_ratio * nearest) & (own >= nearest + gap)
    status = true.astype(np.int8) - false.astype(np.int8)
    named = np.array(labels, dtype=object)
    status[~(rival & (named[:, None] == named[None, :])).any(axis=1)] = 0
    status[rival] = 0
    np.fill_diagonal(status, 0)
    margin: F64 = np.abs(nearest - own) / gap
    return status, margin


def size_facts(arrays: RoomArrays, rival: Mask, t: Thresholds) -> dict[str, Status]:
    """Return the status (n,) of "the bigger" and "the smaller" for each object. Both compare the only two objects of
    one label, so the status is 0 if the room has a third object that the label might mean.

    The volumes of their boxes decide; an object of several boxes is not compared. The status is 0 if the areas of their
    largest sides give the opposite order, as for pictures of different depth, or if the object of smaller volume is
    clearly the taller, the longer or the wider of the two.
    """
    labels = np.array(arrays.labels, dtype=object)
    measured = [_size(item) for item in arrays.objects]
    bigger = np.zeros(len(arrays), dtype=np.int8)
    for i in np.flatnonzero(rival.sum(axis=1) == 1):
        j = int(np.flatnonzero(rival[i])[0])
        one, other = measured[i], measured[j]
        if rival[j].sum() != 1 or labels[i] != labels[j] or one is None or other is None or one.kind != other.kind:
            continue
        if min(one.volume, other.volume) > 0.0:
            bigger[i] = int(_exceeds(one, other, t)) - int(_exceeds(other, one, t))
    return {"bigger": bigger, "smaller": -bigger}


class _Size(NamedTuple):
    """The kind of an object's box, its volume in mm³, the area of its largest side in mm², and its height and its
    shorter and longer horizontal side in mm.
    """

    kind: str
    volume: float
    face: float
    sides: tuple[float, float, float]


def _exceeds(one: _Size, other: _Size, t: Thresholds) -> bool:
    """Return whether people call the object of size `one` the bigger."""
    whole = one.volume >= t.size_ratio * other.volume and one.face > other.face
    return whole and all(b <= t.size_side * a for a, b in zip(one.sides, other.sides, strict=True))


def _size(item: SceneObject) -> _Size | None:
    """Return the size of an object; None if it has no box, or several."""
    if item.parts:
        return None
    upright = 1
    if item.obb is not None:
        kind, extents = "oriented", millimetres(2.0 * item.obb.half_extents).tolist()
        upright = int(np.argmax(np.abs(item.obb.rotation[1])))
    elif item.box is not None:
        kind, extents = "aligned", (millimetres(item.box[1]) - millimetres(item.box[0])).tolist()
    else:
        return None
    small, middle, large = sorted(extents)
    short, long = sorted(extents[:upright] + extents[upright + 1 :])
    return _Size(kind, small * middle * large, middle * large, (extents[upright], short, long))


def between_facts(
    arrays: RoomArrays, s: Stacking, compound: Mask, pairs: NDArray[np.intp], t: Thresholds
) -> tuple[Status, F64]:
    """Return the status and the margin of the statements "object i is between a and b", (n, p) each, for p `pairs` of
    anchors a and b.

    pairs (p, 2) : indices of the anchors
    compound (n,) : objects of several boxes; their centres say little, so their status is 0
    """
    ground = millimetres(arrays.centers[:, [0, 2]])
    a, b = pairs[:, 0], pairs[:, 1]
    along = ground[b] - ground[a]  # (p, 2)
    squared = along[:, 0] * along[:, 0] + along[:, 1] * along[:, 1]
    away = ground[:, None] - ground[a][None]  # (n, p, 2)
    with np.errstate(divide="ignore", invalid="ignore"):
        part = (away[..., 0] * along[:, 0] + away[..., 1] * along[:, 1]) / squared
        off = np.abs(away[..., 0] * along[:, 1] - away[..., 1] * along[:, 0]) / np.sqrt(squared)
    long = (s.length >= exact_mm(t.between_anchor)) & ~compound
    fit = long[a] & long[b] & (squared > 0.0) & (squared <= exact_mm(t.between_length) ** 2)
    clear = (s.shared[:, a] == 0.0) & (s.shared[:, b] == 0.0)
    floor = s.off_floor <= exact_mm(t.on_floor)
    inner = np.minimum(part, 1.0 - part)
    true = fit & clear & floor[:, None] & (part >= t.between_true) & (part <= 1.0 - t.between_true)
    true &= off <= exact_mm(t.between_off_true)
    false = fit & ((part < t.between_false) | (part > 1.0 - t.between_false) | (off >= exact_mm(t.between_off_false)))
    false &= ~_amid(arrays, ground, pairs)
    status = true.astype(np.int8) - false.astype(np.int8)
    status[compound] = 0
    status[a, np.arange(len(pairs))] = 0
    status[b, np.arange(len(pairs))] = 0
    margin: F64 = np.where(true, inner / t.between_true, 1.0 + off / 1000.0)
    return status, margin


def _amid(arrays: RoomArrays, ground: F64, pairs: NDArray[np.intp]) -> Mask:
    """Return (n, p) whether the centre of each object, `ground` (n, 2) in millimetres, is in the gap between the boxes
    of two anchors that face each other, in the part that both flank. Far from the line of the centres of two long
    counters, a thing in the aisle is between them all the same.
    """
    low, high = (millimetres(corner[:, [0, 2]])[pairs] for corner in (arrays.aabb_min, arrays.aabb_max))
    first, last = low.max(axis=1), high.min(axis=1)  # (p, 2): what the anchors share; where they don't, last < first
    at = ground[:, None]
    flanked, gap = (first <= at) & (at <= last), (last <= at) & (at <= first)
    found: Mask = (gap[..., 0] & flanked[..., 1]) | (flanked[..., 0] & gap[..., 1])
    return found
