"""Layouts as views of the hub: each names or links the hub's images and renders nothing.

A layout opens below the folder of the trajectories and takes one scene after the other; its folder replaces an older
one when all scenes are done.
"""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable, Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path
from typing import Any, Final, TypeAlias

import numpy as np
import orjson
from numpy.typing import NDArray

from condvln.formats.streams import JsonArrayStream, atomic_stream
from condvln.navigation.follower import FORWARD, LEFT, RIGHT, STOP
from condvln.trajectories.cameras import MAIN
from condvln.trajectories.hub import SceneWalks
from condvln.trajectories.images import image_path
from schemas.errors import StoreError

__all__ = ["AddScene", "Layout", "janusvln", "link", "merged", "navila", "navila_answer", "new_folder", "usable"]

AddScene: TypeAlias = Callable[[SceneWalks], None]
Layout: TypeAlias = Callable[[Path, str], AbstractContextManager[AddScene]]
"""Opens a layout below the folder of the trajectories, for a split."""

MOST_MERGED: Final = 3
"""Most equal actions that NaVILA joins into one answer."""
HISTORY: Final = 8
"""Most images of the past in a sample of JanusVLN."""

Row = Mapping[str, Any]
Actions = NDArray[np.int8]


def usable(row: Row) -> NDArray[np.bool_]:
    """Return for each frame of a walk whether the right action was taken, (n,) bool."""
    found: NDArray[np.bool_] = np.equal(row["actions"], row["executed"])
    return found


def merged(actions: Actions, right: NDArray[np.bool_], most: int = MOST_MERGED) -> Iterator[tuple[int, int, int]]:
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
def navila(folder: Path, split: str) -> Iterator[AddScene]:
    """Write NaVILA's samples to ``navila/annotations.json``, as JSON lines. The image paths are relative to
    ``images/``.

    A step joins up to three equal actions; its frames are all frames so far, the present one last.
    """
    with atomic_stream(folder / "navila" / "annotations.json") as stream:

        def add(scene: SceneWalks) -> None:
            for row in scene.trajectories():
                names = [_image(row, k).split("/", 1)[1] for k in range(row["n_frames"])]
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


_PROMPT: Final = (
    "You are a visual language navigation model. Follow the instruction: compare it with what you see, and choose the "
    "next action.\n Past observations:{past}\n Present observation:<image>\n Your task is to {task}\n Choose one of "
    "these actions:\n MOVE_FORWARD\n TURN_LEFT\n TURN_RIGHT\n STOP."
)
_JANUS: Final = {STOP: "STOP", FORWARD: "MOVE_FORWARD", LEFT: "TURN_LEFT", RIGHT: "TURN_RIGHT"}


@contextmanager
def janusvln(folder: Path, split: str) -> Iterator[AddScene]:
    """Write JanusVLN's samples to ``janusvln/train.json``, with image paths relative to the folder of the trajectories.
    Also link the frames of each episode into ``janusvln/trajectory_data/R2R/<split>/<episode id>/``.

    Only the frames of gold walks are linked, since folders are named by episode alone. A frame's name has the action
    and ends in ``.png``, which JanusVLN's script looks for; the content is the hub's JPEG.
    """
    target = folder / "janusvln"
    with new_folder(target) as part, atomic_stream(part / "train.json", closing=b"\n]\n") as stream:
        stream.write(b"[\n")
        samples = JsonArrayStream(stream)

        def add(scene: SceneWalks) -> None:
            for row in scene.trajectories():
                right = usable(row)
                for at, action in enumerate(row["actions"]):
                    past = range(at + 1) if at <= HISTORY else np.linspace(0, at, HISTORY + 1, dtype=int).tolist()
                    images = [_image(row, k) for k in past]
                    prompt = _PROMPT.format(past="<image>" * (len(images) - 1), task=row["instruction_text"])
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
                if row["kind"] == "gold":
                    frames = part / "trajectory_data" / "R2R" / split / str(row["episode_id"])
                    frames.mkdir(parents=True)
                    for at, action in enumerate(row["actions"]):
                        link(folder / _image(row, at), frames / f"rgb_{at:04d}_{_JANUS[action].lower()}.png")

        yield add


def _image(row: Row, frame: int) -> str:
    return image_path(row["frames_of"], MAIN, frame)


def link(source: Path, target: Path) -> None:
    """Make `target` a hard link to `source`, or a copy if the file system has no hard links.

    Raises
    ------
    StoreError : an image is missing, or there is one of that name
    """
    try:
        os.link(source, target)
    except (FileNotFoundError, FileExistsError) as error:
        raise StoreError(
            f"can't be linked: {error.strerror}", where=source, remedy="Run again; missing images are made again."
        ) from error
    except OSError:
        shutil.copyfile(source, target)


@contextmanager
def new_folder(target: Path) -> Iterator[Path]:
    """Yield a new empty folder, which replaces `target` at the end of the block if the block succeeds."""
    part = target.with_name(f".{target.name}.part")
    shutil.rmtree(part, ignore_errors=True)
    part.mkdir(parents=True)
    try:
        yield part
        if target.exists():
            shutil.rmtree(target)
        os.rename(part, target)
    finally:
        shutil.rmtree(part, ignore_errors=True)
