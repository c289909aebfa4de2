"""Evaluation in the discrete setting of Matterport3DSimulator: paths over the viewpoints of a connectivity graph.

The definitions are those of R2R's ``eval.py``: distances are shortest paths in the graph, an episode succeeds if its
last viewpoint is less than 3 m from the goal, and there is no STOP flag. nDTW and CLS use the same distances, as the
evaluators of discrete agents do.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final, NoReturn

import numpy as np
import numpy.typing as npt
from scipy.sparse import csr_array
from scipy.sparse.csgraph import shortest_path

from condvln.evaluation.kernels.alignment import dtw_of_costs
from condvln.evaluation.measures import FIDELITY_DISTANCE, NO_LEAF, committed_leaf, length_weighted, spl
from condvln.evaluation.predictions import GraphPrediction
from condvln.export.r2r import ERROR_MARGIN
from condvln.formats.json_entries import document
from condvln.navigation.connectivity import ViewpointGraph, read_connectivity
from schemas.errors import FormatError, MissingFileError

__all__ = [
    "ERROR_MARGIN",
    "GraphBranches",
    "GraphDistances",
    "GraphEpisode",
    "GraphScore",
    "evaluate_graph",
    "read_graph_episodes",
]

NAN: Final = float("nan")
_R2R_REMEDY: Final = "Name an R2R file: [{path_id, scan, path, instructions}, ...]"
Table = npt.NDArray[np.float64]


class GraphDistances:
    """Shortest-path distances in metres between all viewpoints of a scan; infinite between viewpoints that are not
    connected.
    """

    def __init__(self, graph: ViewpointGraph) -> None:
        self.numbers = {name: number for number, name in enumerate(graph.ids)}
        # A zero would mean "no edge".
        weights = np.maximum(graph.lengths, np.finfo(float).tiny)
        count = len(graph.ids)
        edges = csr_array((weights, (graph.edges[:, 0], graph.edges[:, 1])), shape=(count, count))
        self._table: Table = shortest_path(edges, method="D", directed=False)

    @classmethod
    def load(cls, path: Path) -> GraphDistances:
        """Read the distances from ``<scan>_connectivity.json``.

        Raises
        ------
        MissingFileError, FormatError : from :func:`~condvln.navigation.connectivity.read_connectivity`
        """
        return cls(read_connectivity(path))

    def between(self, first: Sequence[int], second: Sequence[int]) -> Table:
        """Return the distances in metres from each viewpoint of `first` to each of `second`, as a table (len(first),
        len(second)).
        """
        found: Table = self._table[np.ix_(first, second)]
        return found

    def along(self, path: Sequence[int]) -> float:
        """Return the length in metres of a path, with consecutive viewpoints joined by their shortest path."""
        return float(self._table[list(path[:-1]), list(path[1:])].sum())


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
    """The goal viewpoints of all leaves, the index of the gold leaf, and the subgoal viewpoints on the gold path."""

    leaves: tuple[str, ...]
    gold_leaf: int
    subgoals: tuple[str, ...]


@dataclass(frozen=True)
class GraphScore:
    """Measures of one instruction; lengths in metres, NaN where a measure is undefined.

    ``spl_route`` uses the length of the reference path, which includes the subgoals. BSA and CSR are defined as in
    :class:`~condvln.evaluation.score.Score`, with graph distances and the same margin.
    """

    path_length: float
    navigation_error: float
    success: float
    oracle_success: float
    spl: float
    ndtw: float
    sdtw: float
    cls: float
    missing: float
    spl_route: float
    bsa: float = NAN
    csr: float = NAN
    bsa_all: float = NAN
    csr_all: float = NAN
    committed_leaf: float = NAN


def read_graph_episodes(path: Path) -> list[GraphEpisode]:
    """Read the instructions of an R2R file; their ids are ``<path_id>_<number>``.

    Raises
    ------
    FormatError : the file is not an R2R file
    """
    records = document(path)
    if not isinstance(records, list):
        _refuse(path, "", "the file is not an array of R2R paths", _R2R_REMEDY)
    found: list[GraphEpisode] = []
    for number, record in enumerate(records):
        place = f"entry {number}"
        if not isinstance(record, dict):
            _refuse(path, place, "the entry is not an object", _R2R_REMEDY)
        lacking = [key for key in ("path_id", "scan", "path", "instructions") if key not in record]
        if lacking:
            _refuse(path, place, f"the key {lacking[0]!r} is missing", _R2R_REMEDY)
        name, route = record["path_id"], record["path"]
        if isinstance(name, bool) or not isinstance(name, int | str):
            _refuse(path, place, "path_id is neither a whole number nor text", _R2R_REMEDY)
        if not isinstance(record["scan"], str):
            _refuse(path, place, "scan is not text", _R2R_REMEDY)
        if not isinstance(route, list) or not all(isinstance(viewpoint, str) for viewpoint in route):
            _refuse(path, place, "path is not a list of viewpoint ids", _R2R_REMEDY)
        if not isinstance(record["instructions"], list):
            _refuse(path, place, "instructions is not a list", _R2R_REMEDY)
        count = len(record["instructions"])
        found += [GraphEpisode(f"{name}_{k}", record["scan"], tuple(route)) for k in range(count)]
    times = Counter(episode.instruction_id for episode in found)
    twice = next((name for name, count in times.items() if count > 1), None)
    if twice is not None:
        _refuse(path, f"instruction {twice}", "two entries have its path_id", _R2R_REMEDY)
    return found


def evaluate_graph(
    episodes: Iterable[GraphEpisode],
    predictions: Iterable[GraphPrediction],
    graphs: Mapping[str, GraphDistances],
    *,
    margin: float = ERROR_MARGIN,
    where: str = "",
) -> dict[str, GraphScore]:
    """Return the scores by instruction id; instructions without a prediction, or with an empty one, count as failures.

    Raises
    ------
    MissingFileError : a scan without a graph
    FormatError : an unknown instruction or viewpoint, a path that begins elsewhere, an episode without a path
    """
    tasks = {episode.instruction_id: episode for episode in episodes}
    lacking = sorted({episode.scan for episode in tasks.values()} - set(graphs))
    if lacking:
        raise MissingFileError(
            f"connectivity graphs are missing for {len(lacking)} scans, such as {lacking[0]}",
            remedy="Name the folder of <scan>_connectivity.json files",
        )
    for task in tasks.values():
        astray = [viewpoint for viewpoint in task.path if viewpoint not in graphs[task.scan].numbers]
        if astray or not task.path:
            what = f"no viewpoint {astray[0]!r} in scan {task.scan}" if astray else "its reference path is empty"
            _refuse("", f"instruction {task.instruction_id}", what)
    found: dict[str, GraphScore] = {}
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


def _score(episode: GraphEpisode, viewpoints: tuple[str, ...], graph: GraphDistances, margin: float) -> GraphScore:
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
    return GraphScore(
        path_length=length,
        navigation_error=error,
        success=float(success),
        oracle_success=float(not missing and (to_goal < margin).any()),
        spl=spl(success, float(graph.between(reference[:1], reference[-1:])[0, 0]), length),
        ndtw=fidelity,
        sdtw=success * fidelity,
        cls=0.0 if missing else length_weighted(coverage, reference_length, length),
        missing=float(missing),
        spl_route=spl(success, reference_length, length),
        **_branching(episode.branches, path, graph, margin, success=success, missing=missing),
    )


def _branching(
    branches: GraphBranches | None,
    path: Sequence[int],
    graph: GraphDistances,
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
        for row in near:
            while reached < count and row[reached]:
                reached += 1
    bsa_all = reached / count if count else float(success)
    bsa = bsa_all if count or success else NAN
    leaf = NO_LEAF
    if not missing:
        ends = [graph.numbers[viewpoint] for viewpoint in branches.leaves]
        leaf = committed_leaf(graph.between(path[-1:], ends)[0].tolist(), margin)
    return {
        "bsa": bsa,
        "csr": NAN if np.isnan(bsa) else float(success and bsa == 1.0),
        "bsa_all": bsa_all,
        "csr_all": float(success and bsa_all == 1.0),
        "committed_leaf": float(leaf),
    }


def _refuse(where: str | Path, place: str, what: str, remedy: str = "See docs/metrics.md") -> NoReturn:
    raise FormatError(what, where=where or None, place=place, remedy=remedy)
