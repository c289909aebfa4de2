"""Render the frames of a scene's walks and write them as files: JPEG for colours, PNG with 16 bits for depth.

With the depth images come the pixel goals, on which InternVLA-N1 is trained: the pixel at which a frame shows the
farthest later position of the walk that the camera sees.
"""

from __future__ import annotations

import hashlib
import os
import re
import shutil
from bisect import bisect_right
from collections.abc import Container, Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from condvln.arrays import F64
from condvln.formats.image_files import jpeg, png16
from condvln.sensors import Frame, Renderer
from condvln.sensors.camera import camera_pose, half_extents
from condvln.trajectories.cameras import Cameras, intrinsics, is_depth
from schemas.config import CameraConfig, TrajectoryConfig
from schemas.errors import StoreError
from schemas.tables import POSES, STEPS

__all__ = [
    "IMAGES",
    "ImageWriter",
    "PixelGoal",
    "clear_parts",
    "clear_walks",
    "image_path",
    "mistake_after",
    "pixel_goal",
    "writing",
]


IMAGES: Final = "images"
"""Folder of all images below the folder of the trajectories."""

_PART: Final = ".part-"
_PART_NAME: Final = re.compile(re.escape(_PART) + r"\d+-.")
"""Beginning of the name of an unfinished folder: the process that writes it, and the walk."""


def image_path(trajectory: str, camera: str, frame: int) -> str:
    """Return the path of an image relative to the folder of the trajectories. As in StreamVLN, file names count from
    001; `frame` counts from 0.
    """
    return f"{IMAGES}/{trajectory}/{camera}/{frame + 1:03d}.{'png' if is_depth(camera) else 'jpg'}"


@contextmanager
def writing(path: Path) -> Iterator[None]:
    """Turn the refusals of a file system inside the block into errors of the project. pyarrow's name no file.

    Raises
    ------
    StoreError : `path` can't be written
    """
    try:
        yield
    except OSError as error:
        raise StoreError(
            f"can't be written: {error.strerror or error}",
            where=path,
            remedy="Free some space and run again; finished scenes stay.",
        ) from error


