"""The surfaces of a whole scene as triangles, for navmesh building and occlusion."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

__all__ = ["STRUCTURE", "SceneGeometry"]

STRUCTURE = -1
"""Owner of a triangle that belongs to no object: floor, wall, door, or a scan that is a single mesh."""


@dataclass(frozen=True, eq=False)
class SceneGeometry:
    """Triangles in Habitat's frame (metres, +Y up).

    vertices : (n, 3)
    faces : (m, 3) indices of vertices, counter-clockwise seen from outside
    owner : (m,) index into the scene's ``objects`` of each face's object, `STRUCTURE` if it has none
    approximate : boxes and generated walls replace surfaces; recorded with all derived results
    """

    vertices: NDArray[np.float64]
    faces: NDArray[np.int64]
    owner: NDArray[np.int64]
    approximate: bool
