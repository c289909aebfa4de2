"""Goal points: positions where an agent counts as having reached an object."""

from __future__ import annotations

import math
from collections.abc import Container, Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Final
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray
from shapely import Polygon, contains_xy

from condvln.episodes.footprint import Footprint, footprint_of
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

TRIED_AT_ONCE: Final = 100_000
"""Places on rings around objects that are tried together; each island is asked for each of them."""

_WIDE: Final[WeakKeyDictionary[PathfinderProtocol, dict[float, tuple[int, ...]]]] = WeakKeyDictionary()
"""Wide islands of each pathfinder in use, by the least radius."""

_BLOCKED: Final[
    WeakKeyDictionary[
        Scene, WeakKeyDictionary[PathfinderProtocol, dict[float, tuple[tuple[SceneObject, Footprint], ...]]]
    ]
] = WeakKeyDictionary()
"""What `blocked_footprints` found in each scene in use, by pathfinder and climb: three stages ask the same."""


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
    known = _BLOCKED.setdefault(scene, WeakKeyDictionary()).setdefault(pathfinder, {})
    found = known.get(max_climb)
    if found is None:
        found = known[max_climb] = _blocked(scene, pathfinder, max_climb)
    return list(found)


def _blocked(
    scene: Scene, pathfinder: PathfinderProtocol, max_climb: float
) -> tuple[tuple[SceneObject, Footprint], ...]:
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
        box = footprint_of(scene, item)
        if box is not None:
            low.append((item, box))
            bottoms.append(bottom)
            unsure.append(storeyless)
    if not low:
        return ()
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
    return tuple(low[k] for k in np.flatnonzero(blocked))


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
    around = {}
    for object_id, item in sorted(scene.object_of.items()):
        room = scene.room_of.get(item.room_id)
        if room is not None and (named is None or object_id in named):
            around[object_id] = _Around.of(item, room, footprint_of(scene, item))
    batches = _batches(list(around.values()), rules)
    found = [x for batch in batches for x in _goal_points(batch, pathfinder, places, rules, obstacles, view)]
    return {object_id: points for object_id, points in zip(around, found, strict=True) if len(points)}


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
    return _goal_points([_Around.of(item, room, Footprint.of(item))], pathfinder, places, rules, obstacles, view)[0]


@dataclass(frozen=True, eq=False, slots=True)
class _Around:
    """An object around which goal points are sought, and its room; `bottom` is its lowest height in metres."""

    item: SceneObject
    room: Room
    box: Footprint
    bottom: float

    @classmethod
    def of(cls, item: SceneObject, room: Room, box: Footprint | None) -> _Around:
        if box is None:
            box = Footprint(item.center[[0, 2]], np.zeros(2), np.eye(2))
        bottom = float(item.aabb[0][1]) if item.aabb is not None else float(item.center[1])
        return cls(item, room, box, bottom)

    @property
    def height(self) -> float:
        """Height in metres at which the floor is sought: without a room to give the storey, that is the floor nearest
        to the object's own bottom.
        """
        return self.bottom if self.room.annotation == "scene" else self.room.floor_y


def _batches(around: Sequence[_Around], rules: GoalsConfig) -> Iterator[list[_Around]]:
    """Yield the objects in batches of about `TRIED_AT_ONCE` places on rings, so that large objects with a long reach
    do not fill the memory.
    """
    batch, tried = list[_Around](), 0.0
    for one in around:
        rings = max((near_rings(rules), far_rings(rules)), key=sum)
        extent = sum(4.0 * float(box.half.sum()) for box in one.box.parts or (one.box,))
        batch.append(one)
        tried += sum(extent + 2 * math.pi * radius for radius in rings) / RING_SPACING
        if tried > TRIED_AT_ONCE:
            yield batch
            batch, tried = [], 0.0
    if batch:
        yield batch


