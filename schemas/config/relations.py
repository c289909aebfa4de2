"""Thresholds of relations."""

from __future__ import annotations

from typing import Final

from pydantic import Field, model_validator

from schemas.config.section import Degrees, Metres, Section, Share

__all__ = ["SECTOR_HALF_WIDTH", "Thresholds"]

SECTOR_HALF_WIDTH: Final = 22.5
"""Degrees; half of one of the eight compass sectors. They tile the circle, so it is a constant and not a key."""


class Thresholds(Section):
    """Where relations begin and end.

    Each predicate has three thresholds: where its edge is emitted, a strict one beyond which text may use it as true
    (``*_true``), and a loose one beyond which text may use it as false (``*_false``). What lies between is never used
    in text, so that a small error of annotation can't turn an instruction false.
    """

    near: Metres = Field(1.0, description="“near” is emitted up to this distance of boxes")
    near_true: Metres = Field(0.85, description="text may say “near” up to this distance of boxes and of surfaces")
    near_false: Metres = Field(1.15, description="text may deny “near” from this distance of boxes and of surfaces")
    far: Metres = Field(3.0, description="“far from” is emitted from this distance of boxes")
    far_true: Metres = Field(3.45, description="text may say “far from” from this distance of boxes")
    far_false: Metres = Field(2.55, description="text may deny “far from” up to this distance of boxes")
    height: Metres = Field(0.30, description="“higher than” and “lower than” are emitted from this height of centres")
    height_true: Metres = Field(0.45, description="text may say higher, lower, above and below from this height")
    height_false: Metres = Field(0.15, description="text may deny higher, lower, above and below up to this height")
    over_horizontal: Metres = Field(
        0.50, description="“above” and “below” are emitted up to this horizontal distance of centres"
    )
    over_horizontal_true: Metres = Field(
        0.42, description="text may say “above” and “below” up to this horizontal distance"
    )
    over_horizontal_false: Metres = Field(
        0.65, description="text may deny “above” and “below” from this horizontal distance"
    )
    over_footprint_true: Share = Field(
        0.2,
        description="text may say “above” and “below” where this share of the smaller footprint lies over the other",
    )
    sector_true: Degrees = Field(15.0, description="text may use a compass word up to this angle off its direction")
    sector_false: Degrees = Field(30.0, description="text may deny a compass word beyond this angle off its direction")
    sector_horizontal_true: Metres = Field(
        0.5, description="text may use a compass word from this horizontal distance of centres"
    )
    level: Degrees = Field(22.5, lt=90, description="a pair is level where its elevation is smaller")
    degenerate_horizontal: Metres = Field(
        0.1, description="edges are flagged as degenerate where the horizontal distance of centres is smaller"
    )
    surface_within: Metres = Field(1.15, description="surface distances are measured up to this distance of boxes")

    @model_validator(mode="after")
    def _margins_are_on_the_right_side(self) -> Thresholds:
        for low, middle, high, name in (
            (self.near_true, self.near, self.near_false, "near"),
            (self.far_false, self.far, self.far_true, "far"),
            (self.height_false, self.height, self.height_true, "height"),
            (self.over_horizontal_true, self.over_horizontal, self.over_horizontal_false, "over_horizontal"),
            (self.sector_true, SECTOR_HALF_WIDTH, self.sector_false, "sector"),
        ):
            if not low < middle < high:
                raise ValueError(
                    f"{name}: {middle:g} must lie between its thresholds in text, got {low:g} and {high:g}"
                )
        if self.surface_within < self.near_false:
            raise ValueError(
                f"surface_within: {self.surface_within:g} must be at least near_false, {self.near_false:g}"
            )
        return self
