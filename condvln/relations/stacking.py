"""Which objects of a room are above, on and beside each other, computed on boxes, and in or on which others the source
puts them; an L-shaped counter counts as its pieces.

All lengths are whole millimetres, in which sums, products and square roots are the same wherever they are computed.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from condvln.arrays import F64, Bools
from condvln.labels import vocabulary
from condvln.relations.metrics import millimetres
from condvln.relations.pieces import Pieces
from condvln.scene import RoomArrays
from condvln.scene.containment import stated_holders
from schemas.config import Thresholds
from schemas.config.constants import OPEN_SHARE

__all__ = ["Holding", "Stacking", "closure", "exact_mm", "held_by", "holding_of", "stacking_of"]


@dataclass(frozen=True, eq=False, slots=True)
class Holding:
    """Statements of a source about the objects of one room, as arrays: contained object by row, holder by column.

    on, inside : (n, n) the source says that the row rests on the column, or is contained in it
    named : (n, n) the source names the column as the row's receptacle, however the statement is interpreted
    denied : (n, n) the source names the row's receptacles, and none of them is the column or in or on it
    container : (n,) objects that others are put into
    open : (n,) containers that one can look into
    """

    on: Bools
    inside: Bools
    named: Bools
    denied: Bools
    container: Bools
    open: Bools


def holding_of(arrays: RoomArrays) -> Holding:
    """Return what the sources state about which of a room's n objects are in or on which others."""
    n, index = len(arrays), {name: k for k, name in enumerate(arrays.object_ids)}
    on, inside, named = (np.zeros((n, n), dtype=np.bool_) for _ in range(3))
    receptacles = {item.object_id: item.receptacles or () for item in arrays.objects}
    upon, within = stated_holders(arrays.objects)
    for mask, holders in ((on, upon), (inside, within), (named, receptacles)):
        for name, found in holders.items():
            mask[index[name], [index[holder] for holder in found if holder in index]] = True
    np.fill_diagonal(named, False)
    placed = np.asarray(on.any(axis=1) | inside.any(axis=1), dtype=np.bool_)
    kinds = [vocabulary.container(label) for label in arrays.labels]
    said_open = [item.openness is not None and item.openness >= OPEN_SHARE for item in arrays.objects]
    opened = [kind == "open" or (kind == "shut" and said) for kind, said in zip(kinds, said_open, strict=True)]
    denied = placed[:, None] & ~closure(named) & ~np.eye(n, dtype=np.bool_)
    containers = np.array([kind is not None for kind in kinds], dtype=np.bool_)
    return Holding(on, inside, named, denied, containers, np.array(opened, dtype=np.bool_))


def closure(direct: Bools) -> Bools:
    """Return a mask (n, n): whether a chain of one or more links of the mask `direct` (n, n) leads from i to j."""
    found = direct.copy()
    for k in np.flatnonzero(direct.any(axis=0) & direct.any(axis=1)).tolist():  # the links through k (Warshall, 1962)
        found[found[:, k]] |= found[k]
    return found


_GROUND: Final = [0, 2]


def exact_mm(metres: float) -> float:
    """Return a threshold in metres as millimetres, rounded to a nanometre. The rounding is needed since 1.15 · 1000 is
    not an integer in binary.
    """
    return round(metres * 1000.0, 6)


@dataclass(frozen=True, eq=False, slots=True)
class Stacking:
    """Quantities that decide whether one object is on, under or above another, for each ordered pair of boxes. Rows are
    subjects, columns are targets; NaN or False where a box is unknown.

    rise, top_rise : (n, n) height of the subject's centre, and of its top, above the target's
    gap : (n, n) height of the subject's bottom above the target's top
    apart : (n, n) horizontal distance of the footprints, 0 where they overlap
    bottom_rise : (n, n) height of the subject's bottom above the target's bottom
    over : (n, n) the subject's centre is within the target's footprint, or the other way round
    distance : (n, n) distance of the boxes
    shared : (n, n) ground area that both footprints cover, mm²
    covered : (n, n) shared area divided by the subject's footprint area
    inside : (n, n) share of the subject's volume inside the target's box
    area : (n,) of the footprint; length : (n,) its longer side; off_floor : (n,) bottom above the room's floor
    known : (n, n) both have a box
    carries : (n, n) the target's object may support the subject's, directly or through others, judging by boxes and
        source
    """

    rise: F64
    top_rise: F64
    gap: F64
    bottom_rise: F64
    apart: F64
    over: Bools
    distance: F64
    shared: F64
    covered: F64
    inside: F64
    area: F64
    length: F64
    off_floor: F64
    known: Bools
    carries: Bools


