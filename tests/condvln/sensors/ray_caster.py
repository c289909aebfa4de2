"""Embree's rays, past back faces: a second opinion on images."""

from __future__ import annotations

import numpy as np
from embreex import rtcore_scene
from embreex.mesh_construction import TriangleMesh
from numpy.typing import NDArray

F64 = NDArray[np.float64]

NEAR = 0.01
BEYOND = 1e-5
"""Metres behind a rejected hit where the ray goes on, for each metre that it has come."""


class RayCaster:
    """Rays through triangles (m, 3, 3), counter-clockwise seen from outside."""

    def __init__(self, triangles: F64) -> None:
        self._origin = triangles.reshape(-1, 3).mean(axis=0)
        self._triangles = triangles - self._origin
        self._scene = rtcore_scene.EmbreeScene(robust=True)
        TriangleMesh(self._scene, self._triangles.astype(np.float32))
        one, two = self._triangles[:, 1] - self._triangles[:, 0], self._triangles[:, 2] - self._triangles[:, 0]
        self._normals = np.cross(one, two)

    def first_front(self, eye: F64, directions: F64) -> tuple[F64, NDArray[np.int64]]:
        """Depth (k,), 0 for none, and triangle (k,), −1, of the first front face along k directions from one eye."""
        depth = np.zeros(len(directions))
        found = np.full(len(directions), -1, np.int64)
        start = np.full(len(directions), NEAR)
        rows = np.arange(len(directions))
        while len(rows):
            origins = eye - self._origin + start[rows, None] * directions[rows]
            hits = self._scene.run(origins.astype(np.float32), directions[rows].astype(np.float32), output=1)
            face = hits["primID"].astype(np.int64)
            met = face >= 0
            rows, face = rows[met], face[met]
            # The distance is computed anew, in double precision.
            normal, corner = self._normals[face], self._triangles[face, 0] - (eye - self._origin)
            slope = np.einsum("ij,ij->i", normal, directions[rows])
            with np.errstate(divide="ignore", invalid="ignore"):
                t = np.einsum("ij,ij->i", normal, corner) / slope
            t = np.where(np.isfinite(t), t, start[rows])
            front = slope < 0
            depth[rows[front]], found[rows[front]] = t[front], face[front]
            start[rows] = np.maximum(t, start[rows]) * (1 + BEYOND) + BEYOND
            rows = rows[~front]
        return depth, found
