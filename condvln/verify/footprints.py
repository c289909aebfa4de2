"""Footprints of objects: how far points are from a footprint, and which footprints a path on the navmesh crosses.
Sample points on the floor of a room, to measure how much of the floor is visible.

For a room with an outline the floor's points are the walkable points of a grid of about 256 points, at least 0.2 m
apart; all grid points if none is walkable. For a room without an outline they are 512 random points on the navmesh,
seeded by the scene. Points inside furniture that the navmesh ignores are left out, unless all are. Each point is 5 cm
above the navmesh, so that no rug hides it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np
import shapely
from numpy.typing import NDArray

from condvln.arrays import F64
from condvln.kept import kept
from condvln.navigation.pathfinder import Pathfinder
from condvln.scene import OrientedBox, Room, Scene, SceneObject
from condvln.seeding import generator
from schemas.config.constants import (
    FLOOR_LEAST_SPACING,
    FLOOR_LIFT,
    FLOOR_POINTS,
    FLOOR_STANDING,
    HANG,
    SINK,
    SNAP_TOLERANCE,
    UPRIGHT_COSINE,
)

__all__ = [
    "Ground",
    "Obstacles",
    "Point",
    "Reach",
    "ground_points",
]

Point = tuple[float, float, float]

_GROUND: Final = np.array([0, 2])
TOUCHING: Final = 0.001
"""Tolerance in metres by which a path may enter a footprint: positions are rounded to as much."""


class _Rectangle(NamedTuple):
    """A rectangle in the (x, z) plane: centre (2,), half lengths (2,), and axes (2, 2) as columns; metres."""

    centre: F64
    half: F64
    axes: F64

    def corners(self, inset: float) -> F64:
        """Return the (4, 2) corners of this rectangle after each side was moved inwards by `inset`."""
        reach = np.maximum(self.half - inset, 0.0)
        corners: F64 = self.centre + (np.array([[1, 1], [-1, 1], [-1, -1], [1, -1]]) * reach) @ self.axes.T
        return corners


class Ground:
    """The footprint of an object in the (x, z) plane: one rectangle, or one rectangle for each part of the object.

    centre : (2,) of the largest rectangle
    """

    def __init__(self, item: SceneObject) -> None:
        box = item.box
        self.bottom = float(item.center[1] if box is None else box[0, 1])
        whole = [item.obb] if item.obb is not None else []
        found = [_below(part) for part in item.parts or whole]
        self._rectangles = [rectangle for rectangle in found if rectangle is not None]
        if len(self._rectangles) < max(len(found), 1):
            low, high = (item.center, item.center) if item.aabb is None else item.aabb
            flat = (low + high)[_GROUND] / 2, (high - low)[_GROUND] / 2
            self._rectangles = [_Rectangle(*flat, np.eye(2))]
        self.centre: F64 = max(self._rectangles, key=lambda one: float(one.half[0] * one.half[1])).centre

    def distances(self, points: F64) -> F64:
        """Return the horizontal distance (n,) in metres from each of the points (n, 3) to the footprint; 0 for a point
        over or under the object.
        """
        away = []
        for centre, half, axes in self._rectangles:
            beyond = np.abs((points[:, _GROUND] - centre) @ axes) - half
            away.append(np.linalg.norm(np.maximum(beyond, 0.0), axis=1))
        return np.asarray(np.minimum.reduce(away))

    @property
    def half_round(self) -> float:
        """Half of the footprint's perimeter in metres."""
        if len(self._rectangles) == 1:
            return float(2.0 * self._rectangles[0].half.sum())
        return float(self.polygon(0.0).length) / 2.0

    def polygon(self, inset: float) -> shapely.Geometry:
        """Return the footprint as a polygon, with the sides of each rectangle moved inwards by `inset`."""
        return shapely.union_all([shapely.Polygon(one.corners(inset)) for one in self._rectangles])