def stacking_of(pieces: Pieces, holding: Holding, thresholds: Thresholds) -> Stacking:
    """Return how the n pieces of a room are stacked."""
    arrays = pieces.arrays
    low, high, centre = millimetres(arrays.aabb_min), millimetres(arrays.aabb_max), millimetres(arrays.centers)
    gaps = [np.maximum(low[:, None, k] - high[None, :, k], low[None, :, k] - high[:, None, k]) for k in range(3)]
    lengths = [
        np.maximum(np.minimum(high[:, None, k], high[None, :, k]) - np.maximum(low[:, None, k], low[None, :, k]), 0.0)
        for k in range(3)
    ]
    beyond = [np.maximum(gap, 0.0) for gap in gaps]
    size = high - low
    area = size[:, 0] * size[:, 2]
    shared = lengths[0] * lengths[2]
    apart = np.sqrt(beyond[0] * beyond[0] + beyond[2] * beyond[2])
    gap = low[:, None, 1] - high[None, :, 1]
    bottom_rise = low[:, None, 1] - low[None, :, 1]
    own = area[:, None]
    within = np.logical_and.reduce(
        [(centre[:, None, k] >= low[None, :, k]) & (centre[:, None, k] <= high[None, :, k]) for k in _GROUND]
    )
    known = ~np.isnan(gap)
    may_rest = (
        (apart == 0.0) & (bottom_rise > exact_mm(thresholds.on_gap_true)) & (gap < exact_mm(thresholds.on_gap_false))
    )
    rests = pieces.any(may_rest) | holding.named
    np.fill_diagonal(rests, False)
    return Stacking(
        rise=centre[:, None, 1] - centre[None, :, 1],
        top_rise=high[:, None, 1] - high[None, :, 1],
        gap=gap,
        bottom_rise=bottom_rise,
        apart=apart,
        over=within | within.T,
        distance=np.sqrt(sum(gap * gap for gap in beyond)),
        shared=shared,
        covered=_parts(shared, np.broadcast_to(own, shared.shape)),
        inside=_parts(shared * lengths[1], np.broadcast_to(own * size[:, None, 1], shared.shape)),
        area=area,
        length=size[:, _GROUND].max(axis=1, initial=-np.inf),
        off_floor=low[:, 1] - millimetres(arrays.floor_y),
        known=known,
        carries=pieces.spread(closure(rests)),
    )


def held_by(pieces: Pieces, holding: Holding, s: Stacking, thresholds: Thresholds) -> tuple[Bools, Bools]:
    """Return two masks (n, n) of pairs of objects: whether the target supports or contains the subject, directly or
    through other objects, and whether the target surrounds most of the subject.

    The masks are stricter than `Stacking.carries`, for which it is enough that footprints touch: objects that touch
    side by side are "near".
    """
    t = thresholds
    ends = (s.bottom_rise > exact_mm(t.on_gap_true)) | (s.gap >= -exact_mm(t.on_gap_true))
    carried = ends & (s.gap < exact_mm(t.on_gap_false)) & (s.covered >= t.held_footprint)
    around = pieces.any(s.inside > t.held_inside) | holding.inside
    direct = pieces.any(carried) | holding.named | around
    for mask in (direct, around):
        np.fill_diagonal(mask, False)
    held = closure(direct)
    np.fill_diagonal(held, False)
    return held, around


def _parts(some: F64, whole: F64) -> F64:
    """Return some / whole; NaN where `whole` is 0."""
    return np.divide(some, whole, out=np.full_like(some, np.nan), where=whole > 0)
