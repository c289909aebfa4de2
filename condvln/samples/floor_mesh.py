"""The free floor of an agent (the open plan minus walls and furniture, shrunk by the agent's radius), as convex
polygons and as a ``.navmesh`` file.
"""

from __future__ import annotations

import heapq
from typing import Final

import numpy as np
import shapely
from numpy.typing import NDArray

from condvln.navigation.navmesh_file import NavMeshFile
from condvln.navigation.polygon_tile import tile_of_polygons
from condvln.navigation.settings import NavMeshSettings
from condvln.samples.layout import WALL_THICKNESS, Layout
from condvln.samples.room_space import AGENT_HEIGHT, BLOCKING_HEIGHT, opened

__all__ = [
    "NAVMESH_HEIGHT",
    "convex_polygons",
    "free_floor",
    "navmesh_of",
    "open_plan",
]


MILLIMETRE: Final = 0.001

SLIT: Final = 0.05
"""Strips of free floor narrower than this (metres) are removed, as a voxel-based builder would."""


def free_floor(layout: Layout, radius: float = 0.1) -> shapely.Geometry:
    """Return the floor on which the centre of an agent of this radius (metres) may be, as polygons over (x, z) with
    corners on the millimetre grid.

    Obstacles are walls and the footprints of everything between ankle and head height; rugs and mats are walkable. The
    result has several polygons if the floor is not connected for that radius.
    """
    blocked = [
        piece.footprint.buffer(radius, join_style="mitre")
        for piece in layout.furniture
        if piece.aabb[1, 1] > BLOCKING_HEIGHT / 1000 and piece.aabb[0, 1] < AGENT_HEIGHT / 1000
    ]
    floor = open_plan(layout).buffer(-radius, join_style="mitre").difference(shapely.union_all(blocked))
    return opened(floor, SLIT, MILLIMETRE)


def open_plan(layout: Layout) -> shapely.Geometry:
    """Return the floor between the walls, doorways included, furniture ignored."""
    rooms = [room.shape.buffer(-WALL_THICKNESS / 2, join_style="mitre") for room in layout.rooms]
    doors = []
    for door in layout.doors:
        (x0, z0), (x1, z1) = door.start, door.end
        across = WALL_THICKNESS / 2 + MILLIMETRE
        doors.append(
            shapely.box(x0, z0 - across, x1, z1 + across)
            if door.along_x
            else shapely.box(x0 - across, z0, x1 + across, z1)
        )
    return shapely.union_all([*rooms, *doors], grid_size=MILLIMETRE)


NAVMESH_HEIGHT: Final = 0.1
"""Height in metres of the navmesh above the floor: where Habitat's voxels put it above a floor slab 0.1 m thick."""

MAX_CORNERS: Final = 6
"""Largest number of corners of a Detour polygon."""

KEY_DECIMALS: Final = 6
"""Decimals in metres that distinguish corners; corners lie on the millimetre grid."""


def navmesh_of(layout: Layout, settings: NavMeshSettings) -> NavMeshFile:
    """Return the navmesh of a layout for an agent of ``settings.agent_radius``: the exact free floor, one island."""
    vertices, polygons = convex_polygons(free_floor(layout, settings.agent_radius))
    points = np.column_stack([vertices[:, 0], np.full(len(vertices), NAVMESH_HEIGHT), vertices[:, 1]])
    return NavMeshFile.of_tile(tile_of_polygons(points, polygons, settings), settings)


def convex_polygons(floor: shapely.Geometry) -> tuple[NDArray[np.float64], list[list[int]]]:
    """Return convex polygons of up to six corners, merged from the constrained Delaunay triangles of `floor`.

    Polygons meet along whole edges only, so two polygons are neighbours if they share two vertices. The pair with the
    longest common edge is merged first, as in Recast's ``rcBuildPolyMesh``.

    Returns
    -------
    vertices (n, 2) of (x, z); polygons as vertex indices, counter-clockwise where the shoelace sum is positive
    """
    triangles = np.round(_triangles(floor), KEY_DECIMALS)
    vertices, index = np.unique(triangles.reshape(-1, 2), axis=0, return_inverse=True)
    corners = [[int(i) for i in row] for row in index.reshape(-1, 3)]
    # Delaunay triangles may have either winding.
    wound = [row if _turn(vertices, *row) > 0 else row[::-1] for row in corners]
    return vertices, _merged(vertices, wound)


def _triangles(floor: shapely.Geometry) -> NDArray[np.float64]:
    """Return the corners (n, 3, 2) of triangles that fill `floor`, in an order that depends only on the geometry."""
    parts = shapely.get_parts(shapely.constrained_delaunay_triangles(shapely.normalize(floor)))
    rings = np.array([shapely.get_coordinates(part)[:3] for part in parts])
    return rings[np.lexsort(rings.reshape(len(rings), -1).T[::-1])]


def _turn(vertices: NDArray[np.float64], a: int, b: int, c: int) -> float:
    """Return twice the signed area of the triangle a, b, c: positive if a, b, c are counter-clockwise in a plot with x
    to the right and z up.
    """
    (ax, az), (bx, bz), (cx, cz) = vertices[[a, b, c]]
    return float((bx - ax) * (cz - az) - (bz - az) * (cx - ax))


def _merged(vertices: NDArray[np.float64], polygons: list[list[int]]) -> list[list[int]]:
    alive: dict[int, list[int]] = dict(enumerate(polygons))
    owner = {edge: number for number, polygon in alive.items() for edge in _edges(polygon)}
    waiting = [(-_length(vertices, edge), edge) for edge in owner if edge[0] < edge[1] and edge[::-1] in owner]
    heapq.heapify(waiting)
    number = len(polygons)
    while waiting:
        _, edge = heapq.heappop(waiting)
        left, right = owner.get(edge), owner.get(edge[::-1])
        if left is None or right is None:
            continue  # already merged since it was queued
        joined = _joined(vertices, alive[left], alive[right], edge)
        if joined is None:
            continue
        del alive[left], alive[right], owner[edge], owner[edge[::-1]]
        alive[number] = joined
        for side in _edges(joined):
            owner[side] = number
            # The common edges of its neighbours are queued again for the merged polygon.
            if side[::-1] in owner:
                key = min(side, side[::-1])
                heapq.heappush(waiting, (-_length(vertices, key), key))
        number += 1
    return list(alive.values())


def _edges(polygon: list[int]) -> list[tuple[int, int]]:
    return list(zip(polygon, [*polygon[1:], polygon[0]], strict=True))


def _length(vertices: NDArray[np.float64], edge: tuple[int, int]) -> float:
    return float(np.linalg.norm(vertices[edge[0]] - vertices[edge[1]]))


def _joined(
    vertices: NDArray[np.float64], left: list[int], right: list[int], edge: tuple[int, int]
) -> list[int] | None:
    """Return the polygons `left` and `right` merged at `edge`. Return None if the result has too many corners or is not
    convex, or if the polygons share more than this edge.
    """
    if len(left) + len(right) - 2 > MAX_CORNERS or len(set(left) & set(right)) > 2:
        return None
    a, b = edge
    at = left.index(b)
    rest = left[at:] + left[:at]  # b … a
    at = right.index(a)
    other = right[at:] + right[:at]  # a … b
    joined = rest + other[1:-1]
    for middle in (a, b):
        at = joined.index(middle)
        if _turn(vertices, joined[at - 1], middle, joined[(at + 1) % len(joined)]) <= 0:
            return None
    return joined