def _below(box: OrientedBox) -> _Rectangle | None:
    """Return the rectangle below an upright box; None if the box is tilted."""
    east, up, south = box.rotation.tolist()
    steep = [abs(cosine) for cosine in up]
    if max(steep) < UPRIGHT_COSINE:
        return None
    upright = steep.index(max(steep))
    i, j = [axis for axis in range(3) if axis != upright]
    one, other = (math.sqrt(east[k] * east[k] + south[k] * south[k]) for k in (i, j))
    axes = np.array([[east[i] / one, east[j] / other], [south[i] / one, south[j] / other]])
    half = box.half_extents.tolist()
    return _Rectangle(box.center[_GROUND], np.array([half[i], half[j]]), axes)


class Reach:
    """Measures how far points are from an object of the scene, and whether the points are on the object's floor and in
    the object's room.

    Results are cached, since many episodes share an object's goals.
    """

    def __init__(self, scene: Scene) -> None:
        self._scene = scene
        self._known: dict[str, dict[Point, tuple[float, bool]]] = {}

    def around(self, object_id: str, positions: Sequence[Point]) -> tuple[tuple[float, ...], tuple[bool, ...]]:
        """Return two sequences: each position's horizontal distance in metres from the object, and whether the position
        is on the object's floor and in its room.

        Both are empty if the object does not exist.
        """
        known = self._known.setdefault(object_id, {})
        new = [position for position in positions if position not in known]
        if new:
            ground = self._ground(object_id)
            if ground is None:
                return (), ()
            points = np.array(new)
            room = self._scene.room_of[self._scene.object_of[object_id].room_id]
            here = _in_reach(ground, room, points)
            known.update(zip(new, zip(ground.distances(points).tolist(), here.tolist(), strict=True), strict=True))
        away, inside = zip(*[known[position] for position in positions], strict=True)
        return away, inside

    def half_round(self, object_id: str) -> float:
        """Return half of the perimeter of the footprint of an object that exists, in metres."""
        ground = self._ground(object_id)
        assert ground is not None
        return ground.half_round

    @kept
    def _ground(self, object_id: str) -> Ground | None:
        item = self._scene.object_of.get(object_id)
        known = item is not None and item.room_id in self._scene.room_of
        return Ground(item) if item is not None and known else None


def _in_reach(ground: Ground, room: Room, points: F64) -> NDArray[np.bool_]:
    """Return for each of the points (n, 3) whether the point is in `room`, and on the floor from which an agent reaches
    the object with the footprint `ground`.
    """
    hang = ground.bottom - points[:, 1]
    good = (hang <= HANG) & (hang >= -SINK)
    if room.annotation != "scene":
        good &= np.abs(points[:, 1] - room.floor_y) <= SINK
        if room.polygon is not None:
            good &= shapely.intersects_xy(shapely.Polygon(room.polygon), points[:, 0], points[:, 2])
    return np.asarray(good, dtype=np.bool_)


class Obstacles:
    """Objects that stand on the floor but that the navmesh ignores: it continues beneath these objects."""

    def __init__(self, scene: Scene, pathfinder: Pathfinder, max_climb: float) -> None:
        standing = [item for item in scene.objects if item.aabb is not None and item.room_id in scene.room_of]
        grounds = [Ground(item) for item in standing]
        below = np.array([[g.centre[0], g.bottom, g.centre[1]] for g in grounds]).reshape(-1, 3)
        floor = np.asarray(pathfinder.snap_points(below), dtype=np.float64)
        # Furniture that the navmesh takes into account leaves a hole, or its walkable top, under its centre.
        open_below = (np.linalg.norm((floor - below)[:, [0, 2]], axis=1) <= SNAP_TOLERANCE) & (
            np.abs(floor[:, 1] - below[:, 1]) < SINK
        )
        chosen = []
        for item, ground, height, ignored in zip(standing, grounds, floor[:, 1], open_below, strict=True):
            room = scene.room_of[item.room_id]
            assert item.aabb is not None
            base = max(room.floor_y, ground.bottom) if room.annotation == "scene" else room.floor_y
            off = ground.bottom - (height if room.annotation == "scene" else base)
            if ignored and off < FLOOR_STANDING and item.aabb[1, 1] - base > max_climb:
                chosen.append((item.object_id, ground))
        self.object_ids = [name for name, _ in chosen]
        self.grounds = [ground for _, ground in chosen]
        self._tree = shapely.STRtree([ground.polygon(TOUCHING) for ground in self.grounds])

    def holding(self, points: F64) -> list[str | None]:
        """Return for each of the points (n, 3) the id of the obstacle whose footprint contains it, or None if there is
        none.
        """
        return self._met(shapely.points(points[:, [0, 2]]), len(points))

    def crossed(self, corners: F64, ends: NDArray[np.int64]) -> list[str | None]:
        """Return for each path the id of an obstacle that the path crosses, or None if it crosses none.

        corners (n, 3) of all paths; ends (k,) : end index of each path in `corners`
        """
        owners = np.repeat(np.arange(len(ends)), np.diff(ends, prepend=0))
        return self._met(shapely.linestrings(corners[:, [0, 2]], indices=owners), len(ends))

    def _met(self, shapes: NDArray[np.object_], count: int) -> list[str | None]:
        met: list[str | None] = [None] * count
        for which, obstacle in self._tree.query(shapes, predicate="intersects").T.tolist():
            met[which] = self.object_ids[obstacle]
        return met


