"""What agents did: the outcome of each episode, walks with the distance to the goal at each pose, tables for the page,
and how much better one agent is than another.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import permutations
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from condvln.evaluation.aggregate import estimate
from condvln.evaluation.evaluate import Evaluation
from condvln.evaluation.metrics import keys_of, metrics_of
from condvln.evaluation.predictions import Prediction
from condvln.evaluation.render import as_document, written
from condvln.evaluation.tables import Cell, Column, Table
from condvln.navigation.protocol import PathfinderProtocol
from schemas.base import Json

__all__ = ["OUTCOMES", "AgentResults", "difference_table", "outcomes", "table_document", "walk_document"]

OUTCOMES: Final = ("not scored", "success", "wrong branch", "no commit", "right leaf, failed", "no prediction")
"""What became of an episode. The page lists them in this order; an agent has a number of them per episode."""
_SHOWN: Final = (*keys_of("walks"), "committed_leaf")


@dataclass(frozen=True, eq=False)
class AgentResults:
    """One agent's scores on one split.

    episodes : by episode id, the number of the outcome and the shown scores
    """

    name: str
    split: str
    episodes: dict[str, tuple[int, Json]]

    @classmethod
    def of(cls, evaluation: Evaluation, split: str) -> AgentResults:
        """Return the results of an evaluation."""
        numbers = outcomes(evaluation)
        rows = {}
        for k, name in enumerate(evaluation.episode_ids):
            scores = {measure: _finite(evaluation.scores[measure][k]) for measure in _SHOWN}
            rows[name] = (int(numbers[k]), scores)
        return cls(evaluation.agent, split, rows)


def outcomes(evaluation: Evaluation) -> NDArray[np.int64]:
    """Return, for each episode, the index of its outcome in :data:`OUTCOMES`, (n,)."""
    scores = evaluation.scores
    cases = [
        (scores["missing"] == 1, "no prediction"),
        (scores["success"] == 1, "success"),
        (scores["wrong_branch"] == 1, "wrong branch"),
        (scores["no_commit"] == 1, "no commit"),
    ]
    numbers = [OUTCOMES.index(name) for _, name in cases]
    return np.select([mask for mask, _ in cases], numbers, OUTCOMES.index("right leaf, failed")).astype(np.int64)


def walk_document(
    prediction: Prediction, goals: Sequence[Sequence[float]], pathfinder: PathfinderProtocol | None
) -> Json:
    """Return an agent's walk of one episode.

    Parameters
    ----------
    goals : goal points of the gold leaf, metres
    pathfinder : measures geodesic distances; without it the page shows straight ones

    Returns
    -------
    ``path``: x, y, z of each pose, metres; ``distance``: metres to the nearest goal from each pose, null where no way
    leads there; ``headings``: degrees clockwise from north, where the file has them; ``stopped``.
    """
    positions = np.asarray(prediction.positions, dtype=np.float64)
    distances = _distances(positions, np.asarray(goals, dtype=np.float64), pathfinder)
    headings = prediction.headings
    return {
        "path": np.round(positions, 2).tolist(),
        "distance": [_finite(value, 2) for value in distances],
        "geodesic": pathfinder is not None,
        "stopped": prediction.stopped,
        "headings": None if headings is None else np.round(-np.degrees(headings) % 360.0).tolist(),
    }


def _distances(
    positions: NDArray[np.float64], goals: NDArray[np.float64], pathfinder: PathfinderProtocol | None
) -> NDArray[np.float64]:
    if not len(positions):
        return np.zeros(0)
    if pathfinder is None:
        apart = np.linalg.norm(positions[:, None] - goals[None], axis=2)
        return np.asarray(apart.min(axis=1))
    once, back = np.unique(positions, axis=0, return_inverse=True)  # turning does not change the position
    nearest: NDArray[np.float64] = np.asarray(pathfinder.distance_table(once, goals), dtype=np.float64).min(axis=1)
    return nearest[back.ravel()]


def _finite(value: float, decimals: int = 4) -> float | None:
    return round(float(value), decimals) if np.isfinite(value) else None


AXES: Final = ("category", "depth", "chain", "source", "observability")
MEASURES: Final = metrics_of("differences")


def difference_table(evaluations: Sequence[Evaluation]) -> Table:
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
        *(Column(one.key, f"difference in {one.heading}", "percent") for one in MEASURES),
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
                rows.append(_row(first, second, axis or "all", value, chosen))
    note = (
        "Differences are in percentage points, over the same episodes. In brackets: 95 % intervals, scenes drawn with "
        "replacement; with one scene there is none."
    )
    return Table("differences", "How much better one agent is", columns, tuple(rows), note, blocks=3)


def _row(first: Evaluation, second: Evaluation, axis: str, value: str, chosen: NDArray[np.bool_]) -> tuple[Cell, ...]:
    scenes = first.axes["scene"][chosen].astype(str)
    own, other = (float(np.nanmean(one.scores["success"][chosen])) for one in (first, second))
    found = [
        estimate(first.scores[name][chosen] - second.scores[name][chosen], scenes) for name in keys_of("differences")
    ]
    cells = [Cell(one.mean, one.low, one.high, one.n, one.total) for one in found]
    total = int(chosen.sum())
    return (
        Cell(first.agent), Cell(second.agent), Cell(axis), Cell(value), Cell(own), Cell(other), *cells,
        Cell(total), Cell(len(set(scenes.tolist()))),
    )  # fmt: skip


def table_document(table: Table, split: str) -> dict[str, Any]:
    """Return a table of one split.

    Returns
    -------
    What :func:`~condvln.evaluation.render.as_document` returns, the ``split``, ``headings`` (a heading of numbers
    begins with ``#``), and ``cells``, the rows as texts, with the same digits as in Markdown.
    """
    marks = {"higher": " ↑", "lower": " ↓", "": ""}
    headings = [
        f"{'' if column.kind == 'text' else '#'}{column.heading}{', m' if column.kind == 'metres' else ''}"
        f"{marks[column.better]}"
        for column in table.columns
    ]
    cells = [[written(cell, column) for cell, column in zip(row, table.columns, strict=True)] for row in table.rows]
    return {**as_document(table), "split": split, "headings": headings, "cells": cells}
