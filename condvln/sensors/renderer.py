"""Images of a scene: colour, depth, instance and label."""

from __future__ import annotations

import io
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final, TypeAlias

import numpy as np
import numpy.typing as npt

from condvln.scene import Scene
from condvln.scene.scene import SceneGeometry
from condvln.sensors.assembly import scene_surfaces
from condvln.sensors.camera import camera_pose, half_extents, pixel_rays
from condvln.sensors.raster import rasterize, shade
from condvln.sensors.surfaces import BLOCK, Surfaces
from schemas.config import CameraConfig
from schemas.errors import UsageError

__all__ = [
    "FAR",
    "NEAR",
    "Frame",
    "Renderer",
    "clip_gif",
    "coloured_depth",
    "coloured_instances",
    "contact_sheet",
    "measured_depth",
    "open_renderer",
    "png",
]

Bytes = npt.NDArray[np.uint8]

TILE: Final = 320
"""Largest number of columns of a contact sheet."""
CAPTION: Final = 16
"""Height in pixels of a caption, and of each line of the heading."""
FRAME_MS: Final = 250
"""Milliseconds per frame of a clip: four actions a second."""
DARK: Final = (24, 24, 24)
LIGHT: Final = (230, 230, 230)


def png(image: npt.NDArray[np.generic]) -> bytes:
    """Return an image as a PNG file. An image (h, w, 3) uint8 is stored in colour; depths (h, w) in metres and integers
    (h, w) are stored with 16 bits.

    Depths are stored in millimetres; values are clipped at 65535.
    """
    from PIL import Image

    values = np.asarray(image)
    if values.dtype.kind == "f":
        values = np.round(values * 1000)
    if values.ndim == 2:
        values = np.clip(values, 0, 65535).astype(np.uint16)
    stream = io.BytesIO()
    Image.fromarray(values).save(stream, "PNG", compress_level=3)
    return stream.getvalue()


def coloured_depth(depth: npt.NDArray[np.floating], farthest: float = 6.0) -> Bytes:
    """Return depth (h, w) in metres as a grey image (h, w, 3): near surfaces are dark, those at `farthest` or beyond
    are white, and pixels where nothing is seen are black.
    """
    grey = np.clip(depth / farthest, 0, 1) * 255
    return np.repeat(grey.astype(np.uint8)[..., None], 3, axis=-1)


def coloured_instances(instance: npt.NDArray[np.integer]) -> Bytes:
    """Return an image (h, w, 3) in which each number in `instance` (h, w) has its own colour. The number 0 is black."""
    steps = np.array([97, 151, 211])  # odd, so that 256 consecutive numbers get different colours
    coloured: Bytes = ((instance[..., None].astype(np.int64) * steps + 64) % 256).astype(np.uint8)
    coloured[instance == 0] = 0
    return coloured


