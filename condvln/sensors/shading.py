"""Pictures for people of scenes without textures: surfaces have the colours of their labels, and shades."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from condvln.scene.scene import FLOOR_COLOUR, WALL_COLOUR, label_colour
from condvln.sensors.renderer import Frame

__all__ = ["UNSEEN", "shaded"]

PLAIN: Final = 0.8
"""Share of pixels with the colour of their neighbours from which a picture counts as one without textures."""
STRUCTURE: Final = {"wall": WALL_COLOUR, "floor": FLOOR_COLOUR, "ceiling": (1.0, 1.0, 1.0)}
LEVEL: Final = 0.8
"""Vertical part of the normal from which a surface without a label is a floor or a ceiling."""
UNSEEN: Final = 205
"""Grey of pixels at which nothing is known."""
_LIGHT: Final = np.array([0.35, -0.75, 0.56])  # from the upper left, behind the camera: right, down, ahead
_AMBIENT: Final = 0.55


def shaded(frame: Frame, labels: tuple[str, ...], hfov: float) -> NDArray[np.uint8]:
    """Return a frame's picture (h, w, 3). If most of it is of even colours, as meshes without textures are drawn, its
    surfaces get the colours of their labels and are shaded; one without a label is floor, wall or ceiling by its
    direction. Pixels at which nothing is known are grey.

    Parameters
    ----------
    labels : label of each number in ``frame.label``, from 1
    hfov : horizontal angle of view, degrees
    """
    seen = frame.depth > 0
    picture = frame.rgb.copy()
    if np.all(picture[1:, 1:] == picture[:-1, :-1], axis=-1).mean() > PLAIN:
        colours = np.array([*STRUCTURE.values(), *(STRUCTURE.get(label) or label_colour(label) for label in labels)])
        normal = _normals(frame.depth.astype(np.float64), hfov)
        built = np.select([normal[..., 1] > LEVEL, normal[..., 1] < -LEVEL], [1, 2])
        own = colours[np.where(frame.label > 0, frame.label + 2, built)]
        light = _AMBIENT + (1 - _AMBIENT) * np.abs(normal @ _LIGHT)
        picture = np.clip(255 * own * light[..., None], 0, 255).astype(np.uint8)
    picture[~seen] = UNSEEN
    return picture


def _normals(depth: NDArray[np.float64], hfov: float) -> NDArray[np.float64]:
    """Return the normal of the surface at each pixel (h, w, 3), right, down, ahead, away from the camera. The slopes of
    1 / depth give it, since 1 / depth of a plane is linear over the picture.
    """
    height, width = depth.shape
    focal = width / 2 / np.tan(np.radians(hfov) / 2)
    near = np.divide(1.0, depth, out=np.zeros_like(depth), where=depth > 0)
    down, right = np.gradient(near)
    columns = np.arange(width) - (width - 1) / 2
    rows = (np.arange(height) - (height - 1) / 2)[:, None]
    normal = np.stack([right * focal, down * focal, near - right * columns - down * rows], axis=-1)
    unit: NDArray[np.float64] = normal / np.maximum(np.linalg.norm(normal, axis=-1, keepdims=True), 1e-9)
    return unit
