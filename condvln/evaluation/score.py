"""All measures of one episode."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt

from condvln.evaluation.goal_distances import Nearness, SnappedPath
from condvln.evaluation.measures import (
    FIDELITY_DISTANCE,
    NO_LEAF,
    DistanceMode,
    cls,
    committed_leaf,
    first_divergence,
    ndtw,
    path_length,
    reached_in_any_order_euclidean,
    reached_in_order,
    reached_in_order_euclidean,
    spl,
)
from condvln.evaluation.predictions import Prediction
from condvln.evaluation.task import Task
from condvln.navigation.protocol import PathfinderProtocol
from schemas.errors import FormatError

__all__ = ["START_TOLERANCE", "Score", "ScoreRules", "score"]

START_TOLERANCE: Final = 0.25
"""Largest allowed distance in metres between the path's first point and the episode's start: one forward step. A larger
one means another episode or another frame.
"""

NAN: Final = float("nan")
Points = npt.NDArray[np.float64]


@dataclass(frozen=True)
class ScoreRules:
    """How episodes are scored; the defaults are those of docs/metrics.md. Lengths in metres."""

    distance: DistanceMode = "geodesic"
    """How subgoals are judged. Distances to goals are always geodesic, as in Habitat."""
    success_distance: float | None = None
    """Overrides each episode's own success distance."""
    oracle_success_distance: float | None = None
    """Radius of oracle success, if larger than the success distance: a path that succeeds also has oracle success."""
    fidelity_distance: float = FIDELITY_DISTANCE
    fast_dtw: bool = False
    """Compute nDTW by VLN-CE's approximation."""
    keep_budget: bool = True
    """Cut paths at the episode's step budget."""


@dataclass(frozen=True)
class Score:
    """Measures of one episode: lengths in metres; rates are 0 or 1, or fractions; NaN where a measure is undefined.

    ``bsa`` and ``csr`` follow the paper: an episode without subgoals counts as reached if it succeeds and is left out
    if it fails. ``bsa_all`` and ``csr_all`` are over all episodes; without subgoals they equal the success.
    """

    path_length: float
    navigation_error: float
    """Distance to the nearest goal point; straight-line if ``unreachable``."""
    success: float
    oracle_success: float
    spl: float
    spl_route: float
    ndtw: float
    sdtw: float
    cls: float
    bsa: float
    csr: float
    bsa_all: float
    csr_all: float
    steps: float
    """Number of actions, STOP included; NaN if the format does not say."""
    collisions: float
    committed_leaf: int
    leaf_correct: float
    wrong_branch: float
    no_commit: float
    divergence: float
    """Number of correct answers before the first wrong one; NaN if none was wrong."""
    stopped: float
    unreachable: float
    over_budget: float
    missing: float
    """There is no prediction, or its path is empty."""


@dataclass(frozen=True, eq=False)
class _Walk:
    """The scored part of a prediction: the path within the step budget."""

    path: SnappedPath
    stopped: bool
    over_budget: bool
    collisions: float


def score(
    task: Task,
    prediction: Prediction | None,
    distances: Nearness | PathfinderProtocol,
    rules: ScoreRules | None = None,
    where: str = "",
) -> Score:
    """Score a prediction of an episode; a missing prediction and an empty path are failures.

    Parameters
    ----------
    distances : the pathfinder of the task's scene, or a cached `Nearness` of it
    rules : VLN-CE's rules if None
    where : the predictions' file, for error messages

    Raises
    ------
    FormatError : the path does not begin at the episode's start
    """
    nearness = distances if isinstance(distances, Nearness) else Nearness(distances)
    rules = rules or ScoreRules()
    if prediction is None or len(prediction.positions) == 0:
        return _failure(task, nearness)
    _check_start(task, prediction, where)
    walk = _judged(task, prediction, nearness, rules)
    radius = task.success_distance if rules.success_distance is None else rules.success_distance
    oracle_radius = max(radius, rules.oracle_success_distance or 0.0)
    positions, goals = walk.path.positions, task.gold.goals
    error = nearness.distance(positions[-1], goals)
    success = walk.stopped and error < radius
    ever = error < oracle_radius or nearness.ever_within(walk.path, goals, oracle_radius)
    length = path_length(positions)
    fidelity = ndtw(positions, task.reference, rules.fidelity_distance, fast=rules.fast_dtw)
    reached = _reached(task, walk, nearness, rules, radius)
    bsa_all, bsa = _subgoal_accuracy(reached, len(task.gold.subgoals), success)
    leaf = _leaf(task, walk, nearness, radius)
    divergence = first_divergence(task.program, task.gold_leaf, leaf)
    unreachable = not np.isfinite(error)
    return Score(
        path_length=length,
        navigation_error=_straight(positions[-1], goals) if unreachable else error,
        success=float(success),
        oracle_success=float(ever),
        spl=spl(success, nearness.distance(task.start, goals), length),
        spl_route=spl(success, task.gold.route_length, length),
        ndtw=fidelity,
        sdtw=success * fidelity,
        cls=cls(positions, task.reference, rules.fidelity_distance),
        bsa=bsa,
        csr=NAN if np.isnan(bsa) else float(success and bsa == 1.0),
        bsa_all=bsa_all,
        csr_all=float(success and bsa_all == 1.0),
        steps=len(positions) - 1.0 if prediction.counts_actions else NAN,
        collisions=walk.collisions,
        committed_leaf=leaf,
        leaf_correct=float(leaf == task.gold_leaf),
        wrong_branch=float(leaf not in (task.gold_leaf, NO_LEAF)),
        no_commit=float(leaf == NO_LEAF),
        divergence=NAN if divergence is None else float(divergence),
        stopped=float(walk.stopped),
        unreachable=float(unreachable),
        over_budget=float(walk.over_budget),
        missing=0.0,
    )


