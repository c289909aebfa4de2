"""Checks of ground-truth documents ``{episode id: {locations, forward_steps, actions}}``."""

from __future__ import annotations

import math
from itertools import pairwise
from typing import Any, Final

from condvln.export.validation.document import Document, check_keys, points, straight
from condvln.export.validation.findings import LintReport

__all__ = ["check_truths"]

_REQUIRED: Final = frozenset({"locations"})
_ALLOWED: Final = frozenset({"locations", "forward_steps", "actions"})
_STOP, _FORWARD, _ACTIONS = 0, 1, range(4)

_START: Final = 0.25
"""Tolerance in metres between the first location and the start: one forward step."""
_DENSE: Final = 1.0
"""Distance in metres between locations above which nDTW becomes too low: the step of the coarsest agents."""


def check_truths(report: LintReport, content: dict[str, Any], document: Document | None) -> None:
    """Check one ground-truth document; if ``document`` is given, also compare it with the episodes of ``document``."""
    for name, truth in content.items():
        place = f"episode {name}"
        report.episode = name
        if document is not None and name not in document.starts:
            report.add(place, "truth-unused", "is not in the split")
        if check_keys(report, place, truth, _REQUIRED, _ALLOWED):
            _check(report, place, truth, name, document)
    for name in document.starts if document is not None else ():
        if name not in content:
            report.episode = name
            report.add(f"episode {name}", "truth-missing", "has no entry")


def _check(report: LintReport, place: str, truth: dict[str, Any], name: str, document: Document | None) -> None:
    locations = truth["locations"]
    if not points(report, f"{place}.locations", locations):
        return
    if not locations:
        report.add(f"{place}.locations", "truth-empty", "there is no point")
        return
    gaps = [straight(a, b) for a, b in pairwise(locations)]
    if gaps and max(gaps) > _DENSE:
        report.add(f"{place}.locations", "truth-sparse", f"{max(gaps):.2f} m between two of them")
    _check_actions(report, place, truth)
    start = document.starts.get(name) if document is not None else None
    if start and straight(locations[0], start) > _START:
        report.add(f"{place}.locations", "truth-start", f"begin {straight(locations[0], start):.2f} m from the start")
    goals = document.goals.get(name, []) if document is not None else []
    reach = [straight(locations[-1], position) - radius for position, radius in goals if math.isfinite(radius)]
    if reach and min(reach) > 0:
        report.add(f"{place}.locations", "truth-goal", f"end {min(reach):.2f} m outside of every goal's radius")


def _check_actions(report: LintReport, place: str, truth: dict[str, Any]) -> None:
    actions, steps = truth.get("actions"), truth.get("forward_steps")
    if actions is not None:
        if not isinstance(actions, list) or not all(type(a) is int and a in _ACTIONS for a in actions):
            report.add(f"{place}.actions", "truth-actions", "not all are 0, 1, 2 or 3")
            return
        if actions and (actions[-1] != _STOP or _STOP in actions[:-1]):
            report.add(f"{place}.actions", "truth-actions", "STOP is not the last one, or not the only one")
    if steps is None:
        return
    if type(steps) is not int:
        report.add(f"{place}.forward_steps", "wrong-type", f"{steps!r} is not a whole number")
        return
    if len(truth["locations"]) != steps + 1:
        report.add(f"{place}.forward_steps", "truth-steps", f"{steps} for {len(truth['locations'])} locations")
    elif actions and actions.count(_FORWARD) != steps:
        report.add(f"{place}.actions", "truth-steps", f"{actions.count(_FORWARD)} forward actions for {steps} steps")
