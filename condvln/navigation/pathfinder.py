"""habitat-sim's ``PathFinder`` reimplemented: bit-identical results from the same ``.navmesh`` files."""

from __future__ import annotations

import logging
import math
import os
from dataclasses import dataclass
from functools import cached_property
from typing import overload

import numpy as np
import numpy.typing as npt

from condvln.navigation.kernels.mesh import BMAX, BMIN, QueryMesh, query_mesh
from condvln.navigation.kernels.movement import nearest_walls, steps
from condvln.navigation.kernels.path import distance_table, route_to_nearest, routes
from condvln.navigation.kernels.projection import ANY_ISLAND, NO_POLYGON, all_navigable, project, top_down_view
from condvln.navigation.navmesh_file import NavMeshFile, read_navmesh, write_navmesh
from condvln.navigation.points import RandomSource, Sampler, many_points, one_point, paired_points
from condvln.navigation.protocol import MultiGoalShortestPath, ShortestPath
from condvln.navigation.settings import NavMeshSettings
from condvln.navigation.tile import (
    WALKABLE,
    Floats,
    Indices,
    Ints,
    NavMeshTile,
    disable_zero_area,
    find_islands,
    polygon_areas,
)
from schemas.errors import InputError, StoreError, UsageError

__all__ = ["HitRecord", "Pathfinder"]

_logger = logging.getLogger(__name__)

# habitat-sim's default of ``is_navigable``: largest vertical distance in metres between the point and the floor.
MAX_Y_DELTA = 0.5
# Largest number of pixels of a picture; more is an error in metres per pixel.
MAX_PIXELS = 100_000_000


@dataclass(frozen=True, eq=False)
class HitRecord:
    """The wall nearest to a point, under habitat-sim's names.

    Attributes
    ----------
    hit_pos : (3,) the wall's nearest point; zeros if no wall is within the search radius
    hit_normal : (3,) unit vector from ``hit_pos`` to the snapped point; NaN if the point is on the wall
    hit_dist : horizontal metres; the search radius if no wall is within it, infinite off the navmesh
    """

    hit_pos: Floats
    hit_normal: Floats
    hit_dist: float


class _LoadedMesh:
    """A navmesh and what queries need of it. As in Habitat, islands precede disabling of zero-area polygons."""

    def __init__(self, navmesh: NavMeshFile) -> None:
        self.navmesh, self.tile = navmesh, disable_zero_area(navmesh.tile)
        self.island_of_poly, self.island_radii = find_islands(navmesh.tile)
        self.query_mesh = query_mesh(
            self.tile, self.island_of_poly, navmesh.origin, navmesh.tile_width, navmesh.tile_height
        )

    @cached_property
    def island_areas(self) -> Floats:
        """Navigable square metres of each island."""
        areas = polygon_areas(self.tile)
        walkable = (self.tile.polys["flags"] & WALKABLE) != 0
        total = np.zeros(len(self.island_radii), np.float32)
        np.add.at(total, self.island_of_poly[walkable], areas[walkable])  # one float32 addition per polygon, in order
        return total

    @cached_property
    def sampler(self) -> Sampler:
        """Draws random points."""
        return Sampler(self.query_mesh)


