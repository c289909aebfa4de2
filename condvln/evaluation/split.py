"""Evaluate prediction files against a split of an export: one evaluation per agent."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from condvln.evaluation.episode_stats import evaluation_of_stats, is_episode_stats, read_episode_stats
from condvln.evaluation.evaluate import Evaluation, evaluate
from condvln.evaluation.graph_split import GraphSplit, r2r_file
from condvln.evaluation.predictions import detect_format, read_graph_predictions, read_predictions
from condvln.evaluation.score import ScoreRules
from condvln.evaluation.stock_split import stock_episodes, stock_file
from condvln.evaluation.task import Task, read_tasks
from condvln.manifest import manifest_path, manifest_paths
from condvln.navigation.graph_pathfinder import GraphFolder
from condvln.navigation.navmesh_folder import NavmeshFolder
from schemas.errors import MissingFileError, UsageError

__all__ = ["SplitOptions", "evaluate_split", "split_tasks"]


@dataclass(frozen=True)
class SplitOptions:
    """How prediction files are read and scored."""

    rules: ScoreRules = field(default_factory=ScoreRules)
    radii: tuple[float, ...] = ()
    """Success distances of a sweep, metres."""
    navmesh_roots: tuple[Path, ...] = ()
    """Folders of the datasets whose navmeshes the export does not contain."""
    assume_stop: bool = False
    connectivity: tuple[Path, ...] = ()
    """Folders of ``<scan>_connectivity.json``, for paths over viewpoints."""


def split_tasks(export: Path, split: str) -> list[Task]:
    """Return the tasks of one split of an export, with the split's dense ground-truth paths.

    Raises
    ------
    MissingFileError : the export has no such split
    """
    manifest = manifest_path(export, split)
    if not manifest.is_file():
        there = [path.stem for path in manifest_paths(export)]
        raise MissingFileError(
            f"the export has no split {split!r}",
            where=manifest,
            remedy=f"Existing splits: {', '.join(there) or 'none'}",
        )
    truth = export / "vlnce" / split / f"{split}_gt.json.gz"
    return list(read_tasks(manifest, truth if truth.is_file() else None))


def evaluate_split(
    export: Path, split: str, predictions: Sequence[Path], options: SplitOptions | None = None
) -> tuple[list[Evaluation], list[Task]]:
    """Evaluate each prediction file (or folder of ``stats_*.json``); agents are named after the files.

    Paths over viewpoints are scored against the split's R2R file; the returned tasks are then those in this file.

    Raises
    ------
    UsageError : two files have the same name; the call mixes paths in space and over viewpoints; an option for paths in
        space is used for paths over viewpoints
    InputError : from the readers
    """
    options = options or SplitOptions()
    names = [path.name.removesuffix(".gz").removesuffix(".json").removesuffix(".jsonl") for path in predictions]
    if len(set(names)) != len(names):
        raise UsageError(
            "two prediction files have the same name", remedy="Agents are named after their files: rename one"
        )
    discrete = [not is_episode_stats(path) and detect_format(path) == "r2r" for path in predictions]
    if all(discrete):
        if options.rules != ScoreRules() or options.assume_stop:
            raise UsageError(
                "some options do not apply to paths over viewpoints, which are scored by R2R's rules",
                remedy="Leave out the options for distances, nDTW and STOP.",
            )
        return _evaluate_discrete(export, split, dict(zip(names, predictions, strict=True)), options)
    if any(discrete):
        raise UsageError(
            "some predictions are paths in space, others paths over viewpoints",
            remedy="They are judged by different rules: evaluate them in two calls",
        )
    stock = None if manifest_paths(export) else stock_file(export, split)
    if stock is not None:
        return _evaluate_stock(stock, dict(zip(names, predictions, strict=True))), []
    tasks = split_tasks(export, split)
    navmeshes = NavmeshFolder((export, *options.navmesh_roots))
    found = []
    for name, path in zip(names, predictions, strict=True):
        if is_episode_stats(path):
            found.append(evaluation_of_stats(tasks, read_episode_stats(path), agent=name, where=str(path)))
            continue
        handed_in = read_predictions(path, assume_stop=options.assume_stop)
        found.append(
            evaluate(tasks, handed_in, navmeshes, options.rules, agent=name, where=str(path), radii=options.radii)
        )
    return found, tasks


def _evaluate_stock(stock: Path, predictions: Mapping[str, Path]) -> list[Evaluation]:
    """Evaluate per-episode results of a split that has no manifest, such as a split of R2R_VLNCE."""
    episodes = stock_episodes(stock)
    for path in predictions.values():
        if not is_episode_stats(path):
            raise UsageError(
                "this split has no manifest, which would name the navmesh on which paths are scored",
                where=path,
                remedy="Give per-episode results instead: stats_<id>.json or {id: {measure: number}}",
            )
    return [
        evaluation_of_stats(episodes, read_episode_stats(path), agent=name, where=str(path))
        for name, path in predictions.items()
    ]


def _evaluate_discrete(
    export: Path, split: str, predictions: Mapping[str, Path], options: SplitOptions
) -> tuple[list[Evaluation], list[Task]]:
    file = r2r_file(export, split)
    known = split_tasks(export, split) if manifest_paths(export) else []
    graph_split = GraphSplit(file, known, GraphFolder(*options.connectivity))
    found = [
        graph_split.evaluate(list(read_graph_predictions(path)), agent=name, where=str(path), radii=options.radii)
        for name, path in predictions.items()
    ]
    return found, graph_split.tasks
