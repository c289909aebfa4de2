"""What all layouts share: the sizes of the agents' actions, and how a layout's folder is written.

The words and numbers of a layout have no sizes of their own, so walks must be made of the agent's own actions: metres
of a step forward, degrees of a turn. Two layouts whose sizes differ can't share walks.
"""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from condvln.navigation.follower import VLN_CE, ActionSpace
from condvln.trajectories.cameras import MAIN
from condvln.trajectories.images import image_path
from schemas.base import Row
from schemas.config import TrajectoryConfig
from schemas.errors import StoreError, UsageError

__all__ = ["HUBS", "MEANINGS", "link", "main_image", "new_folder", "sized", "usable", "with_hub"]


_FIFTEEN: Final = ActionSpace(forward=0.25, turn=15.0)
_THIRTY: Final = ActionSpace(forward=0.25, turn=30.0)

MEANINGS: Final[Mapping[str, ActionSpace]] = {
    # InternRobotics/StreamVLN: config/vln_r2r.yaml, and the prompt of streamvln/streamvln_eval.py
    "streamvln": _FIFTEEN,
    # TidalHarley/NavSpace: snav_training/data_generation/render_streamvln.py
    "snav": _THIRTY,
    # AnjieCheng/NaVILA: evaluation/vlnce_baselines/navila_trainer.py divides by 25 cm and 15 degrees
    "navila": _FIFTEEN,
    # jzhzhang/NaVid-VLN-CE, where Uni-NaVid is evaluated: VLN_CE/habitat_extensions/config/vlnce_task_navid_r2r.yaml;
    # jzhzhang/Uni-NaVid: offline_eval_uninavid.py turns by 30 degrees a word
    "uninavid": _THIRTY,
    # MIV-XJTU/JanusVLN: config/vln_r2r.yaml
    "janusvln": _FIFTEEN,
    # InternRobotics/InternNav: scripts/eval/configs/vln_r2r.yaml; habitat_vln_evaluator.py looks down twice
    "internvla-n1": _FIFTEEN,
}
"""Step forward in metres and turn in degrees that an agent's actions mean, by layout. The layout ``lerobot`` says
itself what its actions mean.
"""

HUBS: Final = ("streamvln", "snav")
"""Layouts that are the hub's own files, ``annotations.json`` and ``images/``; they differ in the sizes of actions."""


def sized(config: TrajectoryConfig, layouts: Sequence[str]) -> TrajectoryConfig:
    """Return the configuration with the sizes of actions that the layouts mean; its own sizes are for layouts that mean
    none.

    Raises
    ------
    UsageError : two layouts mean different sizes, or the configuration sets others than a layout means; looking walks
        are not made of these sizes
    """
    meant = {name: MEANINGS[name] for name in layouts if name in MEANINGS}
    if not meant:
        return config
    first, space = next(iter(meant.items()))
    for name, other in meant.items():
        if other != space:
            raise UsageError(
                f"{first} means {_said(space)}, and {name} means {_said(other)}: one walk can't have both",
                place="--layout",
                remedy="Make each in a folder of its own.",
            )
    for key, size in (("forward", space.forward), ("turn", space.turn)):
        if key in config.model_fields_set and getattr(config, key) != size:
            raise UsageError(
                f"{first} means {_said(space)}: its words would mean other walks than those of "
                f"{key}={getattr(config, key):g}",
                place=f"--walk {key}",
                remedy=f"Leave it out, or choose another layout than {first}.",
            )
    if "looking" in config.walks and space != VLN_CE:
        raise UsageError(
            f"{first} means {_said(space)}, and looking walks are made of {_said(VLN_CE)}",
            place="--walks",
            remedy="Name other kinds of walks, such as --walks direct.",
        )
    return config.model_copy(update={"forward": space.forward, "turn": space.turn})


def with_hub(layouts: Sequence[str], config: TrajectoryConfig) -> tuple[str, ...]:
    """Return the layouts with ``streamvln``, whose files cost nothing, where the walks are made of its actions."""
    space = ActionSpace(forward=config.forward, turn=config.turn)
    named = tuple(dict.fromkeys(layouts))
    if set(named) & set(HUBS) or space != MEANINGS["streamvln"]:
        return named
    return ("streamvln", *named)


def _said(space: ActionSpace) -> str:
    return f"steps of {space.forward:g} m and turns of {space.turn:g}°"


def usable(row: Row) -> NDArray[np.bool_]:
    """Return for each frame of a walk whether the right action was taken, (n,) bool."""
    found: NDArray[np.bool_] = np.equal(row["actions"], row["executed"])
    return found


def main_image(row: Row, frame: int) -> str:
    """Return the path of the main camera's image of a frame, relative to the folder of the trajectories."""
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
