"""Goal points: positions where an agent counts as having reached an object."""

from __future__ import annotations

import math
from collections.abc import Container, Sequence
from typing import Final
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray
from shapely import Polygon, contains_xy

from condvln.arrays import F64
from condvln.episodes.footprint import Footprint, Obstacles
from condvln.episodes.view import SceneView
from condvln.navigation.pathfinder import Pathfinder
from condvln.navigation.protocol import PathfinderProtocol
from condvln.navigation.sight import Recognition, eyes_at
from condvln.scene import Room, Scene, SceneObject, round_mm
from schemas.config import GoalsConfig, PlacesConfig
from schemas.config.constants import (
    FAR_RING_GAP,
    FLOOR_STANDING,
    FURNITURE_DETOUR,
    HANG,
    RING_GAP,
    RING_SPACING,
    SINK,
    SNAP_TOLERANCE,
    WALL_DETOUR,
)

__all__ = ["blocked_footprints", "goal_points", "is_standable", "scene_goals", "wide_islands"]

Sight = tuple[SceneView, Recognition]


THIN: Final = 0.05
"""Thickness in metres up to which the edges of a thing show little of it."""

EDGE_ON: Final = 0.01
"""Metres from the plane of a large face of a thin thing within which nobody stops to look at it."""

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
    low = list[tuple[SceneObject, Footprint]]()
    bottoms, unsure = list[float](), list[bool]()
    for item in scene.objects:
        room = scene.room_of.get(item.room_id)
        if item.aabb is None or room is None:
            continue
        (_, bottom, _), (_, top, _) = item.aabb.tolist()
        storeyless = room.annotation == "scene"
        base = max(room.floor_y, bottom) if storeyless else room.floor_y
        if bottom - base >= FLOOR_STANDING or top - base <= max_climb:
            continue
        box = Footprint.of(item)
        if box is not None:
            low.append((item, box))
            bottoms.append(bottom)
            unsure.append(storeyless)
    if not low:
        return []
    height = np.array(bottoms)
    below = np.insert(np.array([box.center for _, box in low]), 1, height, axis=1)
    snapped = pathfinder.snap_points(below)
    blocked = np.hypot(*(snapped - below)[:, [0, 2]].T) <= SNAP_TOLERANCE
    blocked &= np.abs(snapped[:, 1] - height) < SINK
    # Without a room to give the storey, an object must be less than FLOOR_STANDING above the floor nearest to it.
    asked = np.flatnonzero(blocked & np.array(unsure))
    if len(asked):
        feet = np.array([low[k][0].center for k in asked])
        feet[:, 1] = height[asked]
        floor = pathfinder.snap_points(feet)
        blocked[asked] = np.isfinite(floor).all(axis=1) & (height[asked] - floor[:, 1] < FLOOR_STANDING)
    return [low[k] for k in np.flatnonzero(blocked)]


def scene_goals(
    scene: Scene,
    pathfinder: Pathfinder,
    places: PlacesConfig,
    rules: GoalsConfig,
    obstacles: Obstacles = (),
    sight: Sight | None = None,
    named: Container[str] | None = None,
) -> dict[str, F64]:
    """Return the goal points (k, 3) of every object that has any, by object id, sorted by id.

    sight : the scene's lines of sight, and when an agent at a goal point recognises the object; None tests neither
    named : ids of the objects to which episodes may lead; None means all
    """
    found = {}
    for object_id, item in sorted(scene.object_of.items()):
        room = scene.room_of.get(item.room_id)
        if room is not None and (named is None or object_id in named):
            points = goal_points(item, room, pathfinder, places, rules, obstacles, sight)
            if len(points):
                found[object_id] = points
    return found


