"""Render the frames of a scene's walks and write them as files: JPEG for colours, PNG with 16 bits for depth."""

from __future__ import annotations

import hashlib
import io
import os
import shutil
from collections.abc import Iterator, Mapping
from itertools import pairwise
from pathlib import Path
from typing import Any, Final

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from condvln.sensors import Frame, Renderer
from condvln.trajectories.cameras import Cameras, intrinsics, is_depth
from condvln.trajectories.pixel_goals import mistake_after, pixel_goal
from schemas.config import CameraConfig, TrajectoryConfig
from schemas.errors import StoreError
from schemas.trajectory_tables import POSES, STEPS

__all__ = ["IMAGES", "ImageWriter", "encode_depth", "encode_rgb", "image_path"]

IMAGES: Final = "images"
"""Folder of all images below the folder of the trajectories."""

_PART: Final = ".part-"


def image_path(trajectory: str, camera: str, frame: int) -> str:
    """Return the path of an image relative to the folder of the trajectories. As in StreamVLN, file names count from
    001; `frame` counts from 0.
    """
    return f"{IMAGES}/{trajectory}/{camera}/{frame + 1:03d}.{'png' if is_depth(camera) else 'jpg'}"


def encode_rgb(image: NDArray[np.uint8], quality: int) -> bytes:
    """Return an image (h, w, 3) as a JPEG file."""
    from PIL import Image

    stream = io.BytesIO()
    Image.fromarray(image).save(stream, "JPEG", quality=quality)
    return stream.getvalue()


def encode_depth(depth: NDArray[np.float32], level: int) -> bytes:
    """Return depth (h, w) in metres as a PNG file with 16 bits: millimetres, 0 where nothing is seen."""
    from PIL import Image

    stream = io.BytesIO()
    millimetres = np.clip(np.rint(depth * np.float32(1000)), 0, 65535).astype(np.uint16)
    Image.fromarray(millimetres).save(stream, "PNG", compress_level=level)
    return stream.getvalue()


class ImageWriter:
    """Writes the images of walks below a folder. A walk's own folder appears only when it is complete.

    Parameters
    ----------
    folder : the folder of the trajectories
    keep : write the images; otherwise they are only rendered and hashed
    """

    def __init__(
        self, folder: Path, renderer: Renderer, cameras: Cameras, config: TrajectoryConfig, *, keep: bool = True
    ) -> None:
        self._folder, self._renderer, self._cameras, self._config = folder, renderer, dict(cameras), config
        self._keep = keep
        self._views: dict[CameraConfig, list[str]] = {}
        for name, camera in self._cameras.items():
            self._views.setdefault(camera, []).append(name)

    def write(self, steps: pa.Table) -> pa.Table:
        """Write the images of all walks in `steps`; return the rows of ``poses``.

        Raises
        ------
        StoreError : the folder refuses
        """
        names = steps["trajectory"].to_pylist()
        starts = [0, *(at for at in range(1, len(names)) if names[at] != names[at - 1]), len(names)]
        parts = [self._walk(steps.slice(a, b - a)) for a, b in pairwise(starts) if b > a]
        return pa.concat_tables(parts) if parts else POSES.empty_table()

    def _walk(self, steps: pa.Table) -> pa.Table:
        name = steps["trajectory"][0].as_py()
        target = self._folder / IMAGES / name
        part = target.with_name(f"{_PART}{os.getpid()}-{name}")
        try:
            for camera in self._cameras if self._keep else ():
                (part / camera).mkdir(parents=True, exist_ok=True)
            places = _columns(steps["position"])
            images: list[dict[str, Any]] = []
            right = np.asarray(steps["action"]) == np.asarray(steps["executed"])
            for frame, (place, heading) in enumerate(zip(places, steps["heading"].to_pylist(), strict=True)):
                ahead = places[frame + 1 : mistake_after(right, frame)]
                for camera, data, seen in self.draw(place, heading):
                    goal = None
                    if seen is not None:
                        slack = self._config.goal_slack
                        goal = pixel_goal(self._cameras[camera], place, heading, ahead, seen, slack)
                    path = image_path(name, camera, frame)
                    if self._keep:
                        (part / camera / path.rpartition("/")[2]).write_bytes(data)
                    images.append(
                        {
                            "step": frame,
                            "camera": camera,
                            "image": path,
                            "goal": None if goal is None else [goal.column, goal.row],
                            "goal_frame": None if goal is None else goal.frames,
                            "bytes": len(data),
                            "sha256": hashlib.sha256(data).hexdigest(),
                        }
                    )
            if self._keep:
                _replace(part, target)
        except OSError as error:
            raise StoreError(
                f"can't be written: {error.strerror or error}",
                where=target,
                remedy="Free some space and run again; finished scenes stay.",
            ) from error
        finally:
            shutil.rmtree(part, ignore_errors=True)
        return self._rows(steps, images)

    def draw(
        self, place: NDArray[np.float64], heading: float
    ) -> Iterator[tuple[str, bytes, NDArray[np.float32] | None]]:
        """Yield for each camera: its name, the bytes of its image file, and the depth (h, w) in metres, None for a
        colour camera. Cameras that differ only in modality are rendered once.
        """
        for view, names in self._views.items():
            frame: Frame = self._renderer.look(view, place, heading, rgb=not all(map(is_depth, names)))
            for name in names:
                if is_depth(name):
                    yield name, encode_depth(frame.depth, self._config.png_level), frame.depth
                else:
                    yield name, encode_rgb(frame.rgb, self._config.jpeg_quality), None

    def _rows(self, steps: pa.Table, images: list[dict[str, Any]]) -> pa.Table:
        repeated = steps.take(pa.array([image["step"] for image in images], pa.int64()))
        cameras = [self._cameras[image["camera"]] for image in images]
        columns: dict[str, Any] = {name: repeated[name] for name in STEPS.names}
        columns |= {
            key: [image[key] for image in images]
            for key in ("camera", "image", "goal", "goal_frame", "bytes", "sha256")
        }
        columns |= {key: [getattr(camera, key) for camera in cameras] for key in _CAMERA}
        columns["intrinsics"] = [intrinsics(camera) for camera in cameras]
        return pa.table({name: columns[name] for name in POSES.names}, schema=POSES)


_IMAGE: Final = ("camera", "image", "goal", "goal_frame", "bytes", "sha256")
_CAMERA: Final = ("width", "height", "hfov", "eye_height", "look_down")


def _columns(points: pa.ChunkedArray) -> NDArray[np.float64]:
    whole = points.combine_chunks()
    return np.stack([np.asarray(whole.field(axis)) for axis in "xyz"], axis=1)


def _replace(part: Path, target: Path) -> None:
    """Move the finished folder `part` to `target`, in place of an older folder if there is one."""
    if target.exists():
        shutil.rmtree(target)
    os.rename(part, target)


def clear_parts(folder: Path) -> None:
    """Remove the unfinished image folders that killed writers left behind."""
    for left in (folder / IMAGES).glob(f"{_PART}*"):
        shutil.rmtree(left, ignore_errors=True)


def folders_of(folder: Path) -> Mapping[str, Path]:
    """Return the image folder of each walk, by the walk's name."""
    return {path.name: path for path in (folder / IMAGES).glob("*") if path.is_dir()}
