"""Evaluate viewpoint predictions against an R2R file: one evaluation per agent, for the discrete tables.

If the file belongs to an export, its manifest gives the branches and axes. Another R2R file gets R2R's own measures,
grouped by scan.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import fields, replace
from pathlib import Path
from typing import Final

import numpy as np

from condvln.evaluation.discrete import (
    ERROR_MARGIN,
    GraphBranches,
    GraphDistances,
    GraphEpisode,
    GraphScore,
    evaluate_graph,
    read_graph_episodes,
)
from condvln.evaluation.evaluate import AXES, SWEPT, Evaluation
from condvln.evaluation.measures import NO_LEAF, first_divergence
from condvln.evaluation.predictions import GraphPrediction
from condvln.evaluation.score import Score, ScoreRules
from condvln.evaluation.task import Task
from condvln.navigation.graph_pathfinder import GraphPathfinder
from schemas.errors import MissingFileError

__all__ = ["GraphSplit", "r2r_file"]

NAN: Final = float("nan")


def r2r_file(export: Path, split: str) -> Path:
    """Return the R2R file of a split, in an export or in a folder of R2R's own files.

    Raises
    ------
    MissingFileError : the split has no R2R file
    """
    name = f"R2R_{split}.json"
    found = next((path for path in (export / "r2r" / name, export / name) if path.is_file()), None)
    if found is None:
        raise MissingFileError(
            "the file does not exist, but it is needed to score paths over viewpoints",
            where=export / "r2r" / name,
            remedy="Set 'connectivity' of the mp3d source and generate again: only such exports hold it",
        )
    return found


class GraphSplit:
    """One R2R split.

    Parameters
    ----------
    tasks : tasks of the split's manifest, if it is known
    graphs : connectivity by scan

    Attributes
    ----------
    tasks : the tasks that are in the R2R file, in its order; empty for a file that is not ours

    Raises
    ------
    MissingFileError : a scan has no graph
    FormatError : the file is not an R2R file
    """

    def __init__(self, file: Path, tasks: Iterable[Task], graphs: Mapping[str, GraphPathfinder]) -> None:
        known = {name: task for task in tasks for name in (task.episode_id, *task.aliases)}
        episodes = read_graph_episodes(file)
        lacking = sorted({episode.scan for episode in episodes} - set(graphs))
        if lacking:
            raise MissingFileError(
                f"connectivity graphs are missing for {len(lacking)} scans, such as {lacking[0]}",
                where=file,
                remedy="Name the folder of <scan>_connectivity.json files with --connectivity",
            )
        of_episode = [known.get(episode.instruction_id.rsplit("_", 1)[0]) for episode in episodes]
        self._episodes = [_with_branches(e, t, graphs) for e, t in zip(episodes, of_episode, strict=True)]
        self._of_episode = of_episode
        self._distances = {scan: GraphDistances(graphs[scan].graph) for scan in {e.scan for e in episodes}}
        self.tasks = [task for task in of_episode if task is not None]

    def evaluate(
        self, predictions: Sequence[GraphPrediction], *, agent: str, where: str = "", radii: Sequence[float] = ()
    ) -> Evaluation:
        """Score one agent's predictions, also at the success distances ``radii`` (metres).

        Raises
        ------
        FormatError : an instruction or viewpoint is unknown, or a path begins elsewhere
        """
        scores, *swept = (
            list(evaluate_graph(self._episodes, predictions, self._distances, margin=margin, where=where).values())
            for margin in (ERROR_MARGIN, *radii)
        )
        of_episode = self._of_episode
        return Evaluation(
            agent,
            ScoreRules(success_distance=ERROR_MARGIN),
            tuple(episode.instruction_id for episode in self._episodes),
            tuple(task.group_id if task is not None else None for task in of_episode),
            {axis: np.array([self._axis(row, axis) for row in range(len(of_episode))], dtype=object) for axis in AXES},
            np.array([task.gold_leaf if task is not None else NO_LEAF for task in of_episode], dtype=np.int64),
            np.array([len(task.leaves) if task is not None else 0 for task in of_episode], dtype=np.int64),
            self._columns(scores, [item.name for item in fields(Score)]),
            {radius: self._columns(rows, SWEPT) for radius, rows in zip(radii, swept, strict=True)},
        )

    def _axis(self, row: int, axis: str) -> str | int | None:
        task, scan = self._of_episode[row], self._episodes[row].scan
        if task is not None:
            return task.axes[axis]
        return {"source": "R2R", "scene": scan}.get(axis)

    def _columns(self, scores: Sequence[GraphScore], names: Sequence[str]) -> dict[str, np.ndarray]:
        rows = [_row(score, task) for score, task in zip(scores, self._of_episode, strict=True)]
        return {name: np.array([row.get(name, NAN) for row in rows], dtype=np.float64) for name in names}


def _with_branches(episode: GraphEpisode, task: Task | None, graphs: Mapping[str, GraphPathfinder]) -> GraphEpisode:
    if task is None:
        return episode
    graph = graphs[episode.scan]
    leaves = [graph.viewpoint(leaf.goals[0]) for leaf in task.leaves]
    subgoals = [graph.viewpoint(subgoal) for subgoal in task.gold.subgoals]
    if None in leaves or None in subgoals:  # the graph differs from the one that the export was made with
        return episode
    branches = GraphBranches(tuple(map(str, leaves)), task.gold_leaf, tuple(map(str, subgoals)))
    return replace(episode, branches=branches)


def _row(score: GraphScore, task: Task | None) -> dict[str, float]:
    """Return a score as a table row, under the names that its measures have in continuous space; an infinite navigation
    error becomes undefined (NaN). With a `task`, the row also says which leaf was reached.
    """
    unreachable = not np.isfinite(score.navigation_error)
    row = {item.name: float(getattr(score, item.name)) for item in fields(score)}
    row |= {"navigation_error": NAN if unreachable else row["navigation_error"], "unreachable": float(unreachable)}
    if task is None or np.isnan(score.committed_leaf):
        return row
    leaf = int(score.committed_leaf)
    divergence = first_divergence(task.program, task.gold_leaf, leaf)
    return row | {
        "leaf_correct": float(leaf == task.gold_leaf),
        "wrong_branch": float(leaf not in (task.gold_leaf, NO_LEAF)),
        "no_commit": float(leaf == NO_LEAF),
        "divergence": NAN if divergence is None else float(divergence),
    }
