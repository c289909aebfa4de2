"""Goal points: positions where an agent counts as having reached an object."""

from __future__ import annotations

import math
from collections.abc import Container, Sequence
from typing import Final
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray
from shapely import Polygon, contains_xy

from condvln.episodes.footprint import Footprint
from condvln.episodes.kernels.spread import farthest_points
from condvln.episodes.view import SceneView
from condvln.navigation.pathfinder import Pathfinder
from condvln.navigation.protocol import PathfinderProtocol
from condvln.navigation.sight import View, eyes_at
from condvln.scene import Room, Scene, SceneObject, round_mm
from schemas.config import GoalsConfig, PlacesConfig
from schemas.config.constants import (
    FAR_RING_GAP,
    FLOOR_STANDING,
    FURNITURE_DETOUR,
    HANG,
    LOW_EYE,
    RING_GAP,
    RING_SPACING,
    SINK,
    SNAP_TOLERANCE,
    WALL_DETOUR,
)

__all__ = ["blocked_footprints", "goal_points", "is_standable", "scene_goals", "wide_islands"]

F64 = NDArray[np.float64]


_WIDE: Final[WeakKeyDictionary[PathfinderProtocol, dict[float, tuple[int, ...]]]] = WeakKeyDictionary()
"""Wide islands of each pathfinder in use, by the least radius."""


def wide_islands(pathfinder: PathfinderProtocol, places: PlacesConfig) -> tuple[int, ...]:
    """Return the islands that episodes may use: those that are wide enough and have floor area. Islands of degenerate
    triangles have no floor area.
    """
    known = _WIDE.setdefault(pathfinder, {})
    found = known.get(places.island_radius)
    if found is None:
        found = known[places.island_radius] = tuple(
            k
            for k in range(pathfinder.num_islands)
            if pathfinder.island_radius(k) >= places.island_radius and pathfinder.island_area(k) > 0
        )
    return found


def is_standable(pathfinder: Pathfinder, points: F64, places: PlacesConfig) -> NDArray[np.bool_]:
    """Return a mask (n,) of the `points` (n, 3) that lie on an island that is wide enough. The caller must already have
    rounded the points to 1 mm.
    """
    snapped, islands = pathfinder.snap_to_islands(points)
    near = np.hypot(*(snapped - points)[:, [0, 2]].T) <= SNAP_TOLERANCE
    level = np.abs(snapped[:, 1] - points[:, 1]) <= SNAP_TOLERANCE
    wide = (islands[:, None] == np.array(wide_islands(pathfinder, places), islands.dtype)).any(axis=1)
    return np.asarray(near & level & wide, dtype=np.bool_)


def blocked_footprints(
    scene: Scene, pathfinder: PathfinderProtocol, max_climb: float
) -> list[tuple[SceneObject, Footprint]]:
    """Return each object that stands on the floor but is ignored by the navmesh, together with its footprint. The
    navmesh continues below such an object.

    An object is ignored by the navmesh when the floor under the centre of its box can be stood on; furniture that
    the navmesh takes into account leaves a hole there (or is walkable on top). Flat objects that an agent
    steps over do not count.
    """
    found = []
    for item in scene.objects:
        room = scene.room_of.get(item.room_id)
        box = Footprint.of(item)
        if item.aabb is None or box is None or room is None:
            continue
        bottom, top = item.aabb[0][1], item.aabb[1][1]
        base = max(room.floor_y, bottom) if room.annotation == "scene" else room.floor_y
        if bottom - base >= FLOOR_STANDING or top - base <= max_climb:
            continue
        if room.annotation == "scene" and not _stands_low(item, pathfinder):
            continue
        below = np.array([[box.center[0], bottom, box.center[1]]])
        snapped = pathfinder.snap_points(below)
        on_floor = np.hypot(*(snapped - below)[0, [0, 2]]) <= SNAP_TOLERANCE and abs(snapped[0, 1] - bottom) < SINK
        if on_floor:
            found.append((item, box))
    return found


