"""Compare an episode's VLN-CE record and its ground truth with the manifest. The actions of a ground truth are executed
on the navmesh; locations without actions are compared with the reference path.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from functools import lru_cache
from pathlib import PurePosixPath
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from condvln.arrays import F64
from condvln.navigation.follower import FORWARD, LEFT, RIGHT, STOP, VLN_CE
from condvln.navigation.pathfinder import Pathfinder
from condvln.verify.certificate import Certificate
from condvln.verify.footprints import Point
from condvln.verify.standpoint import heading_of, yaw_of
from schemas.config.constants import PATH_SPACING
from schemas.evaluation import ManifestEpisode

__all__ = [
    "check_looking_truths",
    "check_record",
    "check_truths",
    "executed",
]

MISSING: Final = "missing"
"""Marks a missing key, as opposed to a null value."""
_BASIS: Final = ".basis"
"""End of the names of HM3D's meshes with compressed textures, before the last suffix."""
HEADING: Final = 1e-3
"""Tolerance in degrees between a stated heading and its rotation."""


_INFO: Final = (
    "success_distance", "max_steps", "category", "depth", "chain", "composition", "observability", "evidence_in_view",
    "observability_approximate", "moves", "leads", "words", "instruction_id", "group_id", "episode_hash",
    "navmesh_sha256",
)  # fmt: skip
"""Fields of a manifest row that its record repeats."""


def check_record(
    row: ManifestEpisode,
    record: Mapping[str, Any] | None,
    looking: Mapping[str, Any] | None,
    certificate: Certificate,
) -> None:
    """Check that the VLN-CE record of an episode agrees with the manifest row of the episode, and that the record along
    the looking path differs in its path alone.
    """
    if record is None:
        certificate.holds("record", False, row.episode_id, "no record")
        return
    if row.looking_path:
        along = {**record, "reference_path": [list(point) for point in row.looking_path]}
        certificate.holds("looking_record", looking == along, "the record along the looking path", looking)
    gold = row.leaves[row.gold_leaf] if 0 <= row.gold_leaf < len(row.leaves) else row.leaves[0]
    claimed: dict[str, Any] = {
        "episode_id": row.episode_id,
        "trajectory_id": row.episode_id,
        "start_position": list(row.start_position),
        "start_rotation": list(row.start_rotation),
        "goals": [{"position": list(goal), "radius": row.success_distance} for goal in gold.goals],
        "instruction_text": row.instruction_text,
        "reference_path": [list(point) for point in gold.reference_path],
    }
    info: dict[str, Any] = {
        "geodesic_distance": gold.geodesic_distance,
        "route_length": gold.route_length,
        "subgoals": [list(subgoal.position) for subgoal in gold.subgoals],
        **{name: getattr(row, name) for name in _INFO},
    }
    instruction, said = record.get("instruction"), record.get("info")
    found = {
        **record,
        "instruction_text": instruction.get("instruction_text") if isinstance(instruction, dict) else None,
    }
    said = said if isinstance(said, dict) else {}
    for place, wanted, own in (("", claimed, found), ("info.", info, said)):
        for name, value in wanted.items():
            certificate.same("record", own.get(name, MISSING), value, f"{place}{name}")
    certificate.same("record", *_scene_names(str(record.get("scene_id", "")), row.scene_id), "scene_id")
    yaw = yaw_of(row.start_rotation)
    if yaw is not None:
        heading, stated = heading_of(yaw), said.get("start_heading_degrees")
        off = (float(stated) - heading + 180.0) % 360.0 - 180.0 if isinstance(stated, (int, float)) else math.inf
        certificate.holds("record", abs(off) <= HEADING, stated, heading, "info.start_heading_degrees")


@lru_cache(maxsize=64)
def _scene_names(file: str, scene_id: str) -> tuple[str, str]:
    """Return the name of a scene by its file, and by its id."""
    scene, name = PurePosixPath(file), PurePosixPath(scene_id).name
    # HM3D numbers the folder of a scan, and its file has the scan's name alone.
    return scene.parent.name if scene.stem == f"{name.partition('-')[2]}{_BASIS}" else scene.stem, name


ROUNDED: Final = 0.002
"""Tolerance in metres of a location: both sides of the comparison are rounded to 1 mm."""
SLACK: Final = 1e-6
"""Tolerance in steps: a segment of 2.5000000001 m is ten steps of 0.25 m and not eleven."""


