"""The quantities that decide a relation between objects, with the bounds that text uses and the margin to them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any, Final

import numpy as np
import yaml
from numpy.typing import NDArray

from condvln.own_tables import own_text
from condvln.relations.decisions import (
    DENIED_BY_ALL,
    OF_SOME_PIECE,
    PAIR_PREDICATES,
    TURNED,
    UNITS,
    bounds_of,
    deviations,
    quantities,
)
from condvln.relations.directions import BEARING_DEGREES, COMPASS, edge_azimuths, sighted
from condvln.relations.metrics import millimetres, pair_metrics
from condvln.relations.pieces import Pieces
from condvln.relations.stacking import holding_of, stacking_of
from condvln.scene import RoomArrays
from schemas.config import Thresholds

__all__ = ["Criterion", "RoomMeasures", "bearing_criteria", "decided", "said_of"]

F64 = NDArray[np.float64]
Bound = tuple[str, float]
"""An operator of `_WORDS` and a number in the unit of the criterion."""

_WORDS: Final = {"≤": "at most", "≥": "at least", "<": "less than", ">": "more than", "±": "within"}
_DECIMALS: Final = {"m": 2, "°": 1, "%": 0}
_TOLERANCE: Final = 1e-6
"""Of a comparison with a bound: distances are roots of whole millimetres."""
_BY_SOURCE: Final = frozenset(("on", "in"))
"""Predicates that the source may affirm or deny where boxes do not decide."""

_SHOWN: Final = {"m": (1.0, "m"), "mm": (0.001, "m"), "share": (100.0, "%"), "°": (1.0, "°")}
"""Factor and unit with which the page shows the units of quantities."""


@cache
def _said() -> dict[str, Any]:
    known: dict[str, Any] = yaml.safe_load(own_text("condvln.explorer", "predicates.yaml"))
    return known


def said_of(predicate: str) -> Mapping[str, Any]:
    """Return how the page words a predicate: its "rule", and its "quantities" by name. Without words in
    ``predicates.yaml``, the bounds of a predicate between two objects are said as they are; others have none.
    """
    kind = "compass" if predicate in COMPASS else "bearing" if predicate in BEARING_DEGREES else predicate
    return _said().get(kind) or _said_by_bounds(predicate)


def _said_by_bounds(predicate: str) -> Mapping[str, Any]:
    if predicate not in PAIR_PREDICATES:
        return {"rule": "", "quantities": {}}
    bounds = bounds_of(predicate, Thresholds())
    sides = [
        ", ".join(f"{one.quantity} {_WORDS[side[0]]} {side[1]:g} {UNITS[one.quantity]}" for one, side in found if side)
        for found in ([(one, one.true) for one in bounds], [(one, one.false) for one in bounds])
    ]
    return {"rule": "; false: ".join(filter(None, sides)), "quantities": {one.quantity: one.quantity for one in bounds}}


@dataclass(frozen=True)
class Criterion:
    """One quantity of a relation.

    Attributes
    ----------
    value : in `unit`: metres, degrees or per cent
    true, false : what the quantity must be for the relation to be true or false in text; None if that side does not
        look at it
    """

    name: str
    value: float
    unit: str
    true: Bound | None = None
    false: Bound | None = None

    @property
    def shown(self) -> float:
        """Value as the page writes it."""
        return round(float(self.value), _DECIMALS[self.unit])

    def slack(self, truth: bool) -> float:
        """Return how far the value is on the right side of the bound; negative on the wrong side, and minus infinity if
        this side has no bound or the value is unknown.
        """
        return self._within(float(self.value), truth)

    def holds(self, truth: bool) -> bool:
        """Return whether the value satisfies the bound of one side; False if this side has no bound or the value is
        unknown.
        """
        bound = self.true if truth else self.false
        if bound is None:
            return False
        slack = self.slack(truth)
        return slack > 0.0 if bound[0] in "<>" else slack >= -_TOLERANCE

    def margin(self, truth: bool) -> float:
        """Return the difference of what is written: of the shown value and the bound."""
        return max(0.0, self._within(self.shown, truth))

    def _within(self, value: float, truth: bool) -> float:
        bound = self.true if truth else self.false
        if bound is None or not np.isfinite(value):
            return -np.inf
        operator, limit = bound
        if operator == "±":
            return limit - abs(value)
        return limit - value if operator in "≤<" else value - limit

    def closeness(self, truth: bool) -> float:
        """Return the slack relative to the width of the dead zone, or else to the bound, by which criteria in different
        units are compared.
        """
        bounds = [bound[1] for bound in (self.true, self.false) if bound is not None]
        width = abs(bounds[0] - bounds[1]) if len(bounds) == 2 else abs(bounds[0]) if bounds else 0.0
        return self.slack(truth) / (width or 1.0)

    def written(self, value: float) -> str:
        """Return a value of this criterion with its unit."""
        gap = "" if self.unit == "°" else " "
        return f"{value:.{_DECIMALS[self.unit]}f}{gap}{self.unit}"

    def bound(self, truth: bool) -> str:
        """Return in words what the quantity must be on one side; empty if that side does not look at it."""
        found = self.true if truth else self.false
        if found is None:
            return ""
        return f"{_WORDS[found[0]]} {self.written(found[1]) if found[1] else f'0 {self.unit}'}"

    def document(self, decides: bool) -> dict[str, Any]:
        """Return the criterion as the page shows it."""
        return {
            "name": self.name,
            "value": None if not np.isfinite(self.value) else self.shown,
            "unit": self.unit,
            "true": self.bound(True),
            "false": self.bound(False),
            "decides": decides,
        }


class RoomMeasures:
    """The criteria of the relations between the objects of one room, looked up by object id."""

    def __init__(self, arrays: RoomArrays, thresholds: Thresholds) -> None:
        self._t = thresholds
        pieces = Pieces.of(arrays)
        parts = pieces.arrays
        stacking = stacking_of(pieces, holding_of(arrays), thresholds)
        metrics = pair_metrics(parts.centers, parts.aabb_min, parts.aabb_max, parts.radius)
        edges = edge_azimuths(*map(millimetres, (parts.centers, parts.aabb_min, parts.aabb_max)))
        self._azimuths, self._centers = np.stack([metrics.azimuth, *edges]), parts.centers
        self._measured = quantities(stacking, metrics, parts.radius, np.full_like(metrics.used, np.nan))
        self._of = {name: np.flatnonzero(pieces.owner == k).tolist() for k, name in enumerate(arrays.object_ids)}

    def criteria(
        self, predicate: str, subject: str, anchors: Sequence[str], surface: float | None = None
    ) -> list[list[Criterion]]:
        """Return the criteria of "subject predicate anchors" for each pair of pieces of the subject and the anchor;
        empty for a predicate without criteria or for objects of other rooms.

        surface : distance of the surfaces of the two objects in metres; None if it was not measured
        """
        own = [self._of.get(name) for name in (subject, *anchors)]
        if any(pieces is None for pieces in own) or len(own) < 2:
            return []
        if predicate == "between":
            return [self._between(own[0][0], own[1][0], own[2][0])] if len(own) == 3 else []  # type: ignore[index]
        return [self._pair(predicate, i, j, surface) for i in own[0] or () for j in own[1] or ()]

    def _pair(self, predicate: str, i: int, j: int, surface: float | None) -> list[Criterion]:
        measured, words = self._measured, said_of(predicate)["quantities"]
        if not words:
            return []
        way = predicate.removesuffix(" of")
        if predicate in COMPASS:
            measured = measured | deviations(self._azimuths, predicate)
        if predicate in TURNED:
            i, j = j, i
        found = []
        for quantity, true, false in bounds_of(predicate, self._t, denied=True):
            value = surface if quantity == "surface distance" else float(measured[quantity][i, j])
            if quantity == "air":
                value = max(float(measured[quantity][i, j]), 0.0)
            if value is not None and quantity in words:
                scale, unit = _SHOWN[UNITS[quantity]]
                bounds = [None if one is None else (one[0], one[1] * scale) for one in (true, false)]
                found.append(Criterion(words[quantity].format(way=way), value * scale, unit, *bounds))
        return found

    def _between(self, i: int, a: int, b: int) -> list[Criterion]:
        t, ground = self._t, self._centers[:, [0, 2]]
        along, away = ground[b] - ground[a], ground[i] - ground[a]
        length = float(np.hypot(*along))
        if not length:
            return []
        part = float(away @ along) / length**2
        off = abs(float(away[0] * along[1] - away[1] * along[0])) / length
        inner = 100.0 * min(part, 1.0 - part)
        return [
            Criterion(
                "distance from the nearer end of the line between the anchors, as a part of the line",
                inner, "%", ("≥", 100.0 * t.between_true), ("<", 100.0 * t.between_false),
            ),
            Criterion("distance from that line", off, "m", ("≤", t.between_off_true), ("≥", t.between_off_false)),
        ]  # fmt: skip


def bearing_criteria(direction: str, start: F64, heading: float, box: F64, t: Thresholds) -> list[Criterion]:
    """Return the criteria of "on the left", "ahead" and so on at the start.

    start (3,) : metres; heading : degrees clockwise from north; box (2, 3) : of the object
    """
    seen = sighted(start[None], box, t)
    off = float((seen.azimuth[0] - heading - BEARING_DEGREES[direction] + 180.0) % 360.0 - 180.0)
    low, high = off + float(seen.low[0]), off + float(seen.high[0])
    widest = max(abs(low), abs(high))
    around = any(low <= turn <= high for turn in (-360.0, 0.0, 360.0))
    nearest = 0.0 if around else min(abs((side + 180.0) % 360.0 - 180.0) for side in (low, high))
    middle = (box[0] + box[1]) / 2.0
    distance = float(np.hypot(middle[0] - start[0], middle[2] - start[2]))
    return [
        Criterion(
            f"angle of its centre from {direction}", abs(off), "°", ("≤", t.bearing_true), ("≥", t.bearing_false)
        ),
        Criterion(f"angle of its farthest side from {direction}", widest, "°", ("≤", t.bearing_false)),
        Criterion(f"angle of its nearest side from {direction}", nearest, "°", None, ("≥", t.bearing_true)),
        Criterion("distance from the start", distance, "m", ("≥", t.bearing_distance)),
    ]


def decided(predicate: str, pairs: Sequence[Sequence[Criterion]], truth: bool) -> dict[str, Any]:
    """Return the criteria that decide a relation, which one decides it, and a sentence that says so.

    Of an object of several pieces, the pair of pieces that decides is shown.

    Parameters
    ----------
    pairs : what :meth:`RoomMeasures.criteria` returns
    truth : whether the object counts as a witness

    Returns
    -------
    ``criteria``, ``says``, ``margin``, ``unit`` and ``parts``, the number of pairs of pieces; ``margin`` is None where
    no quantity decides. Empty without pairs.
    """
    pairs = [pair for pair in pairs if pair]
    if not pairs:
        return {}
    one_is_enough = predicate in OF_SOME_PIECE if truth else predicate == "far from"
    pick = max if one_is_enough else min
    pair = pick(pairs, key=lambda one: _closest_call(predicate, one, truth)[0])
    found_at = _closest_call(predicate, pair, truth)[1]
    found, holds = pair[found_at], pair[found_at].holds(truth)
    says = _sentence(predicate, pair, found_at, truth) if holds else _undecided(predicate, pair, truth)
    return {
        "criteria": [one.document(holds and one is found) for one in pair],
        "says": says,
        "margin": round(found.margin(truth), _DECIMALS[found.unit]) if holds else None,
        "unit": found.unit,
        "parts": len(pairs),
    }


def _closest_call(predicate: str, pair: Sequence[Criterion], truth: bool) -> tuple[float, int]:
    """Return the closeness and the index of the criterion that decides: the tightest one where all must hold, else the
    clearest one. What must be so for either truth, such as that the two are near enough for a compass word, decides
    nothing.
    """
    all_deny = not truth and predicate in DENIED_BY_ALL  # each by the same quantity, so that the differences compare
    asked = [
        (one.slack(truth) if all_deny else one.closeness(truth), k)
        for k, one in enumerate(pair)
        if (one.true if truth else one.false) is not None and one.true != one.false
    ]
    return min(asked) if truth or all_deny else max(asked)


def _sentence(predicate: str, pair: Sequence[Criterion], k: int, truth: bool) -> str:
    one = pair[k]
    sides = [
        f"“{'' if side else 'not '}{predicate}” needs {one.bound(side)}" for side in (True, False) if one.bound(side)
    ]
    margin = one.written(one.margin(truth))
    says = f"{one.name} {one.written(one.shown)}; {', '.join(sides)}; so it is {str(truth).lower()}, by {margin}"
    if not truth and one.true is None:
        says += f" (“{predicate}” needs: {pair[0].name} {pair[0].bound(True)})"
    return says


def _undecided(predicate: str, pair: Sequence[Criterion], truth: bool) -> str:
    """Return the sentence about a pair whose quantities do not give the truth."""
    _, k = _closest_call(predicate, pair, not truth)
    if truth:
        return "the boxes do not decide it; the source says so"
    if any(not np.isfinite(one.value) for one in pair if one.false is not None):
        return "the size or place of one of the two is unknown"
    if pair[k].holds(True):
        return f"{pair[k].name} {pair[k].written(pair[k].shown)}: “{predicate}”, but not of this name for certain"
    one = pair[_closest_call(predicate, pair, False)[1]]
    if predicate in _BY_SOURCE:
        return f"{one.name} {one.written(one.shown)}: the boxes do not decide it, only the source can"
    return f"{one.name} {one.written(one.shown)}: between the bounds, so text says neither"
