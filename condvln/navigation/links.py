"""Finish a tile as Habitat does when it builds or loads one: link the polygons, disable those without area.

Follows ``dtNavMesh::connectIntLinks`` (Detour) and ``removeZeroAreaPolys`` (``PathFinder.cpp`` of habitat-sim 0.3.4).
"""

from __future__ import annotations

import numpy as np

from condvln.navigation.tile import DISABLED, LINK, NULL_LINK, Floats, NavMeshTile, Records, base_reference

__all__ = ["disable_zero_area", "link_tile", "polygon_areas"]

# Area in square metres below which Habitat disables a polygon, since walking into one crashes the simulator.
ZERO_AREA = np.float32(1e-5)
INTERNAL_SIDE = 0xFF


def link_tile(tile: NavMeshTile) -> NavMeshTile:
    """Return the tile with new links and with its zero-area polygons disabled, as Habitat saves tiles.

    Links are taken from the free list in polygon order, each polygon's edges last to first, and each is put at the head
    of its polygon's list; the remaining links stay in the free list.
    """
    neighbours = tile.neighbours
    edges = np.arange(neighbours.shape[1])[::-1]
    poly, column = np.nonzero(neighbours[:, ::-1] >= 0)
    used = len(poly)
    if used > len(tile.links):
        raise ValueError(f"tile has {used} inner edges but room for {len(tile.links)} links")
    links = np.zeros(len(tile.links), LINK)
    links["next"] = np.arange(1, len(links) + 1)
    if len(links):
        links["next"][-1] = NULL_LINK
    edge = edges[column]
    index = np.arange(used)
    links["ref"][:used] = base_reference(len(tile.polys)) | neighbours[poly, edge]
    links["edge"][:used] = edge
    links["side"][:used] = INTERNAL_SIDE
    same_poly = np.zeros(used, bool)
    same_poly[1:] = poly[1:] == poly[:-1]
    links["next"][:used] = np.where(same_poly, index - 1, NULL_LINK)
    polys = tile.polys.copy()
    polys["first_link"] = NULL_LINK
    polys["first_link"][poly] = index  # the last assignment wins: the head of the list
    return disable_zero_area(tile.with_parts(links=links, polys=polys))


def disable_zero_area(tile: NavMeshTile) -> NavMeshTile:
    """Return the tile with the flags of polygons below 1e-5 m² set to DISABLED."""
    empty = polygon_areas(tile) < ZERO_AREA
    if not empty.any():
        return tile
    polys: Records = tile.polys.copy()
    polys["flags"][empty] = DISABLED
    return tile.with_parts(polys=polys)


def polygon_areas(tile: NavMeshTile) -> Floats:
    """Return the areas (p,) of the polygons in square metres. Each area is summed in float32 over the polygon's detail
    triangles, in order.
    """
    corners, poly = tile.detail_triangles
    a, b = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 1]
    cross = a[:, [1, 2, 0]] * b[:, [2, 0, 1]] - a[:, [2, 0, 1]] * b[:, [1, 2, 0]]
    squares = cross * cross
    area = np.float32(0.5) * np.sqrt((squares[:, 0] + squares[:, 1]) + squares[:, 2])
    total = np.zeros(len(tile.polys), np.float32)
    np.add.at(total, poly, area)  # unbuffered: one float32 addition per triangle, in order
    return total
