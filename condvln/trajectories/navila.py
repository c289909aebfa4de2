"""The layout of NaVILA: JSON lines, each a step of up to three equal actions."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Final

import numpy as np
import orjson
from numpy.typing import NDArray

from condvln.formats.streams import atomic_stream
from condvln.navigation.follower import FORWARD, LEFT, STOP
from condvln.trajectories.hub import AddScene, Hub, SceneWalks
from condvln.trajectories.layouts import main_image, usable

__all__ = ["merged", "navila", "navila_answer"]

MOST_MERGED: Final = 3
"""Most equal actions that NaVILA joins into one answer."""


def merged(
    actions: NDArray[np.int8], right: NDArray[np.bool_], most: int = MOST_MERGED
) -> Iterator[tuple[int, int, int]]:
    """Yield (first frame, action, number of actions) for each run of at most `most` equal actions; STOP is always
    alone.

    A run has no frame of a mistake: what follows a mistake is not what the frames before it lead to.
    """
    at = 0
    while at < len(actions):
        end = at + 1
        if right[at]:
            while end < len(actions) and end - at < most and right[end] and actions[end] == actions[at] != STOP:
                end += 1
            yield at, int(actions[at]), end - at
        at = end


def navila_answer(action: int, count: int) -> str:
    """Return NaVILA's answer sentence for `count` equal actions, at most three."""
    if action == STOP:
        return "The next action is stop."
    if action == FORWARD:
        return f"The next action is move forward {25 * count} cm."
    return f"The next action is turn {'left' if action == LEFT else 'right'} {15 * count} degrees."


@contextmanager
def navila(hub: Hub) -> Iterator[AddScene]:
    """Write NaVILA's samples to ``navila/annotations.json``, as JSON lines. The image paths are relative to
    ``images/``.

    A step joins up to three equal actions; its frames are all frames so far, the present one last.
    """
    with atomic_stream(hub.folder / "navila" / "annotations.json") as stream:

        def add(scene: SceneWalks) -> None:
            for row in scene.trajectories():
                names = [main_image(row, k).split("/", 1)[1] for k in range(row["n_frames"])]
                actions = np.array(row["actions"], np.int8)
                for at, action, count in merged(actions, usable(row)):
                    entry = {
                        "video_id": f"{row['trajectory']}_{at}",
                        "q": row["instruction_text"],
                        "a": navila_answer(action, count),
                        "frames": names[: at + 1],
                        "episode_id": row["episode_id"],
                        "kind": row["kind"],
                    }
                    for _ in range(row["repeats"][at]):
                        stream.write(orjson.dumps(entry) + b"\n")

        yield add
