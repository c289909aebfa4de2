"""Which facts text may use, and as what: true, false, or not at all."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from condvln.relations.compass import COMPASS, sector_deviation
from condvln.relations.metrics import CENTRE
from condvln.relations.room import RoomRelations
from schemas.config import SECTOR_HALF_WIDTH, Thresholds

__all__ = ["TEXT_PREDICATES", "TextFacts", "text_facts"]

F64 = NDArray[np.float64]
Mask = NDArray[np.bool_]

TEXT_PREDICATES: Final = ("near", "above", "below", *COMPASS, "higher than", "lower than", "far from")
"""Predicates that may stand in text, in order of preference."""


@dataclass(frozen=True, eq=False)
class TextFacts:
    """Three-valued facts about all ordered pairs of a room; the subject is the row, the target the column.

    status : per predicate of `TEXT_PREDICATES` (n, n): 1 usable as true, −1 usable as false, 0 never used (dead zone,
        or nothing to decide by; the diagonal too)
    margin : per predicate (n, n): distance from the threshold at which the edge is emitted, in widths of the dead
        zone on that side, so that usable facts have about 1 or more and larger is safer. The worst of the conditions
        of a true fact, the best of the reasons of a false one. Meaningful where status is not 0
    """

    status: Mapping[str, NDArray[np.int8]]
    margin: Mapping[str, F64]


def text_facts(relations: RoomRelations, thresholds: Thresholds) -> TextFacts:
    """What text may say of a room's pairs."""
    t, metrics, dy = thresholds, relations.metrics, relations.subject_above_target
    facts = {
        "near": _near(relations, t),
        "far from": _far(metrics.used, t),
        "higher than": _higher(dy, t),
        "lower than": _higher(-dy, t),
        "above": _above(dy, metrics.horizontal, metrics.footprint_overlap, t),
        "below": _above(-dy, metrics.horizontal, metrics.footprint_overlap, t),
    }
    clear = (np.abs(metrics.elevation) < t.level) & (metrics.horizontal >= t.sector_horizontal_true)
    clearance = _rising(metrics.horizontal, 0.0, t.sector_horizontal_true)
    for sector, predicate in enumerate(COMPASS):
        facts[predicate] = _compass(sector_deviation(metrics.azimuth, sector), clear, clearance, t)

    return TextFacts(
        status={predicate: facts[predicate][0] for predicate in TEXT_PREDICATES},
        margin={predicate: facts[predicate][1] for predicate in TEXT_PREDICATES},
    )


_Fact = tuple[NDArray[np.int8], F64]
"""Status and margin."""


def _fact(true: Mask, false: Mask, when_true: F64, when_false: F64) -> _Fact:
    """Status and margin from what may be used as true and false, and the margins on both sides."""
    status = true.view(np.int8) - false.view(np.int8)
    np.fill_diagonal(status, 0)
    # Where a fact is usable on one side, the margin of the other is far below.
    return status, np.fmax(when_true, when_false, out=when_true)


def _rising(value: F64, emitted: float, text: float) -> F64:
    """How far `value` is from `emitted` on the side of `text`, in units of the way between the two."""
    scaled: F64 = (value - emitted) * (1.0 / (text - emitted))
    return scaled


def _near(relations: RoomRelations, t: Thresholds) -> _Fact:
    used, surface = relations.metrics.used, relations.surface
    true = (used <= t.near_true) & (surface <= t.near_true)
    # Where surfaces were not measured, the distance of boxes or of bounding spheres is still a lower bound of theirs;
    # the distance of centres is none.
    bound = np.where(relations.metrics.used_metric == CENTRE, np.nan, used)
    least = np.where(np.isnan(surface), bound, surface)
    false = (used >= t.near_false) & (least >= t.near_false)
    when_true = np.minimum(_rising(used, t.near, t.near_true), _rising(surface, t.near, t.near_true))
    when_false = np.minimum(_rising(used, t.near, t.near_false), _rising(least, t.near, t.near_false))
    return _fact(true, false, when_true, when_false)


def _far(used: F64, t: Thresholds) -> _Fact:
    return _fact(
        used >= t.far_true,
        used <= t.far_false,
        _rising(used, t.far, t.far_true),
        _rising(used, t.far, t.far_false),
    )


def _higher(dy: F64, t: Thresholds) -> _Fact:
    return _fact(
        dy >= t.height_true,
        dy <= t.height_false,
        _rising(dy, t.height, t.height_true),
        _rising(dy, t.height, t.height_false),
    )


def _above(dy: F64, horizontal: F64, footprint_overlap: F64, t: Thresholds) -> _Fact:
    true = (dy >= t.height_true) & (horizontal <= t.over_horizontal_true) & (footprint_overlap >= t.over_footprint_true)
    false = (dy <= t.height_false) | (horizontal >= t.over_horizontal_false)
    when_true = np.minimum(
        np.minimum(
            _rising(dy, t.height, t.height_true), _rising(horizontal, t.over_horizontal, t.over_horizontal_true)
        ),
        _rising(footprint_overlap, 0.0, t.over_footprint_true),
    )
    when_false = np.maximum(
        _rising(dy, t.height, t.height_false), _rising(horizontal, t.over_horizontal, t.over_horizontal_false)
    )
    return _fact(true, false, when_true, when_false)


def _compass(deviation: F64, clear: Mask, clearance: F64, t: Thresholds) -> _Fact:
    beside = deviation - SECTOR_HALF_WIDTH
    when_true = np.minimum(beside * (1.0 / (t.sector_true - SECTOR_HALF_WIDTH)), clearance)
    when_false = beside * (1.0 / (t.sector_false - SECTOR_HALF_WIDTH))
    return _fact((deviation <= t.sector_true) & clear, deviation > t.sector_false, when_true, when_false)