class ImageWriter:
    """Writes the images of walks below a folder. A walk's own folder appears only when it is complete.

    Parameters
    ----------
    folder : the folder of the trajectories
    keep : write the images; otherwise they are only rendered and hashed

    Attributes
    ----------
    size : bytes of the distinct images so far
    """

    def __init__(
        self, folder: Path, renderer: Renderer, cameras: Cameras, config: TrajectoryConfig, *, keep: bool = True
    ) -> None:
        self._folder, self._renderer, self._cameras, self._config = folder, renderer, dict(cameras), config
        self._keep = keep
        self.size = 0
        self._views: dict[CameraConfig, list[str]] = {}
        for name, camera in self._cameras.items():
            self._views.setdefault(camera, []).append(name)

    def write(self, steps: pa.Table) -> pa.Table:
        """Write the images of all walks of a scene; return the rows of ``poses``.

        Walks of one scene share many poses: variants of an instruction have one start, and a recovery walk follows the
        gold one until its mistake. Each pose is rendered, encoded, hashed and written once; equal images are hard links
        to the first file.

        Raises
        ------
        StoreError : the folder refuses
        """
        names = steps["trajectory"].to_pylist()
        if not names:
            return POSES.empty_table()
        starts = [0, *(at for at in range(1, len(names)) if names[at] != names[at - 1]), len(names)]
        images = self._folder / IMAGES
        parts = {names[at]: images / f"{_PART}{os.getpid()}-{names[at]}" for at in starts[:-1]}
        try:
            with writing(images):
                for part in parts.values() if self._keep else ():
                    for camera in self._cameras:
                        (part / camera).mkdir(parents=True, exist_ok=True)
                found = self._images(steps, starts, [parts[names[at]] for at in starts[:-1]])
                for name, part in parts.items() if self._keep else ():
                    _replace(part, images / name)
        finally:
            for part in parts.values():
                shutil.rmtree(part, ignore_errors=True)
        return self._rows(steps, found)

    def _images(self, steps: pa.Table, starts: list[int], parts: list[Path]) -> dict[str, list[Any]]:
        """Write the images into the folders of their walks; return the columns of their rows, frame by frame, all
        cameras of a frame together.

        starts : (w + 1,) the first row of `steps` of each walk, and the end; parts : (w,) the walks' folders
        """
        names = [name for view in self._views.values() for name in view]
        # Lists of plain values: a dictionary for each image makes Python's garbage collector walk the whole scene.
        found: dict[str, list[Any]] = {key: [None] * (len(names) * starts[-1]) for key in _IMAGE}
        places, headings = _columns(steps["position"]), np.asarray(steps["heading"])
        right = np.asarray(steps["action"]) == np.asarray(steps["executed"])
        walks = steps["trajectory"].to_pylist()
        files: dict[str, Path] = {}  # the first file of each hash
        for rows in _of_one_pose(places, headings):
            place, heading = places[rows[0]], float(headings[rows[0]])
            of = [bisect_right(starts, row) - 1 for row in rows]
            for number, (camera, data, seen) in enumerate(self.draw(place, heading)):
                hashed = hashlib.sha256(data).hexdigest()
                for row, walk in zip(rows, of, strict=True):
                    start = starts[walk]
                    path = image_path(walks[row], camera, row - start)
                    file = parts[walk] / camera / path.rpartition("/")[2]
                    first = files.setdefault(hashed, file)
                    self.size += len(data) if first is file else 0
                    if self._keep:
                        _put(file, data, first)
                    goal = None
                    if seen is not None:
                        ahead = places[row + 1 : start + mistake_after(right[start : starts[walk + 1]], row - start)]
                        goal = pixel_goal(self._cameras[camera], place, heading, ahead, seen, self._config.goal_slack)
                    at = row * len(names) + number
                    found["camera"][at] = camera
                    found["image"][at] = path
                    found["goal"][at] = None if goal is None else [goal.column, goal.row]
                    found["goal_frame"][at] = None if goal is None else goal.frames
                    found["bytes"][at] = len(data)
                    found["sha256"][at] = hashed
        return found

    def draw(
        self, place: NDArray[np.float64], heading: float
    ) -> Iterator[tuple[str, bytes, NDArray[np.float32] | None]]:
        """Yield for each camera: its name, the bytes of its image file, and the depth (h, w) in metres, None for a
        colour camera. Cameras that differ only in modality are rendered once.
        """
        for view, names in self._views.items():
            depths = [is_depth(name) for name in names]
            frame: Frame = self._renderer.look(
                view, place, heading, rgb=not all(depths), depth=any(depths), objects=False
            )
            for name in names:
                if is_depth(name):
                    yield name, png16(frame.depth, self._config.png_level), frame.depth
                else:
                    yield name, jpeg(frame.rgb, self._config.jpeg_quality), None

    def _rows(self, steps: pa.Table, found: Mapping[str, list[Any]]) -> pa.Table:
        repeated = steps.take(pa.array(np.arange(steps.num_rows).repeat(len(self._cameras))))
        cameras = [self._cameras[name] for name in found["camera"]]
        columns: dict[str, Any] = {name: repeated[name] for name in STEPS.names}
        columns |= {key: found[key] for key in _IMAGE}
        columns |= {key: [getattr(camera, key) for camera in cameras] for key in _CAMERA}
        seen = {name: intrinsics(camera) for name, camera in self._cameras.items()}
        columns["intrinsics"] = [seen[name] for name in found["camera"]]
        return pa.table({name: columns[name] for name in POSES.names}, schema=POSES)


_IMAGE: Final = ("camera", "image", "goal", "goal_frame", "bytes", "sha256")
_CAMERA: Final = ("width", "height", "hfov", "eye_height", "look_down")


def _of_one_pose(places: NDArray[np.float64], headings: NDArray[np.float64]) -> Iterator[list[int]]:
    """Yield for each distinct pose the rows that have it, in the order of their first rows."""
    found: dict[bytes, list[int]] = {}
    for row, pose in enumerate(np.column_stack([places, headings])):
        found.setdefault(pose.tobytes(), []).append(row)
    return iter(found.values())


def _columns(points: pa.ChunkedArray) -> NDArray[np.float64]:
    whole = points.combine_chunks()
    return np.stack([np.asarray(whole.field(axis)) for axis in "xyz"], axis=1)


def _put(path: Path, data: bytes, first: Path) -> None:
    """Write a file, or make it a hard link to the file `first` that holds the same data. Where the file system has no
    links, or no more for this file, all files are written.
    """
    if first != path:
        with suppress(OSError):
            os.link(first, path)
            return
    path.write_bytes(data)


