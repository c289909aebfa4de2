"""Open an export: its splits, episodes, tasks and navmeshes. Evaluate files of predictions or results against a split:
one evaluation per agent.
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Final

import yaml

from condvln.evaluation.discrete import GraphSplit, r2r_file
from condvln.evaluation.episode_stats import (
    Judged,
    evaluation_of_stats,
    is_episode_stats,
    read_episode_stats,
    stock_episodes,
    stock_file,
)
from condvln.evaluation.evaluate import Evaluation, SeesOf, evaluate
from condvln.evaluation.predictions import Prediction, detect_format, read_graph_predictions, read_predictions
from condvln.evaluation.reading import ReadRules
from condvln.evaluation.score import ScoreRules
from condvln.evaluation.task import Task, read_tasks
from condvln.evaluation.walker import Policy, walk
from condvln.formats.regular_file import read_regular
from condvln.manifest import export_manifests, manifest_lines, manifest_path, manifest_paths, read_manifest
from condvln.navigation.follower import VLN_CE, ActionSpace
from condvln.navigation.graph_pathfinder import GraphFolder
from condvln.navigation.pathfinder import Pathfinder
from condvln.navigation.scene_navmesh import NavmeshFolder
from schemas.errors import FormatError, MissingFileError, UsageError
from schemas.evaluation import ManifestEpisode

__all__ = ["Export", "SplitOptions", "evaluate_split", "forward_step", "open_export", "split_tasks"]

TASK_FILE: Final = "configs/vlnce/condvln_task.yaml"
"""Task file of VLN-CE in an export, which has the size of the actions that its episodes were made for."""


@dataclass(frozen=True)
class SplitOptions:
    """How prediction files are read and scored."""

    rules: ScoreRules = field(default_factory=ScoreRules)
    radii: tuple[float, ...] = ()
    """Success distances of a sweep, metres."""
    navmesh_roots: tuple[Path, ...] = ()
    """Folders of the datasets whose navmeshes the export does not contain."""
    reading: ReadRules = field(default_factory=ReadRules)
    forward: float | None = None
    """Length of the agents' action forward in metres; None for that of the export's configuration."""
    connectivity: tuple[Path, ...] = ()
    """Folders of ``<scan>_connectivity.json``, for paths over viewpoints."""
    sees_of: SeesOf | None = None
    """What is recognised on walks in a task's scene; None leaves `justified` undefined."""


def split_tasks(export: Path, split: str) -> list[Task]:
    """Return the tasks of one split of an export, with the split's dense ground-truth paths.

    split : its name, or NAME:FAMILY for its episodes of one source

    Raises
    ------
    MissingFileError : the export has no such split
    UsageError : the split has no episodes of the family
    """
    split, _, family = split.partition(":")
    manifest = manifest_path(export, split)
    if not manifest.is_file():
        there = [path.stem for path in manifest_paths(export)]
        raise MissingFileError(
            f"the export has no split {split!r}",
            where=manifest,
            remedy=f"Existing splits: {', '.join(there) or 'none'}",
        )
    truths = (export / variant / split / f"{split}_gt.json.gz" for variant in ("vlnce", "vlnce_looking"))
    tasks = list(read_tasks(manifest, *(path if path.is_file() else None for path in truths)))
    found = [task for task in tasks if task.axes["source"] == family] if family else tasks
    if tasks and not found:
        sources = ", ".join(sorted({str(task.axes["source"]) for task in tasks}))
        raise UsageError(f"the split has no episodes of {family!r}", where=manifest, remedy=f"It has: {sources}.")
    return found


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
        if options.rules != ScoreRules() or options.reading.assume_stop or options.forward is not None:
            raise UsageError(
                "some options do not apply to paths over viewpoints, which are scored by R2R's rules",
                remedy="Leave out the options for distances, steps, nDTW and STOP.",
            )
        return _evaluate_discrete(export, split, dict(zip(names, predictions, strict=True)), options)
    if any(discrete):
        raise UsageError(
            "some predictions are paths in space, others paths over viewpoints",
            remedy="They are judged by different rules: evaluate them in two calls",
        )
    stock = None if manifest_paths(export) else stock_file(export, split)
    if stock is not None:
        return _evaluate_stock(stock, dict(zip(names, predictions, strict=True)), options.reading), []
    tasks = split_tasks(export, split)
    navmeshes = NavmeshFolder((export, *options.navmesh_roots))
    rules = replace(options.rules, forward=forward_step(export) if options.forward is None else options.forward)
    found = []
    for name, path in zip(names, predictions, strict=True):
        if is_episode_stats(path):
            found.append(_of_stats(tasks, path, name, options.reading))
            continue
        notes: list[str] = []
        handed_in = read_predictions(path, rules=options.reading, notes=notes)
        scored = evaluate(
            tasks,
            handed_in,
            navmeshes,
            rules,
            agent=name,
            where=str(path),
            radii=options.radii,
            sees_of=options.sees_of,
        )
        found.append(replace(scored, notes=(*notes, *scored.notes)))
    return found, tasks


