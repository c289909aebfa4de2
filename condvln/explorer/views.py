"""What an agent sees on the looking path, as pictures."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from condvln.scene.scene import label_colour
from condvln.sensors import cameras_of
from condvln.sensors.renderer import Frame, Renderer, png
from schemas.config import CameraConfig
from schemas.config.constants import EYE_SPACING

__all__ = ["pictures", "shaded"]

F64 = NDArray[np.float64]
CAMERA: Final = "streamvln"
QUARTERS: Final = 4
"""Number of equal parts of the looking path, at whose ends pictures are taken."""


def pictures(episode: Mapping[str, Any], renderer: Renderer, walks: Mapping[str, Any]) -> Iterator[tuple[str, bytes]]:
    """Yield a caption and a PNG for the first view and for places along the looking path, looking ahead, then for the
    frames of the looking walk at which conditions are decided, and for the poses at which agents are nearest to these.

    episode : a document of :func:`episode_document`
    walks : documents of :func:`walk_document` by agent; one without headings has no pictures
    """
    camera = next(camera for name, camera in cameras_of(CAMERA).items() if name.startswith("rgb"))
    looking = episode["looking"] or episode["leaves"][episode["gold"]]
    places, walked = _spaced(np.array(looking["path"], dtype=np.float64), EYE_SPACING)
    for part in range(QUARTERS + 1):
        at = round(part * (len(places) - 1) / QUARTERS)
        if part == 0:
            heading, caption = -math.radians(episode["heading"]), "first view, at the start"
        else:
            ahead = places[min(at + 1, len(places) - 1)] - places[min(at, len(places) - 2)]
            heading, caption = math.atan2(-ahead[0], -ahead[2]), f"{walked[at]:.1f} m along the looking path"
        yield caption, _picture(renderer, camera, places[at], heading)
    for k, view in sorted(episode["views"].items()):
        decided = f"where {'ABCDEFGH'[int(k)]} is decided"
        caption = f"{view['walked']:.1f} m along the looking path, {decided}"
        yield caption, _picture(renderer, camera, np.array(view["at"]), -math.radians(view["heading"]))
        for agent, walk in walks.items():
            path = np.array(walk["path"], dtype=np.float64)
            at = int(np.linalg.norm(path - view["at"], axis=1).argmin())
            if walk["headings"] is not None:
                heading = -math.radians(walk["headings"][at])
                yield (
                    f"agent {agent}, step {at}: as near as it comes to {decided}",
                    _picture(renderer, camera, path[at], heading),
                )


def _picture(renderer: Renderer, camera: CameraConfig, place: F64, heading: float) -> bytes:
    seen = shaded(renderer.look(camera, place, heading), renderer.labels, camera.hfov)
    return png(np.ascontiguousarray(seen[::2, ::2]))


def _spaced(path: F64, spacing: float) -> tuple[F64, F64]:
    """Return points (n, 3) along a path, at most `spacing` metres apart, and the metres walked to each, (n,)."""
    length = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(path, axis=0), axis=1))])
    at: F64 = np.linspace(0.0, float(length[-1]), max(1, math.ceil(length[-1] / spacing)) + 1)
    return np.column_stack([np.interp(at, length, path[:, axis]) for axis in range(3)]), at


PLAIN: Final = 0.8
"""Share of pixels with the colour of their neighbours from which a picture counts as one without textures."""
STRUCTURE: Final = {"wall": (0.85, 0.83, 0.8), "floor": (0.66, 0.56, 0.46), "ceiling": (0.95, 0.95, 0.93)}
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