def _replace(part: Path, target: Path) -> None:
    """Move the finished folder `part` to `target`, in place of an older folder if there is one."""
    if target.is_symlink() or target.exists():
        _remove(target)
    os.rename(part, target)


def _remove(path: Path) -> None:
    """Remove a folder with its files, or a link to a folder, whose target stays."""
    if path.is_symlink():
        path.unlink()
    else:
        shutil.rmtree(path)


def clear_parts(folder: Path, names: Iterable[str]) -> None:
    """Remove the unfinished image folders, layouts and files that killed writers left behind. Links are not followed,
    and other files stay.

    names : paths of what is written, relative to the folder; what is unfinished is beside it, as ``.<name>.part``
    """
    images = folder / IMAGES
    parts = [] if images.is_symlink() else [path for path in images.glob(f"{_PART}*") if _PART_NAME.match(path.name)]
    for path in (folder / name for name in names):
        if path.parent == folder or not path.parent.is_symlink():
            parts.append(path.with_name(f".{path.name}.part"))
    for left in parts:
        if left.is_dir() and not left.is_symlink():
            shutil.rmtree(left, ignore_errors=True)
        else:
            left.unlink(missing_ok=True)


def clear_walks(folder: Path, kept: Container[str]) -> None:
    """Remove the image folders of all walks whose names are not in `kept`. Links are removed, and what they lead to
    stays.
    """
    images = folder / IMAGES
    for path in [] if images.is_symlink() else list(images.glob("*")):
        if path.is_dir() and path.name not in kept:
            _remove(path)


class PixelGoal(NamedTuple):
    """A pixel goal: the column and row of a place in the image, and the number of frames until the walk reaches the
    place.
    """

    column: int
    row: int
    frames: int


def mistake_after(right: NDArray[np.bool_], frame: int) -> int:
    """Return the end (exclusive) of the frames whose places may be the pixel goal at `frame`. The last of these frames
    is the one at which the next mistake begins, or the last of the walk.

    right : (n,) whether the right action was taken at each frame. In a mistake, no place may be a goal.
    """
    if not right[frame]:
        return frame + 1
    wrong = np.flatnonzero(~right[frame:])
    # The place of the first wrong frame is still on the right way.
    return frame + int(wrong[0]) + 1 if len(wrong) else len(right)


def pixel_goal(
    camera: CameraConfig,
    place: F64,
    heading: float,
    ahead: F64,
    depth: NDArray[np.float32],
    slack: float,
) -> PixelGoal | None:
    """Return the pixel at which the camera sees the last visible place of `ahead`, and the number of frames until the
    agent is there; None if no such place is visible.

    Parameters
    ----------
    place, heading : pose of the agent: feet (3,) metres, radians counter-clockwise from −z
    ahead : (m, 3) feet at the following frames, metres
    depth : (h, w) metres along the optical axis, 0 where nothing is seen
    slack : share by which the seen depth may be less than the place's

    Of several frames at one place, the first one counts.
    """
    eye, axes = camera_pose(camera, place, heading)
    tan_x, tan_y = half_extents(camera)
    x, y, z = (ahead - eye).T
    right, up, back = (x * axes[0, k] + y * axes[1, k] + z * axes[2, k] for k in range(3))
    frames = np.flatnonzero((ahead != place).any(axis=1) & (back < 0.0))
    along = -back[frames]
    height, width = depth.shape
    columns = np.floor(((right[frames] / along / tan_x + 1.0) / 2.0 * width).clip(-1.0, width)).astype(int)
    rows = np.floor(((1.0 - up[frames] / along / tan_y) / 2.0 * height).clip(-1.0, height)).astype(int)
    inside = (columns >= 0) & (columns < width) & (rows >= 0) & (rows < height)
    there = np.where(inside, depth[rows.clip(0, height - 1), columns.clip(0, width - 1)], 0.0)
    seen = np.flatnonzero((there > 0.0) & (there >= (1.0 - slack) * along))
    if not len(seen):
        return None
    last = frames[seen[-1]]
    elsewhere = np.flatnonzero((ahead[:last] != ahead[last]).any(axis=1))
    first = int(elsewhere[-1]) + 1 if len(elsewhere) else 0
    return PixelGoal(int(columns[seen[-1]]), int(rows[seen[-1]]), first + 1)
