"""Evaluation in the discrete setting of Matterport3DSimulator: paths over the viewpoints of a connectivity graph.

The definitions are those of R2R's ``eval.py``: distances are shortest paths in the graph, an episode succeeds if its
last viewpoint is less than 3 m from the goal, and there is no STOP flag. nDTW and CLS use the same distances, as the
evaluators of discrete agents do.

If an R2R file belongs to an export, its manifest gives the branches and axes. Another R2R file gets R2R's own measures,
grouped by scan.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any, Final, NoReturn

import numpy as np
from pydantic import BaseModel, StrictInt, StrictStr, TypeAdapter, ValidationError

from condvln.evaluation.evaluate import AXES, SWEPT, Evaluation, columns_of
from condvln.evaluation.measures import (
    FIDELITY_DISTANCE,
    NO_LEAF,
    committed_leaf,
    dtw_of_costs,
    length_weighted,
    prefix_in_order,
    spl,
)
from condvln.evaluation.predictions import GraphPrediction
from condvln.evaluation.score import Score, ScoreRules, branch_measures
from condvln.evaluation.task import Task
from condvln.export.viewpoints import ERROR_MARGIN
from condvln.formats.json_entries import document
from condvln.navigation.graph_pathfinder import GraphPathfinder
from schemas.errors import FormatError, MissingFileError

__all__ = [
    "ERROR_MARGIN",
    "GraphBranches",
    "GraphEpisode",
    "GraphSplit",
    "evaluate_graph",
    "r2r_file",
    "read_graph_episodes",
]

NAN: Final = float("nan")
_R2R_REMEDY: Final = "Name an R2R file: [{path_id, scan, path, instructions}, ...]"


@dataclass(frozen=True)
class GraphEpisode:
    """One instruction of an R2R file, with its path."""

    instruction_id: str
    scan: str
    path: tuple[str, ...]
    branches: GraphBranches | None = None
    """Viewpoints of the leaves; None if no manifest is known."""


@dataclass(frozen=True)
class GraphBranches:
    """The goal viewpoints of all leaves of a task, and the subgoal viewpoints on its gold path."""

    task: Task
    leaves: tuple[str, ...]
    subgoals: tuple[str, ...]


_UNDEFINED: Final[dict[str, Any]] = {item.name: NAN for item in fields(Score)}


class _R2RPath(BaseModel):
    """An entry of an R2R file."""

    path_id: StrictInt | StrictStr
    scan: StrictStr
    path: tuple[StrictStr, ...]
    instructions: list[Any]


_R2R_PATHS: Final = TypeAdapter(list[_R2RPath])


def read_graph_episodes(path: Path) -> list[GraphEpisode]:
    """Read the instructions of an R2R file; their ids are ``<path_id>_<number>``.

    Raises
    ------
    FormatError : the file is not an R2R file
    """
    try:
        records = _R2R_PATHS.validate_python(document(path))
    except ValidationError as error:
        first = error.errors()[0]
        place, _, key = ".".join(map(str, first["loc"])).partition(".")
        _refuse(path, f"entry {place}" if place else "", f"{key}: {first['msg']}".removeprefix(": "), _R2R_REMEDY)
    found = [
        GraphEpisode(f"{one.path_id}_{k}", one.scan, one.path) for one in records for k in range(len(one.instructions))
    ]
    times = Counter(episode.instruction_id for episode in found)
    twice = next((name for name, count in times.items() if count > 1), None)
    if twice is not None:
        _refuse(path, f"instruction {twice}", "two entries have its path_id", _R2R_REMEDY)
    return found


def evaluate_graph(
    episodes: Iterable[GraphEpisode],
    predictions: Iterable[GraphPrediction],
    graphs: Mapping[str, GraphPathfinder],
    *,
    margin: float = ERROR_MARGIN,
    where: str = "",
) -> dict[str, Score]:
    """Return the scores by instruction id; instructions without a prediction, or with an empty one, count as failures.

    ``path_length`` joins viewpoints without a common edge, which ``gaps`` counts, by the shortest path; it is NaN where
    there is none. ``spl_route`` uses the length of the reference path, which includes the subgoals. BSA and CSR use
    graph distances and the same margin. What needs actions is NaN, and so is the navigation error of a goal that can't
    be reached.

    Raises
    ------
    FormatError : an unknown instruction or viewpoint, a path that begins elsewhere, an episode without a path
    """
    tasks = {episode.instruction_id: episode for episode in episodes}
    for task in tasks.values():
        astray = [viewpoint for viewpoint in task.path if viewpoint not in graphs[task.scan].numbers]
        if astray or not task.path:
            what = f"no viewpoint {astray[0]!r} in scan {task.scan}" if astray else "its reference path is empty"
            _refuse("", f"instruction {task.instruction_id}", what)
    found: dict[str, Score] = {}
    for prediction in predictions:
        episode = tasks.get(prediction.instruction_id)
        if episode is None:
            _refuse(where, f"instruction {prediction.instruction_id}", "no such instruction in this split")
        graph = graphs[episode.scan]
        unknown = [viewpoint for viewpoint in prediction.viewpoints if viewpoint not in graph.numbers]
        if unknown:
            _refuse(
                where, f"instruction {prediction.instruction_id}", f"no viewpoint {unknown[0]!r} in scan {episode.scan}"
            )
        if prediction.viewpoints and prediction.viewpoints[0] != episode.path[0]:
            _refuse(
                where,
                f"instruction {prediction.instruction_id}",
                "the path begins at another viewpoint than the episode",
            )
        found[episode.instruction_id] = _score(episode, prediction.viewpoints, graph, margin)
    return {name: found.get(name) or _score(task, (), graphs[task.scan], margin) for name, task in tasks.items()}


def _score(episode: GraphEpisode, viewpoints: tuple[str, ...], graph: GraphPathfinder, margin: float) -> Score:
    reference = [graph.numbers[viewpoint] for viewpoint in episode.path]
    missing = not viewpoints
    path = [graph.numbers[viewpoint] for viewpoint in viewpoints or episode.path[:1]]
    to_goal = graph.between(path, reference[-1:])[:, 0]
    length = graph.along(path)
    error = float(to_goal[-1])
    success = not missing and error < margin
    costs = graph.between(path, reference)
    fidelity = 0.0 if missing else float(np.exp(-dtw_of_costs(costs) / (len(reference) * FIDELITY_DISTANCE)))
    coverage = float(np.exp(-costs.min(axis=0) / FIDELITY_DISTANCE).mean())
    reference_length = graph.along(reference)
    found = {
        "path_length": length if np.isfinite(length) else NAN,
        "navigation_error": error if np.isfinite(error) else NAN,
        "unreachable": float(not np.isfinite(error)),
        "success": float(success),
        "oracle_success": float(not missing and (to_goal < margin).any()),
        "spl": spl(success, float(graph.between(reference[:1], reference[-1:])[0, 0]), length),
        "ndtw": fidelity,
        "sdtw": success * fidelity,
        "cls": 0.0 if missing else length_weighted(coverage, reference_length, length),
        "missing": float(missing),
        "spl_route": spl(success, reference_length, length),
        "gaps": float(graph.gaps(path)),
    }
    branches = _branching(episode.branches, path, graph, margin, success=success, missing=missing)
    return Score(**(_UNDEFINED | found | branches))


def _branching(
    branches: GraphBranches | None,
    path: Sequence[int],
    graph: GraphPathfinder,
    margin: float,
    *,
    success: bool,
    missing: bool,
) -> dict[str, float]:
    if branches is None:
        return {}
    reached, count = 0, len(branches.subgoals)
    if not missing:
        near = graph.between(path, [graph.numbers[viewpoint] for viewpoint in branches.subgoals]) < margin
        reached = prefix_in_order(count, lambda k, at: next((p for p in range(at, len(near)) if near[p, k]), None))
    leaf = NO_LEAF
    if not missing:
        ends = [graph.numbers[viewpoint] for viewpoint in branches.leaves]
        leaf = committed_leaf(graph.between(path[-1:], ends)[0].tolist(), margin)
    return branch_measures(branches.task, reached, leaf, success)


def _refuse(where: str | Path, place: str, what: str, remedy: str = "See docs/metrics.md") -> NoReturn:
    raise FormatError(what, where=where or None, place=place, remedy=remedy)


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
        # An export has each text three times, as R2R's evaluator asks for; they are one episode.
        self._first: dict[str, str] = {}
        for episode in episodes:
            path_id = episode.instruction_id.rsplit("_", 1)[0]
            if path_id in known:
                self._first[episode.instruction_id] = f"{path_id}_0"
        episodes = [e for e in episodes if self._first.get(e.instruction_id, e.instruction_id) == e.instruction_id]
        of_episode = [known.get(episode.instruction_id.rsplit("_", 1)[0]) for episode in episodes]
        self._episodes = [_with_branches(e, t, graphs) for e, t in zip(episodes, of_episode, strict=True)]
        self._of_episode = of_episode
        self._graphs = graphs
        self.tasks = [task for task in of_episode if task is not None]

    def evaluate(
        self, predictions: Sequence[GraphPrediction], *, agent: str, where: str = "", radii: Sequence[float] = ()
    ) -> Evaluation:
        """Score one agent's predictions, also at the success distances ``radii`` (metres). The first of several
        predictions for one text of an export counts.

        Raises
        ------
        FormatError : an instruction or viewpoint is unknown, or a path begins elsewhere
        """
        judged: dict[str, GraphPrediction] = {}
        for prediction in predictions:
            name = self._first.get(prediction.instruction_id, prediction.instruction_id)
            judged.setdefault(name, replace(prediction, instruction_id=name))
        spare = len(predictions) - len(judged)
        scores, *swept = (
            list(evaluate_graph(self._episodes, judged.values(), self._graphs, margin=margin, where=where).values())
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
            columns_of(scores, [*_UNDEFINED]),
            {radius: columns_of(rows, SWEPT) for radius, rows in zip(radii, swept, strict=True)},
            (f"{spare} predictions for texts that the file has again were left out",) if spare else (),
        )

    def _axis(self, row: int, axis: str) -> str | int | None:
        task, scan = self._of_episode[row], self._episodes[row].scan
        if task is not None:
            return task.axes[axis]
        return {"source": "R2R", "scene": scan}.get(axis)


def _with_branches(episode: GraphEpisode, task: Task | None, graphs: Mapping[str, GraphPathfinder]) -> GraphEpisode:
    if task is None:
        return episode
    graph = graphs[episode.scan]
    leaves = [graph.viewpoint(leaf.goals[0]) for leaf in task.leaves]
    subgoals = [graph.viewpoint(subgoal) for subgoal in task.gold.subgoals]
    if None in leaves or None in subgoals:  # the graph differs from the one that the export was made with
        return episode
    branches = GraphBranches(task, tuple(map(str, leaves)), tuple(map(str, subgoals)))
    return replace(episode, branches=branches)
