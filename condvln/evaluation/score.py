"""All measures of one episode."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, fields
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from condvln.evaluation.goal_distances import Nearness, SnappedPath
from condvln.evaluation.measures import (
    FIDELITY_DISTANCE,
    NO_LEAF,
    DistanceMode,
    cls,
    committed_leaf,
    first_divergence,
    ndtw,
    reached_in_any_order_euclidean,
    reached_in_order,
    reached_in_order_euclidean,
    spl,
)
from condvln.evaluation.predictions import Prediction
from condvln.evaluation.task import Task
from condvln.navigation.follower import VLN_CE
from schemas.errors import FormatError

if TYPE_CHECKING:
    from condvln.navigation.pathfinder import Pathfinder
from condvln.arrays import F64
from schemas.program import leaf_truths

__all__ = ["START_TOLERANCE", "TOLD_AFTER_STOP", "Score", "ScoreRules", "Sees", "branch_measures", "score"]

START_TOLERANCE: Final = 0.25
"""Largest allowed distance in metres between the path's first point and the episode's start: one forward step. A larger
one means another episode or another frame.
"""

TOLD_AFTER_STOP: Final = frozenset({"committed_leaf", "leaf_correct", "wrong_branch", "no_commit", "divergence"})
"""Measures that depend on which leaf is gold or was reached: an environment tells them after STOP only."""

NAN: Final = float("nan")
Sees = Callable[[Prediction], Sequence[int | None]]
"""Returns, for each condition on the gold route in order, the first pose of a walk at which the evidence seen so far
decides it; None if there is none.
"""


LOOKING: Final = ("spl_look", "ndtw_look", "sdtw_look", "cls_look")
"""Measures against the looking path."""


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
    forward: float = VLN_CE.forward
    """Length of the agent's action forward."""


@dataclass(frozen=True)
class Score:
    """Measures of one episode: lengths in metres; rates are 0 or 1, or fractions; NaN where a measure is undefined.

    ``bsa`` and ``csr`` follow the paper: an episode without subgoals counts as reached if it succeeds and is left out
    if it fails. ``bsa_all`` and ``csr_all`` are over all episodes; without subgoals they equal the success.
    """

    path_length: float
    """NaN if the path has a step between places without a way between them."""
    navigation_error: float
    """Distance to the nearest goal point; straight-line if ``unreachable``."""
    success: float
    oracle_success: float
    spl: float
    spl_route: float
    spl_look: float
    """NaN, as the other measures against the looking path, where the episode has none."""
    ndtw: float
    ndtw_look: float
    sdtw: float
    sdtw_look: float
    cls: float
    cls_look: float
    justified: float
    """Success, and all evidence was recognised in time; NaN where nobody could check."""
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
    gaps: float
    """Number of steps that no single action can have made."""
    off_navmesh: float
    """Number of positions that are not on the navmesh."""


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
    distances: Nearness | Pathfinder,
    rules: ScoreRules | None = None,
    where: str = "",
    sees: Sees | None = None,
) -> Score:
    """Score a prediction of an episode; a missing prediction and an empty path are failures.

    Parameters
    ----------
    distances : the pathfinder of the task's scene, or a cached `Nearness` of it
    rules : VLN-CE's rules if None
    where : the predictions' file, for error messages
    sees : what is recognised on walks in the task's scene; without it, `justified` is undefined

    Raises
    ------
    FormatError : the path does not begin at the episode's start, or has a position that is not finite
    """
    nearness = distances if isinstance(distances, Nearness) else Nearness(distances)
    rules = rules or ScoreRules()
    if prediction is None or len(prediction.positions) == 0:
        return _failure(task, nearness, sees)
    _check_path(task, prediction, where)
    walk = _judged(task, prediction, nearness, rules)
    radius = task.success_distance if rules.success_distance is None else rules.success_distance
    oracle_radius = max(radius, rules.oracle_success_distance or 0.0)
    positions, goals = walk.path.positions, task.gold.goals
    error = nearness.distance(positions[-1], goals)
    success = walk.stopped and error < radius
    ever = error < oracle_radius or nearness.ever_within(walk.path, goals, oracle_radius)
    steps, gaps = nearness.steps(walk.path, rules.forward)
    length = float(steps.sum())
    reached = _reached(task, walk, nearness, rules, radius)
    leaf = _leaf(task, walk, nearness, radius)
    unreachable = not np.isfinite(error)
    return Score(
        path_length=length if np.isfinite(length) else NAN,
        navigation_error=_straight(positions[-1], goals) if unreachable else error,
        success=float(success),
        oracle_success=float(ever),
        spl=spl(success, nearness.distance(task.start, goals), length),
        spl_route=spl(success, task.gold.route_length, length),
        **_fidelity("", positions, task.reference, success, length, rules),
        **_looking(task, positions, success, length, rules),
        justified=NAN if sees is None else float(success and _in_time(task, walk, nearness, radius, sees(prediction))),
        steps=len(positions) - 1.0 if prediction.counts_actions else NAN,
        collisions=walk.collisions,
        stopped=float(walk.stopped),
        unreachable=float(unreachable),
        over_budget=float(walk.over_budget),
        missing=0.0,
        gaps=float(gaps.sum()),
        off_navmesh=float(walk.path.off_navmesh),
        **branch_measures(task, reached, leaf, success),
    )


