"""The arrays for navmesh queries, in the layout of the kernels."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from condvln.navigation.tile import WALKABLE, Floats, Indices, Ints, NavMeshTile

__all__ = ["QueryMesh", "query_mesh"]

# Positions in ``QueryMesh.grid``
BMIN, BMAX, QUANT, CLIMB, ORIGIN_X, ORIGIN_Z, TILE_WIDTH, TILE_HEIGHT, SLACK = 0, 3, 6, 7, 8, 9, 10, 11, 12
GRID_SIZE = 13

# Polygons are skipped by their boxes only if they are farther than the best so far by this margin, so that rounding
# never decides: in metres, and as a share of the largest coordinate (32 float32 ulps or more).
BOX_SLACK = 1e-3
BOX_SLACK_RELATIVE = 4e-6


class QueryMesh(NamedTuple):
    """The query data of p polygons, n detail triangles and b tree nodes. All arrays are C-contiguous, all indices
    64-bit.
    """

    verts: Floats
    """(v, 3) vertices, metres"""
    poly_verts: Indices
    """(p, 6) vertex of each corner"""
    poly_size: Indices
    """(p,) corners"""
    neighbours: Indices
    """(p, 6) polygon across each edge, -1 for a wall"""
    walkable: npt.NDArray[np.uint8]
    """(p,) 1 if habitat-sim's query filter accepts the polygon"""
    island: Indices
    """(p,) connected component"""
    tri_start: Indices
    """(p + 1,) first detail triangle"""
    tri_points: Floats
    """(n, 3, 3) corners of detail triangles"""
    tri_edges: npt.NDArray[np.uint8]
    """(n, 3) per edge from corner j to j + 1: bit 0 on the polygon's boundary, bit 1 seen from the other triangle"""
    boxes: Floats
    """(p, 4) least x, least z, greatest x, greatest z"""
    bv_bounds: Indices
    """(b, 6) box in cells, lower then upper"""
    bv_index: Indices
    """(b,) polygon, or minus the nodes to skip"""
    grid: Floats
    """(13,) tile bounds, cells per metre, climb, Detour's grid, margin of ``boxes``"""


def query_mesh(tile: NavMeshTile, island: Indices, origin: Floats, tile_width: float, tile_height: float) -> QueryMesh:
    """Convert ``tile`` to the arrays for queries. ``origin`` (x, z), ``tile_width`` and ``tile_height`` describe the
    grid, as the tile's file states them.
    """
    corners, poly = tile.detail_triangles
    counts = np.bincount(poly, minlength=len(tile.polys))
    start = np.zeros(len(tile.polys) + 1, np.int64)
    np.cumsum(counts, out=start[1:])
    grid = np.zeros(GRID_SIZE, np.float32)
    grid[BMIN : BMIN + 3], grid[BMAX : BMAX + 3] = tile.bounds
    grid[QUANT], grid[CLIMB] = tile.header["bv_quant_factor"], tile.header["walkable_climb"]
    grid[ORIGIN_X], grid[ORIGIN_Z] = origin[0], origin[2]
    grid[TILE_WIDTH], grid[TILE_HEIGHT] = tile_width, tile_height
    grid[SLACK] = BOX_SLACK + BOX_SLACK_RELATIVE * max(float(np.abs(tile.verts).max()), float(np.abs(corners).max()))
    return QueryMesh(
        # a copy, since numba would compile again for a read-only array
        verts=np.array(tile.verts, np.float32, order="C"),
        poly_verts=tile.poly_verts.astype(np.int64, order="C"),
        poly_size=tile.polys["vert_count"].astype(np.int64),
        neighbours=tile.neighbours.astype(np.int64, order="C"),
        walkable=((tile.polys["flags"] & WALKABLE) != 0).astype(np.uint8),
        island=np.array(island, np.int64, order="C"),
        tri_start=start,
        tri_points=np.ascontiguousarray(corners, np.float32),
        tri_edges=_edge_bits(tile, counts, start),
        boxes=_boxes(tile, corners, poly),
        bv_bounds=np.concatenate([tile.bv_nodes["bmin"], tile.bv_nodes["bmax"]], axis=1).astype(np.int64),
        bv_index=tile.bv_nodes["i"].astype(np.int64),
        grid=grid,
    )


def _edge_bits(tile: NavMeshTile, counts: npt.NDArray[np.int64], start: Indices) -> npt.NDArray[np.uint8]:
    poly = np.repeat(np.arange(len(counts)), counts)
    rows = np.arange(len(poly)) + (tile.detail_meshes["tri_base"].astype(np.int64) - start[:-1])[poly]
    tris = tile.detail_tris[rows]
    boundary = (tris[:, 3:4] >> np.array([0, 2, 4], np.uint8)) & 1
    seen_elsewhere = tris[:, [0, 1, 2]] < tris[:, [1, 2, 0]]
    bits: npt.NDArray[np.uint8] = (boundary | (seen_elsewhere.astype(np.uint8) << 1)).astype(np.uint8)
    return np.ascontiguousarray(bits)


def _boxes(tile: NavMeshTile, corners: Floats, poly: Ints) -> Floats:
    used = np.arange(tile.poly_verts.shape[1])[None, :, None] < tile.polys["vert_count"][:, None, None]
    ground = tile.verts[tile.poly_verts][:, :, [0, 2]]
    low = np.where(used, ground, np.inf).min(axis=1)
    high = np.where(used, ground, -np.inf).max(axis=1)
    detail = corners[:, :, [0, 2]]
    np.minimum.at(low, poly, detail.min(axis=1))
    np.maximum.at(high, poly, detail.max(axis=1))
    return np.ascontiguousarray(np.concatenate([low, high], axis=1), np.float32)
