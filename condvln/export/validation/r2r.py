"""Checks of discrete R2R files, also against the scans' graphs if given."""

from __future__ import annotations

import math
from collections.abc import Mapping
from itertools import pairwise
from typing import Any, Final

from condvln.export.validation.document import check_keys, is_number
from condvln.export.validation.findings import LintReport
from condvln.navigation.graph_pathfinder import GraphPathfinder
from schemas.errors import CondVLNError

__all__ = ["check_r2r"]

_REQUIRED: Final = frozenset({"scan", "path_id", "path", "heading", "instructions"})
_ALLOWED: Final = _REQUIRED | {"distance"}
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
        keys = _ALLOWED | set(item) if isinstance(item, dict) else _ALLOWED
        if not check_keys(report, place, item, _REQUIRED, frozenset(keys)):
            continue
        report.episode = str(item["path_id"])
        place = f"path {report.episode}"
        if str(item["path_id"]) in seen:
            report.add(place, "duplicate-id", "occurs twice")
        seen.add(str(item["path_id"]))
        scans.add(str(item["scan"]))
        _check(report, place, item, (graphs or {}).get(str(item["scan"])), least=1 if withheld else 2)
    return scans


def _is_withheld(item: Any) -> bool:
    """Return whether an item states only the first viewpoint of its path, as every item of R2R's test split does."""
    return (
        isinstance(item, dict) and "distance" not in item and _is_path(item.get("path"), 1) and len(item["path"]) == 1
    )


def _is_path(value: Any, least: int) -> bool:
    """Return whether a value is a list of at least ``least`` viewpoint ids; any text counts as an id."""
    return isinstance(value, list) and len(value) >= least and all(isinstance(one, str) for one in value)


def _check(report: LintReport, place: str, item: dict[str, Any], graph: GraphPathfinder | None, *, least: int) -> None:
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
