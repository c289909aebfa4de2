"""Sample points on the free floor of a room: an agent must have seen them before it can know that something is
absent.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import shapely
from numpy.typing import NDArray

from condvln.arrays import F64
from condvln.episodes.footprint import Obstacles
from condvln.navigation.protocol import PathfinderProtocol
from condvln.scene import Room, Scene
from condvln.seeding import generator
from schemas.config.constants import FLOOR_LEAST_SPACING, FLOOR_LIFT, FLOOR_POINTS, SINK, SNAP_TOLERANCE

__all__ = ["floor_points", "standing_points"]


def floor_points(
    scene: Scene, room: Room, pathfinder: PathfinderProtocol, islands: Sequence[int], obstacles: Obstacles = ()
) -> F64:
    """Return points (n, 3) spread evenly over the walkable floor of `room`; over the whole floor if none of it is
    walkable.

    A room without a polygon stands for the whole scene.

    Parameters
    ----------
    islands : navmesh islands that count as floor
    obstacles : furniture that the navmesh ignores; the floor inside its footprint is not free
    """
    points, good = _room_floor(scene, room, pathfinder, islands)
    points = points[good] if good.any() else points
    free = _free(points, obstacles)
    points = points[free] if free.any() else points
    return np.asarray(points + np.array([0.0, FLOOR_LIFT, 0.0]), dtype=np.float64)


def standing_points(
    scene: Scene, room: Room, pathfinder: PathfinderProtocol, islands: Sequence[int], obstacles: Obstacles = ()
) -> F64:
    """Return evenly spread positions (n, 3) in `room` at which an agent can stand; empty if there are none.

    These are the points of :func:`floor_points` that lie on the navmesh, at floor height.
    """
    points, good = _room_floor(scene, room, pathfinder, islands)
    return np.asarray(points[good & _free(points, obstacles)], dtype=np.float64)


def _free(points: F64, obstacles: Obstacles) -> NDArray[np.bool_]:
    """Return a mask (n,) of the `points` (n, 3) that lie outside the footprints of all obstacles."""
    free = np.ones(len(points), dtype=bool)
    for _, footprint in obstacles:
        free &= footprint.distance(points) > 0.0
    return free


def _whole_floor(scene: Scene, pathfinder: PathfinderProtocol, islands: Sequence[int]) -> F64:
    areas = np.array([pathfinder.island_area(k) for k in islands])
    if not areas.sum() > 0:
        return np.empty((0, 3))
    rng = generator(0, scene.scene_id, "floor")
    counts = np.ceil(2 * FLOOR_POINTS * areas / areas.sum()).astype(int)
    drawn = [
        pathfinder.get_random_navigable_points(int(n), rng, island) for n, island in zip(counts, islands, strict=True)
    ]
    points = np.concatenate(drawn).astype(np.float64)
    return np.asarray(points[np.isfinite(points).all(axis=1)], dtype=np.float64)


def _room_floor(
    scene: Scene, room: Room, pathfinder: PathfinderProtocol, islands: Sequence[int]
) -> tuple[F64, NDArray[np.bool_]]:
    """Return grid points (n, 3) inside a room's outline, snapped to the navmesh where possible, and a mask (n,) of the
    points that were snapped.

    Points of a room without navmesh are at the height of the room's floor.
    """
    if room.polygon is None:
        points = _whole_floor(scene, pathfinder, islands)
        return points, np.ones(len(points), dtype=bool)
    outline = shapely.Polygon(room.polygon)
    if not outline.is_valid:
        outline = shapely.make_valid(outline)
    spacing = max(FLOOR_LEAST_SPACING, math.sqrt(outline.area / FLOOR_POINTS))
    low, high = np.array(outline.bounds[:2]), np.array(outline.bounds[2:])
    # The grid is centred, so that a narrow room has points along its middle.
    axes = []
    for a, b in zip(low, high, strict=True):
        count = max(1, int((b - a) / spacing))
        axes.append((a + b) / 2 + (np.arange(count) - (count - 1) / 2) * spacing)
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 2)
    grid = grid[shapely.contains_xy(outline, grid[:, 0], grid[:, 1])]
    asked = np.column_stack([grid[:, 0], np.full(len(grid), room.floor_y), grid[:, 1]])
    if not len(asked):
        return asked, np.zeros(0, dtype=bool)
    snapped = pathfinder.snap_points(asked).astype(np.float64)
    with np.errstate(invalid="ignore"):
        good = np.hypot(*(snapped - asked)[:, [0, 2]].T) <= SNAP_TOLERANCE
        good &= np.abs(snapped[:, 1] - room.floor_y) <= SINK
    good &= np.isin(pathfinder.get_islands(asked), islands)
    return np.asarray(snapped if good.any() else asked, dtype=np.float64), np.asarray(good, dtype=np.bool_)
