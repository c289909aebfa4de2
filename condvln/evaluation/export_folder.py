"""An export opened in Python: its splits, episodes, tasks and navmeshes, and the scores of an agent."""

from __future__ import annotations

import os
from collections.abc import Sequence
from functools import cached_property
from pathlib import Path

from condvln.evaluation.evaluate import Evaluation, evaluate
from condvln.evaluation.predictions import Prediction
from condvln.evaluation.score import ScoreRules
from condvln.evaluation.split import split_tasks
from condvln.evaluation.task import Task
from condvln.evaluation.walker import Policy, walk
from condvln.manifest import manifest_lines, manifest_path, manifest_paths, read_manifest
from condvln.navigation.navmesh_folder import NavmeshFolder
from condvln.navigation.pathfinder import Pathfinder
from schemas.errors import MissingFileError
from schemas.evaluation import ManifestEpisode

__all__ = ["Export", "open_export"]

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
    if not manifest_paths(path):
        raise MissingFileError(
            "no manifest/<split>.jsonl in this folder", where=path, remedy="Name the folder that condvln export wrote"
        )
    return Export(path, [Path(root) for root in roots])