class Pathfinder:
    """Shortest paths, snapping, islands and movement on one navmesh.

    Names and semantics are habitat-sim 0.3.4's. Points are (3,) and batches (n, 3), metres, Habitat frame, rounded to
    float32 on entry. A point that can't be projected snaps to NaN; one that can't be reached has infinite distance.
    Instances may be shared by threads; their only state is the navmesh and the sequence of random points.
    """

    def __init__(self, navmesh: NavMeshFile | None = None) -> None:
        """Without a navmesh the pathfinder is empty until :meth:`load_nav_mesh`, as habitat-sim's. What needs a navmesh
        raises UsageError before; habitat-sim's process ends there.
        """
        self._loaded_mesh = None if navmesh is None else _LoadedMesh(navmesh)
        self._random = np.random.default_rng(0)

    @property
    def _loaded(self) -> _LoadedMesh:
        if self._loaded_mesh is None:
            raise UsageError("the pathfinder has no navmesh", remedy="Call load_nav_mesh first")
        return self._loaded_mesh

    @property
    def navmesh(self) -> NavMeshFile:
        """The navmesh as it was loaded or built."""
        return self._loaded.navmesh

    @property
    def query_mesh(self) -> QueryMesh:
        """The navmesh as kernels take it."""
        return self._loaded.query_mesh

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> Pathfinder:
        """Load a pathfinder over a ``.navmesh`` file.

        Raises
        ------
        MissingFileError, FormatError : from :func:`~condvln.navigation.navmesh_file.read_navmesh`
        """
        return cls(read_navmesh(path))

    @classmethod
    def from_tile(cls, tile: NavMeshTile, settings: NavMeshSettings | None = None) -> Pathfinder:
        """Build a pathfinder over a newly built (and linked) tile."""
        return cls(NavMeshFile.of_tile(tile, settings or NavMeshSettings()))

    @classmethod
    def build(
        cls,
        vertices: npt.ArrayLike,
        faces: npt.ArrayLike,
        settings: NavMeshSettings | None = None,
        profile: str = "habitat>=0.3.4",
    ) -> Pathfinder:
        """Build a pathfinder over the navmesh that Habitat would build from triangles.

        Parameters and errors are those of :func:`condvln.navigation.recast.build_navmesh`.
        """
        from condvln.navigation.recast import build_navmesh  # imported here, since few callers need its kernels

        return cls(build_navmesh(vertices, faces, settings, profile))

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the navmesh, byte for byte as it was loaded or built."""
        write_navmesh(path, self.navmesh)

    def load_nav_mesh(self, path: str | os.PathLike[str]) -> bool:
        """Load another navmesh into this pathfinder, as habitat-sim does. Returns False where the file can't be read,
        and logs why; the navmesh of before stays.
        """
        try:
            self._loaded_mesh = _LoadedMesh(read_navmesh(path))
        except InputError as error:
            _logger.warning("%s", error)
            return False
        return True

    def save_nav_mesh(self, path: str | os.PathLike[str]) -> bool:
        """Write the navmesh. As in habitat-sim, returns False if there is none, or if the file can't be written."""
        try:
            self.save(path)
        except (UsageError, StoreError) as error:
            _logger.warning("%s", error)
            return False
        return True

    # -- properties
    # --------------------------------------------------------------------------------------------------------

    @property
    def settings(self) -> NavMeshSettings:
        """The build settings. A file of version 1 has only agent and cell sizes; the other settings are defaults."""
        return self.navmesh.known_settings

    @property
    def nav_mesh_settings(self) -> NavMeshSettings:
        """habitat-sim's name of :attr:`settings`."""
        return self.settings

    @property
    def is_loaded(self) -> bool:
        """Whether there is a navmesh."""
        return self._loaded_mesh is not None

    @property
    def bounds(self) -> tuple[Floats, Floats]:
        """Lowest and highest corner of the navmesh, (3,) each, in metres; the highest corner includes the agent's
        height.
        """
        return self._loaded.tile.bounds

    def get_bounds(self) -> tuple[Floats, Floats]:
        """Return :attr:`bounds`, under habitat-sim's name."""
        return self.bounds

    @property
    def num_islands(self) -> int:
        """Number of connected components."""
        return len(self._loaded.island_radii)

    @property
    def navigable_area(self) -> float:
        """Navigable area in square metres, all islands together."""
        total = np.float32(0.0)
        for area in self._loaded.island_areas:
            total += area
        return float(total)

    def island_area(self, island_index: int = -1) -> float:
        """Return the area in square metres of one island; of all for -1."""
        return (
            self.navigable_area
            if island_index == -1
            else float(self._loaded.island_areas[self._island_index(island_index)])
        )

    def build_navmesh_vertices(self, island_index: int = -1) -> Floats:
        """Return the corners (3 m, 3) of the floor's m triangles, or of those of one island: habitat-sim's, in its
        order. Corners that triangles share are repeated.
        """
        corners, poly = self.navmesh.tile.detail_triangles
        if island_index != -1:
            corners = corners[self._loaded.island_of_poly[poly] == self._island_index(island_index)]
        return corners.reshape(-1, 3)

    def build_navmesh_vertex_indices(self, island_index: int = -1) -> Indices:
        """Return the indices (3 m,) of the corners of each triangle in :meth:`build_navmesh_vertices`."""
        return np.arange(len(self.build_navmesh_vertices(island_index)))

    # -- points --------------------------------------------------------------------------------------------------------

    def snap_point(self, point: npt.ArrayLike, island_index: int | None = None) -> Floats:
        """Return the nearest point (3,) on the navmesh, or on one island; NaN if none is within 2 m (4 m in height)."""
        snapped: Floats = self.snap_points(one_point(point), island_index)[0]
        return snapped

    def snap_points(self, points: npt.ArrayLike, island: int | None = None) -> Floats:
        """Return the positions (n, 3) to which n points snap; see :meth:`snap_point`."""
        chosen = ANY_ISLAND if island is None or island == -1 else self._island_index(island)
        return project(self.query_mesh, many_points(points), chosen)[1]

    def snap_to_islands(self, points: npt.ArrayLike) -> tuple[Floats, Ints]:
        """Return the positions (n, 3) to which n points snap and the islands (n,) of these; see :meth:`snap_point` and
        :meth:`get_island`.
        """
        polys, snapped = project(self.query_mesh, many_points(points), ANY_ISLAND)
        return snapped, self._islands_of(polys)

    def is_navigable(self, point: npt.ArrayLike, max_y_delta: float = MAX_Y_DELTA) -> bool:
        """Return whether the point is on the navmesh, within 1 cm horizontally and ``max_y_delta`` metres in height."""
        return bool(self.are_navigable(one_point(point), max_y_delta)[0])

    def are_navigable(self, points: npt.ArrayLike, max_y_delta: float = MAX_Y_DELTA) -> npt.NDArray[np.bool_]:
        """Return a mask (n,) of the points that are on the navmesh; see :meth:`is_navigable`."""
        return all_navigable(self.query_mesh, many_points(points), np.float32(max_y_delta))

    def get_island(self, point: npt.ArrayLike) -> int:
        """Return the index of the island that the point snaps to; -1 if the point is off the navmesh."""
        return int(self.get_islands(one_point(point))[0])

    def get_islands(self, points: npt.ArrayLike) -> Ints:
        """Return the island indices (n,) of n points; see :meth:`get_island`."""
        return self.snap_to_islands(points)[1]

    def _islands_of(self, polys: Indices) -> Ints:
        return np.where(polys == NO_POLYGON, -1, self._loaded.island_of_poly[polys]).astype(np.int32)

    def island_radius(self, point_or_index: npt.ArrayLike) -> float:
        """Return the distance in metres from the mean of an island's corners to the farthest corner. The island is
        given by its index or by a point of it; the result is 0 if the point is off the mesh.
        """
        where = np.asarray(point_or_index)
        index = self._island_index(int(where)) if where.ndim == 0 else self.get_island(where)
        return float(self._loaded.island_radii[index]) if index >= 0 else 0.0

    # -- paths ---------------------------------------------------------------------------------------------------------

    @overload
    def find_path(self, start: ShortestPath | MultiGoalShortestPath) -> bool: ...
    @overload
    def find_path(self, start: npt.ArrayLike, end: npt.ArrayLike) -> ShortestPath: ...
    def find_path(
        self, start: npt.ArrayLike | ShortestPath | MultiGoalShortestPath, end: npt.ArrayLike | None = None
    ) -> ShortestPath | bool:
        """Return the shortest path between two points. Given one path instead, as in habitat-sim, answer that path's
        own request, fill it in and return whether a path was found.

        Raises
        ------
        UsageError : a path's start or end, or the end, is missing
        """
        if isinstance(start, ShortestPath | MultiGoalShortestPath):
            return self._answer(start)
        if end is None:
            raise UsageError("a path needs an end", remedy="Give start and end, or a ShortestPath that holds both")
        lengths, counts, points = routes(self.query_mesh, one_point(start), one_point(end), True)
        return ShortestPath(float(lengths[0]), points, 0 if counts[0] else -1)

    def _answer(self, path: ShortestPath | MultiGoalShortestPath) -> bool:
        ends = path.requested_ends if isinstance(path, MultiGoalShortestPath) else path.requested_end
        if path.requested_start is None or ends is None:
            raise UsageError("the path has no requested start or end", remedy="Set both before find_path")
        if isinstance(path, MultiGoalShortestPath):
            found = self.find_multi_goal_path(path.requested_start, ends)
            path.closest_end_point_index = found.closest_goal
        else:
            found = self.find_path(path.requested_start, ends)
            path.closest_goal = found.closest_goal
        path.points, path.geodesic_distance = found.points, found.geodesic_distance
        return found.found

    def find_paths(self, starts: npt.ArrayLike, ends: npt.ArrayLike) -> list[ShortestPath]:
        """Return the paths of n pairs. A single start is paired with every end, and a single end with every start."""
        lengths, counts, points = self.path_corners(starts, ends)
        pieces = np.split(points, np.cumsum(counts)[:-1])
        return [
            ShortestPath(float(length), piece, 0 if len(piece) else -1)
            for length, piece in zip(lengths, pieces, strict=False)
        ]

    def path_corners(self, starts: npt.ArrayLike, ends: npt.ArrayLike) -> tuple[Floats, Indices, Floats]:
        """Return the paths of n pairs as arrays: their lengths (n,), the number of corners of each (n,), 0 if there is
        no path, and the corners of all (k, 3), one path after the other. See :meth:`find_paths`.
        """
        return routes(self.query_mesh, *paired_points(starts, ends), True)

    def find_multi_goal_path(self, start: npt.ArrayLike, ends: npt.ArrayLike) -> ShortestPath:
        """Return the shortest of the paths to several ends; ends off the navmesh are ignored."""
        begin, goals = one_point(start), many_points(ends)
        reach = goals - begin
        squares = reach * reach
        bounds = np.sqrt((squares[:, 0] + squares[:, 1]) + squares[:, 2])
        if len(goals) == 1:
            bounds = np.zeros(1, np.float32)
        order = np.argsort(bounds, kind="stable")
        length, goal, points = route_to_nearest(self.query_mesh, begin[0], goals, bounds, order)
        return ShortestPath(float(length), points, int(goal))

    def geodesic_distance(self, start: npt.ArrayLike, end: npt.ArrayLike) -> float:
        """Return the geodesic distance in metres to ``end``, or to the nearest of several ends; infinite if there is
        no path.
        """
        if np.ndim(end) == 2:
            return self.find_multi_goal_path(start, end).geodesic_distance
        return float(routes(self.query_mesh, one_point(start), one_point(end), False)[0][0])

    def geodesic_distances(self, starts: npt.ArrayLike, ends: npt.ArrayLike) -> Floats:
        """Return the geodesic distances (n,), float32, of n pairs; see :meth:`geodesic_distance`. A single start is
        paired with every end, and a single end with every start.
        """
        return routes(self.query_mesh, *paired_points(starts, ends), False)[0]

    def distance_table(self, starts: npt.ArrayLike, ends: npt.ArrayLike) -> Floats:
        """Return a table (n, m), float32, of the geodesic distances in metres from each of n starts to each of m ends;
        see :meth:`geodesic_distance`.
        """
        return distance_table(self.query_mesh, many_points(starts), many_points(ends))

    # -- movement ------------------------------------------------------------------------------------------------------

    def try_step(self, start: npt.ArrayLike, end: npt.ArrayLike) -> Floats:
        """Return the point (3,) that a move from ``start`` towards ``end`` reaches. The move slides along walls; the
        result is ``start`` if the move is impossible.
        """
        reached: Floats = self.try_steps(one_point(start), one_point(end))[0]
        return reached

    def try_step_no_sliding(self, start: npt.ArrayLike, end: npt.ArrayLike) -> Floats:
        """Return the point (3,) that a move from ``start`` towards ``end`` reaches. The move stops at the first wall,
        as in habitat-sim 0.3.4.
        """
        reached: Floats = self.try_steps(one_point(start), one_point(end), sliding=False)[0]
        return reached

    def try_steps(self, starts: npt.ArrayLike, ends: npt.ArrayLike, sliding: bool = True) -> Floats:
        """Return the points (n, 3) that n moves from ``starts`` towards ``ends`` reach."""
        first, second = many_points(starts), many_points(ends)
        if len(first) != len(second):
            raise UsageError(f"there are {len(first)} starts but {len(second)} ends", remedy="Give one end per start")
        return steps(self.query_mesh, first, second, sliding)

    def distance_to_closest_obstacle(self, point: npt.ArrayLike, max_search_radius: float = 2.0) -> float:
        """Return the horizontal distance in metres to the nearest wall, at most ``max_search_radius``; infinite off the
        navmesh.
        """
        return self.closest_obstacle_surface_point(point, max_search_radius).hit_dist

    def closest_obstacle_surface_point(self, point: npt.ArrayLike, max_search_radius: float = 2.0) -> HitRecord:
        """Return the nearest point on a wall, the wall's normal towards the given point, and the distance between the
        two points.
        """
        distances, hits, normals = nearest_walls(self.query_mesh, one_point(point), np.float32(max_search_radius))
        return HitRecord(hits[0], normals[0], float(distances[0]))

    # -- random points -------------------------------------------------------------------------------------------------

    def seed(self, seed: int) -> None:
        """Restart the sequence of :meth:`get_random_navigable_point`; a new pathfinder has seed 0."""
        self._random = np.random.default_rng(seed)

    def get_random_navigable_point(self, max_tries: int = 10, island_index: int = -1) -> Floats:
        """Return the next point (3,) of this pathfinder's own random sequence, uniform over the floor or over one
        island.

        The distribution is habitat-sim's, the sequence is not: Habitat draws from the C library's generator. For
        results that do not depend on earlier calls, use :meth:`get_random_navigable_points` with a generator.

        Parameters
        ----------
        max_tries : accepted for compatibility with habitat-sim; one try is enough here
        island_index : -1 for any island

        Raises
        ------
        InputError : there is no floor
        """
        island = None if island_index < 0 else island_index
        point: Floats = self.get_random_navigable_points(1, self._random, island)[0]
        return point

    def get_random_navigable_points(self, count: int, rng: RandomSource, island: int | None = None) -> Floats:
        """Return ``count`` points (count, 3) uniform over the floor, or over one island.

        Raises
        ------
        InputError : there is no floor
        """
        return self._loaded.sampler.draw(count, rng, None if island is None else self._island_index(island))

    def get_random_navigable_point_near(
        self,
        circle_center: npt.ArrayLike,
        radius: float,
        max_tries: int = 100,
        island_index: int = -1,
        *,
        rng: RandomSource | None = None,
    ) -> Floats:
        """Return a random point (3,), uniform over the floor within ``radius`` metres of ``circle_center``; NaN if
        ``max_tries`` draws from the polygons in reach give none.

        Parameters
        ----------
        island_index : -1 for any island
        rng : a generator or seed, for results that do not depend on earlier calls; by default the next point of this
            pathfinder's own sequence, as of :meth:`get_random_navigable_point`
        """
        chosen = None if island_index < 0 else self._island_index(island_index)
        source = self._random if rng is None else rng
        return self._loaded.sampler.draw_near(one_point(circle_center)[0], radius, source, max_tries, chosen)

    # -- pictures ------------------------------------------------------------------------------------------------------

    def get_topdown_view(
        self, meters_per_pixel: float, height: float, eps: float = MAX_Y_DELTA
    ) -> npt.NDArray[np.bool_]:
        """Return a mask of the navigable points of a horizontal grid at ``height``. A navigable point is at most
        ``eps`` metres above or below the navmesh. The mask's rows run along z, its columns along x.

        Raises
        ------
        UsageError : the resolution is not a positive number, or gives more than 100 million pixels
        """
        if not (meters_per_pixel > 0 and math.isfinite(meters_per_pixel)):
            raise UsageError(
                f"the metres per pixel must be positive and finite, got {meters_per_pixel}",
                remedy="Give a positive number, such as 0.05",
            )
        grid, pixel = self.query_mesh.grid, np.float32(meters_per_pixel)
        columns = float(abs(grid[BMIN] - grid[BMAX]) / pixel)
        rows = float(abs(grid[BMIN + 2] - grid[BMAX + 2]) / pixel)
        if columns * rows > MAX_PIXELS:
            raise UsageError(
                f"the picture would be too large: {columns:.0f} x {rows:.0f} pixels", remedy="Use more metres per pixel"
            )
        return top_down_view(self.query_mesh, int(columns), int(rows), pixel, np.float32(height), np.float32(eps))

    def get_topdown_island_view(
        self, meters_per_pixel: float, height: float, eps: float = MAX_Y_DELTA
    ) -> npt.NDArray[np.int32]:
        """Return the island of each point of the grid of :meth:`get_topdown_view`; -1 where it is not navigable."""
        view = self.get_topdown_view(meters_per_pixel, height, eps)
        low, pixel = self.bounds[0], np.float32(meters_per_pixel)
        # As in the mask, positions are sums of pixels in float32.
        z, x = (
            np.cumsum(np.r_[low[axis], np.full(max(count - 1, 0), pixel)], dtype=np.float32)
            for axis, count in zip((2, 0), view.shape, strict=True)
        )
        rows, columns = np.nonzero(view)
        islands = np.full(view.shape, -1, np.int32)
        if len(rows):
            at = np.stack([x[columns], np.full(len(rows), height, np.float32), z[rows]], axis=1)
            islands[rows, columns] = self.get_islands(at)
        return islands

    def _island_index(self, index: int) -> int:
        if not 0 <= index < self.num_islands:
            raise UsageError(
                f"there is no island {index}: the navmesh has {self.num_islands}",
                remedy="Take an index from get_island",
            )
        return index
