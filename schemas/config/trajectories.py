"""Trajectories for training: which walks are made, how images are stored, and which steps are repeated."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, model_validator

from schemas.config.section import Section, Share

__all__ = ["TrajectoryConfig", "WalkKind"]

WalkKind = Literal["gold", "oracle", "recovery", "exploration"]

Count = Annotated[int, Field(ge=1, le=1000)]


class TrajectoryConfig(Section):
    """The walks of ``condvln trajectories`` and the form of their images."""

    walks: tuple[WalkKind, ...] = Field(
        ("gold",),
        min_length=1,
        description="kinds of walks; `gold`: the shortest walk to the gold leaf; `oracle`: the same walk with the gold"
        " branch as a plain instruction; `recovery`: the gold walk with a mistake and the way back; `exploration`:"
        " looks at the evidence of each condition, then walks to the gold leaf",
    )
    seed: int = Field(0, ge=0, description="seed of mistakes, repetitions and sampled conditions")
    jpeg_quality: Annotated[int, Field(ge=1, le=100)] = Field(90, description="quality of JPEG images")
    png_level: Annotated[int, Field(ge=0, le=3)] = Field(1, description="compression level of depth images")
    least_actions: Annotated[int, Field(ge=1, json_schema_extra={"unit": "actions"})] = Field(
        4, description="minimum number of actions of a walk; StreamVLN's loader skips shorter walks"
    )
    most_actions: Annotated[int, Field(ge=1, le=999, json_schema_extra={"unit": "actions"})] = Field(
        498, description="maximum number of actions of a walk; StreamVLN drops longer ones"
    )
    recoveries: Count = Field(1, description="number of recovery walks per episode")
    wrong_turns: Share = Field(
        0.5, description="share of recovery walks that set out for another leaf; the others slip at random"
    )
    least_mistake: Annotated[int, Field(ge=1, json_schema_extra={"unit": "actions"})] = Field(
        2, description="minimum number of wrong actions of a mistake"
    )
    most_mistake: Annotated[int, Field(ge=1, json_schema_extra={"unit": "actions"})] = Field(
        12, description="maximum number of wrong actions of a mistake"
    )

    look_angle: Annotated[float, Field(gt=0, lt=180, json_schema_extra={"unit": "°"})] = Field(
        60.0, description="horizontal angle ahead of the agent within which an exploration walk sees evidence"
    )
    goal_slack: Share = Field(
        0.1,
        description="a place counts as visible if the depth measured at its pixel is at least "
        "(1 − goal_slack) × the place's own depth",
    )
    stop_repeats: Count = Field(
        1, description="number of training samples made of each frame whose right action is STOP"
    )
    forward_repeats: Count = Field(
        1, description="number of training samples made of each frame whose right action is forward"
    )
    turn_repeats: Count = Field(
        1, description="number of training samples made of each frame whose right action is a turn"
    )

    @model_validator(mode="after")
    def _bounds_rise(self) -> TrajectoryConfig:
        for least, most in (("least_actions", "most_actions"), ("least_mistake", "most_mistake")):
            if getattr(self, least) > getattr(self, most):
                raise ValueError(f"{least}: {getattr(self, least)} must not be above {most}, {getattr(self, most)}")
        if len(set(self.walks)) != len(self.walks):
            raise ValueError("walks: a kind is named twice")
        return self
