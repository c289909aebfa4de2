"""Checks of paths: ground truth ``{episode id: {locations, forward_steps, actions}}``, and discrete R2R files, also
against the scans' graphs if given.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from itertools import pairwise
from typing import Any, Final

from condvln.export.validation.episodes import Document
from condvln.export.validation.findings import LintReport, check_keys, is_number, points, straight
from condvln.navigation.graph_pathfinder import GraphPathfinder
from schemas.errors import CondVLNError

__all__ = ["check_r2r", "check_truths"]

_TRUTH_REQUIRED: Final = frozenset({"locations"})
_TRUTH_ALLOWED: Final = frozenset({"locations", "forward_steps", "actions"})
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
        if check_keys(report, place, truth, _TRUTH_REQUIRED, _TRUTH_ALLOWED):
            _check_truth(report, place, truth, name, document)
    for name in document.starts if document is not None else ():
        if name not in content:
            report.episode = name
            report.add(f"episode {name}", "truth-missing", "has no entry")


def _check_truth(report: LintReport, place: str, truth: dict[str, Any], name: str, document: Document | None) -> None:
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


_ITEM_REQUIRED: Final = frozenset({"scan", "path_id", "path", "heading", "instructions"})
_ITEM_ALLOWED: Final = _ITEM_REQUIRED | {"distance"}
_DISTANCE: Final = 0.02
"""Tolerance in metres: R2R rounds distances to 1 cm."""


def check_r2r(report: LintReport, items: list[Any], graphs: Mapping[str, GraphPathfinder] | None = None) -> set[str]:
    """Check one file and return the ids of its scans."""
    if not items:
        report.add("", "no-episodes", "there is none")
    seen: set[str] = set()
    scans: set[str] = set()
    withheld = bool(items) and all(map(_is_withheld, items))
    if withheld:
        report.add("", "goals-withheld", "every path is its start alone")
    for number, item in enumerate(items):
        place = f"[{number}]"
        report.episode = ""
        # R2R's readers take plain dictionaries, so additional keys are harmless.
        keys = _ITEM_ALLOWED | set(item) if isinstance(item, dict) else _ITEM_ALLOWED
        if not check_keys(report, place, item, _ITEM_REQUIRED, frozenset(keys)):
            continue
        report.episode = str(item["path_id"])
        place = f"path {report.episode}"
        if str(item["path_id"]) in seen:
            report.add(place, "duplicate-id", "occurs twice")
        seen.add(str(item["path_id"]))
        scans.add(str(item["scan"]))
        graph = None if graphs is None else graphs.get(str(item["scan"]))
        _check_item(report, place, item, graph, least=1 if withheld else 2)
    return scans


def _is_withheld(item: Any) -> bool:
    """Return whether an item states only the first viewpoint of its path, as every item of R2R's test split does."""
    return (
        isinstance(item, dict) and "distance" not in item and _is_path(item.get("path"), 1) and len(item["path"]) == 1
    )


def _is_path(value: Any, least: int) -> bool:
    """Return whether a value is a list of at least ``least`` viewpoint ids; any text counts as an id."""
    return isinstance(value, list) and len(value) >= least and all(isinstance(one, str) for one in value)


def _check_item(
    report: LintReport, place: str, item: dict[str, Any], graph: GraphPathfinder | None, *, least: int
) -> None:
    heading, texts, path = item["heading"], item["instructions"], item["path"]
    if not is_number(heading) or not 0 <= heading < 2 * math.pi:
        report.add(f"{place}.heading", "heading-range", f"{heading!r}")
    if not isinstance(texts, list) or not texts or not all(isinstance(text, str) for text in texts):
        report.add(f"{place}.instructions", "wrong-type", "not a list of texts")
    elif not all(text.strip() for text in texts):
        report.add(f"{place}.instructions", "empty-text", "one has no words")
    if not _is_path(path, least):
        report.add(f"{place}.path", "wrong-type", "not a list of two viewpoints or more")
        return
    if any(a == b for a, b in pairwise(path)):
        report.add(f"{place}.path", "duplicate-viewpoint", "a viewpoint is repeated in succession")
    if graph is not None:
        _check_graph(report, place, item, graph)


def _check_graph(report: LintReport, place: str, item: dict[str, Any], graph: GraphPathfinder) -> None:
    unknown = [viewpoint for viewpoint in item["path"] if viewpoint not in graph.graph.ids]
    if unknown:
        report.add(f"{place}.path", "unknown-viewpoint", unknown[0])
        return
    try:
        length = graph.path_length(item["path"])
    except CondVLNError as error:
        report.add(f"{place}.path", "path-disconnected", error.what)
        return
    told = item.get("distance")
    if "distance" in item and (not is_number(told) or not abs(float(told or 0) - length) <= _DISTANCE):
        report.add(f"{place}.distance", "distance-differs", f"{told!r}, the graph has {length:.2f} m")
