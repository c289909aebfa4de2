"""What an agent sees on the gold path: the place from which each condition is first decided, and pictures."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from condvln.episodes.view import SceneView
from condvln.explorer.shading import shaded
from condvln.navigation.sight import View, eyes_at
from condvln.sensors import cameras_of
from condvln.sensors.pictures import png
from condvln.sensors.renderer import Renderer
from schemas.config import CameraConfig, EpisodeConfig, PlacesConfig
from schemas.config.constants import EYE_SPACING

__all__ = ["first_views", "pictures"]

F64 = NDArray[np.float64]
Document = dict[str, Any]
CAMERA: Final = "streamvln"
QUARTERS: Final = 4
"""Number of equal parts of the gold path, at whose ends pictures are taken."""


def first_views(
    episode: Mapping[str, Any], view: SceneView, places: PlacesConfig, rules: EpisodeConfig
) -> dict[str, Document]:
    """Return, by condition of the gold route, the first place on the gold path at which the objects that decide the
    condition have been seen: the position ``at``, ``walked``, the metres walked from the start, and the first of these
    objects.

    A condition is left out if no object decides it, or if its objects are not all seen from the path.

    Parameters
    ----------
    episode : a document of :func:`episode_document` with facts
    """
    path, walked = _spaced(np.array(episode["leaves"][episode["gold"]]["path"], dtype=np.float64), EYE_SPACING)
    eyes = eyes_at(path, places.eye_height)
    found = {}
    for k in episode["route"]:
        names = _deciding(episode["facts"][k], episode["program"]["conditions"][k])
        if not names:
            continue
        sights = [view.seen(eyes, view.target(name), View(range=places.sight_range)) for name in names]
        # What was seen at a place stays known on the rest of the path.
        known = [np.maximum.accumulate(seen, axis=0).mean(axis=1) >= rules.object_seen for seen in sights]
        decided = np.all(known, axis=0)
        if decided.any():
            first = int(np.argmax(decided))
            found[str(k)] = {
                "at": path[first].round(3).tolist(),
                "walked": round(float(walked[first]), 2),
                "object": names[0],
            }
    return found


def pictures(
    episode: Mapping[str, Any], renderer: Renderer, centers: Mapping[str, NDArray[np.float64]]
) -> Iterator[tuple[str, bytes]]:
    """Yield a caption and a PNG for the first view and for places along the gold path, looking ahead, then for the
    places from which conditions are first decided, looking at the object that decides.

    Parameters
    ----------
    episode : a document with ``views``
    centers : by object id, metres
    """
    camera = next(camera for name, camera in cameras_of(CAMERA).items() if name.startswith("rgb"))
    path = np.array(episode["leaves"][episode["gold"]]["path"], dtype=np.float64)
    places, walked = _spaced(path, EYE_SPACING)
    for part in range(QUARTERS + 1):
        at = round(part * (len(places) - 1) / QUARTERS)
        if part == 0:
            heading, caption = -math.radians(episode["heading"]), "first view, at the start"
        else:
            ahead = places[min(at + 1, len(places) - 1)] - places[min(at, len(places) - 2)]
            heading, caption = math.atan2(-ahead[0], -ahead[2]), f"{walked[at]:.1f} m along the gold path"
        yield caption, _picture(renderer, camera, places[at], heading)
    for k, view in sorted(episode["views"].items()):
        place = np.array(view["at"], dtype=np.float64)
        ahead = centers[view["object"]] - place
        label = episode["program"]["conditions"][int(k)]["label"]
        caption = f"{view['walked']:.1f} m along the gold path, looking at the {label} of {'ABCDEFGH'[int(k)]}"
        yield caption, _picture(renderer, camera, place, math.atan2(-ahead[0], -ahead[2]))


def _picture(renderer: Renderer, camera: CameraConfig, place: F64, heading: float) -> bytes:
    seen = shaded(renderer.look(camera, place, heading), renderer.labels, camera.hfov)
    return png(np.ascontiguousarray(seen[::2, ::2]))


def _deciding(facts: Mapping[str, Any], condition: Mapping[str, Any]) -> list[str]:
    """Return the ids of the objects that must be seen to decide a condition: one witness, or all rivals if there is no
    witness, and in either case the anchors. Empty if there are neither witnesses nor rivals.
    """
    witnesses = [thing["id"] for thing in facts["things"] if thing["role"] == "witness"][:1]
    rivals = [thing["id"] for thing in facts["things"] if thing["role"] == "rival"]
    here = witnesses or rivals
    anchors = [anchor["object_id"] for anchor in (condition["qualifier"] or {}).get("anchors", ())]
    return [*here, *anchors] if here else []


def _spaced(path: F64, spacing: float) -> tuple[F64, F64]:
    """Return points (n, 3) along a path, at most `spacing` metres apart, and the metres walked to each, (n,)."""
    length = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(path, axis=0), axis=1))])
    at: F64 = np.linspace(0.0, float(length[-1]), max(1, math.ceil(length[-1] / spacing)) + 1)
    return np.column_stack([np.interp(at, length, path[:, axis]) for axis in range(3)]), at
