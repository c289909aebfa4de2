"""Check looking paths: walks on which an agent sees the evidence of each condition before it acts on it.

The published actions are executed by this package's own walker. Frame k is what a level camera shows after k actions.
A condition is decided at the first frame by which all targets of one of its proofs are seen, and the frame that an
episode names must be that one: at an earlier frame the agent could not know, and an honest agent does not look longer.
It must be decided before the walk comes to a stop or a goal that only the branch taken has.

The path itself is checked on the navmesh: it begins at the start, is walkable, passes the stops of the gold leaf in
order and ends at a goal. The walk may stray from it as far as discrete steps do.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from itertools import pairwise
from typing import Final

import numpy as np

from condvln.arrays import F64, Bools
from condvln.navigation.follower import FORWARD, LEFT, RIGHT, STOP
from condvln.navigation.pathfinder import Pathfinder
from condvln.navigation.sight import eyes_at
from condvln.verify.certificate import Certificate, VerifierRules
from condvln.verify.observability import proofs_of, stops_of
from condvln.verify.program_check import tree_of
from condvln.verify.records import executed
from condvln.verify.referents import SceneReferents
from condvln.verify.sight import Sight, Sought
from condvln.verify.standpoint import yaw_of
from schemas.episode import EpisodeLeaf
from schemas.evaluation import ManifestEpisode

__all__ = ["check_looking"]


CORNER: Final = 0.002
"""Tolerance in metres of a point that is rounded to 1 mm, on its three axes."""
STRAY: Final = 0.5
"""Metres on the ground, two steps, by which the walk may miss the path, and a corner of it, until all is decided."""
STRAY_ONWARD: Final = 1.5
"""The same after that, when the walk goes on by what is the shortest way from each of its places. The path may be so
much longer than the walk, since the walk cuts corners.
"""
SAMPLES: Final = 0.1
"""Metres between points of a straight line that are looked up on the navmesh, which is as far from each wall."""
FACING: Final = 20.0
"""Degrees to either side within which the goal is ahead at the end."""
ROUNDING: Final = 1e-6
_ACTIONS: Final = frozenset((STOP, FORWARD, LEFT, RIGHT))


def check_looking(
    rows: Sequence[ManifestEpisode],
    certificates: Sequence[Certificate],
    pathfinder: Pathfinder,
    sight: Sight,
    referents: SceneReferents,
    rules: VerifierRules,
) -> None:
    """Check the looking paths of the episodes of one scene. The positions of the episodes must already have been
    checked.
    """
    asked = [pair for pair in zip(rows, certificates, strict=True) if _is_told(*pair)]
    if not asked:
        return
    paths = [np.array(row.looking_path, np.float64) for row, _ in asked]
    sides = np.array([side for path in paths for side in pairwise(path)])
    metres = pathfinder.geodesic_distances(sides[:, 0], sides[:, 1]).astype(np.float64)
    straight = np.linalg.norm(sides[:, 1] - sides[:, 0], axis=1)
    # Detour's way is longer than a straight one where its corridor is another.
    joined = [
        extra <= 2 * CORNER or _is_open(pathfinder, *side) for extra, side in zip(metres - straight, sides, strict=True)
    ]
    walkable = np.split(np.array(joined, bool), np.cumsum([len(path) - 1 for path in paths])[:-1])
    actions = [np.array(row.looking_actions, np.int8) for row, _ in asked]
    yaws = [yaw_of(row.start_rotation) or 0.0 for row, _ in asked]
    walks = executed(pathfinder, [row.start_position for row, _ in asked], yaws, [taken[:-1] for taken in actions])
    for (row, certificate), path, free, walk in zip(asked, paths, walkable, walks, strict=True):
        gold = row.leaves[row.gold_leaf]
        # Corners of a path have the height of the navmesh's polygons; stops that of its finer floor there.
        feet = np.column_stack([path[:, 0], pathfinder.snap_points(path)[:, 1], path[:, 2]])
        faults = [*_off_path(row, gold, path, feet, free)]
        certificate.holds("looking_path", not faults, "a walk over the floor past the stops", faults)
        _check_bounds(row, gold, path, rules, certificate)
        faults = [*_astray(row, gold, path, *walk, pathfinder, sight, rules)]
        certificate.holds("looking_actions", not faults, "a walk along the path to the goal", faults)
        _check_decisions(row, *walk, sight, referents, rules, certificate)


def _is_told(row: ManifestEpisode, certificate: Certificate) -> bool:
    """Return whether a row has a looking path with actions that can be executed; record it if not."""
    path, taken = row.looking_path or (), row.looking_actions or ()
    told = len(path) > 1 and row.looking_length is not None and row.looking_decided is not None
    certificate.holds("looking_path", told, "a looking path", (path, row.looking_length, row.looking_decided))
    stops = _ACTIONS.issuperset(taken) and taken[-1:] == (STOP,) and taken.count(STOP) == 1
    certificate.holds("looking_actions", stops, "actions whose only STOP is the last one", taken)
    return told and stops and 0 <= row.gold_leaf < len(row.leaves)


def _is_open(pathfinder: Pathfinder, begin: F64, end: F64) -> bool:
    """Return whether a straight line from one corner to the next lies on the navmesh."""
    points = np.linspace(begin, end, math.ceil(float(np.linalg.norm(end - begin)) / SAMPLES) + 1)
    moved = pathfinder.snap_points(points) - points
    return bool((np.hypot(moved[:, 0], moved[:, 2]) <= CORNER).all())


def _off_path(row: ManifestEpisode, gold: EpisodeLeaf, path: F64, feet: F64, walkable: Bools) -> Iterator[str]:
    """Yield what is wrong with a path. `feet` are its corners on the floor, NaN where there is none; `walkable` tells
    of each two neighbouring corners whether they are joined.
    """
    if math.dist(path[0], row.start_position) > CORNER:
        yield "it does not begin at the start"
    if not walkable.all():
        yield f"it is blocked after corner {walkable.argmin()}"
    at = 0
    for stop in gold.subgoals:
        near = _at(path[at:], feet[at:], stop.position)
        if not near.any():
            yield f"it does not pass {stop.object_id}"
        at += int(near.argmax())
    if not any(_at(path[-1:], feet[-1:], goal).any() for goal in gold.goals):
        yield "it does not end at a goal"


def _at(path: F64, feet: F64, stop: Sequence[float]) -> Bools:
    """Return a mask (n,) of the corners of a path (n, 3) that are at a stop, themselves or on the floor."""
    away = np.linalg.norm(np.stack([path, feet]) - np.array(stop), axis=2)
    return np.asarray((away <= CORNER).any(axis=0))


def _check_bounds(
    row: ManifestEpisode, gold: EpisodeLeaf, path: F64, rules: VerifierRules, certificate: Certificate
) -> None:
    """Check the length of a path, and that it and its actions are within what the configuration allows."""
    assert row.looking_length is not None
    assert row.looking_actions is not None
    length = float(np.linalg.norm(np.diff(path, axis=0), axis=1).sum())
    certificate.close("looking_length", row.looking_length, length, CORNER / 2 * len(path))
    most = rules.episodes.looking_detour.most(gold.route_length)
    certificate.holds("looking_detour", length <= most + CORNER * len(path), most, length)
    taken, ceiling = 1.5 * len(row.looking_actions), rules.episodes.step_ceiling
    certificate.holds("looking_budget", taken <= ceiling, f"at most {ceiling}", taken, "1.5 times the actions")


def _astray(
    row: ManifestEpisode,
    gold: EpisodeLeaf,
    path: F64,
    places: F64,
    yaws: F64,
    pathfinder: Pathfinder,
    sight: Sight,
    rules: VerifierRules,
) -> Iterator[str]:
    """Yield what is wrong with a walk: where it leaves the path, what it misses, and where it ends."""
    off = _distances(places, path)
    decided = np.arange(len(places)) > max(row.looking_decided or (0,))
    most = np.where(decided, STRAY_ONWARD, STRAY)
    if (off > most).any():
        yield f"frame {int((off - most).argmax())} is {off[(off - most).argmax()]:.2f} m from the path"
    spared = sum(map(math.dist, path, path[1:])) - sum(map(math.dist, places, places[1:]))
    if spared > STRAY_ONWARD:
        yield f"it is {spared:.2f} m shorter than the path"
    at = 0
    for number, corner in enumerate(path):
        near = np.hypot(*(places[at:] - corner)[:, ::2].T) <= most[at:]
        if not near.any():
            yield f"it does not pass corner {number} of the path"
            break
        at += int(near.argmax())
    at = 0
    for stop in gold.subgoals:
        near = np.linalg.norm(places[at:] - np.array(stop.position), axis=1) <= row.success_distance
        if not near.any():
            yield f"it does not pass {stop.object_id}"
        at += int(near.argmax())
    left = float(pathfinder.distance_table(places[-1:], np.array(gold.goals)).min())
    if not left <= row.success_distance:
        yield f"it ends {left:.2f} m from the goal"
    eye = eyes_at(places[-1], rules.places.eye_height)[0]
    if not sight.is_ahead(("thing", gold.object_id, 0.0), eye, float(yaws[-1]), FACING):
        yield f"{gold.object_id} is not ahead at the end"


def _distances(places: F64, path: F64) -> F64:
    """Return the distance (n,) on the ground in metres from each of the places (n, 3) to a path of corners (k, 3)."""
    begin, side = path[:-1, ::2], np.diff(path[:, ::2], axis=0)
    away = places[:, None, ::2] - begin
    square = (side * side).sum(axis=1)
    along = np.clip((away * side).sum(axis=2) / np.where(square > 0, square, 1), 0, 1)
    metres: F64 = np.linalg.norm(away - along[..., None] * side, axis=2).min(axis=1)
    return metres


def _check_decisions(
    row: ManifestEpisode,
    places: F64,
    yaws: F64,
    sight: Sight,
    referents: SceneReferents,
    rules: VerifierRules,
    certificate: Certificate,
) -> None:
    """Check at which frame each condition on the gold path is decided."""
    route = [*dict.fromkeys(row.program.route()[0])]
    frames = row.looking_decided or ()
    if not certificate.same("looking_decided", len(frames), len(route), "number of conditions"):
        return
    eyes = eyes_at(places, rules.places.eye_height)
    for number, told in zip(route, frames, strict=True):
        upto, known = max(told + 1, 0), dict[Sought, float]()
        found = math.inf
        for way in proofs_of(row.program.conditions[number], referents, sight):
            for thing in way:
                if thing not in known:
                    first = sight.first_frame(thing, eyes[:upto], yaws[:upto])
                    known[thing] = math.inf if first is None else first
            found = min(found, max(known[thing] for thing in way))
        certificate.same("looking_decided", told, found, f"condition {number}")
        acted = _acts(row, number, places)
        certificate.holds("looking_acted", told <= acted, told, acted, f"condition {number}")


def _acts(row: ManifestEpisode, number: int, places: F64) -> float:
    """Return the first frame at which a walk is within the success distance of a stop or goal that only the branch
    taken has; infinity if there is none.
    """
    _, then, other = next(side for side in tree_of(row.program).sides if side[0] == number)
    taken, left = (then, other) if row.program.conditions[number].truth else (other, then)
    passed = {name for name, _ in stops_of([row.leaves[k] for k in left])}
    only = [place for name, place in stops_of([row.leaves[k] for k in taken]) if name not in passed]
    away = places[:, None, ::2] - np.array(only).reshape(-1, 3)[:, ::2]
    near = (np.linalg.norm(away, axis=2) < row.success_distance - ROUNDING).any(axis=1)
    return float(near.argmax()) if near.any() else math.inf
