"""What the metrics need of an episode, read from an export's manifest and ground-truth file."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
from pydantic import ValidationError

from condvln.arrays import F64
from condvln.export.splits import SHAPE_AXES, observability_class, oddness_class, route_class, words_class
from condvln.formats.json_entries import entries, parsed
from condvln.manifest import read_manifest
from condvln.navigation.points import densify
from schemas.errors import FormatError
from schemas.evaluation import ManifestEpisode
from schemas.program import Program
from schemas.vlnce import GroundTruth

__all__ = ["AXES", "LeafTask", "LookingTask", "Task", "read_ground_truth", "read_tasks", "task_of"]


AXES: Final = ("source", "scene", *SHAPE_AXES)
"""Columns by which scores can be grouped."""


@dataclass(frozen=True, eq=False)
class LeafTask:
    """One leaf of a task.

    goals : (k, 3) metres, the one nearest to the start first; subgoals : (m, 3) in order; path : (c, 3) its corners
    objects : ids of the objects of the subgoals and, last, of the goals
    outlines : of each subgoal, the corners (k, 2) of the room in which it is reached anywhere, x and z; None for one
        that is a point
    """

    goals: F64
    subgoals: F64
    route_length: float
    geodesic_distance: float
    path: F64
    objects: tuple[str, ...]
    outlines: tuple[F64 | None, ...] = ()

    @property
    def end(self) -> F64:
        """The goal point (3,) at the end of the leaf's path."""
        found: F64 = self.goals[np.square(self.goals - self.path[-1]).sum(axis=1).argmin()]
        return found


@dataclass(frozen=True, eq=False)
class LookingTask:
    """The looking path of a task.

    reference : (r, 3) dense locations, metres; length : metres; actions : those of the walk along it, the last is STOP
    """

    reference: F64
    length: float
    actions: tuple[int, ...]


@dataclass(frozen=True, eq=False)
class Task:
    """One episode, as the metrics need it.

    Attributes
    ----------
    episode_id : the id in files, an integer as decimal text; episode_hash : the hash of its content
    axes : the episode's groups in the tables: source, scene, category, depth, chain, composition, observability,
        moves, leads, and the classes of the route's length and of the number of words
    reference : (r, 3) dense locations of the gold route
    looking : None where the format has no headings, so that nothing can be looked at
    success_distance : τ, metres
    """

    episode_id: str
    group_id: str | None
    text: str
    axes: Mapping[str, str | int | None]
    program: Program
    gold_leaf: int
    leaves: tuple[LeafTask, ...]
    start: F64
    start_rotation: tuple[float, float, float, float]
    reference: F64
    success_distance: float
    max_steps: int
    navmesh: str
    navmesh_sha256: str
    episode_hash: str = ""
    looking: LookingTask | None = None

    def __repr__(self) -> str:
        return f"Task({self.episode_id}, {self.axes['scene']}: {self.text!r})"

    @property
    def n_leaves(self) -> int:
        """Number of leaves."""
        return len(self.leaves)

    @property
    def subgoals(self) -> int:
        """Number of stops before the goal on the gold leaf's route."""
        return len(self.gold.subgoals)

    @property
    def aliases(self) -> tuple[str, ...]:
        """Other ids of the episode in files of predictions: its hash."""
        return (self.episode_hash,) if self.episode_hash else ()

    @property
    def gold(self) -> LeafTask:
        """The gold leaf."""
        return self.leaves[self.gold_leaf]


def task_of(row: ManifestEpisode, locations: F64 | None = None, looking: F64 | None = None) -> Task:
    """Return the task of a manifest row; without ``locations``, and those of the ``looking`` path, the densified paths
    are the references.
    """
    leaves = tuple(
        LeafTask(
            np.array(leaf.goals, dtype=np.float64),
            np.array([subgoal.position for subgoal in leaf.subgoals], dtype=np.float64).reshape(-1, 3),
            leaf.route_length,
            leaf.geodesic_distance,
            np.array(leaf.reference_path, dtype=np.float64),
            (*(subgoal.object_id for subgoal in leaf.subgoals), leaf.object_id),
            tuple(None if stop.outline is None else np.array(stop.outline, np.float64) for stop in leaf.subgoals),
        )
        for leaf in sorted(row.leaves, key=lambda leaf: leaf.leaf)
    )
    gold = next(leaf for leaf in row.leaves if leaf.leaf == row.gold_leaf)
    axes = {axis: getattr(row, axis, None) for axis in AXES} | {
        "scene": f"{row.source}/{row.scene_id}",
        "observability": observability_class(row.observability, row.evidence_in_view),
        "oddness": oddness_class(row.oddness),
        "route": route_class(row.route_length),
        "words": words_class(row.words),
    }
    return Task(
        str(row.episode_id),
        row.group_id,
        row.instruction_text,
        axes,
        row.program,
        row.gold_leaf,
        leaves,
        np.array(row.start_position, dtype=np.float64),
        row.start_rotation,
        densify(gold.reference_path) if locations is None else locations,
        row.success_distance,
        row.max_steps,
        row.navmesh,
        row.navmesh_sha256,
        row.episode_hash,
        _looking(row, looking),
    )


def _looking(row: ManifestEpisode, locations: F64 | None) -> LookingTask | None:
    if row.looking_path is None or row.looking_length is None or row.looking_actions is None:
        return None
    reference = densify(row.looking_path) if locations is None else locations
    return LookingTask(reference, row.looking_length, row.looking_actions)


def read_tasks(manifest: Path, ground_truth: Path | None = None, looking: Path | None = None) -> Iterator[Task]:
    """Yield the tasks of a split in the order of its manifest; ``ground_truth`` is the split's ``_gt`` file, and
    ``looking`` that of its looking paths.

    Raises
    ------
    FormatError : a line is not a manifest row, an id is repeated, or an episode has no ground truth
    """
    truths, looked = (None if path is None else read_ground_truth(path) for path in (ground_truth, looking))

    def locations(row: ManifestEpisode, found: dict[str, F64] | None, path: Path | None) -> F64 | None:
        if found is not None and str(row.episode_id) not in found:
            raise _damaged(manifest, f"episode {row.episode_id}", f"has no entry in {path}")
        return None if found is None else found[str(row.episode_id)]

    for row in read_manifest(manifest):
        along = None if row.looking_path is None else locations(row, looked, looking)
        yield task_of(row, locations(row, truths, ground_truth), along)


def read_ground_truth(path: Path) -> dict[str, F64]:
    """Return the locations (r, 3) in metres of each episode of a ``_gt`` file.

    Raises
    ------
    FormatError : the file has another format
    """
    found = {}
    for name, data in entries(path):
        if name is None:
            raise _damaged(path, "the file", "an array, not an object of episodes")
        try:
            truth = GroundTruth.model_validate(parsed(data, path, f"episode {name}"))
        except ValidationError as error:
            raise _damaged(path, f"episode {name}", str(error.errors()[0]["msg"])) from error
        if not truth.locations:
            raise _damaged(path, f"episode {name}: locations", "empty")
        found[name] = np.array(truth.locations, dtype=np.float64)
    return found


def _damaged(path: Path, place: str, what: str) -> FormatError:
    return FormatError(what, where=path, place=place, remedy="Export the split again")
