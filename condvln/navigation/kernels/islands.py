"""Connected components, as habitat-sim's ``IslandSystem`` finds them."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from condvln.compiled import compiled, inlined
from condvln.navigation.tile import Floats, Indices


@compiled
def find_islands(
    verts: Floats, poly_verts: Indices, poly_size: Indices, neighbours: Indices, walkable: npt.NDArray[np.uint8]
) -> tuple[Indices, Floats]:
    """Return the island of each polygon (p,) and the radius of each island in metres.

    Flood fill in polygon order, into walkable neighbours only; a polygon that nothing reaches is an island of its own.
    The radius is the greatest distance between a polygon corner of the island and the mean of all its polygon corners
    (with repeats, in the order of the fill).
    """
    count = poly_size.shape[0]
    island = np.full(count, -1, np.int64)
    radii = np.empty(count, np.float32)
    stack = np.empty(count, np.int64)
    members = np.empty(count, np.int64)
    islands = 0
    for seed in range(count):
        if island[seed] >= 0:
            continue
        island[seed] = islands
        stack[0] = seed
        waiting = 1
        found = 0
        while waiting > 0:
            waiting -= 1
            poly = stack[waiting]
            members[found] = poly
            found += 1
            for edge in range(poly_size[poly]):
                other = neighbours[poly, edge]
                if other >= 0 and island[other] < 0 and walkable[other]:
                    island[other] = islands
                    stack[waiting] = other
                    waiting += 1
        radii[islands] = _radius(verts, poly_verts, poly_size, members[:found])
        islands += 1
    return island, radii[:islands].copy()


@inlined
def _radius(verts: Floats, poly_verts: Indices, poly_size: Indices, members: Indices) -> np.float32:
    x, y, z = np.float32(0.0), np.float32(0.0), np.float32(0.0)
    corners = 0
    for poly in members:
        for i in range(poly_size[poly]):
            v = poly_verts[poly, i]
            x += verts[v, 0]
            y += verts[v, 1]
            z += verts[v, 2]
            corners += 1
    total = np.float32(corners)
    x = x / total
    y = y / total
    z = z / total
    radius = np.float32(0.0)
    for poly in members:
        for i in range(poly_size[poly]):
            v = poly_verts[poly, i]
            dx = verts[v, 0] - x
            dy = verts[v, 1] - y
            dz = verts[v, 2] - z
            radius = max(radius, np.sqrt(dx * dx + dy * dy + dz * dz))
    return radius
