"""Habitat's ``PathFinder`` without Habitat: the same answers, bit for bit, from the same ``.navmesh`` files."""

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
from condvln.navigation.tile import WALKABLE, Floats, Ints, NavMeshTile
from schemas.errors import UsageError

__all__ = ["HitRecord", "Pathfinder"]

# habitat-sim's default of ``is_navigable``, metres between the point and the floor below or above it.
MAX_Y_DELTA = 0.5
# A picture with more pixels than this is a mistake in metres per pixel.
MAX_PIXELS = 100_000_000


@dataclass(frozen=True, eq=False)
class HitRecord:
    """The wall nearest to a point, under habitat-sim's names.

    Attributes
    ----------
    hit_pos : (3,) the wall's nearest point; zeros where none is within the search radius
    hit_normal : (3,) unit vector from there to the snapped point; NaN where the point lies on the wall
    hit_dist : metres in the ground plane; the search radius where no wall is within it, infinite off the navmesh
    """

    hit_pos: Floats
    hit_normal: Floats
    hit_dist: float


class Pathfinder:
    """Shortest paths, snapping, islands and movement on one navmesh.

    Names and semantics are habitat-sim 0.3.4's. Points are (3,) and batches (n, 3), metres, Habitat frame, rounded to
    float32 on entry. A point that can't be projected snaps to NaN; one that can't be reached is infinitely far.
    Instances may be shared by threads; all that changes is the sequence of ``get_random_navigable_point``.
    """

    def __init__(self, navmesh: NavMeshFile) -> None:
        self.navmesh = navmesh
        self._random = np.random.default_rng(0)
        tile = navmesh.tile
        # Islands come before polygons without area are taken off the mesh, as in Habitat.
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
        """Pathfinder over a ``.navmesh`` file.

        Raises
        ------
        MissingFileError, FormatError : from :func:`~condvln.navigation.navmesh_file.read_navmesh`
        """
        return cls(read_navmesh(path))

    @classmethod
    def from_tile(cls, tile: NavMeshTile, settings: NavMeshSettings | None = None) -> Pathfinder:
        """Pathfinder over a tile just built (and linked)."""
        return cls(NavMeshFile.of_tile(tile, settings or NavMeshSettings()))

    @classmethod
    def build(
        cls,
        vertices: npt.ArrayLike,
        faces: npt.ArrayLike,
        settings: NavMeshSettings | None = None,
        profile: str = "habitat>=0.3.4",
    ) -> Pathfinder:
        """Pathfinder over the navmesh that Habitat would build from triangles.

        Parameters and errors are those of :func:`condvln.navigation.recast.build_navmesh`.
        """
        from condvln.navigation.recast import build_navmesh  # its kernels are needed by few

        return cls(build_navmesh(vertices, faces, settings, profile))

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the navmesh, byte for byte as it was loaded or built."""
        write_navmesh(path, self.navmesh)

    # -- what it is ----------------------------------------------------------------------------------------------------

    @property
    def settings(self) -> NavMeshSettings:
        """What the navmesh was built with (version 1 has agent and cell sizes only; the rest are defaults)."""
        return self.navmesh.known_settings

    @property
    def bounds(self) -> tuple[Floats, Floats]:
        """Lowest and highest corner, (3,) each; the upper one includes the agent's height."""
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
        np.add.at(total, self._island_of_poly[walkable], areas[walkable])  # one float32 addition a polygon, in order
        return total

    @property
    def navigable_area(self) -> float:
        """Square metres of floor, all islands together."""
        total = np.float32(0.0)
        for area in self._island_areas:
            total += area
        return float(total)

    def island_area(self, index: int) -> float:
        """Square metres of one island."""
        return float(self._island_areas[self._island_index(index)])

    # -- points --------------------------------------------------------------------------------------------------------

    def snap_point(self, point: npt.ArrayLike, island: int | None = None) -> Floats:
        """Nearest point (3,) on the navmesh, or on one island of it; NaN where none is within 2 m (4 m in height)."""
        snapped: Floats = self.snap_points(one_point(point), island)[0]
        return snapped

    def snap_points(self, points: npt.ArrayLike, island: int | None = None) -> Floats:
        """:meth:`snap_point` of each of n points, (n, 3)."""
        chosen = ANY_ISLAND if island is None else self._island_index(island)
        return project(self.query_mesh, many_points(points), chosen)[1]

    def is_navigable(self, point: npt.ArrayLike, max_y_delta: float = MAX_Y_DELTA) -> bool:
        """Is the point on the navmesh, to 1 cm in the ground plane and ``max_y_delta`` metres in height?"""
        return bool(self.are_navigable(one_point(point), max_y_delta)[0])

    def are_navigable(self, points: npt.ArrayLike, max_y_delta: float = MAX_Y_DELTA) -> npt.NDArray[np.bool_]:
        """:meth:`is_navigable` of each of n points, (n,)."""
        return all_navigable(self.query_mesh, many_points(points), np.float32(max_y_delta))

    def get_island(self, point: npt.ArrayLike) -> int:
        """Index of the island that the point snaps to; -1 where it snaps to none."""
        return int(self.get_islands(one_point(point))[0])

    def get_islands(self, points: npt.ArrayLike) -> Ints:
        """:meth:`get_island` of each of n points, (n,)."""
        polys, _ = project(self.query_mesh, many_points(points), ANY_ISLAND)
        return np.where(polys == NO_POLYGON, -1, self._island_of_poly[polys]).astype(np.int32)

    def island_radius(self, point_or_index: npt.ArrayLike) -> float:
        """Metres from the mean corner of an island (an index, or that of a point) to the farthest; 0 off the mesh."""
        where = np.asarray(point_or_index)
        index = self._island_index(int(where)) if where.ndim == 0 else self.get_island(where)
        return float(self._island_radii[index]) if index >= 0 else 0.0

    # -- paths ---------------------------------------------------------------------------------------------------------

    def find_path(self, start: npt.ArrayLike, end: npt.ArrayLike) -> ShortestPath:
        """Shortest path between two points."""
        lengths, counts, points = routes(self.query_mesh, one_point(start), one_point(end), True)
        return ShortestPath(float(lengths[0]), points, 0 if counts[0] else -1)

    def find_paths(self, starts: npt.ArrayLike, ends: npt.ArrayLike) -> list[ShortestPath]:
        """Paths of n pairs; a single start or end serves all."""
        lengths, counts, points = routes(self.query_mesh, *paired_points(starts, ends), True)
        pieces = np.split(points, np.cumsum(counts)[:-1])
        return [
            ShortestPath(float(length), piece, 0 if len(piece) else -1)
            for length, piece in zip(lengths, pieces, strict=False)
        ]

    def find_multi_goal_path(self, start: npt.ArrayLike, ends: npt.ArrayLike) -> ShortestPath:
        """Shortest of the paths to several ends; ends off the navmesh are left out."""
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
        """Metres along the shortest path to ``end``, or to the nearest of several; infinite where there is none."""
        if np.ndim(end) == 2:
            return self.find_multi_goal_path(start, end).geodesic_distance
        return float(routes(self.query_mesh, one_point(start), one_point(end), False)[0][0])

    def geodesic_distances(self, starts: npt.ArrayLike, ends: npt.ArrayLike) -> Floats:
        """:meth:`geodesic_distance` of n pairs, (n,) float32; a single start or end serves all the others."""
        return routes(self.query_mesh, *paired_points(starts, ends), False)[0]

    def distance_table(self, starts: npt.ArrayLike, ends: npt.ArrayLike) -> Floats:
        """:meth:`geodesic_distance` from each of n starts to each of m ends, (n, m) float32."""
        return distance_table(self.query_mesh, many_points(starts), many_points(ends))

    # -- movement ------------------------------------------------------------------------------------------------------

    def try_step(self, start: npt.ArrayLike, end: npt.ArrayLike) -> Floats:
        """Where a move from ``start`` towards ``end`` ends (3,), sliding along walls; ``start`` if it can't be made."""
        reached: Floats = self.try_steps(one_point(start), one_point(end))[0]
        return reached

    def try_step_no_sliding(self, start: npt.ArrayLike, end: npt.ArrayLike) -> Floats:
        """Where a move from ``start`` towards ``end`` ends (3,), stopping at the first wall (habitat-sim 0.3.4)."""
        reached: Floats = self.try_steps(one_point(start), one_point(end), sliding=False)[0]
        return reached

    def try_steps(self, starts: npt.ArrayLike, ends: npt.ArrayLike, sliding: bool = True) -> Floats:
        """The steps of n pairs, (n, 3)."""
        first, second = many_points(starts), many_points(ends)
        if len(first) != len(second):
            raise UsageError(
                f"{len(first)} starts but {len(second)} ends: a step needs one of both", remedy="Give as many of both"
            )
        return steps(self.query_mesh, first, second, sliding)

    def distance_to_closest_obstacle(self, point: npt.ArrayLike, max_search_radius: float = 2.0) -> float:
        """Metres in the ground plane to the nearest wall, at most the radius; infinite off the navmesh."""
        return self.closest_obstacle_surface_point(point, max_search_radius).hit_dist

    def closest_obstacle_surface_point(self, point: npt.ArrayLike, max_search_radius: float = 2.0) -> HitRecord:
        """The point of the nearest wall and the way from it."""
        distances, hits, normals = nearest_walls(self.query_mesh, one_point(point), np.float32(max_search_radius))
        return HitRecord(hits[0], normals[0], float(distances[0]))

    # -- random points -------------------------------------------------------------------------------------------------

    @cached_property
    def _sampler(self) -> Sampler:
        return Sampler(self.query_mesh)

    def seed(self, seed: int) -> None:
        """Start the sequence of :meth:`get_random_navigable_point` again; a new pathfinder has seed 0."""
        self._random = np.random.default_rng(seed)

    def get_random_navigable_point(self, max_tries: int = 10, island_index: int = -1) -> Floats:
        """The next point (3,) of this pathfinder's own sequence, uniform over the floor or over one island of it.

        The distribution is habitat-sim's, the sequence is not: Habitat draws from the C library's generator. Code whose
        result must not depend on the calls before it uses :meth:`get_random_navigable_points` with a generator.

        Parameters
        ----------
        max_tries : taken for habitat-sim's sake; one try is enough here
        island_index : -1 for any island

        Raises
        ------
        InputError : there is no floor
        """
        island = None if island_index < 0 else island_index
        point: Floats = self.get_random_navigable_points(1, self._random, island)[0]
        return point

    def get_random_navigable_points(self, count: int, rng: RandomSource, island: int | None = None) -> Floats:
        """``count`` points (count, 3) uniform over the floor, or over one island of it.

        Raises
        ------
        InputError : there is no floor
        """
        return self._sampler.draw(count, rng, None if island is None else self._island_index(island))

    def get_random_navigable_point_near(
        self, centre: npt.ArrayLike, radius: float, rng: RandomSource, max_tries: int = 100, island: int | None = None
    ) -> Floats:
        """A point (3,) uniform over the floor within ``radius`` metres of ``centre`` in the ground plane.

        NaN where ``max_tries`` draws from the polygons in reach bring none.
        """
        chosen = None if island is None else self._island_index(island)
        return self._sampler.draw_near(one_point(centre)[0], radius, rng, max_tries, chosen)

    # -- pictures ------------------------------------------------------------------------------------------------------

    def top_down_view(self, metres_per_pixel: float, height: float, eps: float = MAX_Y_DELTA) -> npt.NDArray[np.bool_]:
        """Navigability (rows along z, columns along x) of the points at ``height``, to ``eps`` metres in height.

        Raises
        ------
        UsageError : the resolution is not a positive number, or gives more than 100 million pixels
        """
        if not (metres_per_pixel > 0 and math.isfinite(metres_per_pixel)):
            raise UsageError(f"{metres_per_pixel} metres per pixel", remedy="Give a positive number, such as 0.05")
        grid, pixel = self.query_mesh.grid, np.float32(metres_per_pixel)
        columns = float(abs(grid[BMIN] - grid[BMAX]) / pixel)
        rows = float(abs(grid[BMIN + 2] - grid[BMAX + 2]) / pixel)
        if columns * rows > MAX_PIXELS:
            raise UsageError(
                f"{columns:.0f} x {rows:.0f} pixels at {metres_per_pixel} metres per pixel", remedy="Take larger pixels"
            )
        return top_down_view(self.query_mesh, int(columns), int(rows), pixel, np.float32(height), np.float32(eps))

    def _island_index(self, index: int) -> int:
        if not 0 <= index < self.num_islands:
            raise UsageError(f"island {index} of {self.num_islands}", remedy="Take an index from get_island")
        return index


def _warm_up() -> None:
    from condvln.navigation.polygon_tile import tile_of_polygons

    square = np.array([[0, 0, 0], [1, 0, 0], [1, 0, 1], [0, 0, 1]], np.float32)
    pathfinder = Pathfinder.from_tile(tile_of_polygons(square, [[0, 1, 2], [0, 2, 3]]))
    start, end = [0.1, 0.0, 0.5], [0.9, 0.0, 0.5]
    pathfinder.find_path(start, end)
    pathfinder.distance_table([start], [end])
    pathfinder.find_multi_goal_path(start, [end])
    pathfinder.is_navigable(start)
    pathfinder.get_random_navigable_point()
    pathfinder.try_step(start, end)
    pathfinder.distance_to_closest_obstacle(start)


register_warm_up("paths", _warm_up)