def executed(
    pathfinder: Pathfinder, starts: Sequence[Point], yaws: Sequence[float], actions: Sequence[NDArray[np.int8]]
) -> list[tuple[F64, F64]]:
    """Return for each agent that executes its `actions` (n,) the positions (n + 1, 3) and the yaws (n + 1,) in radians
    before the first action and after each. STOP and unknown actions don't move it. All agents step together.
    """
    turn = math.radians(VLN_CE.turn)
    turns = [np.append(0, np.cumsum((its == LEFT) - 1 * (its == RIGHT))) % VLN_CE.headings for its in actions]
    facing = [yaw + its * turn for yaw, its in zip(yaws, turns, strict=True)]
    goes = [its == FORWARD for its in actions]
    steps = [
        (VLN_CE.forward * np.stack([-np.sin(yaw), 0 * yaw, -np.cos(yaw)], axis=1)[:-1][go]).astype(np.float32)
        for yaw, go in zip(facing, goes, strict=True)
    ]
    places = [np.full((len(its) + 1, 3), start, np.float32) for its, start in zip(steps, starts, strict=True)]
    for step in range(max([len(its) for its in steps], default=0)):
        moving = [k for k, its in enumerate(steps) if step < len(its)]
        at = np.array([places[k][step] for k in moving])
        reached = pathfinder.try_steps(at, at + np.array([steps[k][step] for k in moving]))
        for k, place in zip(moving, reached, strict=True):
            places[k][step + 1] = place
    return [
        (along[np.append(0, np.cumsum(go))].astype(np.float64), yaw)
        for along, go, yaw in zip(places, goes, facing, strict=True)
    ]


class _Told(NamedTuple):
    """What a ground-truth entry says: locations (n, 3) in metres, number of forward steps, and actions (n,) if any."""

    locations: F64
    forward: Any
    actions: NDArray[np.int8] | None


def check_truths(
    rows: Sequence[ManifestEpisode],
    truths: Sequence[Mapping[str, Any] | None],
    pathfinder: Pathfinder,
    certificates: Sequence[Certificate],
) -> None:
    """Check the ground-truth entries of the rows of a scene."""
    told = [_told(truth) for truth in truths]
    walked = [
        (row, its.actions)
        for row, its in zip(rows, told, strict=True)
        if its is not None and its.actions is not None and 0 <= row.gold_leaf < len(row.leaves)
    ]
    yaws = [yaw_of(row.start_rotation) or 0.0 for row, _ in walked]
    taken = [its.reshape(-1) for _, its in walked]
    made = executed(pathfinder, [row.start_position for row, _ in walked], yaws, taken)
    along = (places[np.append(True, its == FORWARD)] for (places, _), its in zip(made, taken, strict=True))
    for row, its, certificate in zip(rows, told, certificates, strict=True):
        if its is None:
            certificate.holds("ground_truth", False, row.episode_id, "no such entry, or a malformed one")
        else:
            _check(row, its, along, certificate)


def check_looking_truths(
    rows: Sequence[ManifestEpisode],
    truths: Sequence[Mapping[str, Any] | None],
    pathfinder: Pathfinder,
    certificates: Sequence[Certificate],
) -> None:
    """Check the ground-truth entries along the looking paths: the actions of the rows and the places they lead to."""
    looking = [k for k, row in enumerate(rows) if row.looking_actions]
    taken = [np.array(rows[k].looking_actions, np.int8) for k in looking]
    yaws = [yaw_of(rows[k].start_rotation) or 0.0 for k in looking]
    made = executed(pathfinder, [rows[k].start_position for k in looking], yaws, taken)
    for k, actions, (places, _) in zip(looking, taken, made, strict=True):
        its, certificate = _told(truths[k]), certificates[k]
        if its is None or its.actions is None or its.actions.tolist() != actions.tolist():
            certificate.holds("looking_truth", False, actions.tolist(), its, "actions")
            continue
        along = places[np.append(True, actions == FORWARD)]
        off = _metres_off(along, its.locations)
        certificate.holds("looking_truth", off <= ROUNDED, "the places gone through", f"{off} m off", "locations")
        certificate.same("looking_truth", its.forward, len(along) - 1, "forward_steps")


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
    off = _metres_off(along, locations)
    certificate.holds("ground_truth", off <= ROUNDED, "the places gone through", f"{off} m off", "locations")


def _metres_off(along: F64, locations: F64) -> float:
    """Return how far stated locations are from the places that a walk goes through; infinite for another number."""
    return float(np.abs(along - locations).max(initial=0.0)) if along.shape == locations.shape else np.inf


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
    at = 0
    for subgoal, stop in zip(gold.subgoals, stops, strict=True):
        near = np.linalg.norm(along[at:] - stop, axis=1) <= row.success_distance
        certificate.holds("ground_truth", bool(near.any()), subgoal.object_id, "not passed", "subgoals")
        at += int(near.argmax())  # none: where it was
    end = float(np.linalg.norm(goals - along[-1], axis=1).min(initial=np.inf))
    certificate.holds("ground_truth", end < row.success_distance, row.success_distance, end, "metres left to the goal")


def _cut(path: F64, spacing: float) -> F64:
    """Return corners (n, 3) with each segment divided into the fewest equal parts of at most `spacing` metres."""
    along = np.diff(path, axis=0)
    parts = np.ceil(np.sqrt((along * along).sum(axis=1)) / spacing - SLACK).astype(np.int64)
    side = np.repeat(np.arange(len(along)), parts)
    within = np.arange(len(side)) - np.repeat(np.cumsum(parts) - parts, parts)
    return np.concatenate([path[side] + along[side] * (within / parts[side])[:, None], path[-1:]])
