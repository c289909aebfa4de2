"""The request of a run of ``condvln trajectories``, and the check that the run may write to the output folder."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

from condvln.trajectories.cameras import Sweep
from condvln.trajectories.recipe import RECORD
from jobs.assignments import read_section
from schemas.config import TrajectoryConfig
from schemas.errors import UsageError

__all__ = ["STATE", "Request", "refuse_links", "refuse_strangers", "trajectory_config"]

STATE: Final = ".condvln"
"""Store of the run below the folder: what is committed, and who wrote which images."""


@dataclass(frozen=True)
class Request:
    """What is asked of a run.

    target : a configuration or an export; overrides, scenes, roots : as `find_target` takes them
    licensed : the user has accepted the terms of scenes whose images may not be passed on
    recipe_only : render and hash the images, and do not write them
    recipe : folder of a recipe, whose walks and images are made again; `target` is empty then, and the split, cameras
        and configuration are those of the recipe
    """

    target: str
    out: Path
    split: str = "train"
    layouts: tuple[str, ...] = ("streamvln",)
    camera: str = "streamvln"
    sweep: Sweep | None = None
    config: TrajectoryConfig = field(default_factory=TrajectoryConfig)
    scenes: tuple[str, ...] = ()
    roots: tuple[Path, ...] = ()
    overrides: tuple[str, ...] = ()
    workers: int | None = None
    inline: bool = False
    plan: bool = False
    retry: bool = False
    licensed: bool = False
    recipe_only: bool = False
    recipe: Path | None = None


def trajectory_config(walks: Sequence[str], keys: Sequence[str]) -> TrajectoryConfig:
    """Return the configuration of walks with some keys set.

    walks : kinds of walks; the default if empty
    keys : ``jpeg_quality=80`` and the like

    Raises
    ------
    UsageError : a text is not of the form ``key=value``, an unknown key, or a value that is not allowed
    """
    given = {"walks": list(walks)} if walks else {}
    return read_section(TrajectoryConfig, keys, option="--walk", example="jpeg_quality=80", given=given)


def refuse_strangers(folder: Path) -> None:
    """Refuse a folder with files that this command did not write."""
    if folder.exists() and not folder.is_dir():
        raise UsageError("this is a file", where=folder, place="--out", remedy="Name a folder.")
    if folder.is_dir() and any(folder.iterdir()) and not (folder / STATE).is_dir() and not (folder / RECORD).is_file():
        raise UsageError(
            "the folder holds files that condvln trajectories did not write",
            where=folder,
            place="--out",
            remedy="Name an empty folder.",
        )


def refuse_links(folder: Path, names: Iterable[str]) -> None:
    """Refuse a folder of which one of `names` is a link: a run replaces and removes what is in them, and must not do so
    elsewhere.
    """
    for path in (folder / name for name in names):
        if path.is_symlink():
            raise UsageError(
                "this is a link, and what a run replaces or removes would lie outside of its folder",
                where=path,
                place="--out",
                remedy="Name the folder on the other disk by --out, or let the whole folder be a link.",
            )
