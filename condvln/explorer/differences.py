"""How much better one agent is than another, in all and by category, depth and chain, with intervals."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import permutations
from typing import Final

import numpy as np
from numpy.typing import NDArray

from condvln.evaluation.evaluate import Evaluation
from condvln.evaluation.statistics import estimate
from condvln.evaluation.tables import Cell, Column, Table

__all__ = ["difference_table"]

AXES: Final = ("category", "depth", "chain", "source", "observability")
MEASURES: Final = (("success", "SR"), ("leaf_correct", "right leaf"), ("bsa_all", "BSA-all"))


def difference_table(evaluations: Sequence[Evaluation], *, seed: int = 0) -> Table:
    """Return the differences between each two agents over the episodes of a split that both were scored on. It has no
    rows if the agents were scored on different episodes.

    An interval resamples scenes, as in the main table; it needs at least two scenes.
    """
    columns = (
        Column("first", "agent", "text"),
        Column("second", "against", "text"),
        Column("axis", "by", "text"),
        Column("value", "value", "text"),
        Column("own", "its SR", "percent"),
        Column("other", "the other's SR", "percent"),
        *(Column(name, f"difference in {title}", "percent") for name, title in MEASURES),
        Column("episodes", "n", "count"),
        Column("scenes", "scenes", "count"),
    )
    rows = []
    for first, second in permutations(evaluations, 2):
        if first.episode_ids != second.episode_ids:
            continue
        for axis in ("", *AXES):
            values = first.axes[axis].tolist() if axis else ["all"] * len(first)
            for value in sorted({str(value) for value in values if value is not None}):
                chosen = np.array([str(one) == value for one in values], dtype=bool)
                rows.append(_row(first, second, axis or "all", value, chosen, seed))
    note = (
        "Differences are in percentage points, over the same episodes. In brackets: 95 % intervals, scenes drawn with "
        "replacement; with one scene there is none."
    )
    return Table("differences", "How much better one agent is", columns, tuple(rows), note, blocks=3)


def _row(
    first: Evaluation, second: Evaluation, axis: str, value: str, chosen: NDArray[np.bool_], seed: int
) -> tuple[Cell, ...]:
    scenes = first.axes["scene"][chosen].astype(str)
    own, other = (float(np.nanmean(one.scores["success"][chosen])) for one in (first, second))
    found = [
        estimate(first.scores[name][chosen] - second.scores[name][chosen], scenes, seed=seed) for name, _ in MEASURES
    ]
    cells = [Cell(one.mean, one.low, one.high, one.n, one.total) for one in found]
    total = int(chosen.sum())
    return (
        Cell(first.agent), Cell(second.agent), Cell(axis), Cell(value), Cell(own), Cell(other), *cells,
        Cell(total), Cell(len(set(scenes.tolist()))),
    )  # fmt: skip
