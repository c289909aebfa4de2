"""Decide for each fact whether text may use it as true, as false, or not at all."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from condvln.relations.comparison import between_facts, closest_facts, size_facts
from condvln.relations.compass import COMPASS, edge_azimuths, sector_deviation
from condvln.relations.grouping import in_one_group
from condvln.relations.holding import Holding, holding_of
from condvln.relations.metrics import AABB, SPHERE, PairMetrics, millimetres, pair_metrics
from condvln.relations.pieces import Pieces
from condvln.relations.room import RoomRelations
from condvln.relations.stacking import Stacking, exact_mm, held_by, stacking_of
from condvln.scene import RoomArrays
from schemas.config import SECTOR_HALF_WIDTH, Thresholds

__all__ = ["PAIR_PREDICATES", "SIZE_PREDICATES", "TEXT_PREDICATES", "TextFacts", "text_facts"]

F64 = NDArray[np.float64]
Mask = NDArray[np.bool_]
Status = NDArray[np.int8]

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
"""Predicates of an object and one anchor."""

SIZE_PREDICATES: Final = ("bigger", "smaller")
"""Predicates that compare an object with the only other one of its label."""

TEXT_PREDICATES: Final = (*PAIR_PREDICATES, "between", "closest to", *SIZE_PREDICATES)
"""All predicates that may occur in text."""


@dataclass(frozen=True, eq=False)
class TextFacts:
    """Three-valued facts about the objects of a room, in the order of ``RoomArrays.object_ids``.

    A status is 1 where the fact is usable as true, −1 where it is usable as false, and 0 where it is never used (dead
    zone, unknown, or the diagonal).

    status : for each predicate of `PAIR_PREDICATES` (n, n), the subject by row and the anchor by column
    margin : for each such predicate (n, n) the distance from the threshold: at least 1 where status is not 0, and
        larger where it is safer; comparable within one predicate only
    denied : for each predicate of `COMPASS` (n, n) whether a condition may ask for it as false, which takes more than
        telling rivals apart
    excluded : for "far from" (n, n) whether a rival is excluded by it, which takes more than a status of −1
    """

    status: Mapping[str, Status]
    margin: Mapping[str, F64]
    denied: Mapping[str, Mask]
    excluded: Mapping[str, Mask]
    _arrays: RoomArrays
    _whole: Stacking
    _distance: F64
    _held: Mask
    _compound: Mask
    _thresholds: Thresholds

    def between(self, pairs: NDArray[np.intp]) -> tuple[Status, F64]:
        """Return the status and the margin of the statements "object i is between a and b", (n, p) each. `pairs` (p, 2)
        has the indices of each a and b.
        """
        return between_facts(self._arrays, self._whole, self._compound, pairs, self._thresholds)

    def closest(self, rival: Mask) -> tuple[Status, F64]:
        """Return the status and the margin of the statements "object i is the closest to object j", (n, n) each.
        `rival` (n, n) says whether the label of object i could mean object j.
        """
        return closest_facts(self._distance, self._arrays.labels, rival, self._held, self._thresholds)

    def sizes(self, rival: Mask) -> dict[str, Status]:
        """Return the status (n,) of each predicate of `SIZE_PREDICATES`. `rival` (n, n) says whether the label of
        object i could mean object j.
        """
        return size_facts(self._arrays, rival, self._thresholds)


def text_facts(relations: RoomRelations, thresholds: Thresholds) -> TextFacts:
    """Return the facts that text may state about a room's objects.

    For an object of several pieces, "on", "under", "in", "near" and "above" are true if true for some piece and false
    if false for all; the compass directions, "higher than" and "far from" are true if true for all pieces.
    """
    t, arrays = thresholds, relations.objects
    pieces, holding = Pieces.of(arrays), holding_of(arrays)
    stacking = stacking_of(pieces, holding, t)
    parts, (held, around) = pieces.arrays, held_by(pieces, holding, stacking, t)
    metrics = (
        pair_metrics(parts.centers, parts.aabb_min, parts.aabb_max, parts.radius)
        if pieces.several
        else relations.metrics
    )
    facts = {
        "on": _said_on(_some(pieces, _on(stacking, t)), holding),
        "under": _some(pieces, _under(stacking, t)),
        "in": _said_in(_some(pieces, _in(stacking, holding.open[pieces.owner], t)), holding),
        "near": _unheld(
            _some(pieces, _near(stacking, metrics, parts.radius, pieces.spread(relations.surface), t)),
            held,
            around,
            holding,
            in_one_group(arrays),
        ),
        "far from": _far_of(pieces, _far(metrics.used, t)),
        "higher than": _each(pieces, _higher(stacking, t)),
        "above": _some(pieces, _above(stacking, metrics.horizontal, metrics.footprint_overlap, t)),
    }
    facts["lower than"] = _turned(facts["higher than"])
    facts["below"] = _turned(facts["above"])
    clear = (np.abs(metrics.elevation) < t.level) & (metrics.horizontal >= t.sector_horizontal_true)
    beside, denied = ~stacking.over, {}
    edges = edge_azimuths(*map(millimetres, (parts.centers, parts.aabb_min, parts.aabb_max)))
    azimuths = np.stack([metrics.azimuth, *edges])
    clearance = _rising(metrics.horizontal, 0.0, t.sector_horizontal_true)
    for sector, predicate in enumerate(COMPASS):
        seen = sector_deviation(azimuths, sector)
        facts[predicate] = _each(pieces, _compass(seen, beside, clear, clearance, t))
        denied[predicate] = pieces.all((seen > t.sector_denied).all(axis=0) & beside)

    return TextFacts(
        status={predicate: facts[predicate][0] for predicate in PAIR_PREDICATES},
        margin={predicate: facts[predicate][1] for predicate in PAIR_PREDICATES},
        denied=denied,
        # "The picture away from the coat rack" is one of several only where the others hang beside the coat rack.
        excluded={"far from": pieces.any(metrics.used <= t.near_true)},
        _arrays=arrays,
        _whole=stacking_of(Pieces(arrays, arrays, np.arange(len(arrays))), holding, t) if pieces.several else stacking,
        _distance=pieces.least(stacking.distance),
        _held=held | held.T,
        _compound=pieces.compound,
        _thresholds=t,
    )


_Fact = tuple[Status, F64]
"""Status and margin of a predicate."""


def _fact(true: Mask, false: Mask, when_true: F64, when_false: F64) -> _Fact:
    """Return the status and margin of a predicate. `true` and `false` are masks of the pairs for which text may use the
    predicate as true or as false; `when_true` and `when_false` are the margins of these two cases.
    """
    status = true.view(np.int8) - false.view(np.int8)
    np.fill_diagonal(status, 0)
    # Where a fact is usable on one side, the other side's margin is far below 1.
    return status, np.fmax(when_true, when_false, out=when_true)


def _turned(fact: _Fact) -> _Fact:
    """Return the fact with subject and anchor exchanged, as "below" follows from "above"."""
    status, margin = fact
    return np.ascontiguousarray(status.T), np.ascontiguousarray(margin.T)


def _some(pieces: Pieces, fact: _Fact) -> _Fact:
    """Return facts about objects from facts about their pieces. A fact is true if it is true for some pair of pieces,
    and false if it is false for all pairs.
    """
    return _of_objects(pieces, fact, pieces.any(fact[0] == 1), pieces.all(fact[0] == -1), pieces.most(fact[1]))


def _each(pieces: Pieces, fact: _Fact) -> _Fact:
    """Return facts about objects from facts about their pieces. A fact is true if it is true for all pairs of pieces,
    and false if it is false for all pairs.
    """
    return _of_objects(pieces, fact, pieces.all(fact[0] == 1), pieces.all(fact[0] == -1), pieces.least(fact[1]))


def _far_of(pieces: Pieces, fact: _Fact) -> _Fact:
    """Return facts about objects from facts about their pieces. A fact is true if it is true for all pairs of pieces,
    and false if it is false for some pair.
    """
    return _of_objects(pieces, fact, pieces.all(fact[0] == 1), pieces.any(fact[0] == -1), pieces.least(fact[1]))


def _of_objects(pieces: Pieces, fact: _Fact, true: Mask, false: Mask, margin: F64) -> _Fact:
    return _fact(true, false, margin, margin) if pieces.several else fact


def _said_on(fact: _Fact, holding: Holding) -> _Fact:
    """Return the fact "on" after adding what the source states. Where the boxes leave "on" undecided, the source
    decides; where the source says "on" and the boxes deny it, the status is 0.
    """
    status, margin = fact
    true = (status == 1) | (holding.on & (status == 0))
    false = ((status == -1) & ~holding.on) | (holding.denied & (status == 0))
    said = np.where((status == 0) & (true | false), 1.0, margin)
    return _fact(true, false, said, said)


def _said_in(fact: _Fact, holding: Holding) -> _Fact:
    """Return the fact "in" after adding what the source states about open containers. Where the boxes leave "in"
    undecided, the source decides; where the source says "in" and the boxes deny it, the status is 0.
    """
    status, margin = fact
    said = holding.inside & holding.open[None, :]
    true = (status == 1) | (said & (status == 0))
    margin = np.where((status == 0) & true, 1.0, margin)
    return _fact(true, (status == -1) & ~said, margin, margin)


def _rising(value: F64, emitted: float, text: float) -> F64:
    """Return the position of `value` on a linear scale, which is 0 at the threshold `emitted` and 1 at the threshold
    `text`.
    """
    scaled: F64 = (value - emitted) * (1.0 / (text - emitted))
    return scaled


def _near(s: Stacking, metrics: PairMetrics, radius: F64, surface: F64, t: Thresholds) -> _Fact:
    """Return status and margin of "near". The fact is true if two objects are close in space and neither is far above
    the other, and false if they are far apart along the ground; a difference in height alone is not enough.

    Footprints, and circles around bounding spheres, enclose their objects and so bound their ground distance; centres
    do not.
    """
    used = metrics.used
    true = (used <= t.near_true) & (surface <= t.near_true)
    true &= np.fmax(s.gap, s.gap.T) <= exact_mm(t.near_over)
    round_ones = np.maximum(metrics.horizontal - (radius[:, None] + radius[None, :]), 0.0)
    ground = np.where(metrics.used_metric == AABB, s.apart / 1000.0, np.nan)
    ground = np.where(metrics.used_metric == SPHERE, round_ones, ground)
    when_true = np.minimum(_rising(used, t.near, t.near_true), _rising(surface, t.near, t.near_true))
    return _fact(true, ground >= t.near_false, when_true, _rising(ground, t.near, t.near_false))


def _unheld(fact: _Fact, held: Mask, around: Mask, holding: Holding, grouped: Mask) -> _Fact:
    """Return `fact`, which is "near", with its status set to 0 where one object is on or in the other: of such objects
    people say neither "near" nor "not near". Of two objects of one group, people do not say "not near".

    The contents of a container are found through the container, so text never calls them near to anything.
    """
    status, margin = fact
    boxed = np.asarray((around & holding.container[None, :]).any(axis=1))
    decided = ~(held | held.T)
    true = (status == 1) & decided & ~boxed[:, None] & ~boxed[None, :]
    return _fact(true, (status == -1) & decided & ~grouped, margin, margin)


def _far(used: F64, t: Thresholds) -> _Fact:
    return _fact(
        used >= t.far_true,
        used <= t.far_false,
        _rising(used, t.far, t.far_true),
        _rising(used, t.far, t.far_false),
    )


def _on(s: Stacking, t: Thresholds) -> _Fact:
    """Return status and margin of "on": the subject's bottom is at the anchor's top. Below the top of the anchor's box,
    "on" is undecided, since the box includes headboards and arm rests.
    """
    true = (
        (np.abs(s.gap) <= exact_mm(t.on_gap_true))
        & (s.covered >= t.on_footprint_true)
        & (s.area[None, :] > s.area[:, None])
        & (s.rise > 0.0)
    )
    false = s.known & ((s.apart > 0.0) | (s.gap >= exact_mm(t.on_gap_false)))
    when_false = np.maximum(1.0 + s.apart / 1000.0, _rising(s.gap, 0.0, exact_mm(t.on_gap_false)))
    return _fact(true, false, np.where(true, 0.5 + s.covered, -np.inf), when_false)


def _under(s: Stacking, t: Thresholds) -> _Fact:
    """Return status and margin of "under": the subject is on the floor, below an anchor with space beneath it. The
    bottom of the anchor's box is taken as the anchor's underside.
    """
    floor = s.off_floor[:, None] <= exact_mm(t.on_floor)
    true = floor & (s.gap.T >= 0.0) & (s.covered >= t.under_footprint_true)
    apart = exact_mm(t.over_apart_false)
    return _fact(true, s.apart >= apart, np.where(true, 0.2 + s.covered, -np.inf), s.apart / apart)


def _in(s: Stacking, container: Mask, t: Thresholds) -> _Fact:
    """Return status and margin of "in". The fact is true for subjects inside an open container, and false for subjects
    apart from the container; the status is 0 if the anchor is not an open container.
    """
    true = container[None, :] & (s.inside >= t.in_share_true)
    false = container[None, :] & (s.distance > 0.0)
    return _fact(true, false, np.where(true, 0.2 + s.inside, -np.inf), 1.0 + s.distance / 1000.0)


def _higher(s: Stacking, t: Thresholds) -> _Fact:
    """Return status and margin of "higher than", which compares both centres and tops: the fact is false only if the
    other object is higher by both. The status is 0 unless both objects are off the floor and neither may support the
    other.
    """
    fit = (s.off_floor >= exact_mm(t.off_floor)) & ~np.isnan(s.off_floor)
    fit = fit[:, None] & fit[None, :] & ~s.carries & ~s.carries.T
    middle, up, down = exact_mm(t.height), exact_mm(t.height_true), -exact_mm(t.other_way)
    true = fit & (s.rise >= up) & (s.top_rise >= exact_mm(t.top_true))
    false = fit & (s.rise <= down) & (s.top_rise <= down)
    return _fact(true, false, _rising(s.rise, middle, up), _rising(s.rise, middle, down))


def _above(s: Stacking, horizontal: F64, footprint_overlap: F64, t: Thresholds) -> _Fact:
    """Return status and margin of "above". A vertical gap is required, since an object that rests on another is "on"
    it, not "above" it.
    """
    rise, air = exact_mm(t.height_true), exact_mm(t.over_gap_true)
    true = (
        (s.rise >= rise)
        & (horizontal <= t.over_horizontal_true)
        & (footprint_overlap >= t.over_footprint_true)
        & (s.gap >= air)
        & ~s.carries
    )
    low, apart = exact_mm(t.height_false), exact_mm(t.over_apart_false)
    false = s.known & ((s.rise <= low) | (s.apart >= apart)) & ~s.carries
    when_true = np.minimum(
        np.minimum(_rising(s.rise, exact_mm(t.height), rise), s.gap / air),
        np.minimum(
            _rising(horizontal, t.over_horizontal, t.over_horizontal_true),
            _rising(footprint_overlap, 0.0, t.over_footprint_true),
        ),
    )
    return _fact(true, false, when_true, np.maximum(_rising(s.rise, exact_mm(t.height), low), s.apart / apart))


def _compass(deviations: F64, beside: Mask, clear: Mask, clearance: F64, t: Thresholds) -> _Fact:
    """Return status and margin of one compass direction. The status is 0 unless the objects are side by side: neither
    is over, on or partly inside the other.

    deviations (3, n, n) : off the direction, between the centres and from the nearest point of either footprint to the
        other's centre
    """
    scale = np.array([t.sector_true - SECTOR_HALF_WIDTH, *[t.sector_edge - t.sector_false] * 2])
    off = deviations - np.array([SECTOR_HALF_WIDTH, t.sector_false, t.sector_false])[:, None, None]
    when_true = np.minimum((off * (1.0 / scale)[:, None, None]).min(axis=0), clearance)
    when_false = (deviations.min(axis=0) - SECTOR_HALF_WIDTH) * (1.0 / (t.sector_false - SECTOR_HALF_WIDTH))
    true = (deviations[0] <= t.sector_true) & (deviations[1:] <= t.sector_edge).all(axis=0) & clear
    false = (deviations > t.sector_false).all(axis=0)
    return _fact(true & beside, false & beside, when_true, when_false)
