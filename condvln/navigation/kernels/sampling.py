"""Uniform points on polygons: ``dtRandomPointInConvexPoly`` with the height of the detail mesh."""

from __future__ import annotations

import numpy as np

from condvln.compiled import compiled
from condvln.navigation.kernels.geometry import ONE, ZERO, triangle_area
from condvln.navigation.kernels.mesh import QueryMesh
from condvln.navigation.kernels.projection import NAN, height_on_polygon
from condvln.navigation.tile import Floats, Indices
from condvln.uncounted import uncounted


@compiled
def ground_areas(mesh: QueryMesh) -> Floats:
    """Return twice the area (p,) of each walkable polygon in the ground plane, 0 for others: Detour's sampling
    weights.
    """
    mesh = uncounted(mesh)
    weights = np.zeros(mesh.poly_size.shape[0], np.float32)
    for poly in range(mesh.poly_size.shape[0]):
        if mesh.walkable[poly]:
            for corner in range(2, mesh.poly_size[poly]):
                weights[poly] += max(_fan_area(mesh, poly, corner), ZERO)
    return weights


@compiled
def _fan_area(mesh: QueryMesh, poly: int, corner: int) -> np.float32:
    a = mesh.verts[mesh.poly_verts[poly, 0]]
    b = mesh.verts[mesh.poly_verts[poly, corner - 1]]
    c = mesh.verts[mesh.poly_verts[poly, corner]]
    return triangle_area(a[0], a[2], b[0], b[2], c[0], c[2])


@compiled
def points_on_polygons(mesh: QueryMesh, polys: Indices, picks: Floats, spreads: Floats) -> Floats:
    """Return points (n, 3), one on each of n polygons. A point is NaN if rounding placed it off its polygon.

    ``picks`` chooses the triangle of the polygon's fan and the position along its far edge, ``spreads`` the distance
    from the first corner; if both are uniform in [0, 1), the points are uniform on the polygon.
    """
    mesh = uncounted(mesh)
    points = np.empty((polys.shape[0], 3), np.float32)
    for i in range(polys.shape[0]):
        poly = polys[i]
        whole = ZERO
        for corner in range(2, mesh.poly_size[poly]):
            whole += max(_fan_area(mesh, poly, corner), ZERO)
        threshold = picks[i] * whole
        passed = ZERO
        chosen = mesh.poly_size[poly] - 1
        u = ONE
        for corner in range(2, mesh.poly_size[poly]):
            area = max(_fan_area(mesh, poly, corner), ZERO)
            if threshold < passed + area:
                u = (threshold - passed) / area
                chosen = corner
                break
            passed += area
        v = np.sqrt(spreads[i])
        at_first = ONE - v
        at_before = (ONE - u) * v
        at_chosen = u * v
        a = mesh.verts[mesh.poly_verts[poly, 0]]
        b = mesh.verts[mesh.poly_verts[poly, chosen - 1]]
        c = mesh.verts[mesh.poly_verts[poly, chosen]]
        x = at_first * a[0] + at_before * b[0] + at_chosen * c[0]
        z = at_first * a[2] + at_before * b[2] + at_chosen * c[2]
        over, y = height_on_polygon(
            mesh.verts, mesh.poly_verts, mesh.poly_size, mesh.tri_start, mesh.tri_points, mesh.tri_edges, poly, x, z
        )
        points[i, 0] = x if over else NAN
        points[i, 1] = y if over else NAN
        points[i, 2] = z if over else NAN
    return points