def _goal_points(
    around: Sequence[_Around],
    pathfinder: Pathfinder,
    places: PlacesConfig,
    rules: GoalsConfig,
    obstacles: Sequence[tuple[SceneObject, Footprint]],
    view: SceneView | None,
) -> list[F64]:
    """Return the goal points of each of several objects; see `goal_points`."""
    detour = FURNITURE_DETOUR if view is not None and view.walls_known else WALL_DETOUR
    chosen = [np.empty((0, 3))] * len(around)
    left = list(range(len(around)))
    for offsets, reach in ((near_rings(rules), rules.reach), (far_rings(rules), rules.reach_at_most)):
        asked = [around[k] for k in left]
        found = _standing_places(asked, offsets, reach, pathfinder, places, obstacles)
        if view is not None:
            masks = _seeing(found, asked, view, places)
            found = [points[mask] for points, mask in zip(found, masks, strict=True)]
        for k, seen in zip(left, found, strict=True):
            one = around[k]
            if len(seen):
                ordered = seen[np.lexsort((seen[:, 2], seen[:, 0], one.box.distance(seen)))]
                chosen[k] = _spread(ordered, one.box, rules.points, pathfinder, one.box.half_perimeter + detour)
        left = [k for k in left if not len(chosen[k])]
    return chosen


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
    around: Sequence[_Around],
    offsets: Sequence[float],
    reach: float,
    pathfinder: Pathfinder,
    places: PlacesConfig,
    obstacles: Sequence[tuple[SceneObject, Footprint]],
) -> list[F64]:
    """Return for each object the places (n, 3) on rings around it at which an agent can stand, in ascending order.

    offsets : radii of the rings; reach : greatest distance from the object's box; all in metres
    """
    if not offsets or not around:
        return [np.empty((0, 3))] * len(around)
    flat = [np.concatenate([one.box.ring(offset, RING_SPACING) for offset in offsets]) for one in around]
    owner = np.repeat(np.arange(len(around)), [len(ring) for ring in flat])
    asked = np.insert(np.concatenate(flat), 1, np.array([one.height for one in around])[owner], axis=1)
    # Each island is asked separately, so that a walkable table top never hides the floor beneath it.
    islands = wide_islands(pathfinder, places)
    tries, owner = np.concatenate([asked[:0], *[asked] * len(islands)]), np.tile(owner, len(islands))
    snapped = np.concatenate([asked[:0], *(pathfinder.snap_points(asked, island) for island in islands)])
    good = np.isfinite(snapped).all(axis=1)
    good &= np.hypot(*(snapped - tries)[:, [0, 2]].T) <= SNAP_TOLERANCE
    owner, points = _distinct(owner[good], round_mm(snapped[good]))
    ends = np.searchsorted(owner, np.arange(len(around) + 1))
    near = [one.box.distance(points[i:j]) <= reach for one, (i, j) in zip(around, pairwise(ends), strict=True)]
    hang = np.array([one.bottom for one in around])[owner] - points[:, 1]
    keep = (hang <= HANG) & (hang >= -SINK) & np.concatenate(near) & is_standable(pathfinder, points, places)
    for room in {id(one.room): one.room for one in around}.values():
        if room.annotation != "scene":
            here = np.flatnonzero(np.array([one.room is room for one in around])[owner])
            keep[here] &= np.abs(points[here, 1] - room.floor_y) <= SINK
            if room.polygon is not None:
                keep[here] &= contains_xy(Polygon(room.polygon), points[here, 0], points[here, 2])
    owner, points = owner[keep], points[keep]
    free = np.ones(len(points), dtype=bool)
    for other, footprint in obstacles:
        others = np.array([one.item.object_id != other.object_id for one in around])
        close = np.flatnonzero(footprint.is_near(points) & others[owner])
        free[close] &= footprint.distance(points[close]) > 0.0
    ends = np.searchsorted(owner[free], np.arange(1, len(around)))
    return np.split(points[free], ends)


def _distinct(owner: NDArray[np.intp], points: F64) -> tuple[NDArray[np.intp], F64]:
    """Return the distinct ones of `points` (n, 3) of each of their owners (n,), in ascending order of both, as
    ``np.unique`` does, but faster.
    """
    order = np.lexsort((points[:, 2], points[:, 1], points[:, 0], owner))
    whose, ordered = owner[order], points[order]
    fresh = np.ones(len(ordered), dtype=bool)
    fresh[1:] = (ordered[1:] != ordered[:-1]).any(axis=1) | (whose[1:] != whose[:-1])
    return whose[fresh], np.asarray(ordered[fresh], dtype=np.float64)


def _seeing(
    found: Sequence[F64], around: Sequence[_Around], view: SceneView, places: PlacesConfig
) -> list[NDArray[np.bool_]]:
    """Return for each object a mask (n,) of its points (n, 3) in `found` from which some part of it is visible."""
    seen = [np.zeros(len(points), dtype=bool) for points in found]
    names, reach = [one.item.object_id for one in around], View(range=places.sight_range)
    for height in (places.eye_height, LOW_EYE):
        left = [np.flatnonzero(~mask) for mask in seen]
        eyes = [eyes_at(points[rows], height) for points, rows in zip(found, left, strict=True)]
        for mask, rows, more in zip(seen, left, view.glimpsed_each(eyes, names, reach), strict=True):
            mask[rows] = more
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
