"""When a relation holds between two things: as an edge of the graph, as true in text, and as false in text.

The product decides distances and thresholds of pairs of things here; the verifier has its own. ``text`` then takes back
what a person would not say: of things that hold each other (``stacking``, by bounds of its own), of what lies in a
container, of things that stand together as a group. Between the bounds for true and for false is a dead zone,
in which text says neither. Margins are the distance from the threshold of the graph's edge, as a
multiple of the distance at which text may use the relation. The facts that compare objects follow: closest to an
anchor, bigger or smaller of two, between two anchors.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import reduce
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from condvln.arrays import F64, Bools
from condvln.relations.directions import COMPASS, sector_deviation
from condvln.relations.metrics import AABB, SPHERE, PairMetrics, millimetres
from condvln.relations.stacking import Stacking, exact_mm
from condvln.scene import RoomArrays, SceneObject
from schemas.config import SECTOR_HALF_WIDTH, Thresholds

__all__ = [
    "DENIED_BY_ALL",
    "OF_SOME_PIECE",
    "PAIR_PREDICATES",
    "SEMANTIC",
    "TURNED",
    "UNITS",
    "Bound",
    "Bounds",
    "Fact",
    "between_facts",
    "bounds_of",
    "closest_facts",
    "denies",
    "deviations",
    "edges",
    "fact",
    "fact_of",
    "halfway",
    "quantities",
    "size_facts",
]

Quantities = Mapping[str, F64]

SEMANTIC: Final = ("near", "far from", "higher than", "lower than", "above", "below")
"""Predicates with an edge of their own if their thresholds hold, besides the one canonical edge of a pair."""

PAIR_PREDICATES: Final = (
    "on",
    "under",
    "in",
    "near",
    "above",
    "below",
    *COMPASS,
    "higher than",
    "lower than",
    "far from",
)
"""Predicates of an object and one anchor that text may use."""

TURNED: Final = {"lower than": "higher than", "below": "above"}
"""Predicates that are others with the things exchanged."""

OF_SOME_PIECE: Final = frozenset(("on", "under", "in", "near", "above", "below"))
"""Predicates that are true of an object of several pieces if they are true of one pair of pieces, and false if they are
false of all pairs. The others are true if they are true of all pairs.
"""

DENIED_BY_ALL: Final = frozenset(("higher than", "lower than", *COMPASS))
"""Predicates that are false only if all their bounds for false hold; for the others one is enough."""

UNITS: Final = {
    **dict.fromkeys(("distance", "surface distance", "ground distance", "horizontal"), "m"),
    **dict.fromkeys(("air", "gap", "apart", "box distance", "rise", "top rise", "off floor", "room below"), "mm"),
    **dict.fromkeys(("covered", "inside", "overlap"), "share"),
    **dict.fromkeys(("elevation", "off centre", "off anchor's edge", "off own edge"), "°"),
}
"""The units of all quantities. Lengths from `Stacking` are whole millimetres."""

OFF: Final = ("off centre", "off anchor's edge", "off own edge")
"""Angles off a compass direction, see `deviations`."""

Bound = tuple[str, float]
"""An operator (`≤`, `≥`, `<`, `>`, or `±` for an absolute value of at most) and a limit in the quantity's unit."""

_MEETS: Final[Mapping[str, Callable[[Any, float], Any]]] = {
    "≤": np.less_equal,
    "≥": np.greater_equal,
    "<": np.less,
    ">": np.greater,
    "±": lambda value, limit: np.abs(value) <= limit,
}


class Bounds(NamedTuple):
    """What one quantity must be for a relation to be true or false in text; None if that side does not look at it."""

    quantity: str
    true: Bound | None = None
    false: Bound | None = None


class Fact(NamedTuple):
    """What text may state about all ordered pairs, (n, n) each: the status, 1 for true, −1 for false, 0 for neither;
    and the margin, which is at least 1 where the status is not 0.
    """

    status: NDArray[np.int8]
    margin: F64


