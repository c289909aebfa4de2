"""Pictures of scenes without textures: surfaces get the colour of their label, and light that shows their shape."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from condvln.scene.palette import label_colour
from condvln.sensors.renderer import Frame

__all__ = ["shaded"]

PLAIN: Final = 0.5
"""Share of white among the seen pixels from which a picture counts as one without textures."""
UNSEEN: Final = 205
"""Grey of pixels at which nothing is known."""
_LIGHT: Final = np.array([0.35, -0.75, 0.56])  # from the upper left, behind the camera: right, down, ahead
_AMBIENT: Final = 0.55


def shaded(frame: Frame, labels: tuple[str, ...], hfov: float) -> NDArray[np.uint8]:
    """Return a frame's picture (h, w, 3). If most of it is white, as meshes without textures are drawn, its white
    surfaces are coloured and shaded. Pixels at which nothing is known are grey.

    Parameters
    ----------
    labels : label of each number in ``frame.label``, from 1
    hfov : horizontal angle of view, degrees
    """
    seen = frame.depth > 0
    white = seen & np.all(frame.rgb == 255, axis=-1)
    picture = frame.rgb.copy()
    if white.sum() > PLAIN * max(1, seen.sum()):
        colours = np.array([(0.85, 0.83, 0.8), *map(label_colour, labels)])
        light = _light(frame.depth.astype(np.float64), hfov)
        coloured = np.clip(colours[frame.label] * light[..., None] * 255, 0, 255).astype(np.uint8)
        picture[white] = coloured[white]
    picture[~seen] = UNSEEN
    return picture


def _light(depth: NDArray[np.float64], hfov: float) -> NDArray[np.float64]:
    """Return the brightness (h, w) of the pixels, computed from the normal of the surface at each pixel. The slopes of
    1 / depth give the normal, since 1 / depth of a plane is linear over the picture.
    """
    height, width = depth.shape
    focal = width / 2 / np.tan(np.radians(hfov) / 2)
    near = np.divide(1.0, depth, out=np.zeros_like(depth), where=depth > 0)
    down, right = np.gradient(near)
    columns = np.arange(width) - (width - 1) / 2
    rows = (np.arange(height) - (height - 1) / 2)[:, None]
    normal = np.stack([right * focal, down * focal, near - right * columns - down * rows], axis=-1)
    normal /= np.maximum(np.linalg.norm(normal, axis=-1, keepdims=True), 1e-9)
    brightness: NDArray[np.float64] = _AMBIENT + (1 - _AMBIENT) * np.abs(normal @ _LIGHT)
    return brightness
