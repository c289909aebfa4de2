"""Read other people's episode files: text, scene, and how far each episode's path leads.

Supported: VLN-CE and RxR-VLN-CE (``episodes``), NavSpace (the same, and the ``balance_variants`` of its training set),
R2R (a list of paths with ``instructions``) and RxR (one per line). The path is taken from the reference path, else the
goal, else the actions, else the viewpoints. If a file withholds all of them, as test splits do, an episode has no path.
"""

from __future__ import annotations

import math
import os
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path, PurePosixPath
from typing import Any, Final

from condvln.formats.json_document import MAX_COORDINATE, JsonNode
from condvln.language.instruction_files import instruction_items

__all__ = ["ForeignEpisode", "read_foreign"]

_STEP: Final = 0.25
"""Length of a forward action in metres."""
_FORWARD: Final = 1


@dataclass(frozen=True, slots=True)
class ForeignEpisode:
    """One instruction text of another project's file, with the scene and how far the episode's path leads (None if
    unknown).

    displacement : horizontal metres from its start to its end; rise : height in metres of the end above the start
    """

    episode_id: str
    scene: str
    text: str
    displacement: float | None = None
    rise: float | None = None


def read_foreign(path: str | os.PathLike[str]) -> Iterator[ForeignEpisode]:
    """Yield the episodes of another project's file in order, one for each instruction text.

    Raises
    ------
    InputError : the file does not exist, or it holds no instructions
    """
    for item, texts in instruction_items(Path(path)):
        yield from _episodes(item, texts)


def _episodes(item: JsonNode, texts: list[str]) -> Iterator[ForeignEpisode]:
    value = item.object().value
    scene = str(value.get("scene_id") or value.get("scan") or value.get("scene") or "")
    name = next((str(value[key]) for key in ("episode_id", "instruction_id", "path_id") if key in value), "")
    displacement, rise = _path(value)
    base = ForeignEpisode(name, PurePosixPath(scene).name.split(".")[0], "", displacement, rise)
    if "instructions" in item:
        for number, text in enumerate(texts):
            yield replace(base, episode_id=f"{name}_{number}", text=text)
        return
    (text,) = texts
    yield replace(base, text=text)
    own = value.get("navspace")
    variants = own.get("balance_variants") if isinstance(own, dict) else None
    for one in variants if isinstance(variants, list) else ():
        if isinstance(one, dict) and isinstance(one.get("instruction_text"), str):
            walked = _walked(one.get("actions"))
            yield replace(
                base,
                episode_id=str(one.get("id", name)),
                text=one["instruction_text"],
                displacement=0.0 if walked == 0.0 else displacement,
                rise=0.0 if walked == 0.0 else rise,
            )


def _path(value: dict[str, Any]) -> tuple[float | None, float | None]:
    """Return the displacement and the rise, in metres, of the path of an episode given as JSON; each is None if it is
    unknown.
    """
    points = value.get("reference_path")
    goals = value.get("goals")
    start = value.get("start_position")
    end = points[-1] if isinstance(points, list) and points else None
    if end is None and isinstance(goals, list) and goals and isinstance(goals[0], dict):
        end = goals[0].get("position")
    if _is_point(start) and _is_point(end):
        assert start is not None
        assert end is not None
        return math.hypot(end[0] - start[0], end[2] - start[2]), end[1] - start[1]
    walked = _walked(value.get("actions") or value.get("reference_actions"))
    if walked is not None:
        return walked, None
    viewpoints = value.get("path")
    if isinstance(viewpoints, list) and viewpoints:
        if len(viewpoints) == 1 or viewpoints[0] == viewpoints[-1]:
            return 0.0, 0.0
        distance = value.get("distance")
        return float(distance) if distance is not None and _is_metres(distance) else math.inf, None
    return None, None


def _walked(actions: object) -> float | None:
    if not isinstance(actions, list) or not actions:
        return None
    return _STEP * sum(action in (_FORWARD, "forward", "MOVE_FORWARD") for action in actions)


def _is_point(value: Any) -> bool:
    return isinstance(value, list) and len(value) == 3 and all(_is_metres(x) for x in value)


def _is_metres(value: Any) -> bool:
    """Return whether a value is a number whose absolute value is at most MAX_COORDINATE. NaN, and whole numbers too
    large for a float, fail this comparison.
    """
    return isinstance(value, int | float) and not isinstance(value, bool) and abs(value) <= MAX_COORDINATE