def ground_points(
    scene: Scene, room: Room, pathfinder: Pathfinder, least_radius: float, furniture: Sequence[Ground]
) -> F64:
    """Return points (n, 3) on a room's floor; empty if the scene has no floor at all.

    least_radius : least radius in metres of an island that an episode may use
    furniture : objects that the navmesh ignores
    """
    wide = [
        k
        for k in range(pathfinder.num_islands)
        if pathfinder.island_radius(k) >= least_radius and pathfinder.island_area(k) > 0.0
    ]
    if room.polygon is None:
        points = _drawn(scene.scene_id, pathfinder, wide)
    else:
        points = _grid(room.polygon, room.floor_y, pathfinder, wide)
    blocked = np.zeros(len(points), dtype=bool)
    for ground in furniture:
        blocked |= ground.distances(points) <= 0.0
    if not blocked.all():
        points = points[~blocked]
    raised: F64 = points + np.array([0.0, FLOOR_LIFT, 0.0])
    return raised


def _drawn(scene_id: str, pathfinder: Pathfinder, islands: Sequence[int]) -> F64:
    """Return random points (n, 3) on all islands; each island gets a number of points in proportion to its area."""
    areas = [pathfinder.island_area(k) for k in islands]
    rng = generator(0, scene_id, "floor")
    places = [np.empty((0, 3))]
    for island, area in zip(islands, areas, strict=True):
        count = math.ceil(2 * FLOOR_POINTS * area / sum(areas))
        places.append(np.asarray(pathfinder.get_random_navigable_points(count, rng, island), dtype=np.float64))
    points = np.concatenate(places)
    return points[~np.isnan(points).any(axis=1)]


def _grid(polygon: F64, height: float, pathfinder: Pathfinder, islands: Sequence[int]) -> F64:
    """Return the walkable points of a centred grid inside an outline. If none is walkable, return all points of the
    grid inside the outline.
    """
    outline = shapely.make_valid(shapely.Polygon(polygon))
    apart = max(FLOOR_LEAST_SPACING, math.sqrt(outline.area / FLOOR_POINTS))
    west, north, east, south = outline.bounds
    x, z = np.meshgrid(_line(west, east, apart), _line(north, south, apart), indexing="ij")
    within = shapely.contains_xy(outline, x, z)
    points = np.stack([x[within], np.full(int(within.sum()), height), z[within]], axis=1)
    if not len(points):
        return points
    floor = np.asarray(pathfinder.snap_points(points), dtype=np.float64)
    moved = floor - points
    stood = (np.hypot(moved[:, 0], moved[:, 2]) <= SNAP_TOLERANCE) & (np.abs(moved[:, 1]) <= SINK)
    stood &= np.isin(pathfinder.get_islands(points), islands)
    return floor[stood] if stood.any() else points


def _line(low: float, high: float, apart: float) -> F64:
    """Return evenly spaced numbers, at steps of `apart`, that are centred in the interval from `low` to `high`."""
    count = max(1, int((high - low) / apart))
    return np.asarray((low + high) / 2 + (np.arange(count) - (count - 1) / 2) * apart, dtype=np.float64)
