"""The cameras of a hub (see ``hub``): the main camera, whose images all layouts share, and those that a layout or a
sweep adds.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import product
from typing import Any, Final, Literal

from pydantic import ValidationError

from condvln.sensors.camera import half_extents
from schemas.base import first_fault
from schemas.config import CameraConfig
from schemas.errors import UsageError

__all__ = ["MAIN", "Cameras", "Sweep", "hub_cameras", "intrinsics", "setting", "sweep_of"]

MAIN: Final = "rgb"
"""Name of the hub's main camera: the folder that StreamVLN's loader reads."""

Cameras = Mapping[str, CameraConfig]
"""Cameras by name. A name begins with ``rgb`` or ``depth``; a dot separates the modality from the setting."""

_STREAMVLN: Final = CameraConfig(width=640, height=480, hfov=79.0, max_depth=None, normalized=False)

PRESETS: Final[Mapping[str, CameraConfig]] = {
    "streamvln": _STREAMVLN,
    "snav": _STREAMVLN.model_copy(update={"width": 384, "height": 384, "hfov": 120.0, "eye_height": 1.5}),
    "vlnce": _STREAMVLN.model_copy(update={"width": 224, "height": 224, "hfov": 90.0}),
}
"""Main cameras of published agents."""

N1_SETTINGS: Final[Sequence[tuple[float, float]]] = ((1.25, 0.0), (1.25, 30.0))
"""Heights in metres and downward angles in degrees of InternVLA-N1's pair of cameras: level, then looking down."""


@dataclass(frozen=True)
class Sweep:
    """Variants of the main camera: one for each combination of values from the lists; an empty list keeps the main
    camera's value.

    heights : metres above the agent's feet; pitches : degrees below the horizon; hfovs : degrees; sizes : (width,
    height) in pixels
    """

    heights: tuple[float, ...] = ()
    pitches: tuple[float, ...] = ()
    hfovs: tuple[float, ...] = ()
    sizes: tuple[tuple[int, int], ...] = ()
    modalities: tuple[Literal["rgb", "depth"], ...] = field(default=("rgb",))

    def cameras(self, main: CameraConfig) -> dict[str, CameraConfig]:
        """Return the cameras by name; none if all lists are empty.

        Raises
        ------
        UsageError : a value that no camera can have
        """
        if not (self.heights or self.pitches or self.hfovs or self.sizes):
            return {}
        found: dict[str, CameraConfig] = {}
        for height, pitch, hfov, size in product(
            self.heights or (main.eye_height,),
            self.pitches or (main.look_down,),
            self.hfovs or (main.hfov,),
            self.sizes or ((main.width, main.height),),
        ):
            values = {"eye_height": height, "look_down": pitch, "hfov": hfov, "width": size[0], "height": size[1]}
            try:
                camera = CameraConfig.model_validate(main.model_dump() | values)
            except ValidationError as error:
                raise UsageError(first_fault(error), place="--sweep", remedy="Change this value.") from None
            name = setting(camera)
            name += f"_{camera.hfov:g}fov" if self.hfovs else ""
            name += f"_{camera.width}x{camera.height}" if self.sizes else ""
            found |= {f"{modality}.{name}": camera for modality in self.modalities}
        return found


def sweep_of(texts: Sequence[str]) -> Sweep:
    """Return the sweep that texts such as ``height=0.6,1.25`` describe.

    Raises
    ------
    UsageError : a text is not of the form ``key=value,value``, or an unknown key or value
    """
    found: dict[str, tuple[Any, ...]] = {}
    for text in texts:
        key, _, values = text.partition("=")
        try:
            field_name, read = _SWEPT[key]
            found[field_name] = tuple(read(value) for value in values.split(","))
        except (KeyError, ValueError):
            raise UsageError(
                f"{text!r} is not a sweep",
                place="--sweep",
                remedy="Examples: height=0.6,1.25 pitch=0,30 hfov=79,90 size=640x480,224x224 images=rgb,depth",
            ) from None
    return Sweep(**found)


def _size(text: str) -> tuple[int, int]:
    width, height = text.split("x")
    return int(width), int(height)


def _modality(text: str) -> str:
    return ("rgb", "depth")[("rgb", "depth").index(text)]


_SWEPT: Final[Mapping[str, tuple[str, Callable[[str], Any]]]] = {
    "height": ("heights", float),
    "pitch": ("pitches", float),
    "hfov": ("hfovs", float),
    "size": ("sizes", _size),
    "images": ("modalities", _modality),
}


def setting(camera: CameraConfig) -> str:
    """Return the name that InternVLA-N1 gives to a camera's height and pitch, such as ``125cm_30deg``."""
    return f"{round(camera.eye_height * 100)}cm_{camera.look_down:g}deg"


def hub_cameras(preset: str, layouts: Iterable[str], sweep: Sweep | None = None) -> dict[str, CameraConfig]:
    """Return all cameras of a hub by name: the preset's camera as `MAIN`, those that the layouts need, and those of the
    sweep.

    Raises
    ------
    UsageError : no preset has this name
    """
    if preset not in PRESETS:
        raise UsageError(
            f"there is no main camera {preset!r}", place="--camera", remedy=f"Choose one of {', '.join(PRESETS)}."
        )
    main = PRESETS[preset]
    found = {MAIN: main}
    if "internvla-n1" in layouts:
        for height, pitch in N1_SETTINGS:
            camera = main.model_copy(update={"eye_height": height, "look_down": pitch})
            # The level camera is the main one where its height is the same: it is not rendered twice.
            if camera != main:
                found |= {f"rgb.{setting(camera)}": camera, f"depth.{setting(camera)}": camera}
    return found | (sweep or Sweep()).cameras(main)


def intrinsics(camera: CameraConfig) -> dict[str, float]:
    """Return focal lengths and principal point in pixels; the centre of the first pixel is at (0.5, 0.5)."""
    focal = camera.width / 2 / half_extents(camera)[0]
    return {"fx": focal, "fy": focal, "cx": camera.width / 2, "cy": camera.height / 2}


def is_depth(name: str) -> bool:
    """Whether a camera of this name stores depth."""
    return name.partition(".")[0] == "depth"


def modality(name: str) -> str:
    """Return the modality of the camera with this name: ``rgb`` or ``depth``."""
    return name.partition(".")[0]