def bounds_of(predicate: str, t: Thresholds, *, denied: bool = False) -> tuple[Bounds, ...]:
    """Return the bounds of a predicate of `PAIR_PREDICATES`. It is true if all bounds for true hold, and false if one
    of those for false holds, or all, see `DENIED_BY_ALL`. A predicate of `TURNED` has the bounds of the other one, with
    the things exchanged.

    denied : the bounds at which a condition may deny a compass direction; telling rivals apart takes less

    Raises
    ------
    KeyError : it is none of `PAIR_PREDICATES`, or has no bounds yet
    """
    mm = exact_mm
    if predicate == "near":
        return (
            Bounds("distance", true=("≤", t.near_true)),
            Bounds("surface distance", true=("≤", t.near_true)),
            Bounds("air", true=("≤", mm(t.near_over))),
            Bounds("ground distance", false=("≥", t.near_false)),
        )
    if predicate == "far from":
        return (Bounds("distance", true=("≥", t.far_true), false=("≤", t.far_false)),)
    if predicate == "on":
        return (
            Bounds("gap", true=("±", mm(t.on_gap_true)), false=("≥", mm(t.on_gap_false))),
            Bounds("covered", true=("≥", t.on_footprint_true)),
            Bounds("apart", false=(">", 0.0)),
        )
    if predicate == "under":
        return (
            Bounds("off floor", true=("≤", mm(t.on_floor))),
            Bounds("room below", true=("≥", 0.0)),
            Bounds("covered", true=("≥", t.under_footprint_true)),
            Bounds("apart", false=("≥", mm(t.over_apart_false))),
        )
    if predicate == "in":
        return (Bounds("inside", true=("≥", t.in_share_true)), Bounds("box distance", false=(">", 0.0)))
    if predicate in ("higher than", "lower than"):
        down = ("≤", -mm(t.other_way))
        return (
            Bounds("rise", true=("≥", mm(t.height_true)), false=down),
            Bounds("top rise", true=("≥", mm(t.top_true)), false=down),
        )
    if predicate in ("above", "below"):
        return (
            Bounds("rise", true=("≥", mm(t.height_true)), false=("≤", mm(t.height_false))),
            Bounds("horizontal", true=("≤", t.over_horizontal_true)),
            Bounds("overlap", true=("≥", t.over_footprint_true)),
            Bounds("gap", true=("≥", mm(t.over_gap_true))),
            Bounds("apart", false=("≥", mm(t.over_apart_false))),
        )
    if predicate not in COMPASS:
        raise KeyError(predicate)
    away = (">", t.sector_denied if denied else t.sector_false)
    limits = (t.sector_true, t.sector_edge, t.sector_edge)
    return (
        *(Bounds(off, true=("≤", limit), false=away) for off, limit in zip(OFF, limits, strict=True)),
        Bounds("elevation", true=("<", t.level)),
        Bounds("horizontal", true=("≥", t.sector_horizontal_true)),
        Bounds("horizontal", true=("≤", t.sector_within), false=("≤", t.sector_within) if denied else None),
    )


def halfway(predicate: str, t: Thresholds) -> float:
    """Return the limit between true and false for somebody who can't say neither and sees things in part: in metres, in
    degrees for a compass direction, and as a share for "on", "under", "in" and "between" (of the footprint, of the
    thing, of the line between the anchors; "beside the line" is the distance from that line).
    """
    limits = {
        "near": (t.near_true + t.near_false) / 2,
        "far from": t.far,
        "on": t.on_footprint_true / 2,
        "under": t.under_footprint_true / 2,
        "in": t.in_share_true * 0.75,
        "between": (t.between_true + t.between_false) / 2,
        "beside the line": (t.between_off_true + t.between_off_false) / 2,
    }
    return SECTOR_HALF_WIDTH if predicate in COMPASS else limits.get(predicate, t.height)


def edges(metrics: PairMetrics, t: Thresholds) -> dict[str, Bools]:
    """Return, for each predicate of `SEMANTIC`, whether the graph has the edge, (n, n)."""
    rise = -metrics.delta[..., 1] + 0.0
    over = metrics.horizontal <= t.over_horizontal
    higher, lower = rise >= t.height, rise <= -t.height
    near, far = metrics.used <= t.near, metrics.used >= t.far
    return dict(zip(SEMANTIC, (near, far, higher, lower, higher & over, lower & over), strict=True))


