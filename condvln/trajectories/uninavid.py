"""The layout of Uni-NaVid and NaVid: a video of all frames up to the present one, and the next four actions."""

from __future__ import annotations

import io
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Final

import numpy as np
import orjson

from condvln.formats.streams import JsonArrayStream, atomic_stream
from condvln.navigation.follower import FORWARD, LEFT, RIGHT, STOP
from condvln.trajectories.cameras import MAIN
from condvln.trajectories.hub import SceneWalks
from condvln.trajectories.images import image_path
from condvln.trajectories.layouts import AddScene, new_folder, usable
from condvln.trajectories.videos import mp4_of_jpegs

__all__ = ["ACTIONS_AHEAD", "uninavid"]

ACTIONS_AHEAD: Final = 4
"""Actions of an answer, and frames between two samples of a walk."""
REDUCED: Final = 2
"""Factor by which the hub's images are reduced in videos; the loaders reduce them further."""
_QUALITY: Final = 85

_WORDS: Final = {STOP: "stop", FORWARD: "forward", LEFT: "left", RIGHT: "right"}
_PROMPT: Final = (
    "You are a robot that follows instructions in a building. Here are a video of historical observations and an image "
    "of the current observation <image>. Your task is: '{task}'. Give your next four actions; each is forward, left, "
    "right or stop."
)
"""Uni-NaVid finds navigation samples by the words from ``a video`` to ``current observation``."""


@contextmanager
def uninavid(folder: Path, split: str) -> Iterator[AddScene]:
    """Write Uni-NaVid's samples to ``uninavid/annotations.json``, and one video per sample to ``uninavid/nav_videos/``.

    A sample is taken at every fourth frame and at the last one. An answer has four actions, the last ones STOP at the
    end of a walk; it never reaches into a mistake.
    """
    with new_folder(folder / "uninavid") as part, atomic_stream(part / "annotations.json", closing=b"\n]\n") as stream:
        stream.write(b"[\n")
        entries = JsonArrayStream(stream)
        (part / "nav_videos").mkdir()

        def add(scene: SceneWalks) -> None:
            for row in scene.trajectories():
                frames, size = _reduced(folder, row)
                for at, answer in samples_of(row):
                    video = f"nav_videos/{row['trajectory']}_{at:03d}.mp4"
                    (part / video).write_bytes(mp4_of_jpegs(frames[: at + 1], *size))
                    entry = {
                        "id": f"NAV_ID_{row['trajectory']}_{at}",
                        "video": video,
                        "conversations": [
                            {"from": "human", "value": _PROMPT.format(task=row["instruction_text"])},
                            {"from": "gpt", "value": " ".join(answer)},
                        ],
                        "episode_id": row["episode_id"],
                        "kind": row["kind"],
                    }
                    for _ in range(row["repeats"][at]):
                        entries.entry(orjson.dumps(entry))

        yield add


def samples_of(row: dict[str, Any]) -> Iterator[tuple[int, list[str]]]:
    """Yield (frame, the next four actions as words) for each sample of a walk."""
    right = usable(row)
    count = len(right)
    words = [_WORDS[action] for action in row["actions"]] + [_WORDS[STOP]] * (ACTIONS_AHEAD - 1)
    for at in sorted({*range(0, count, ACTIONS_AHEAD), count - 1}):
        if np.all(right[at : at + ACTIONS_AHEAD]):
            yield at, words[at : at + ACTIONS_AHEAD]


def _reduced(folder: Path, row: dict[str, Any]) -> tuple[list[bytes], tuple[int, int]]:
    """Return the frames of a walk as smaller JPEG files, and their width and height."""
    from PIL import Image

    found = []
    size = (0, 0)
    for frame in range(row["n_frames"]):
        with Image.open(folder / image_path(row["frames_of"], MAIN, frame)) as image:
            size = (max(image.width // REDUCED, 1), max(image.height // REDUCED, 1))
            image.draft("RGB", size)  # decodes at the smaller size, which costs a quarter
            stream = io.BytesIO()
            small = image if image.size == size else image.resize(size, Image.Resampling.BOX)
            small.save(stream, "JPEG", quality=_QUALITY)
        found.append(stream.getvalue())
    return found, size
