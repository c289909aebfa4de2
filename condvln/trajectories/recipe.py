"""Recipes of trajectories: their walks, poses, cameras and hashes, from which the images can be made again.

Every folder of trajectories holds its recipe. A recipe may come from somebody else, so everything in it is checked
before it is used. Whose images may be passed on is a matter of the datasets' terms, which a folder's README states.
"""

from __future__ import annotations

import re
from collections import Counter, defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from functools import cached_property
from pathlib import Path
from string import Template
from typing import Annotated, Any, Final, NamedTuple

import numpy as np
import orjson
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq
from pydantic import BaseModel, ConfigDict, Field

from condvln.formats.parquet_rows import refuse_parquet_bombs
from condvln.formats.regular_file import read_regular
from condvln.own_tables import own_text
from condvln.sources.family import FAMILIES
from condvln.trajectories.cameras import MAIN
from condvln.trajectories.images import image_path
from schemas.base import first_fault
from schemas.config import CameraConfig, TrajectoryConfig
from schemas.errors import FormatError, MissingFileError, UsageError
from schemas.tables import STEPS, TRAJECTORY_TABLES

__all__ = [
    "RECIPE_FILES",
    "RECORD",
    "Recipe",
    "RecipeRecord",
    "RecipeScene",
    "licences",
    "read_me",
    "refuse_unlicensed",
]

RECORD: Final = "trajectories.json"
"""The folder's own record: layouts, cameras, configuration, counts and versions. It is written last."""

RECIPE_FILES: Final = ("README.md", "left_out.parquet", "poses.parquet", RECORD, "trajectories.parquet")
"""Files of a folder of trajectories that hold nothing of the scenes' images."""

_REMEDY: Final = "Ask for the recipe again."
_NAME: Final = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,199}")
SplitText = Annotated[str, Field(pattern=r"^[a-z_]{1,20}$")]
CameraName = Annotated[str, Field(pattern=r"^(rgb|depth)(\.[A-Za-z0-9_.-]{1,60})?$")]


class RecipeRecord(BaseModel):
    """What ``trajectories.json`` says of how images are made.

    scene_files : hash over the source files of each scene, by ``<family>/<scene>``
    encoders : what wrote the images, with its version, by suffix
    decoders : what read the textures, with its version, by their kinds
    """

    model_config = ConfigDict(extra="ignore", frozen=True)

    split: SplitText
    layouts: tuple[str, ...]
    cameras: dict[CameraName, CameraConfig]
    config: TrajectoryConfig
    export_snapshot: str
    scene_files: dict[str, str]
    libraries: dict[str, str]
    encoders: dict[str, str]
    decoders: dict[str, str]


class RecipeScene(NamedTuple):
    """The size of one scene of a recipe.

    frames : of the walks that have images of their own; poses : distinct ones among them, each rendered once
    told : frames of all walks; squared : the sum of their squared numbers of frames
    """

    episodes: int
    frames: int
    poses: int
    told: int
    squared: int


