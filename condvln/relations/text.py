"""Decide for each fact whether text may use it as true, as false, or not at all."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from condvln.arrays import F64, Bools
from condvln.labels.lists import Role, have_role
from condvln.relations.decisions import (
    OF_SOME_PIECE,
    PAIR_PREDICATES,
    TURNED,
    Fact,
    between_facts,
    closest_facts,
    denies,
    deviations,
    fact,
    fact_of,
    quantities,
    size_facts,
)
from condvln.relations.directions import COMPASS, edge_azimuths
from condvln.relations.metrics import millimetres, pair_metrics
from condvln.relations.pieces import Pieces
from condvln.relations.room import RoomRelations
from condvln.relations.stacking import Holding, Stacking, held_by, holding_of, stacking_of
from condvln.scene import RoomArrays
from schemas.config import Thresholds
from schemas.config.constants import GROUP_RUG, GROUP_TABLE

__all__ = ["SIZE_PREDICATES", "TEXT_PREDICATES", "TextFacts", "in_one_group", "measured_by_boxes", "text_facts"]


def in_one_group(arrays: RoomArrays) -> NDArray[np.bool_]:
    """Return a mask (n, n) of the pairs of objects whose footprints are both within `GROUP_RUG` of a third object that
    is a rug, or within `GROUP_TABLE` of one that is a coffee table.
    """
    low, high = millimetres(arrays.aabb_min), millimetres(arrays.aabb_max)
    found = np.zeros((len(arrays), len(arrays)), dtype=np.bool_)
    reaches: tuple[tuple[Role, float], ...] = (("carpet", GROUP_RUG), ("low table", GROUP_TABLE))
    for role, reach in reaches:
        middle = np.flatnonzero(have_role(arrays.labels, role))
        gaps = [
            np.maximum(low[:, None, k] - high[None, middle, k], low[None, middle, k] - high[:, None, k]) for k in (0, 2)
        ]
        x, z = (np.maximum(gap, 0.0) for gap in gaps)
        close = x * x + z * z <= (1000.0 * reach) ** 2  # False where a box is unknown
        close[middle, np.arange(len(middle))] = False
        found |= (close[:, None, :] & close[None, :, :]).any(axis=2)
    return found


Status = NDArray[np.int8]

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
    denied: Mapping[str, Bools]
    excluded: Mapping[str, Bools]
    _arrays: RoomArrays
    _whole: Stacking
    _distance: F64
    _held: Bools
    _compound: Bools
    _thresholds: Thresholds

    def between(self, pairs: NDArray[np.intp]) -> tuple[Status, F64]:
        """Return the status and the margin of the statements "object i is between a and b", (n, p) each. `pairs` (p, 2)
        has the indices of each a and b.
        """
        return between_facts(self._arrays, self._whole, self._compound, pairs, self._thresholds)

    def closest(self, rival: Bools) -> tuple[Status, F64]:
        """Return the status and the margin of the statements "object i is the closest to object j", (n, n) each.
        `rival` (n, n) says whether the label of object i could mean object j.
        """
        return closest_facts(self._distance, self._arrays.labels, rival, self._held, self._thresholds)

    def sizes(self, rival: Bools) -> dict[str, Status]:
        """Return the status (n,) of each predicate of `SIZE_PREDICATES`. `rival` (n, n) says whether the label of
        object i could mean object j.
        """
        return size_facts(self._arrays, rival, self._thresholds)


def text_facts(relations: RoomRelations, thresholds: Thresholds) -> TextFacts:
    """Return the facts that text may state about a room's objects.

    For an object of several pieces, see `OF_SOME_PIECE`; "far from" is false if it is false for some pair of pieces.
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
    measured = quantities(stacking, metrics, parts.radius, pieces.spread(relations.surface))
    container = holding.open[pieces.owner]

    denied = {}
    azimuths = np.stack(
        [metrics.azimuth, *edge_azimuths(*map(millimetres, (parts.centers, parts.aabb_min, parts.aabb_max)))]
    )
    facts: dict[str, Fact] = {}
    for predicate in sorted(PAIR_PREDICATES, key=TURNED.__contains__):
        if predicate in TURNED:
            facts[predicate] = _turned(facts[TURNED[predicate]])
            continue
        own = {**measured, **(deviations(azimuths, predicate) if predicate in COMPASS else {})}
        of_objects = _some if predicate in OF_SOME_PIECE else _far_of if predicate == "far from" else _each
        facts[predicate] = of_objects(pieces, fact_of(predicate, own, stacking, t, container))
        if predicate in COMPASS:
            denied[predicate] = pieces.all(denies(predicate, own, t) & ~stacking.over)
    facts["on"], facts["in"] = _said_on(facts["on"], holding), _said_in(facts["in"], holding)
    facts["near"] = _unheld(facts["near"], held, around, holding, in_one_group(arrays))
    return TextFacts(
        status={predicate: facts[predicate].status for predicate in PAIR_PREDICATES},
        margin={predicate: facts[predicate].margin for predicate in PAIR_PREDICATES},
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


def measured_by_boxes(arrays: RoomArrays, thresholds: Thresholds) -> dict[str, F64]:
    """Return the quantities of all pairs of a room's objects by their boxes alone, (n, n) each; NaN where unknown."""
    stacking = stacking_of(Pieces.of(arrays), holding_of(arrays), thresholds)
    metrics = pair_metrics(arrays.centers, arrays.aabb_min, arrays.aabb_max, arrays.radius)
    return quantities(stacking, metrics, arrays.radius, np.full_like(metrics.used, np.nan))


def _turned(one: Fact) -> Fact:
    """Return the fact with subject and anchor exchanged, as "below" follows from "above"."""
    status, margin = one
    return Fact(np.ascontiguousarray(status.T), np.ascontiguousarray(margin.T))


def _some(pieces: Pieces, one: Fact) -> Fact:
    """Return facts about objects from facts about their pieces. A fact is true if it is true for some pair of pieces,
    and false if it is false for all pairs.
    """
    return _of_objects(pieces, one, pieces.any(one.status == 1), pieces.all(one.status == -1), pieces.most(one.margin))


def _each(pieces: Pieces, one: Fact) -> Fact:
    """Return facts about objects from facts about their pieces. A fact is true if it is true for all pairs of pieces,
    and false if it is false for all pairs.
    """
    return _of_objects(pieces, one, pieces.all(one.status == 1), pieces.all(one.status == -1), pieces.least(one.margin))


def _far_of(pieces: Pieces, one: Fact) -> Fact:
    """Return facts about objects from facts about their pieces. A fact is true if it is true for all pairs of pieces,
    and false if it is false for some pair.
    """
    return _of_objects(pieces, one, pieces.all(one.status == 1), pieces.any(one.status == -1), pieces.least(one.margin))


def _of_objects(pieces: Pieces, one: Fact, true: Bools, false: Bools, margin: F64) -> Fact:
    return fact(true, false, margin, margin) if pieces.several else one


def _said_on(one: Fact, holding: Holding) -> Fact:
    """Return the fact "on" after adding what the source states. Where the boxes leave "on" undecided, the source
    decides; where the source says "on" and the boxes deny it, the status is 0.
    """
    status, margin = one
    true = (status == 1) | (holding.on & (status == 0))
    false = ((status == -1) & ~holding.on) | (holding.denied & (status == 0))
    said = np.where((status == 0) & (true | false), 1.0, margin)
    return fact(true, false, said, said)


def _said_in(one: Fact, holding: Holding) -> Fact:
    """Return the fact "in" after adding what the source states about open containers. Where the boxes leave "in"
    undecided, the source decides; where the source says "in" and the boxes deny it, the status is 0.
    """
    status, margin = one
    said = holding.inside & holding.open[None, :]
    true = (status == 1) | (said & (status == 0))
    margin = np.where((status == 0) & true, 1.0, margin)
    return fact(true, (status == -1) & ~said, margin, margin)


def _unheld(one: Fact, held: Bools, around: Bools, holding: Holding, grouped: Bools) -> Fact:
    """Return `one`, which is "near", with its status set to 0 where one object is on or in the other: of such objects
    people say neither "near" nor "not near". Of two objects of one group, people do not say "not near".

    The contents of a container are found through the container, so text never calls them near to anything.
    """
    status, margin = one
    boxed = np.asarray((around & holding.container[None, :]).any(axis=1))
    decided = ~(held | held.T)
    true = (status == 1) & decided & ~boxed[:, None] & ~boxed[None, :]
    return fact(true, (status == -1) & decided & ~grouped, margin, margin)
