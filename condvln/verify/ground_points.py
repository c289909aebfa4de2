"""Sample points on the floor of a room, to measure how much of the floor is visible.

For a room with an outline these are the walkable points of a grid of about 256 points, at least 0.2 m apart; all grid
points if none is walkable. For a room without an outline they are 512 random points on the navmesh, seeded by the
scene. Points inside furniture that the navmesh ignores are left out, unless all are. Each point is 5 cm above the
navmesh, so that no rug hides it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import shapely
from numpy.typing import NDArray

from condvln.navigation.pathfinder import Pathfinder
from condvln.scene import Room, Scene
from condvln.seeding import generator
from condvln.verify.footprints import Ground
from schemas.config.constants import FLOOR_LEAST_SPACING, FLOOR_LIFT, FLOOR_POINTS, SINK, SNAP_TOLERANCE

__all__ = ["ground_points"]

F64 = NDArray[np.float64]


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
