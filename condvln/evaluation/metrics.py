"""The metrics: one entry each, from which lists of measures, columns of tables and leaderboard, and the names in other
evaluators' files are made. `condvln.evaluation.score` computes them, docs/metrics.md defines them.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, Literal

__all__ = ["METRICS", "Better", "Kind", "Metric", "Shown", "keys_of", "metrics_of"]

Kind = Literal["text", "count", "metres", "percent", "number", "p"]
Better = Literal["higher", "lower", ""]
Shown = Literal["main", "twin", "branches", "sweep", "comparison", "board", "ranking", "plots", "differences", "walks"]
OfSuccess = Literal["", "factor", "needed"]


@dataclass(frozen=True)
class Metric:
    """One metric.

    Attributes
    ----------
    key : its field of :class:`~condvln.evaluation.score.Score`
    heading, kind, better : its column's heading and number format, and which values are better
    shown : the tables that have it. ``sweep`` also says that it depends on the success distance; ``board`` is a
        leaderboard's file, ``ranking`` what it prints; ``differences`` and ``walks`` are on the explorer's page
    theirs : its names in other evaluators' results
    yes_or_no : it is 0 or 1 for each episode
    success : whether the success is a factor of it, or is needed to define it
    """

    key: str
    heading: str
    kind: Kind
    better: Better
    shown: tuple[Shown, ...]
    theirs: tuple[str, ...] = ()
    yes_or_no: bool = False
    success: OfSuccess = ""


METRICS: Final = (
    Metric(
        "success",
        "SR",
        "percent",
        "higher",
        ("main", "twin", "branches", "sweep", "comparison", "board", "ranking", "plots", "differences"),
        ("success",),
        yes_or_no=True,
    ),
    Metric("spl_look", "SPL-look", "percent", "higher", ("main", "comparison", "board", "ranking"), success="factor"),
    Metric("ndtw_look", "nDTW-look", "percent", "higher", ("main", "board")),
    Metric(
        "bsa_all",
        "BSA-all",
        "percent",
        "higher",
        ("main", "twin", "sweep", "board", "plots", "differences", "walks"),
        ("bsa", "branch_subgoal_accuracy", "branch_selection_accuracy"),
        success="needed",
    ),
    Metric(
        "csr_all",
        "CSR-all",
        "percent",
        "higher",
        ("main", "twin", "sweep", "comparison", "board", "ranking", "plots"),
        ("csr", "conditional_success_rate"),
        yes_or_no=True,
        success="factor",
    ),
    Metric(
        "justified",
        "justified",
        "percent",
        "higher",
        ("main", "comparison", "board", "ranking"),
        yes_or_no=True,
        success="factor",
    ),
    Metric("path_length", "TL", "metres", "", ("main",), ("path_length",)),
    Metric("navigation_error", "NE", "metres", "lower", ("main", "twin", "walks"), ("distance_to_goal", "ne")),
    Metric(
        "oracle_success",
        "OSR",
        "percent",
        "higher",
        ("main", "twin", "sweep"),
        ("oracle_success", "os"),
        yes_or_no=True,
        success="needed",
    ),
    Metric(
        "spl", "SPL", "percent", "higher", ("main", "twin", "sweep", "comparison", "walks"), ("spl",), success="factor"
    ),
    Metric("spl_route", "SPL-route", "percent", "higher", ("main", "board", "ranking")),
    Metric("ndtw", "nDTW", "percent", "higher", ("main", "twin", "comparison", "board", "walks"), ("ndtw",)),
    Metric("sdtw", "SDTW", "percent", "higher", ("main",), ("sdtw",), success="factor"),
    Metric("cls", "CLS", "percent", "higher", ("main",), ("cls",)),
    Metric("sdtw_look", "SDTW-look", "percent", "higher", ("board",), success="factor"),
    Metric("cls_look", "CLS-look", "percent", "higher", ("board",)),
    Metric("bsa", "BSA (paper)", "percent", "higher", ("main",)),
    Metric("csr", "CSR (paper)", "percent", "higher", ("main", "twin")),
    Metric(
        "leaf_correct",
        "right leaf",
        "percent",
        "higher",
        ("branches", "sweep", "comparison", "board", "ranking", "differences"),
    ),
    Metric("wrong_branch", "wrong branch", "percent", "lower", ("branches", "board")),
    Metric("no_commit", "no commit", "percent", "lower", ("branches", "board")),
    Metric("stopped", "stopped", "percent", "", ("branches",)),
    Metric("steps", "steps", "number", "", ("branches",), ("steps", "steps_taken")),
    Metric("collisions", "collisions", "number", "lower", ("branches",), ("collisions",)),
    Metric("unreachable", "unreachable", "percent", "", ("branches",)),
    Metric("over_budget", "over budget", "percent", "", ("branches",)),
    Metric("missing", "missing", "percent", "", ("branches",)),
    Metric("gaps", "gaps", "number", "lower", ("branches",)),
    Metric("off_navmesh", "off navmesh", "number", "lower", ("branches",)),
)
"""All metrics, in the order of the tables."""


def metrics_of(table: Shown) -> tuple[Metric, ...]:
    """Return the metrics that a table has."""
    return tuple(metric for metric in METRICS if table in metric.shown)


def keys_of(table: Shown) -> tuple[str, ...]:
    """Return the keys of the metrics that a table has."""
    return tuple(metric.key for metric in metrics_of(table))
