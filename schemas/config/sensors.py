"""Cameras (image size, field of view, pose, form of the depth image) and errors of detector, pose and motor."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, model_validator

from schemas.base import Finite, Metres, Section, Share

__all__ = ["CameraConfig", "LookerConfig", "NoiseConfig"]

Pixels = Annotated[int, Field(ge=1, le=8192, json_schema_extra={"unit": "px"})]


class CameraConfig(Section):
    """A pinhole camera on an agent, with Habitat's conventions; the defaults are VLN-CE's depth camera.

    It stands straight above the agent's feet and looks where the agent does. The vertical angle follows from the
    horizontal one and the shape of the image. Depth is measured along the optical axis.
    """

    width: Pixels = 256
    """columns of the image"""
    height: Pixels = 256
    """rows of the image"""
    hfov: Annotated[float, Field(gt=0, lt=180, json_schema_extra={"unit": "°"})] = 90.0
    """horizontal field of view"""
    eye_height: Annotated[Finite, Field(ge=0, json_schema_extra={"unit": "m"})] = 1.25
    """height of the camera above the agent's feet"""
    look_down: Annotated[Finite, Field(ge=-90, le=90, json_schema_extra={"unit": "°"})] = 0.0
    """angle by which the camera looks below the horizon; negative looks up"""
    turn: Annotated[Finite, Field(ge=-360, le=360, json_schema_extra={"unit": "°"})] = 0.0
    """angle by which the camera looks to the left of the agent's heading"""
    min_depth: Annotated[Finite, Field(ge=0, json_schema_extra={"unit": "m"})] = 0.0
    """minimum depth; smaller depths are raised to it"""
    max_depth: Metres | None = 10.0
    """maximum depth; larger depths are lowered to it; null for no limit"""
    normalized: bool = True
    """depths are scaled from 0 at min_depth to 1 at max_depth; otherwise they are metres"""

    @model_validator(mode="after")
    def _depths_rise(self) -> CameraConfig:
        if self.max_depth is None and self.normalized:
            raise ValueError("normalized: depths without a max_depth cannot be normalized")
        if self.max_depth is not None and not self.min_depth < self.max_depth:
            raise ValueError(f"max_depth: {self.max_depth:g} must be above min_depth, {self.min_depth:g}")
        return self


class NoiseConfig(Section):
    """Errors of a detector, of a pose estimate and of a motor; none by default."""

    missed: Share = 0.0
    """share of the things in view that are missed"""
    confused: Share = 0.0
    """share of the things in view that get another label of the scene"""
    false: Share = 0.0
    """share of looks in which the detector reports a thing that is not there"""
    position: Annotated[Finite, Field(ge=0, json_schema_extra={"unit": "m"})] = 0.0
    """standard deviation of the estimated position, along each axis of the ground"""
    heading: Annotated[Finite, Field(ge=0, json_schema_extra={"unit": "°"})] = 0.0
    """standard deviation of the estimated heading"""
    step: Annotated[Finite, Field(ge=0, json_schema_extra={"unit": "share"})] = 0.0
    """standard deviation of a step's length, as a share of the length"""
    turn: Annotated[Finite, Field(ge=0, json_schema_extra={"unit": "share"})] = 0.0
    """standard deviation of a turn's angle, as a share of the angle"""


class LookerConfig(Section):
    """The reference agent ``looker``: its cameras, its errors and its memory."""

    noise: NoiseConfig = NoiseConfig()
    """errors of the agent's detector, pose and motor"""
    logic: Share = 0.0
    """share of conditions that the agent answers wrongly whatever it has seen"""
    memory: Annotated[int, Field(ge=1, json_schema_extra={"unit": "steps"})] | None = None
    """number of steps after which the agent forgets a thing that is out of view; null for never"""
    map: Literal["own", "given"] = "own"
    """own: a map that the agent builds as it goes; given: the agent knows the whole floor from the start"""
    pixels: Pixels = 128
    """rows and columns of each of the agent's four cameras, which together cover all directions"""
    least_pixels: Annotated[int, Field(ge=1, json_schema_extra={"unit": "px"})] = 1
    """minimum number of a thing's pixels that an image must show for the agent to notice the thing"""
    reach: Metres = 10.0
    """maximum distance at which things and floor are seen"""
    close: Metres = 3.0
    """a thing counts as absent from a floor only if the floor was seen from at most this distance"""
    patience: Share = 0.7
    """share of the step budget that the agent has at least to decide conditions; of the rest it keeps as many steps as
    the walk to its stops needs, and answers what is undecided by then"""
