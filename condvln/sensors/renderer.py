"""Images of a scene: colour, depth, instance and label."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final, TypeAlias

import numpy as np
import numpy.typing as npt
from numpy.typing import NDArray

from condvln.compiled import register_warm_up
from condvln.scene import Scene
from condvln.scene.geometry import SceneGeometry
from condvln.sensors.assembly import scene_surfaces
from condvln.sensors.camera import camera_pose, half_extents, pixel_rays
from condvln.sensors.kernels.raster import rasterize
from condvln.sensors.kernels.shading import resolve_depth, resolve_owner, shade
from condvln.sensors.surfaces import BLOCK, Material, SurfaceBuilder, Surfaces
from schemas.config import CameraConfig
from schemas.errors import UsageError

__all__ = ["FAR", "NEAR", "Frame", "Renderer", "measured_depth", "open_renderer"]

NEAR: Final = 0.01
"""Near plane: metres along the optical axis; that of habitat-sim."""
FAR: Final = 1000.0
"""Far plane: metres along the optical axis."""

F64 = NDArray[np.float64]
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
        seen = np.empty(shape if depth else (0, 0), np.float32)
        if depth:
            resolve_depth(inverse, face, seen)
        instance = np.empty(shape if objects else (0, 0), np.int32)
        if objects:
            resolve_owner(face, own.owner, instance)
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


def _warm_up() -> None:
    builder = SurfaceBuilder()
    corners = np.array([[[-1.0, -1, -2], [1, -1, -2], [0, 1, -2]]])
    builder.add(corners, 0, builder.material(Material(texture=builder.texture([np.zeros((1, 1, 3), np.uint8)]))))
    Renderer(builder.surfaces()).look(CameraConfig(width=4, height=4), np.zeros(3))


register_warm_up("cameras", _warm_up)