def _stands_low(item: SceneObject, pathfinder: PathfinderProtocol) -> bool:
    """Return whether an object stands on the floor: its bottom is less than FLOOR_STANDING above the nearest floor."""
    assert item.aabb is not None
    bottom = np.array([[item.center[0], item.aabb[0][1], item.center[2]]])
    snapped = pathfinder.snap_points(bottom)
    return bool(np.isfinite(snapped).all() and item.aabb[0][1] - snapped[0, 1] < FLOOR_STANDING)


def scene_goals(
    scene: Scene,
    pathfinder: Pathfinder,
    places: PlacesConfig,
    rules: GoalsConfig,
    obstacles: Sequence[tuple[SceneObject, Footprint]] = (),
    view: SceneView | None = None,
    named: Container[str] | None = None,
) -> dict[str, F64]:
    """Return the goal points (k, 3) of every object that has any, by object id, sorted by id.

    named : ids of the objects to which episodes may lead; None means all
    """
    goals = {}
    for object_id, item in sorted(scene.object_of.items()):
        room = scene.room_of.get(item.room_id)
        if room is not None and (named is None or object_id in named):
            points = goal_points(item, room, pathfinder, places, rules, obstacles, view)
            if len(points):
                goals[object_id] = points
    return goals


def goal_points(
    item: SceneObject,
    room: Room,
    pathfinder: Pathfinder,
    places: PlacesConfig,
    rules: GoalsConfig,
    obstacles: Sequence[tuple[SceneObject, Footprint]] = (),
    view: SceneView | None = None,
) -> F64:
    """Return at most ``rules.points`` navigable points (k, 3) around `item`, sorted by distance to its box; empty if no
    point is suitable.

    With a `view`, part of the object is visible from each point, to the camera or to a lower eye that can look under a
    table. All points lie on the same side of any wall: their geodesic distance to the point nearest to the box is at
    most half the box's perimeter plus WALL_DETOUR, or plus FURNITURE_DETOUR where walls limit what is visible.
    """
    box = Footprint.of(item)
    if box is None:
        box = Footprint(item.center[[0, 2]], np.zeros(2), np.eye(2))
    bottom = float(item.aabb[0][1]) if item.aabb is not None else float(item.center[1])
    for offsets, reach in ((near_rings(rules), rules.reach), (far_rings(rules), rules.reach_at_most)):
        found = _standing_places(item, room, box, bottom, offsets, reach, pathfinder, places, obstacles, view)
        if len(found):
            detour = FURNITURE_DETOUR if view is not None and view.walls_known else WALL_DETOUR
            return _spread(found, box, rules.points, pathfinder, box.half_perimeter + detour)
    return np.empty((0, 3))


def near_rings(rules: GoalsConfig) -> tuple[float, ...]:
    """Return the radii of the rings within the reach: how far each ring is from the object, in metres. The radii are
    evenly spaced; the largest is 4 % below the reach, since snapping moves candidates a little.
    """
    count = math.ceil(rules.reach / RING_GAP)
    return tuple(round(0.96 * rules.reach * (k + 1) / count, 6) for k in range(count))


def far_rings(rules: GoalsConfig) -> tuple[float, ...]:
    """Return the radii of the rings outside the reach: how far each ring is from the object, in metres. The radii lie
    between 20 and 80 % of the way from the reach to the largest allowed distance.
    """
    span = rules.reach_at_most - rules.reach
    count = math.ceil(span / FAR_RING_GAP)
    steps = [0.5] if count == 1 else [0.2 + 0.6 * k / (count - 1) for k in range(count)]
    return tuple(round(rules.reach + span * step, 6) for step in steps)