class Recipe:
    """A recipe on disk.

    Parameters
    ----------
    folder : a folder of trajectories, with or without images

    Raises
    ------
    MissingFileError, FormatError : the folder holds no recipe, or its record is damaged
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        path = folder / RECORD
        try:
            self.record = RecipeRecord.model_validate(orjson.loads(read_regular(path)))
        except FileNotFoundError:
            raise MissingFileError("the folder holds no recipe", where=folder, remedy=_REMEDY) from None
        except (OSError, ValueError) as error:
            raise FormatError(
                f"not a record of trajectories ({first_fault(error)})", where=path, remedy=_REMEDY
            ) from None
        if MAIN not in self.record.cameras:
            raise FormatError(f"the camera {MAIN!r} is missing", where=path, place="cameras", remedy=_REMEDY)

    @cached_property
    def scenes(self) -> dict[tuple[str, str], RecipeScene]:
        """The scenes of the recipe by (family, id), each with its size.

        Raises
        ------
        MissingFileError, FormatError : a table is missing or damaged
        """
        found: defaultdict[tuple[str, str], Counter[str]] = defaultdict(Counter)
        episodes: defaultdict[tuple[str, str], set[int]] = defaultdict(set)
        for row in self._read("left_out", columns=["source", "scene_id"]).to_pylist():
            found[row["source"], row["scene_id"]].update()
        poses = self._read("poses", columns=["source", "scene_id", "position", "heading"]).flatten()
        for row in poses.group_by(poses.column_names).aggregate([]).to_pylist():
            found[row["source"], row["scene_id"]]["poses"] += 1
        columns = ["source", "scene_id", "episode_id", "trajectory", "frames_of", "n_frames"]
        for row in self._read("trajectories", columns=columns).to_pylist():
            scene = row["source"], row["scene_id"]
            episodes[scene].add(row["episode_id"])
            count = row["n_frames"]
            own = count if row["frames_of"] == row["trajectory"] else 0
            found[scene].update(frames=own, told=count, squared=count**2)
        return {
            scene: RecipeScene(len(episodes[scene]), sums["frames"], sums["poses"], sums["told"], sums["squared"])
            for scene, sums in found.items()
        }

    def tables(self, family: str, scene_id: str) -> dict[str, pa.Table]:
        """Return the tables ``trajectories``, ``steps`` and ``left_out`` of one scene.

        Raises
        ------
        FormatError : rows contradict each other, or a name is not that of a walk or an image
        """
        found = {name: self._scene(name, family, scene_id) for name in TRAJECTORY_TABLES}
        poses = found.pop("poses")
        for fault in self._faults(found["trajectories"].to_pylist(), poses):
            raise FormatError(fault, where=self.folder, place=f"{family}/{scene_id}", remedy=_REMEDY)
        main = poses.filter(pc.equal(poses["camera"], MAIN)).select(STEPS.names)
        found["steps"] = main.sort_by([("trajectory", "ascending"), ("frame", "ascending")]).cast(STEPS)
        return found

    def hashes(self, family: str, scene_id: str) -> dict[str, str]:
        """Return the SHA-256 of each image of a scene, by path."""
        of_scene = [("source", "=", family), ("scene_id", "=", scene_id)]
        poses = self._read("poses", columns=["image", "sha256"], filters=of_scene)
        return dict(zip(poses["image"].to_pylist(), poses["sha256"].to_pylist(), strict=True))

    def _faults(self, walks: list[dict[str, Any]], poses: pa.Table) -> Iterator[str]:
        """Yield what is wrong with the rows of a scene."""
        rows: dict[str, list[dict[str, Any]]] = {}
        columns = ["trajectory", "episode_id", "frame", "camera", "image", "action", "executed", "position", "heading"]
        for pose in poses.select(columns).to_pylist():
            rows.setdefault(pose["trajectory"], []).append(pose)
        own = {walk["trajectory"]: walk for walk in walks if walk["frames_of"] == walk["trajectory"]}
        if len({walk["trajectory"] for walk in walks}) != len(walks) or rows.keys() != own.keys():
            yield "trajectories.parquet and poses.parquet have different walks"
            return
        for walk in walks:
            name = walk["trajectory"]
            if not _NAME.fullmatch(name):
                yield f"{name!r} is not the name of a walk"
            elif walk["frames_of"] not in own:
                yield f"{name}: the images of {walk['frames_of']!r} are not there"
            elif any(len(walk[key]) != walk["n_frames"] for key in ("actions", "executed", "repeats")):
                yield f"{name}: actions, repeats and frames differ in number"
        for name, walk in own.items():
            yield from self._walk_faults(name, walk, rows[name])

    def _walk_faults(self, name: str, walk: Mapping[str, Any], rows: list[dict[str, Any]]) -> Iterator[str]:
        count = walk["n_frames"]
        wanted = {(frame, camera) for frame in range(count) for camera in self.record.cameras}
        if len(rows) != len(wanted) or {(row["frame"], row["camera"]) for row in rows} != wanted:
            yield f"{name}: a frame has no pose, or more than one"
            return
        places: dict[int, tuple[Any, ...]] = {}
        for row in rows:
            frame = row["frame"]
            pose = (*row["position"].values(), row["heading"])
            if row["image"] != image_path(name, row["camera"], frame):
                yield f"{name}: {row['image']!r} is not the path of frame {frame}"
            if (row["action"], row["executed"]) != (walk["actions"][frame], walk["executed"][frame]):
                yield f"{name}: frame {frame} has another action than the walk"
            if places.setdefault(frame, pose) != pose or not np.isfinite(np.array(pose, np.float64)).all():
                yield f"{name}: the cameras of frame {frame} have different poses, or none"

    def _scene(self, name: str, family: str, scene_id: str) -> pa.Table:
        table = self._read(name, filters=[("source", "=", family), ("scene_id", "=", scene_id)])
        return table.drop_columns(["source"])

    def _read(self, name: str, **options: Any) -> pa.Table:
        path = self.folder / f"{name}.parquet"
        schema = TRAJECTORY_TABLES[name].append(pa.field("source", pa.string(), nullable=False))
        try:
            refuse_parquet_bombs(path)
            table = pq.read_table(path, **options)
            wanted = pa.schema([schema.field(column) for column in options.get("columns", schema.names)])
            table = table.select(wanted.names).cast(wanted)
            table.validate(full=True)
        except FileNotFoundError:
            raise MissingFileError(f"{name}.parquet is missing", where=self.folder, remedy=_REMEDY) from None
        except (pa.ArrowException, OSError, KeyError, ValueError) as error:
            raise FormatError(f"not a table of trajectories ({error})", where=path, remedy=_REMEDY) from None
        empty = [field.name for field in wanted if not field.nullable and table[field.name].null_count]
        if empty:
            raise FormatError("a value is missing", where=path, place=empty[0], remedy=_REMEDY)
        return table


def licences(families: Iterable[str]) -> dict[str, dict[str, Any]]:
    """Return the name, terms and credit of each family, and whether its images may be passed on, by family."""
    return {
        name: {
            "name": FAMILIES[name].name,
            "terms": FAMILIES[name].terms,
            "credit": FAMILIES[name].credit,
            "images_may_be_shared": not FAMILIES[name].licensed,
        }
        for name in sorted(set(families) & FAMILIES.keys())
    }


def refuse_unlicensed(families: Iterable[str]) -> None:
    """Refuse to make images of scenes if the terms of their family do not allow images to be passed on.

    Raises
    ------
    UsageError : there is such a family
    """
    closed = [FAMILIES[name].name for name in sorted(set(families) & FAMILIES.keys()) if FAMILIES[name].licensed]
    if closed:
        raise UsageError(
            f"the terms of {' and '.join(closed)} forbid to pass on images of the scenes",
            place="--licensed",
            remedy="Add --licensed if you have accepted these terms and keep the images to yourself; or add "
            "--recipe-only to write what may be shared: actions, poses, cameras and hashes, without images.",
        )


def read_me(split: str, terms: Mapping[str, Mapping[str, Any]], files: Sequence[str], *, images: bool) -> str:
    """Return the text of the folder's ``README.md``.

    terms : by family, as `licences` returns them
    files : files of the recipe
    images : whether the folder has images
    """
    closed = [row["name"] for row in terms.values() if not row["images_may_be_shared"]]
    rows = [
        f"| {row['name']} | {row['terms']} | "
        f"{'yes, under these terms' if row['images_may_be_shared'] else 'no'} | {row['credit']} |\n"
        for row in terms.values()
    ]
    recipe = ", ".join(f"`{name}`" for name in files)
    said = f"The recipe is in `recipe/`: {recipe}."
    if not images:
        said = "This folder is a recipe: it has no images."
    elif closed:
        said = (
            f"**Do not pass on the images of {' and '.join(closed)}**, nor files made from them. What may be shared is "
            f"the recipe: {recipe}, also in `recipe/`."
        )
    text = own_text("condvln.trajectories", "readme.md")
    return Template(text).substitute(split=split, terms="".join(rows), said=said)
