"""Small scenes of triangles whose images are known in closed form, and rays that know nothing of the renderer."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from condvln.sensors.renderer import Renderer
from condvln.sensors.surfaces import Material, SurfaceBuilder
from schemas.config import CameraConfig

F64 = NDArray[np.float64]

_FACES = np.array(
    [
        [0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5],
        [0, 4, 5], [0, 5, 1], [2, 3, 7], [2, 7, 6],
        [0, 2, 6], [0, 6, 4], [1, 5, 7], [1, 7, 3],
    ]
)  # fmt: skip


def box_triangles(low: Sequence[float], high: Sequence[float], inside: bool = False) -> F64:
    """(12, 3, 3) triangles of a box seen from outside, or from inside."""
    corner = np.array([[x, y, z] for x in (low[0], high[0]) for y in (low[1], high[1]) for z in (low[2], high[2])])
    triangles: F64 = corner[_FACES]
    return triangles[:, ::-1] if inside else triangles


def renderer_of(*pieces: tuple[F64, tuple[float, float, float]], labels: tuple[str, ...] = ()) -> Renderer:
    """A scene of pieces, each a body of one colour; the first is structure, the others objects 0, 1, …"""
    builder = SurfaceBuilder()
    for number, (triangles, colour) in enumerate(pieces):
        builder.add(triangles, number - 1, builder.material(Material(colour)))
    return Renderer(builder.surfaces(), labels or tuple(f"thing {k}" for k in range(len(pieces) - 1)))


def rays(camera: CameraConfig, rotation: F64) -> F64:
    """(h, w, 3) directions of the pixels' centres in the scene's frame, of length 1 along the optical axis."""
    half = np.tan(np.radians(camera.hfov) / 2)
    x = ((np.arange(camera.width) + 0.5) / camera.width * 2 - 1) * half
    y = (1 - (np.arange(camera.height) + 0.5) / camera.height * 2) * half * camera.height / camera.width
    grid = np.stack(np.broadcast_arrays(x[None, :], y[:, None], -1.0), axis=-1)
    directions: F64 = grid @ rotation.T
    return directions