def contact_sheet(
    pictures: Sequence[Bytes], captions: Sequence[str], columns: int = 4, heading: Sequence[str] = ()
) -> bytes:
    """Return a PNG file that shows pictures (h, w, 3) of equal size in rows, each picture with its caption. The lines
    of `heading` are at the top.
    """
    from PIL import Image, ImageDraw

    height, width = pictures[0].shape[:2]
    wide = min(width, TILE)
    high = round(height * wide / width)
    rows = -(-len(pictures) // columns)
    top = CAPTION * len(heading) + (CAPTION // 2 if heading else 0)
    sheet = Image.new("RGB", (columns * wide, top + rows * (high + CAPTION)), DARK)
    draw = ImageDraw.Draw(sheet)
    for number, line in enumerate(heading):
        draw.text((4, 2 + number * CAPTION), line, fill=LIGHT)
    for number, (picture, caption) in enumerate(zip(pictures, captions, strict=True)):
        place = number % columns * wide, top + number // columns * (high + CAPTION)
        tile = Image.fromarray(picture)
        sheet.paste(tile if tile.size == (wide, high) else tile.resize((wide, high), Image.Resampling.BOX), place)
        draw.text((place[0] + 4, place[1] + high + 1), caption, fill=LIGHT)
    stream = io.BytesIO()
    sheet.save(stream, "PNG")
    return stream.getvalue()


def clip_gif(pictures: Sequence[Bytes]) -> bytes:
    """Return a GIF file that shows pictures (h, w, 3) of equal size one after the other."""
    from PIL import Image

    frames = [Image.fromarray(picture) for picture in pictures]
    stream = io.BytesIO()
    frames[0].save(stream, "GIF", save_all=True, append_images=frames[1:], duration=FRAME_MS, loop=0)
    return stream.getvalue()


NEAR: Final = 0.01
"""Near plane: metres along the optical axis; that of habitat-sim."""
FAR: Final = 1000.0
"""Far plane: metres along the optical axis."""

Image: TypeAlias = npt.NDArray[np.uint8] | npt.NDArray[np.float32] | npt.NDArray[np.int32]


@dataclass(frozen=True, eq=False, slots=True)
class Frame:
    """The images of one camera; row 0 is the uppermost, column 0 the leftmost. Images that were not requested are
    empty.

    rgb : (h, w, 3) red, green, blue; black where nothing is seen
    depth : (h, w) metres along the optical axis, 0 where nothing is seen; see `measured_depth` for the depth that
        agents get
    instance : (h, w) index into the scene's ``objects`` plus 1; 0 for structure and where nothing is seen
    label : (h, w) index into `Renderer.labels` plus 1; 0 as in `instance`
    """

    rgb: npt.NDArray[np.uint8]
    depth: npt.NDArray[np.float32]
    instance: npt.NDArray[np.int32]
    label: npt.NDArray[np.int32]


class Renderer:
    """Renders a scene's surfaces without lighting, transparency or antialiasing, as habitat-sim renders scans.

    Back faces are never drawn, even if the material is double-sided.

    Parameters
    ----------
    surfaces : the triangles to render
    object_labels : canonical label of each of the scene's objects

    Attributes
    ----------
    surfaces : as given
    labels : the canonical labels, sorted
    notes : known deviations from a real view; recorded with all derived results
    """

    def __init__(self, surfaces: Surfaces, object_labels: tuple[str, ...] = ()) -> None:
        self.surfaces = surfaces
        self.labels = tuple(sorted(set(object_labels)))
        self.notes = surfaces.notes
        number = {label: k + 1 for k, label in enumerate(self.labels)}
        self._label_of = np.array([0, *(number[label] for label in object_labels)], np.int32)
        if len(surfaces.owner) and int(surfaces.owner.max()) >= len(self._label_of) - 1:
            missing = int(surfaces.owner.max()) + 2 - len(self._label_of)
            self._label_of = np.concatenate([self._label_of, np.zeros(missing, np.int32)])

    def __repr__(self) -> str:
        return f"Renderer({self.surfaces!r})"

    def look(
        self,
        camera: CameraConfig,
        position: npt.ArrayLike,
        heading: float = 0.0,
        *,
        rgb: bool = True,
        depth: bool = True,
        objects: bool = True,
    ) -> Frame:
        """Render what an agent's camera sees.

        Parameters
        ----------
        position : (3,) of the agent's feet, metres, Habitat frame
        heading : radians counter-clockwise from −Z
        rgb, depth, objects : False leaves out the colours, the depth, or the instances and labels

        Raises
        ------
        UsageError : the position or heading is not finite
        """
        return self.frame(camera, *camera_pose(camera, position, heading), rgb=rgb, depth=depth, objects=objects)

    def frame(
        self,
        camera: CameraConfig,
        eye: npt.ArrayLike,
        rotation: npt.ArrayLike,
        *,
        rgb: bool = True,
        depth: bool = True,
        objects: bool = True,
    ) -> Frame:
        """Render what a camera at `eye` (3,), metres, sees; the columns of `rotation` (3, 3) are right, up and back.

        The height, pitch and yaw of `camera` are ignored; `rgb`, `depth` and `objects` are those of `look`.

        Raises
        ------
        UsageError : the eye or the rotation is not finite
        """
        own = self.surfaces
        place = np.ascontiguousarray(np.asarray(eye, np.float64) - own.origin)
        axes = np.ascontiguousarray(rotation, np.float64)
        if place.shape != (3,) or axes.shape != (3, 3) or not (np.isfinite(place).all() and np.isfinite(axes).all()):
            raise UsageError("the camera's position and rotation must be finite")
        shape = camera.height, camera.width
        inverse = np.full(shape, 1 / FAR, np.float32)
        face = np.full(shape, -1, np.int32)
        columns, rows = pixel_rays(camera)
        extents = half_extents(camera)
        rasterize(own.corners, own.lows, own.highs, BLOCK, place, axes, columns, rows, *extents, NEAR, inverse, face)
        drawn = face >= 0
        seen = np.zeros(shape if depth else (0, 0), np.float32)
        if depth:
            seen[drawn] = np.float32(1) / inverse[drawn]
        instance = np.zeros(shape if objects else (0, 0), np.int32)
        if objects:
            instance[drawn] = own.owner[face[drawn]] + 1
        colours = np.empty((*shape, 3) if rgb else (0, 0, 3), np.uint8)
        if rgb:
            texels = own.texels
            shade(
                face,
                own.corners,
                place,
                axes,
                columns,
                rows,
                own.coordinates,
                own.colours,
                own.material,
                own.factors,
                own.texture,
                own.wraps,
                texels.first_level,
                texels.levels,
                texels.offsets,
                texels.widths,
                texels.heights,
                texels.data,
                colours,
            )
        # `take` is twice as fast as indexing.
        return Frame(colours, seen, instance, self._label_of.take(instance))

    def observe(
        self, cameras: Mapping[str, CameraConfig], position: npt.ArrayLike, heading: float = 0.0
    ) -> dict[str, Image]:
        """Return the images of several cameras by name, in the form that their presets define.

        A name begins with the camera's modality: ``rgb`` (h, w, 3) uint8, ``depth`` (h, w) float32 as `measured_depth`,
        ``instance`` or ``label`` (h, w) int32. Cameras that differ only in modality are rendered once.

        Raises
        ------
        UsageError : a name begins with something else, or the pose is not finite
        """
        drawn: dict[CameraConfig, Frame] = {}
        wanted: dict[CameraConfig, set[str]] = {}
        for name, camera in cameras.items():
            wanted.setdefault(camera, set()).add(name.split("_")[0])
        found: dict[str, Image] = {}
        for name, camera in cameras.items():
            if camera not in drawn:
                kinds = wanted[camera]
                drawn[camera] = self.look(
                    camera,
                    position,
                    heading,
                    rgb="rgb" in kinds,
                    depth="depth" in kinds,
                    objects=not kinds.isdisjoint({"instance", "label"}),
                )
            frame = drawn[camera]
            match name.split("_")[0]:
                case "rgb":
                    found[name] = frame.rgb
                case "depth":
                    found[name] = measured_depth(camera, frame.depth)
                case "instance":
                    found[name] = frame.instance
                case "label":
                    found[name] = frame.label
                case _:
                    raise UsageError(f"{name!r} is not a camera name: it must begin with rgb, depth, instance or label")
        return found


def measured_depth(camera: CameraConfig, depth: npt.NDArray[np.float32]) -> npt.NDArray[np.float32]:
    """Return depth (h, w) in metres as an agent gets it: clipped to the camera's range, normalised to [0, 1] if
    configured.

    Follows habitat-lab's ``HabitatSimDepthSensor``: a pixel without a surface gets the least depth.
    """
    if camera.max_depth is None and camera.min_depth == 0:
        return depth
    clipped = np.clip(depth, np.float32(camera.min_depth), np.float32(camera.max_depth or np.inf))
    if camera.normalized and camera.max_depth is not None:
        clipped = (clipped - np.float32(camera.min_depth)) / np.float32(camera.max_depth - camera.min_depth)
    return np.asarray(clipped, np.float32)


def open_renderer(scene: Scene, geometry: SceneGeometry | None) -> Renderer:
    """Return the renderer of a scene.

    Parameters
    ----------
    geometry : the scene's triangles, from its source

    Raises
    ------
    InputError : a mesh can't be read
    """
    return Renderer(scene_surfaces(scene, geometry), tuple(item.label for item in scene.objects))