def quantities(s: Stacking, metrics: PairMetrics, radius: F64, surface: F64) -> dict[str, F64]:
    """Return the quantities of all ordered pairs, (n, n) each, but the angles of `deviations`.

    Footprints, and circles around bounding spheres, enclose their things and so bound their distance on the ground;
    centres do not.

    Parameters
    ----------
    radius (n,), surface (n, n) : metres
    """
    circles = np.maximum(metrics.horizontal - (radius[:, None] + radius[None, :]), 0.0)
    ground = np.where(metrics.used_metric == AABB, s.apart / 1000.0, np.nan)
    return {
        "distance": metrics.used,
        "surface distance": surface,
        "ground distance": np.where(metrics.used_metric == SPHERE, circles, ground),
        "horizontal": metrics.horizontal,
        "air": np.fmax(s.gap, s.gap.T),
        "gap": s.gap,
        "room below": s.gap.T,
        "apart": s.apart,
        "box distance": s.distance,
        "rise": s.rise,
        "top rise": s.top_rise,
        "off floor": np.broadcast_to(s.off_floor[:, None], s.gap.shape),
        "covered": s.covered,
        "inside": s.inside,
        "overlap": metrics.footprint_overlap,
        "elevation": np.abs(metrics.elevation),
    }


def deviations(azimuths: Sequence[F64] | F64, predicate: str) -> dict[str, F64]:
    """Return the angles off a compass direction, see `OFF`. `azimuths` are those of the centres, and of the centres
    from the nearest point of either footprint (``compass.edge_azimuths``).
    """
    return dict(zip(OFF, sector_deviation(np.asarray(azimuths), COMPASS.index(predicate)), strict=True))


def fact(true: Bools, false: Bools, when_true: F64, when_false: F64) -> Fact:
    """Return the status and margin of a predicate. `true` and `false` are masks of the pairs for which text may use the
    predicate as true or as false; `when_true` and `when_false` are the margins of these two cases.
    """
    status = true.view(np.int8) - false.view(np.int8)
    np.fill_diagonal(status, 0)
    # Where a fact is usable on one side, the other side's margin is far below 1.
    return Fact(status, np.fmax(when_true, when_false))


def fact_of(predicate: str, q: Quantities, s: Stacking, t: Thresholds, container: Bools) -> Fact:
    """Return what text may state of a predicate, judged by boxes and surfaces; not of "lower than" and "below".

    Parameters
    ----------
    q : what `quantities` returns, and for a compass direction what `deviations` returns
    container (n,) : the thing is an open container
    """
    bounds = bounds_of(predicate, t)
    true = reduce(np.logical_and, [_meets(q, one.quantity, one.true) for one in bounds if one.true])
    denials = [_meets(q, one.quantity, one.false) for one in bounds if one.false]
    false = reduce(np.logical_and if predicate in DENIED_BY_ALL else np.logical_or, denials)
    fit_true, fit_false = _fit(predicate, s, t, container)
    when_true, when_false = _margins(predicate, q, s, t)
    true = true & fit_true
    if predicate in ("on", "under", "in"):  # a share alone does not say how nearly they are true
        when_true = np.where(true, when_true, -np.inf)
    return fact(true, false & fit_false, when_true, when_false)


def denies(predicate: str, q: Quantities, t: Thresholds) -> Bools:
    """Return for which pairs a condition may deny a compass direction, (n, n)."""
    bounds = bounds_of(predicate, t, denied=True)
    return reduce(np.logical_and, [_meets(q, one.quantity, one.false) for one in bounds if one.false])


def _meets(q: Quantities, quantity: str, bound: Bound) -> Bools:
    operator, limit = bound
    found: Bools = _MEETS[operator](q[quantity], limit)
    return found


def _fit(predicate: str, s: Stacking, t: Thresholds, container: Bools) -> tuple[Bools | bool, Bools | bool]:
    """Return for which pairs text may use a predicate at all, as true and as false."""
    if predicate == "on":  # below the top of a box nothing is decided: it includes headboards and arm rests
        return (s.area[None, :] > s.area[:, None]) & (s.rise > 0.0), s.known
    if predicate == "in":
        return container[None, :], container[None, :]
    if predicate == "higher than":  # of things off the floor that can't support each other
        raised = s.off_floor >= exact_mm(t.off_floor)
        fit = raised[:, None] & raised[None, :] & ~s.carries & ~s.carries.T
        return fit, fit
    if predicate == "above":  # what rests on a thing is on it, not above it
        return ~s.carries, s.known & ~s.carries
    if predicate in COMPASS:  # side by side: neither is over, on or partly inside the other
        return ~s.over, ~s.over
    return True, True