def _standing_places(
    item: SceneObject,
    room: Room,
    box: Footprint,
    bottom: float,
    offsets: Sequence[float],
    reach: float,
    pathfinder: Pathfinder,
    places: PlacesConfig,
    obstacles: Sequence[tuple[SceneObject, Footprint]],
    view: SceneView | None,
) -> F64:
    if not offsets:
        return np.empty((0, 3))
    flat = np.concatenate([box.ring(offset, RING_SPACING) for offset in offsets])
    # Without a room to give the storey, the floor is the one nearest to the object's own bottom.
    height = bottom if room.annotation == "scene" else room.floor_y
    asked = np.column_stack([flat[:, 0], np.full(len(flat), height), flat[:, 1]])
    # Each island is asked separately, so that a walkable table top never hides the floor beneath it.
    islands = wide_islands(pathfinder, places)
    tries = np.concatenate([asked] * len(islands)) if islands else asked[:0]
    snapped = np.concatenate([pathfinder.snap_points(asked, island) for island in islands] or [asked[:0]])
    good = np.isfinite(snapped).all(axis=1)
    good &= np.hypot(*(snapped - tries)[:, [0, 2]].T) <= SNAP_TOLERANCE
    points = _distinct(round_mm(snapped[good]))
    if not len(points):
        return points
    hang = bottom - points[:, 1]
    keep = (hang <= HANG) & (hang >= -SINK) & (box.distance(points) <= reach) & is_standable(pathfinder, points, places)
    if room.annotation != "scene":
        keep &= np.abs(points[:, 1] - room.floor_y) <= SINK
        if room.polygon is not None:
            keep &= contains_xy(Polygon(room.polygon), points[:, 0], points[:, 2])
    points = points[keep]
    low, high = (points.min(axis=0), points.max(axis=0)) if len(points) else (np.zeros(3), np.zeros(3))
    free = np.ones(len(points), dtype=bool)
    for other, footprint in obstacles:
        if other.object_id != item.object_id and not footprint.is_beside(low, high):
            free &= footprint.distance(points) > 0.0
    points = points[free]
    if view is not None:
        points = points[_seeing(points, item, view, places)]
    if not len(points):
        return points
    order = np.lexsort((points[:, 2], points[:, 0], box.distance(points)))
    return np.asarray(points[order], dtype=np.float64)


def _distinct(points: F64) -> F64:
    """Return the distinct ones of `points` (n, 3), in ascending order, as ``np.unique`` does, but faster."""
    ordered = points[np.lexsort((points[:, 2], points[:, 1], points[:, 0]))]
    fresh = np.ones(len(ordered), dtype=bool)
    fresh[1:] = (ordered[1:] != ordered[:-1]).any(axis=1)
    return np.asarray(ordered[fresh], dtype=np.float64)


def _seeing(points: F64, item: SceneObject, view: SceneView, places: PlacesConfig) -> NDArray[np.bool_]:
    """Return a mask (n,) of the `points` (n, 3) from which some part of the object is visible."""
    seen = np.zeros(len(points), dtype=bool)
    for height in (places.eye_height, LOW_EYE):
        left = np.flatnonzero(~seen)
        if len(left):
            seen[left] = view.glimpsed(eyes_at(points[left], height), item.object_id, View(range=places.sight_range))
    return seen


def _spread(points: F64, box: Footprint, count: int, pathfinder: Pathfinder, limit: float) -> F64:
    """Choose up to `count` of `points` that are spread out, and return them sorted by distance to `box`. The first of
    `points` is always chosen, then repeatedly the point farthest from all points chosen before (the earliest on ties).
    Points whose geodesic distance from the first one is above `limit` metres are never chosen: a wall lies between.
    """
    ways = np.full(len(points), np.nan)  # geodesic distances from the first point, where they are known
    while True:
        taken = farthest_points(points, count, ways > limit, RING_SPACING)
        unknown = taken[np.isnan(ways[taken])]
        if not len(unknown):
            break
        found = pathfinder.geodesic_distances(points[0], points[unknown])
        ways[unknown] = np.where(np.isnan(found), np.inf, found)
    chosen = points[taken]
    return np.asarray(chosen[np.argsort(box.distance(chosen), kind="stable")], dtype=np.float64)