def _check_start(task: Task, prediction: Prediction, where: str) -> None:
    off = float(np.linalg.norm(prediction.positions[0] - task.start))
    if off > START_TOLERANCE:
        raise FormatError(
            f"the path begins {off:.2f} m from the episode's start",
            where=where or None,
            place=f"episode {task.episode_id}",
            remedy="Check that the file is of this split; positions are metres in Habitat's frame, the start first",
        )


def _judged(task: Task, prediction: Prediction, nearness: Nearness, rules: ScoreRules) -> _Walk:
    positions, stopped, collided = prediction.positions, prediction.stopped, prediction.collided
    over = rules.keep_budget and prediction.counts_actions and len(positions) - 1 > task.max_steps
    if over:
        positions, stopped = positions[: task.max_steps + 1], False
    collisions = NAN if collided is None else float(collided[: len(positions)].sum())
    return _Walk(nearness.snap(positions), stopped, over, collisions)


def _reached(task: Task, walk: _Walk, nearness: Nearness, rules: ScoreRules, radius: float) -> int:
    if rules.distance == "euclidean":
        return reached_in_order_euclidean(walk.path.positions, task.gold.subgoals, radius)
    if rules.distance == "euclidean-any-order":
        return reached_in_any_order_euclidean(walk.path.positions, task.gold.subgoals, radius)
    return reached_in_order(nearness, walk.path, task.gold.subgoals, radius)


def _subgoal_accuracy(reached: int, subgoals: int, success: bool) -> tuple[float, float]:
    """Return an episode's subgoal accuracy twice: its value for ``bsa_all``, and its value for ``bsa``, which is NaN if
    the paper's rule leaves the episode out.
    """
    if subgoals:
        return reached / subgoals, reached / subgoals
    return float(success), 1.0 if success else NAN


def _leaf(task: Task, walk: _Walk, nearness: Nearness, radius: float) -> int:
    if not walk.stopped:
        return NO_LEAF
    end = walk.path.positions[-1]
    return committed_leaf([nearness.distance(end, leaf.goals) for leaf in task.leaves], radius)


def _straight(point: Points, goals: Points) -> float:
    return float(np.sqrt(np.square(goals - point).sum(axis=1)).min())


def _failure(task: Task, nearness: Nearness) -> Score:
    """Return the score of a missing prediction: the agent stays at the start and fails."""
    error = nearness.distance(task.start, task.gold.goals)
    unreachable = not np.isfinite(error)
    bsa = 0.0 if len(task.gold.subgoals) else NAN
    return Score(
        path_length=0.0,
        navigation_error=_straight(task.start, task.gold.goals) if unreachable else error,
        success=0.0,
        oracle_success=0.0,
        spl=0.0,
        spl_route=0.0,
        ndtw=0.0,
        sdtw=0.0,
        cls=0.0,
        bsa=bsa,
        csr=bsa,
        bsa_all=0.0,
        csr_all=0.0,
        steps=NAN,
        collisions=NAN,
        committed_leaf=NO_LEAF,
        leaf_correct=0.0,
        wrong_branch=0.0,
        no_commit=1.0,
        divergence=NAN,
        stopped=0.0,
        unreachable=float(unreachable),
        over_budget=0.0,
        missing=1.0,
    )