def _margins(predicate: str, q: Quantities, s: Stacking, t: Thresholds) -> tuple[F64, F64]:
    """Return the margins of a predicate where it is true and where it is false."""
    if predicate == "near":
        close = np.minimum(*(_rising(q[name], t.near, t.near_true) for name in ("distance", "surface distance")))
        return close, _rising(q["ground distance"], t.near, t.near_false)
    if predicate == "far from":
        return _rising(q["distance"], t.far, t.far_true), _rising(q["distance"], t.far, t.far_false)
    if predicate in ("on", "under", "in"):
        base, share = {"on": (0.5, s.covered), "under": (0.2, s.covered), "in": (0.2, s.inside)}[predicate]
        if predicate == "on":
            away = np.maximum(1.0 + s.apart / 1000.0, _rising(s.gap, 0.0, exact_mm(t.on_gap_false)))
        else:
            away = s.apart / exact_mm(t.over_apart_false) if predicate == "under" else 1.0 + s.distance / 1000.0
        return base + share, away
    if predicate in ("higher than", "above"):
        middle, up, low = (exact_mm(height) for height in (t.height, t.height_true, t.height_false))
        rise = _rising(s.rise, middle, up)
        if predicate == "higher than":
            return rise, _rising(s.rise, middle, -exact_mm(t.other_way))
        centred = _rising(q["horizontal"], t.over_horizontal, t.over_horizontal_true)
        over = np.minimum(centred, _rising(q["overlap"], 0.0, t.over_footprint_true))
        apart = s.apart / exact_mm(t.over_apart_false)
        return reduce(np.minimum, [rise, s.gap / exact_mm(t.over_gap_true), over]), np.maximum(
            _rising(s.rise, middle, low), apart
        )
    centre, *ends = (q[name] for name in OFF)
    half, edge = SECTOR_HALF_WIDTH, t.sector_edge - t.sector_false
    inside = [
        (centre - half) * (1.0 / (t.sector_true - half)),
        *((end - t.sector_false) * (1.0 / edge) for end in ends),
    ]
    clearance = _rising(q["horizontal"], 0.0, t.sector_horizontal_true)
    away = (reduce(np.minimum, [centre, *ends]) - half) * (1.0 / (t.sector_false - half))
    return reduce(np.minimum, [*inside, clearance]), away


def _rising(value: F64, emitted: float, text: float) -> F64:
    """Return the position of `value` on a linear scale, which is 0 at the threshold `emitted` and 1 at the threshold
    `text`.
    """
    scaled: F64 = (value - emitted) * (1.0 / (text - emitted))
    return scaled


Status = NDArray[np.int8]


def closest_facts(distance: F64, labels: Sequence[str], rival: Bools, held: Bools, t: Thresholds) -> tuple[Status, F64]:
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


def size_facts(arrays: RoomArrays, rival: Bools, t: Thresholds) -> dict[str, Status]:
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
    arrays: RoomArrays, s: Stacking, compound: Bools, pairs: NDArray[np.intp], t: Thresholds
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


def _amid(arrays: RoomArrays, ground: F64, pairs: NDArray[np.intp]) -> Bools:
    """Return (n, p) whether the centre of each object, `ground` (n, 2) in millimetres, is in the gap between the boxes
    of two anchors that face each other, in the part that both flank. Far from the line of the centres of two long
    counters, a thing in the aisle is between them all the same.
    """
    low, high = (millimetres(corner[:, [0, 2]])[pairs] for corner in (arrays.aabb_min, arrays.aabb_max))
    first, last = low.max(axis=1), high.min(axis=1)  # (p, 2): what the anchors share; where they don't, last < first
    at = ground[:, None]
    flanked, gap = (first <= at) & (at <= last), (last <= at) & (at <= first)
    found: Bools = (gap[..., 0] & flanked[..., 1]) | (flanked[..., 0] & gap[..., 1])
    return found
