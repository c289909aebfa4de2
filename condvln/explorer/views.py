"""What an agent sees on the looking path, as pictures."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from condvln.episodes.observability import places_at
from condvln.sensors import cameras_of
from condvln.sensors.renderer import Renderer, png
from condvln.sensors.shading import shaded
from schemas.config import CameraConfig
from schemas.config.constants import EYE_SPACING

__all__ = ["pictures"]

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
    return places_at(path, at), at
