"""The layout of JanusVLN: a conversation for each frame, with images of the past."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Final

import numpy as np
import orjson

from condvln.navigation.follower import FORWARD, LEFT, RIGHT, STOP
from condvln.trajectories.hub import AddScene, Hub, SceneWalks, json_array
from condvln.trajectories.layouts import link, main_image, new_folder, usable

__all__ = ["janusvln"]

HISTORY: Final = 8
"""Most images of the past in a sample."""

_PROMPT: Final = (
    "You are a visual language navigation model, and your should go to the locations to complete the given task. "
    "Compare the observation and instruction to infer your current progress, and then select the correct direction "
    "from the candidates to go to the target location and finish the task.\n {images}These images are your historical "
    "observations and your current observation.\n Your task is to {task} \n You should take one of the following "
    "actions:\n MOVE_FORWARD\n TURN_LEFT\n TURN_RIGHT\n STOP."
)
"""The words that JanusVLN sends when it is evaluated (MIV-XJTU/JanusVLN, ``call_model`` in ``src/evaluation.py``): the
system's turn, the images, the user's text. They are one turn here, since its loader for training has a fixed system's
turn and takes none from a file.
"""
_JANUS: Final = {STOP: "STOP", FORWARD: "MOVE_FORWARD", LEFT: "TURN_LEFT", RIGHT: "TURN_RIGHT"}


@contextmanager
def janusvln(hub: Hub) -> Iterator[AddScene]:
    """Write JanusVLN's samples to ``janusvln/train.json``, with image paths relative to the folder of the trajectories.
    Also link the frames of each episode into ``janusvln/trajectory_data/R2R/<split>/<episode id>/``.

    Folders are named by episode alone: the frames of its looking walk are linked, else those of its direct walk. A
    frame's name has the action and ends in ``.png``, which JanusVLN's script looks for; the content is the hub's JPEG.
    """
    with new_folder(hub.folder / "janusvln") as part, json_array(part / "train.json") as samples:

        def add(scene: SceneWalks) -> None:
            for row in scene.trajectories():
                right = usable(row)
                for at, action in enumerate(row["actions"]):
                    past = range(at + 1) if at <= HISTORY else np.linspace(0, at, HISTORY + 1, dtype=int).tolist()
                    images = [main_image(row, k) for k in past]
                    prompt = _PROMPT.format(images="<image>" * len(images), task=row["instruction_text"])
                    sample = {
                        "id": f"{row['episode_id']}/{row['trajectory']}/{at}",
                        "conversations": [
                            {"from": "human", "value": prompt},
                            {"from": "gpt", "value": _JANUS[action]},
                        ],
                        "images": images,
                    }
                    for _ in range(row["repeats"][at] if right[at] else 0):
                        samples.entry(orjson.dumps(sample))
                frames = part / "trajectory_data" / "R2R" / hub.split / str(row["episode_id"])
                if row["kind"] in ("looking", "direct") and not frames.exists():
                    frames.mkdir(parents=True)
                    for at, action in enumerate(row["actions"]):
                        link(hub.folder / main_image(row, at), frames / f"rgb_{at:04d}_{_JANUS[action].lower()}.png")

        yield add
