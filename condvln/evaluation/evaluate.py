"""Score one agent's predictions on a split: a table with one row per episode."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from typing import TYPE_CHECKING, Any, Final, TypeAlias

import numpy as np
import numpy.typing as npt

from condvln.evaluation.goal_distances import Nearness
from condvln.evaluation.metrics import keys_of
from condvln.evaluation.predictions import Prediction
from condvln.evaluation.score import Score, ScoreRules, Sees, score
from condvln.evaluation.task import AXES, Task
from schemas.errors import FormatError

if TYPE_CHECKING:
    from condvln.navigation.pathfinder import Pathfinder

__all__ = ["AXES", "SWEPT", "Evaluation", "SeesOf", "columns_of", "evaluate"]

SWEPT: Final = keys_of("sweep")
"""Measures that depend on the success distance; computed for each distance of a sweep."""

PathfinderOf: TypeAlias = "Callable[[Task], Pathfinder]"
SeesOf = Callable[[Task], Sees | None]


@dataclass(frozen=True, eq=False)
class Evaluation:
    """The scores of one agent on one split.

    Attributes
    ----------
    episode_ids, group_ids : ids of the n rows, in the order of the manifest
    axes : (n,) object arrays by name (:data:`AXES`)
    gold_leaf, n_leaves : (n,)
    scores : (n,) float64 arrays by the names of :class:`~condvln.evaluation.score.Score`
    sweep : by success distance, (n,) arrays by the names of :data:`SWEPT`
    notes : what was left out or changed when the agent's file was read, a sentence each
    """

    agent: str
    rules: ScoreRules
    episode_ids: tuple[str, ...]
    group_ids: tuple[str | None, ...]
    axes: Mapping[str, npt.NDArray[np.object_]]
    gold_leaf: npt.NDArray[np.int64]
    n_leaves: npt.NDArray[np.int64]
    scores: Mapping[str, npt.NDArray[np.float64]]
    sweep: Mapping[float, Mapping[str, npt.NDArray[np.float64]]] = field(default_factory=dict)
    notes: tuple[str, ...] = ()

    def __len__(self) -> int:
        return len(self.episode_ids)

    def __repr__(self) -> str:
        means = ", ".join(f"{name} {self.means[name]:.3f}" for name in ("success", "spl", "bsa_all", "leaf_correct"))
        return f"Evaluation({self.agent}: {len(self)} episodes, {means})"

    @property
    def means(self) -> dict[str, float]:
        """Mean of each measure over the episodes for which it is defined; NaN if there are none."""
        defined = {name: values[~np.isnan(values)] for name, values in self.scores.items()}
        return {name: float(values.mean()) if len(values) else float("nan") for name, values in defined.items()}

    def rows(self) -> list[dict[str, Any]]:
        """Return one dictionary per episode: ids as in the tables, axes, scores; undefined measures are None."""
        columns: dict[str, list[Any]] = {"episode_id": [int(name) for name in self.episode_ids]}
        columns |= {name: values.tolist() for name, values in self.axes.items()}
        columns["scene_id"] = [scene.split("/", 1)[-1] for scene in columns.pop("scene")]
        columns |= {"gold_leaf": self.gold_leaf.tolist()}
        for name, values in self.scores.items():
            columns[name] = [None if np.isnan(value) else value for value in values.tolist()]
        return [dict(zip(columns, row, strict=True)) for row in zip(*columns.values(), strict=True)]


def evaluate(
    tasks: Sequence[Task],
    predictions: Iterable[Prediction],
    pathfinder_of: PathfinderOf,
    rules: ScoreRules | None = None,
    *,
    agent: str = "agent",
    where: str = "",
    radii: Sequence[float] = (),
    sees_of: SeesOf | None = None,
) -> Evaluation:
    """Score every task; a task without a prediction counts as a failure.

    Parameters
    ----------
    pathfinder_of : returns the pathfinder of a task's scene
    where : name of the predictions' file, for messages
    radii : success distances of a sweep, metres
    sees_of : returns what is recognised on walks in a task's scene, None where the scene is not there; `justified` is
        undefined then

    Raises
    ------
    FormatError : a prediction is of an unknown episode, repeated, or starts elsewhere
    """
    rules = rules or ScoreRules()
    numbers = {task.episode_id: number for number, task in enumerate(tasks)}
    aliases = {alias: task.episode_id for task in tasks for alias in task.aliases}
    scores: list[Score | None] = [None] * len(tasks)
    swept: dict[float, list[Score | None]] = {radius: [None] * len(tasks) for radius in radii}

    all_round = 0

    def judge(number: int, prediction: Prediction | None) -> None:
        nonlocal all_round
        task = tasks[number]
        nearness = Nearness(pathfinder_of(task))
        sees = sees_of(task) if sees_of is not None else None
        all_round += sees is not None and prediction is not None and prediction.headings is None
        scores[number] = score(task, prediction, nearness, rules, where, sees)
        for radius, kept in swept.items():
            kept[number] = score(task, prediction, nearness, replace(rules, success_distance=radius), where)

    for prediction in predictions:
        name = prediction.episode_id if prediction.episode_id in numbers else aliases.get(prediction.episode_id, "")
        if name not in numbers:
            raise FormatError(
                f"no episode {prediction.episode_id!r} in this split",
                where=where or None,
                remedy="Evaluate each split's predictions against that split",
            )
        if scores[numbers[name]] is not None:
            raise FormatError(f"episode {name!r} is predicted twice", where=where or None, remedy="Keep one of the two")
        judge(numbers[name], prediction)
    for number in range(len(tasks)):
        if scores[number] is None:
            judge(number, None)
    bare = sum(bool(task.axes.get("leads")) and all(one is None for one in task.gold.outlines) for task in tasks)
    notes = (
        (all_round, "paths have no headings: justified counts what is seen all round"),
        (bare, "episodes lead to rooms that the manifest does not outline: only the lead's point counts; export again"),
    )
    return Evaluation(
        agent,
        rules,
        tuple(numbers),
        tuple(task.group_id for task in tasks),
        {axis: np.array([task.axes[axis] for task in tasks], dtype=object) for axis in AXES},
        np.array([task.gold_leaf for task in tasks], dtype=np.int64),
        np.array([len(task.leaves) for task in tasks], dtype=np.int64),
        columns_of(scores, [item.name for item in fields(Score)]),
        {radius: columns_of(kept, SWEPT) for radius, kept in swept.items()},
        tuple(f"{count} of {len(tasks)} {said}" for count, said in notes if count),
    )


def columns_of(scores: Sequence[Score | None], names: Iterable[str]) -> dict[str, npt.NDArray[np.float64]]:
    """Return the named measures of scores, a column each."""
    return {name: np.array([getattr(row, name) for row in scores], dtype=np.float64) for name in names}
