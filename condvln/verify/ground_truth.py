"""Check an episode's ground truth: its actions are executed on the navmesh, or its locations are compared with the
reference path.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from condvln.navigation.follower import STOP
from condvln.verify.certificate import Certificate
from condvln.verify.heading import yaw_of
from condvln.verify.kernels.passing import passed_and_left
from condvln.verify.walks import Walks
from schemas.config.constants import PATH_SPACING
from schemas.evaluation import ManifestEpisode

__all__ = ["check_truths"]

F64 = NDArray[np.float64]

ROUNDED: Final = 0.002
"""Tolerance in metres of a location: both sides of the comparison are rounded to 1 mm."""
SLACK: Final = 1e-6
"""Tolerance in steps: a segment of 2.5000000001 m is ten steps of 0.25 m and not eleven."""


class _Told(NamedTuple):
    """What a ground-truth entry says: locations (n, 3) in metres, number of forward steps, and actions (n,) if any."""

    locations: F64
    forward: Any
    actions: NDArray[np.int8] | None


def check_truths(
    rows: Sequence[ManifestEpisode],
    truths: Sequence[Mapping[str, Any] | None],
    walks: Walks,
    certificates: Sequence[Certificate],
) -> None:
    """Check the ground-truth entries of the rows of a scene. All actions are executed together."""
    told = [_told(truth) for truth in truths]
    walked = [
        (row, its.actions)
        for row, its in zip(rows, told, strict=True)
        if its is not None and its.actions is not None and 0 <= row.gold_leaf < len(row.leaves)
    ]
    yaws = [yaw_of(row.start_rotation) or 0.0 for row, _ in walked]
    along = iter(walks.along([row.start_position for row, _ in walked], yaws, [taken for _, taken in walked]))
    for row, its, certificate in zip(rows, told, certificates, strict=True):
        if its is None:
            certificate.holds("ground_truth", False, row.episode_id, "no such entry, or a malformed one")
        else:
            _check(row, its, along, certificate)


def _told(truth: Mapping[str, Any] | None) -> _Told | None:
    try:
        assert truth is not None
        locations = np.array(truth["locations"], dtype=np.float64).reshape(-1, 3)
        forward, actions = truth["forward_steps"], truth.get("actions")
        return _Told(locations, forward, None if actions is None else np.array(actions, dtype=np.int8))
    except (AssertionError, KeyError, OverflowError, TypeError, ValueError):
        return None


def _check(row: ManifestEpisode, told: _Told, executed: Iterator[F64], certificate: Certificate) -> None:
    """Check one entry. `executed` yields the places to which its actions lead, if it has any."""
    locations = told.locations
    certificate.same("ground_truth", told.forward, len(locations) - 1, "forward_steps")
    if not 0 <= row.gold_leaf < len(row.leaves):
        return
    if told.actions is None:
        along = _cut(np.array(row.leaves[row.gold_leaf].reference_path), PATH_SPACING)
    else:
        along = next(executed)
        _check_actions(row, told.actions, along, certificate)
    off = float(np.abs(along - locations).max(initial=0.0)) if along.shape == locations.shape else np.inf
    certificate.holds("ground_truth", off <= ROUNDED, "the places gone through", f"{off} m off", "locations")


def _check_actions(row: ManifestEpisode, taken: NDArray[np.int8], along: F64, certificate: Certificate) -> None:
    """Check that the only STOP is the last action, that the actions use at most half of the step budget, and that they
    lead past each subgoal in turn and then to the goal.
    """
    ends = np.flatnonzero(taken == STOP).tolist()
    certificate.same("ground_truth", ends, [len(taken) - 1], "places of STOP")
    certificate.holds(
        "ground_truth", 2 * len(taken) <= row.max_steps, row.max_steps, 2 * len(taken), "twice the actions"
    )
    gold = row.leaves[row.gold_leaf]
    stops = np.array([subgoal.position for subgoal in gold.subgoals], dtype=np.float64).reshape(-1, 3)
    goals = np.array(gold.goals, dtype=np.float64).reshape(-1, 3)
    passed, end = passed_and_left(along, stops, goals, row.success_distance)
    for subgoal, near in zip(gold.subgoals, passed.tolist(), strict=True):
        certificate.holds("ground_truth", near, subgoal.object_id, "not passed", "subgoals")
    certificate.holds("ground_truth", end < row.success_distance, row.success_distance, end, "metres left to the goal")


def _cut(path: F64, spacing: float) -> F64:
    """Return corners (n, 3) with each segment divided into the fewest equal parts of at most `spacing` metres."""
    along = np.diff(path, axis=0)
    parts = np.ceil(np.sqrt((along * along).sum(axis=1)) / spacing - SLACK).astype(np.int64)
    side = np.repeat(np.arange(len(along)), parts)
    within = np.arange(len(side)) - np.repeat(np.cumsum(parts) - parts, parts)
    return np.concatenate([path[side] + along[side] * (within / parts[side])[:, None], path[-1:]])
