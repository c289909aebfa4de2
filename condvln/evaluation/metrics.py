"""The metrics: one row of ``metrics.csv`` each, from which lists of measures, columns of tables and leaderboard, and
names in other evaluators' files are made. `condvln.evaluation.score` computes them, docs/metrics.md defines them.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, Literal

from condvln.own_tables import own_rows

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


def _read() -> tuple[Metric, ...]:
    listed, said = ("shown", "theirs"), ("yes_or_no",)
    return tuple(
        Metric(
            **row | {name: tuple(row[name].split()) for name in listed} | {name: row[name] == "yes" for name in said}
        )
        for row in own_rows("condvln.evaluation", "metrics.csv")
    )


METRICS: Final = _read()
"""All metrics, in the order of the tables."""


def metrics_of(table: Shown) -> tuple[Metric, ...]:
    """Return the metrics that a table has."""
    return tuple(metric for metric in METRICS if table in metric.shown)


def keys_of(table: Shown) -> tuple[str, ...]:
    """Return the keys of the metrics that a table has."""
    return tuple(metric.key for metric in metrics_of(table))