def goal_points(
    item: SceneObject,
    room: Room,
    pathfinder: Pathfinder,
    places: PlacesConfig,
    rules: GoalsConfig,
    obstacles: Obstacles = (),
    sight: Sight | None = None,
) -> F64:
    """Return at most ``rules.points`` navigable points (k, 3) around `item`, sorted by distance to its box; empty if no
    point is suitable.

    Points farther than ``rules.reach`` from its box are used on sides where no nearer one is suitable: a level camera
    that stands close to a low thing looks over it.

    With `sight`, a level camera recognises the object from each point, so that a walk ends with it in view. All points
    lie on the same side of any wall: their geodesic distance to the point nearest to the box is at most half the box's
    perimeter plus WALL_DETOUR, or plus FURNITURE_DETOUR where walls limit what is visible.
    """
    box = Footprint.of(item) or Footprint(item.center[[0, 2]], np.zeros(2), np.eye(2))
    detour = FURNITURE_DETOUR if sight is not None and sight[0].walls_known else WALL_DETOUR
    points = np.empty((0, 3))
    for offsets, reach in ((near_rings(rules), rules.reach), (far_rings(rules), rules.reach_at_most)):
        found = _standing_places(item, room, box, offsets, reach, pathfinder, places, obstacles)
        if sight is not None:
            view, recognition = sight
            found = found[~_is_edge_on(found, box)]
            found = found[view.recognised(eyes_at(found, places.eye_height), item.object_id, recognition)]
        away = np.linalg.norm(found[:, None] - points, axis=2).min(axis=1, initial=np.inf)
        points = np.concatenate([points, found[away > rules.reach_at_most]])
    ordered = points[np.lexsort((points[:, 2], points[:, 0], box.distance(points)))]
    return _spread(ordered, box, rules.points, pathfinder, box.half_perimeter + detour) if len(points) else points


def _is_edge_on(points: F64, box: Footprint) -> NDArray[np.bool_]:
    """Return a mask (n,) of the points in the plane of one of the two large upright faces of a thin thing, where rings
    around it have places. Rounding alone would decide whether an agent sees that face, which may be all that there is
    to see of a mirror.
    """
    thin = int(np.argmin(box.half))
    if box.half[thin] > THIN / 2:
        return np.zeros(len(points), dtype=bool)
    off = np.abs((points[:, [0, 2]] - box.center) @ box.axes[thin])
    return np.asarray(np.abs(off - box.half[thin]) < EDGE_ON)


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
    offsets: Sequence[float],
    reach: float,
    pathfinder: Pathfinder,
    places: PlacesConfig,
    obstacles: Obstacles,
) -> F64:
    """Return the places (n, 3) on rings around an object at which an agent can stand, in ascending order.

    offsets : radii of the rings; reach : greatest distance from the object's box; all in metres
    """
    if not offsets:
        return np.empty((0, 3))
    bottom = float(item.center[1] if item.aabb is None else item.aabb[0][1])
    storeyless = room.annotation == "scene"
    # Without a room to give the storey, the floor is sought that is nearest to the object's own bottom.
    height = bottom if storeyless else room.floor_y
    asked = np.insert(np.concatenate([box.ring(offset, RING_SPACING) for offset in offsets]), 1, height, axis=1)
    # Each island is asked separately, so that a walkable table top never hides the floor beneath it.
    islands = wide_islands(pathfinder, places)
    tries = np.concatenate([asked[:0], *[asked] * len(islands)])
    snapped = np.concatenate([asked[:0], *(pathfinder.snap_points(asked, island) for island in islands)])
    good = np.isfinite(snapped).all(axis=1)
    good &= np.hypot(*(snapped - tries)[:, [0, 2]].T) <= SNAP_TOLERANCE
    points = np.unique(round_mm(snapped[good]), axis=0)
    hang = bottom - points[:, 1]
    keep = (hang <= HANG) & (hang >= -SINK) & (box.distance(points) <= reach)
    keep &= is_standable(pathfinder, points, places)
    if not storeyless:
        keep &= np.abs(points[:, 1] - room.floor_y) <= SINK
        if room.polygon is not None:
            keep &= contains_xy(Polygon(room.polygon), points[:, 0], points[:, 2])
    for other, footprint in obstacles:
        if other.object_id != item.object_id:
            keep &= footprint.distance(points) > 0.0
    return np.asarray(points[keep], dtype=np.float64)


def farthest_points(points: F64, count: int, excluded: NDArray[np.bool_], least: float) -> NDArray[np.int64]:
    """Return the indices of up to `count` of the points (n, 3): the first one, then repeatedly the one farthest from
    all before that is not `excluded` (n,), the earliest on ties, as long as it is at least `least` metres away.
    """
    gap, taken = np.where(excluded, -1.0, np.inf), [0]
    while len(taken) < min(count, len(points)):
        gap = np.minimum(gap, np.linalg.norm(points - points[taken[-1]], axis=1))
        following = int(np.argmax(gap))
        if gap[following] < least:
            break
        taken.append(following)
    return np.array(taken, np.int64)


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