def _fidelity(
    suffix: str, positions: F64, reference: F64, success: bool, length: float, rules: ScoreRules
) -> dict[str, Any]:
    """Return nDTW, SDTW and CLS against a reference (r, 3), under their names in `Score`."""
    found = ndtw(positions, reference, rules.fidelity_distance, fast=rules.fast_dtw)
    coverage = cls(positions, reference, rules.fidelity_distance, length=length)
    return {f"ndtw{suffix}": found, f"sdtw{suffix}": success * found, f"cls{suffix}": coverage}


def _looking(task: Task, positions: F64, success: bool, length: float, rules: ScoreRules) -> dict[str, Any]:
    """Return the measures against the looking path, under their names in `Score`."""
    if task.looking is None:
        return dict.fromkeys(LOOKING, NAN)
    found = _fidelity("_look", positions, task.looking.reference, success, length, rules)
    return found | {"spl_look": spl(success, task.looking.length, length)}


def _in_time(task: Task, walk: _Walk, nearness: Nearness, radius: float, decided: Sequence[int | None]) -> bool:
    """Return whether each condition is decided before the walk comes to a stop or goal that only its answer leads to.

    decided : for each condition on the gold route in order, the pose at which it is decided; None for never
    """
    return all(
        at is not None
        and not any(
            (first := nearness.first_within(walk.path, point, radius)) is not None and first <= at for point in points
        )
        for at, points in zip(decided, _committing(task), strict=True)
    )


def _committing(task: Task) -> Iterator[F64]:
    """Yield, for each condition on the gold route in order, the stops and goals (k, 3) that only the leaves below its
    answer have.
    """
    routes = leaf_truths(task.program.category)
    gold = routes[task.gold_leaf]
    for at in sorted({[number for number, _ in gold].index(number) for number, _ in gold}):
        below = [leaf for leaf, route in zip(task.leaves, routes, strict=True) if route[: at + 1] == gold[: at + 1]]
        beside = {
            name
            for leaf, route in zip(task.leaves, routes, strict=True)
            if route[:at] == gold[:at] and route[at] != gold[at]
            for name in leaf.objects
        }
        yield np.vstack(
            [
                points
                for leaf in below
                for name, points in zip(leaf.objects, (*leaf.subgoals[:, None], leaf.goals), strict=True)
                if name not in beside
            ]
        )


def _check_path(task: Task, prediction: Prediction, where: str) -> None:
    if not np.isfinite(prediction.positions).all():
        raise FormatError(
            "a position of the path is not finite",
            where=where or None,
            place=f"episode {task.episode_id}",
            remedy="Give three numbers in metres for each position",
        )
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
    return reached_in_order(nearness, walk.path, task.gold.subgoals, radius, task.gold.outlines)


def branch_measures(task: Task, reached: int, leaf: int, success: bool) -> dict[str, Any]:
    """Return the measures of branches, under their names in `Score`, in space or on a graph.

    Parameters
    ----------
    reached : number of the gold path's subgoals that were reached, see `condvln.evaluation.measures`
    leaf : index of the leaf at which the agent stopped, or `NO_LEAF`
    """
    count = len(task.gold.subgoals)
    share = reached / count if count else float(success)
    by_the_paper = share if count or success else NAN
    divergence = first_divergence(task.program, task.gold_leaf, leaf)
    return {
        "bsa": by_the_paper,
        "csr": NAN if np.isnan(by_the_paper) else float(success and share == 1.0),
        "bsa_all": share,
        "csr_all": float(success and share == 1.0),
        "committed_leaf": leaf,
        "leaf_correct": float(leaf == task.gold_leaf),
        "wrong_branch": float(leaf not in (task.gold_leaf, NO_LEAF)),
        "no_commit": float(leaf == NO_LEAF),
        "divergence": NAN if divergence is None else float(divergence),
    }


def _leaf(task: Task, walk: _Walk, nearness: Nearness, radius: float) -> int:
    if not walk.stopped:
        return NO_LEAF
    end = walk.path.positions[-1]
    return committed_leaf([nearness.distance(end, leaf.goals) for leaf in task.leaves], radius)


def _straight(point: F64, goals: F64) -> float:
    return float(np.sqrt(np.square(goals - point).sum(axis=1)).min())


def _failure(task: Task, nearness: Nearness, sees: Sees | None) -> Score:
    """Return the score of a missing prediction: the agent stays at the start and fails."""
    error = nearness.distance(task.start, task.gold.goals)
    unreachable = not np.isfinite(error)
    known = {
        "navigation_error": _straight(task.start, task.gold.goals) if unreachable else error,
        "steps": NAN,
        "collisions": NAN,
        "unreachable": float(unreachable),
        "missing": 1.0,
        **({} if sees else {"justified": NAN}),
        **({} if task.looking else dict.fromkeys(LOOKING, NAN)),
    }
    values: dict[str, Any] = dict.fromkeys((item.name for item in fields(Score)), 0.0)
    return Score(**values | branch_measures(task, 0, NO_LEAF, success=False) | known)
