"""Trajectories for training: which walks are made, how images are stored, and which steps are repeated."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, model_validator

from schemas.base import Section, Share

__all__ = ["TrajectoryConfig", "WalkKind"]

WalkKind = Literal["looking", "direct", "oracle", "recovery"]

Count = Annotated[int, Field(ge=1, le=1000)]


class TrajectoryConfig(Section):
    """The walks of ``condvln trajectories`` and the form of their images."""

    walks: tuple[WalkKind, ...] = Field(("looking",), min_length=1)
    """kinds of walks; `looking`: sees the evidence of each condition before it acts on it, then walks to the gold leaf;
    `direct`: the shortest walk to the gold leaf, which teaches turns before the frames justify them; `oracle`: the
    direct walk with the gold branch as a plain instruction; `recovery`: the direct walk with a mistake and the way
    back"""
    forward: Annotated[float, Field(gt=0, le=10, json_schema_extra={"unit": "m"})] = 0.25
    """length of a step forward; a layout sets its agent's own"""
    turn: Annotated[float, Field(ge=1, le=180, json_schema_extra={"unit": "°"})] = 15.0
    """angle of a turn, which divides 360; a layout sets its agent's own"""
    seed: int = Field(0, ge=0)
    """seed of mistakes, repetitions and sampled conditions"""
    jpeg_quality: Annotated[int, Field(ge=1, le=100)] = 90
    """quality of JPEG images"""
    png_level: Annotated[int, Field(ge=0, le=3)] = 1
    """compression level of depth images"""
    least_actions: Annotated[int, Field(ge=1, json_schema_extra={"unit": "actions"})] = 4
    """minimum number of actions of a walk; StreamVLN's loader skips shorter walks"""
    most_actions: Annotated[int, Field(ge=1, le=999, json_schema_extra={"unit": "actions"})] = 498
    """maximum number of actions of a walk; StreamVLN drops longer ones"""
    recoveries: Count = 1
    """number of recovery walks per episode"""
    wrong_turns: Share = 0.5
    """share of recovery walks that set out for another leaf; the others slip at random"""
    least_mistake: Annotated[int, Field(ge=1, json_schema_extra={"unit": "actions"})] = 2
    """minimum number of wrong actions of a mistake"""
    most_mistake: Annotated[int, Field(ge=1, json_schema_extra={"unit": "actions"})] = 12
    """maximum number of wrong actions of a mistake"""
    goal_slack: Share = 0.1
    """a place counts as visible if the depth measured at its pixel is at least (1 − goal_slack) × the place's own
    depth"""
    stop_repeats: Count = 1
    """number of training samples made of each frame whose right action is STOP"""
    forward_repeats: Count = 1
    """number of training samples made of each frame whose right action is forward"""
    turn_repeats: Count = 1
    """number of training samples made of each frame whose right action is a turn"""

    @model_validator(mode="after")
    def _values_agree(self) -> TrajectoryConfig:
        for least, most in (("least_actions", "most_actions"), ("least_mistake", "most_mistake")):
            if getattr(self, least) > getattr(self, most):
                raise ValueError(f"{least}: {getattr(self, least)} must not be above {most}, {getattr(self, most)}")
        if not (360.0 / self.turn).is_integer():
            raise ValueError(f"turn: {self.turn:g}° must divide 360°, such as 15 or 30")
        if "looking" in self.walks and (self.forward, self.turn) != (0.25, 15.0):
            raise ValueError(
                "walks: looking walks have steps of 0.25 m and turns of 15°; choose others, such as direct"
            )
        if len(set(self.walks)) != len(self.walks):
            raise ValueError("walks: a kind is named twice")
        return self