def forward_step(export: Path) -> float:
    """Return the length in metres of the action forward that an export's task file for VLN-CE names; VLN-CE's own if
    there is no such file.

    Raises
    ------
    FormatError : the file names no length
    """
    path = export / TASK_FILE
    if not path.is_file():
        return VLN_CE.forward
    try:
        step = yaml.safe_load(read_regular(path))["SIMULATOR"]["FORWARD_STEP_SIZE"]
        return ActionSpace(forward=float(step)).forward
    except (yaml.YAMLError, LookupError, TypeError, ValueError, RecursionError, UsageError) as error:
        raise FormatError(
            "the file names no length of the action forward",
            where=path,
            place="SIMULATOR.FORWARD_STEP_SIZE",
            remedy="Export the split again, or name the length with --forward-step",
        ) from error


def _of_stats(episodes: Sequence[Judged], path: Path, agent: str, rules: ReadRules) -> Evaluation:
    notes: list[str] = []
    stats = read_episode_stats(path, rules, notes)
    return evaluation_of_stats(episodes, stats, agent=agent, where=str(path), notes=notes)


def _evaluate_stock(stock: Path, predictions: Mapping[str, Path], rules: ReadRules) -> list[Evaluation]:
    """Evaluate per-episode results of a split that has no manifest, such as a split of R2R_VLNCE."""
    episodes = stock_episodes(stock)
    for path in predictions.values():
        if not is_episode_stats(path):
            raise UsageError(
                "this split has no manifest, which would name the navmesh on which paths are scored",
                where=path,
                remedy="Give per-episode results instead: stats_<id>.json or {id: {measure: number}}",
            )
    return [_of_stats(episodes, path, name, rules) for name, path in predictions.items()]


def _evaluate_discrete(
    export: Path, split: str, predictions: Mapping[str, Path], options: SplitOptions
) -> tuple[list[Evaluation], list[Task]]:
    file = r2r_file(export, split)
    known = split_tasks(export, split) if manifest_paths(export) else []
    graph_split = GraphSplit(file, known, GraphFolder(*options.connectivity))
    found = []
    for name, path in predictions.items():
        notes: list[str] = []
        walks = list(read_graph_predictions(path, options.reading, notes))
        scored = graph_split.evaluate(walks, agent=name, where=str(path), radii=options.radii)
        found.append(replace(scored, notes=(*notes, *scored.notes)))
    return found, graph_split.tasks


PathLike = str | os.PathLike[str]


class Export:
    """An export folder, opened; see :func:`open_export`."""

    def __init__(self, folder: Path, roots: Sequence[Path]) -> None:
        self.folder = folder
        self._navmeshes = NavmeshFolder((folder, *roots))

    def __repr__(self) -> str:
        counts = ", ".join(f"{split} {count}" for split, count in self.splits.items())
        return f"Export({self.folder}: {counts})"

    @cached_property
    def splits(self) -> dict[str, int]:
        """Number of episodes by split."""
        return {path.stem: sum(1 for _ in manifest_lines(path)) for path in manifest_paths(self.folder)}

    def episodes(self, split: str) -> list[ManifestEpisode]:
        """Return the full ground truth of a split's episodes: program, truths, gold leaf, all leaves, distances.

        Raises
        ------
        MissingFileError, FormatError : the split does not exist, or its manifest is damaged
        """
        return list(read_manifest(manifest_path(self.folder, split)))

    def tasks(self, split: str) -> list[Task]:
        """Return the episodes of a split as tasks, the input of the metrics. Raises the errors of :meth:`episodes`."""
        return split_tasks(self.folder, split)

    def pathfinder(self, episode: Task | ManifestEpisode) -> Pathfinder:
        """Return the pathfinder of an episode's scene.

        Raises
        ------
        MissingFileError : the navmesh is neither in the export nor in the datasets' folders
        FormatError : the file is not the navmesh that the episode was placed on
        """
        return self._navmeshes(episode)

    def run(self, split: str, policy: Policy) -> list[Prediction]:
        """Let an agent walk every episode of a split on its navmesh and return the predictions."""
        return [walk(task, policy, self.pathfinder(task)) for task in self.tasks(split)]

    def evaluate(
        self, split: str, predictions: Sequence[Prediction], *, agent: str = "agent", rules: ScoreRules | None = None
    ) -> Evaluation:
        """Score one agent's predictions on a split, one row per episode; ``Evaluation.means`` has the means.

        Raises
        ------
        FormatError : an episode is unknown or repeated, or a path does not begin at the start
        """
        return evaluate(self.tasks(split), predictions, self._navmeshes, rules or ScoreRules(), agent=agent)


def open_export(folder: PathLike, roots: Sequence[PathLike] = ()) -> Export:
    """Open the export in a folder.

    Parameters
    ----------
    roots : folders of the datasets whose navmeshes the export does not contain

    Raises
    ------
    MissingFileError : the folder holds no export
    """
    path = Path(folder)
    export_manifests(path)
    return Export(path, [Path(root) for root in roots])
