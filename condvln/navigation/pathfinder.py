"""habitat-sim's ``PathFinder`` reimplemented: bit-identical results from the same ``.navmesh`` files."""

from __future__ import annotations

import math
import os
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt

from condvln.compiled import register_warm_up
from condvln.navigation.kernels.islands import find_islands
from condvln.navigation.kernels.mesh import BMAX, BMIN, query_mesh
from condvln.navigation.kernels.movement import nearest_walls, steps
from condvln.navigation.kernels.projection import ANY_ISLAND, NO_POLYGON, all_navigable, project, top_down_view
from condvln.navigation.kernels.route import distance_table, route_to_nearest, routes
from condvln.navigation.links import disable_zero_area, polygon_areas
from condvln.navigation.navmesh_file import NavMeshFile, read_navmesh, write_navmesh
from condvln.navigation.points import many_points, one_point, paired_points
from condvln.navigation.protocol import ShortestPath
from condvln.navigation.sampling import RandomSource, Sampler
from condvln.navigation.settings import NavMeshSettings
from condvln.navigation.tile import WALKABLE, Floats, Indices, Ints, NavMeshTile
from schemas.errors import UsageError

__all__ = ["HitRecord", "Pathfinder"]

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


class Pathfinder:
    """Shortest paths, snapping, islands and movement on one navmesh.

    Names and semantics are habitat-sim 0.3.4's. Points are (3,) and batches (n, 3), metres, Habitat frame, rounded to
    float32 on entry. A point that can't be projected snaps to NaN; one that can't be reached has infinite distance.
    Instances may be shared by threads; their only state is the sequence of ``get_random_navigable_point``.
    """

    def __init__(self, navmesh: NavMeshFile) -> None:
        self.navmesh = navmesh
        self._random = np.random.default_rng(0)
        tile = navmesh.tile
        # Islands are found before polygons without area are disabled, as in Habitat.
        self._island_of_poly, self._island_radii = find_islands(
            np.array(tile.verts, np.float32, order="C"),
            tile.poly_verts.astype(np.int64, order="C"),
            tile.polys["vert_count"].astype(np.int64),
            tile.neighbours.astype(np.int64, order="C"),
            (tile.polys["flags"] & WALKABLE).astype(np.uint8),
        )
        self._tile = disable_zero_area(tile)
        self.query_mesh = query_mesh(
            self._tile, self._island_of_poly, navmesh.origin, navmesh.tile_width, navmesh.tile_height
        )

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

    # -- properties
    # --------------------------------------------------------------------------------------------------------

    @property
    def settings(self) -> NavMeshSettings:
        """The build settings. A file of version 1 has only agent and cell sizes; the other settings are defaults."""
        return self.navmesh.known_settings

    @property
    def bounds(self) -> tuple[Floats, Floats]:
        """Lowest and highest corner of the navmesh, (3,) each, in metres; the highest corner includes the agent's
        height.
        """
        return self._tile.bounds

    @property
    def num_islands(self) -> int:
        """Number of connected components."""
        return len(self._island_radii)

    @cached_property
    def _island_areas(self) -> Floats:
        areas = polygon_areas(self._tile)
        walkable = (self._tile.polys["flags"] & WALKABLE) != 0
        total = np.zeros(self.num_islands, np.float32)
        np.add.at(total, self._island_of_poly[walkable], areas[walkable])  # one float32 addition per polygon, in order
        return total

    @property
    def navigable_area(self) -> float:
        """Navigable area in square metres, all islands together."""
        total = np.float32(0.0)
        for area in self._island_areas:
            total += area
        return float(total)

    def island_area(self, index: int) -> float:
        """Return the area in square metres of one island."""
        return float(self._island_areas[self._island_index(index)])

    # -- points --------------------------------------------------------------------------------------------------------

    def snap_point(self, point: npt.ArrayLike, island: int | None = None) -> Floats:
        """Return the nearest point (3,) on the navmesh, or on one island; NaN if none is within 2 m (4 m in height)."""
        snapped: Floats = self.snap_points(one_point(point), island)[0]
        return snapped

    def snap_points(self, points: npt.ArrayLike, island: int | None = None) -> Floats:
        """Return the positions (n, 3) to which n points snap; see :meth:`snap_point`."""
        chosen = ANY_ISLAND if island is None else self._island_index(island)
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
        return np.where(polys == NO_POLYGON, -1, self._island_of_poly[polys]).astype(np.int32)

    def island_radius(self, point_or_index: npt.ArrayLike) -> float:
        """Return the distance in metres from the mean of an island's corners to the farthest corner. The island is
        given by its index or by a point of it; the result is 0 if the point is off the mesh.
        """
        where = np.asarray(point_or_index)
        index = self._island_index(int(where)) if where.ndim == 0 else self.get_island(where)
        return float(self._island_radii[index]) if index >= 0 else 0.0

    # -- paths ---------------------------------------------------------------------------------------------------------

    def find_path(self, start: npt.ArrayLike, end: npt.ArrayLike) -> ShortestPath:
        """Return the shortest path between two points."""
        lengths, counts, points = routes(self.query_mesh, one_point(start), one_point(end), True)
        return ShortestPath(float(lengths[0]), points, 0 if counts[0] else -1)

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

    @cached_property
    def _sampler(self) -> Sampler:
        return Sampler(self.query_mesh)

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
        return self._sampler.draw(count, rng, None if island is None else self._island_index(island))

    def get_random_navigable_point_near(
        self, centre: npt.ArrayLike, radius: float, rng: RandomSource, max_tries: int = 100, island: int | None = None
    ) -> Floats:
        """Return a random point (3,), uniform over the floor within ``radius`` metres of ``centre`` in the ground
        plane.

        NaN if ``max_tries`` draws from the polygons in reach give none.
        """
        chosen = None if island is None else self._island_index(island)
        return self._sampler.draw_near(one_point(centre)[0], radius, rng, max_tries, chosen)

    # -- pictures ------------------------------------------------------------------------------------------------------

    def top_down_view(self, metres_per_pixel: float, height: float, eps: float = MAX_Y_DELTA) -> npt.NDArray[np.bool_]:
        """Return a mask of the navigable points of a horizontal grid at ``height``. A navigable point is at most
        ``eps`` metres above or below the navmesh. The mask's rows run along z, its columns along x.

        Raises
        ------
        UsageError : the resolution is not a positive number, or gives more than 100 million pixels
        """
        if not (metres_per_pixel > 0 and math.isfinite(metres_per_pixel)):
            raise UsageError(
                f"the metres per pixel must be positive and finite, got {metres_per_pixel}",
                remedy="Give a positive number, such as 0.05",
            )
        grid, pixel = self.query_mesh.grid, np.float32(metres_per_pixel)
        columns = float(abs(grid[BMIN] - grid[BMAX]) / pixel)
        rows = float(abs(grid[BMIN + 2] - grid[BMAX + 2]) / pixel)
        if columns * rows > MAX_PIXELS:
            raise UsageError(
                f"the picture would be too large: {columns:.0f} x {rows:.0f} pixels", remedy="Use more metres per pixel"
            )
        return top_down_view(self.query_mesh, int(columns), int(rows), pixel, np.float32(height), np.float32(eps))

    def _island_index(self, index: int) -> int:
        if not 0 <= index < self.num_islands:
            raise UsageError(
                f"there is no island {index}: the navmesh has {self.num_islands}",
                remedy="Take an index from get_island",
            )
        return index


def _warm_up() -> None:
    from condvln.navigation.polygon_tile import tile_of_polygons

    square = np.array([[0, 0, 0], [1, 0, 0], [1, 0, 1], [0, 0, 1]], np.float32)
    pathfinder = Pathfinder.from_tile(tile_of_polygons(square, [[0, 1, 2], [0, 2, 3]]))
    start, end = [0.1, 0.0, 0.5], [0.9, 0.0, 0.5]
    pathfinder.find_path(start, end)
    pathfinder.distance_table([start], [end])
    pathfinder.find_multi_goal_path(start, [end])
    pathfinder.snap_point(start)
    pathfinder.is_navigable(start)
    pathfinder.get_random_navigable_point()
    pathfinder.try_step(start, end)
    pathfinder.distance_to_closest_obstacle(start)


register_warm_up("paths", _warm_up)
