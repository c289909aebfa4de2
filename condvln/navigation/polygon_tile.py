"""Build a navmesh tile directly from convex polygons, without voxelisation.

For generated scenes, whose free floor is known as polygons, and for tests with closed-form distances. Recast's result
for the same floor would be coarser (cells of 5 cm); Habitat can use a navmesh of either kind.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from condvln.navigation.settings import NavMeshSettings
from condvln.navigation.tile import (
    DETAIL_MESH,
    MAX_VERTS_PER_POLYGON,
    POLYGON,
    WALKABLE,
    Floats,
    NavMeshTile,
    Records,
    build_bv_tree,
    link_tile,
    quantise_bounds,
)
from schemas.errors import InputError

__all__ = ["tile_of_polygons"]

MAX_POLYGON_VERTICES = 0xFFFF  # vertices of a tile are numbered in 16 bits
MAX_POLYGONS = 0x7FFF  # neighbours, too; their highest bit marks another tile
# Tolerance in square metres of the convexity test, for rounding.
CONVEXITY_TOLERANCE = 1e-6
# Edge flags of a fan triangle's three edges: on the polygon's boundary or not.
BOUNDARY_FIRST, BOUNDARY_MIDDLE, BOUNDARY_LAST = 1, 4, 16


def tile_of_polygons(
    vertices: npt.ArrayLike, polygons: Sequence[Sequence[int]], settings: NavMeshSettings | None = None
) -> NavMeshTile:
    """Return a linked tile whose polygons are connected wherever two of them share an edge (the same two vertices).

    Parameters
    ----------
    vertices : (v, 3) metres, Habitat frame; fewer than 65,535
    polygons : convex, 3 to 6 vertices each, in either winding
    settings : agent sizes and cell size written into the tile; Habitat's defaults if not given

    Raises
    ------
    InputError : a polygon is not convex, has too few or too many corners, or refers to an unknown vertex; an edge
        is shared by more than two polygons; a number is not finite
    """
    chosen = settings or NavMeshSettings()
    verts = np.ascontiguousarray(vertices, np.float32).reshape(-1, 3)
    if not np.isfinite(verts).all():
        raise InputError("a vertex is NaN or infinite", remedy="Correct the floor polygons")
    if not (3 <= len(verts) < MAX_POLYGON_VERTICES and 1 <= len(polygons) <= MAX_POLYGONS):
        raise InputError(
            f"a tile can't have {len(verts)} vertices and {len(polygons)} polygons", remedy="Split the scene"
        )
    corners = [_wound(verts, list(polygon), number) for number, polygon in enumerate(polygons)]
    polys = _polygon_records(corners)
    low = np.array([verts[c].min(axis=0) for c in corners])
    high = np.array([verts[c].max(axis=0) for c in corners])
    bmin, bmax = low.min(axis=0), high.max(axis=0) + np.array([0, chosen.agent_height, 0], np.float32)
    detail_meshes, detail_tris = _fans(corners)
    return link_tile(
        NavMeshTile.assemble(
            bmin=bmin,
            bmax=bmax,
            cell_size=chosen.cell_size,
            walkable_height=chosen.agent_height,
            walkable_radius=chosen.agent_radius,
            walkable_climb=chosen.agent_max_climb,
            verts=verts,
            polys=polys,
            detail_meshes=detail_meshes,
            detail_verts=np.empty((0, 3), np.float32),
            detail_tris=detail_tris,
            bv_nodes=build_bv_tree(*quantise_bounds(low, high, bmin, chosen.cell_size)),
        )
    )


def _wound(verts: Floats, corners: list[int], number: int) -> list[int]:
    """Return the corners in counter-clockwise order seen from above (x east, z south). String pulling expects this
    order.
    """
    place = f"polygon {number}"
    if not 3 <= len(corners) <= MAX_VERTS_PER_POLYGON or len(set(corners)) != len(corners):
        raise InputError(
            f"the polygon's {len(corners)} corners are too few, too many or not all different",
            place=place,
            remedy="Give 3 to 6 different vertices",
        )
    if min(corners) < 0 or max(corners) >= len(verts):
        raise InputError("the polygon refers to an unknown vertex", place=place, remedy="Correct the floor polygons")
    ground = verts[corners][:, [0, 2]].astype(np.float64)
    along = np.roll(ground, -1, axis=0) - ground
    following = np.roll(along, -1, axis=0)
    turns = along[:, 0] * following[:, 1] - along[:, 1] * following[:, 0]
    if (turns > CONVEXITY_TOLERANCE).any() and (turns < -CONVEXITY_TOLERANCE).any():
        raise InputError("the polygon is not convex", place=place, remedy="Split it into convex polygons")
    return corners if turns.sum() <= 0 else corners[::-1]


def _polygon_records(corners: list[list[int]]) -> Records:
    polys = np.zeros(len(corners), POLYGON)
    sides: dict[tuple[int, int], list[tuple[int, int]]] = {}
    for number, polygon in enumerate(corners):
        polys["vert_count"][number] = len(polygon)
        polys["verts"][number, : len(polygon)] = polygon
        for edge, vertex in enumerate(polygon):
            other = polygon[(edge + 1) % len(polygon)]
            sides.setdefault((min(vertex, other), max(vertex, other)), []).append((number, edge))
    for (a, b), users in sides.items():
        if len(users) > 2:
            raise InputError(
                f"{len(users)} polygons share the edge {a}-{b}, but at most two may",
                remedy="Correct the floor polygons",
            )
        if len(users) == 2:
            (first, first_edge), (second, second_edge) = users
            polys["neis"][first, first_edge] = second + 1
            polys["neis"][second, second_edge] = first + 1
    polys["flags"] = WALKABLE
    return polys


def _fans(corners: list[list[int]]) -> tuple[Records, npt.NDArray[np.uint8]]:
    """Return the detail meshes and detail triangles of polygons. Each polygon is a fan of triangles around its first
    corner, without additional vertices.
    """
    meshes = np.zeros(len(corners), DETAIL_MESH)
    triangles: list[tuple[int, int, int, int]] = []
    for number, polygon in enumerate(corners):
        meshes["tri_base"][number], meshes["tri_count"][number] = len(triangles), len(polygon) - 2
        for corner in range(2, len(polygon)):
            first = BOUNDARY_FIRST if corner == 2 else 0
            last = BOUNDARY_LAST if corner == len(polygon) - 1 else 0
            triangles.append((0, corner - 1, corner, first | BOUNDARY_MIDDLE | last))
    return meshes, np.array(triangles, np.uint8)
