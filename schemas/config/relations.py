"""Thresholds of the predicates."""

from __future__ import annotations

from typing import Final

from pydantic import Field, model_validator

from schemas.config.section import Degrees, Metres, Section, Share

__all__ = ["SECTOR_HALF_WIDTH", "Thresholds"]

SECTOR_HALF_WIDTH: Final = 22.5
"""Half of one of the eight compass sectors, degrees. The sectors tile the circle, so it is not a key."""


class Thresholds(Section):
    """Thresholds of the predicates.

    Each predicate has three thresholds: where its edge is emitted, a strict one beyond which text may use it as true
    (``*_true``), and a loose one beyond which text may use it as false (``*_false``). What lies between is never used
    in text, so that a small error of annotation can't turn an instruction false.
    """

    near: Metres = Field(1.0, description="“near” is emitted up to this distance of boxes")
    near_true: Metres = Field(0.5, description="text may say “near” up to this distance of boxes and of surfaces")
    near_over: Metres = Field(
        0.25,
        description="text may say “near” only where, in addition, the bottom of one is at most this far "
        "above the top of the other",
    )
    near_false: Metres = Field(1.75, description="text may deny “near” from this distance of footprints")
    held_footprint: Share = Field(
        0.25,
        description="a thing carries another if this share of the other's footprint is over it, at its top "
        "or within its height; “near” is then never used for the pair",
    )
    held_inside: Share = Field(
        0.5, description="“near” is never used for a pair if more than this share of one box is inside the other"
    )
    far: Metres = Field(3.0, description="“far from” is emitted from this distance of boxes")
    far_true: Metres = Field(3.45, description="text may say “far from” from this distance of boxes")
    far_false: Metres = Field(2.55, description="text may deny “far from” up to this distance of boxes")
    height: Metres = Field(0.30, description="“higher than” and “lower than” are emitted from this height of centres")
    height_true: Metres = Field(
        0.45, description="text may say “higher”, “lower”, “above” and “below” from this height"
    )
    height_false: Metres = Field(
        0.15, description="text may deny “higher”, “lower”, “above” and “below” up to this height"
    )
    over_horizontal: Metres = Field(
        0.50, description="“above” and “below” are emitted up to this horizontal distance of centres"
    )
    over_horizontal_true: Metres = Field(
        0.42, description="text may say “above” and “below” up to this horizontal distance"
    )
    over_footprint_true: Share = Field(
        0.2,
        description="text may say “above” and “below” where this share of the smaller footprint lies over the other",
    )
    over_gap_true: Metres = Field(
        0.10, description="text may say “above” and “below” where this much air is between the two; less is a support"
    )
    over_apart_false: Metres = Field(
        0.30, description="text may deny “above”, “below” and “under” where footprints are this far apart"
    )
    top_true: Metres = Field(
        0.15,
        description="text may say higher and lower where tops differ by at least this, in the same "
        "direction as the centres",
    )
    top_false: Metres = Field(0.05, description="text may deny “higher” and “lower” where tops differ by at most this")
    off_floor: Metres = Field(
        0.30,
        description="“higher” and “lower” are used only for things whose bottoms are at least this far above the floor",
    )
    on_gap_true: Metres = Field(0.03, description="text may say “on” where bottom and top differ by at most this")
    on_gap_false: Metres = Field(0.15, description="text may deny “on” where the bottom is this far above the top")
    on_footprint_true: Share = Field(
        0.5, description="text may say “on” where this share of the thing's footprint lies over the other's"
    )
    on_floor: Metres = Field(0.10, description="a thing stands on the floor if its bottom is at most this far above it")
    under_footprint_true: Share = Field(
        0.8, description="text may say “under” where this share of the thing's footprint lies under the other"
    )
    in_share_true: Share = Field(0.8, description="text may say “in” where this share of the thing's box is inside")
    between_true: Share = Field(
        0.3,
        description="text may say “between” from this fraction of the line of centres to the same fraction "
        "before its end",
    )
    between_false: Share = Field(
        0.1,
        description="text may deny “between” before this fraction of the line, and after the same fraction "
        "before its end",
    )
    between_off_true: Metres = Field(0.4, description="text may say “between” up to this distance off the line")
    between_off_false: Metres = Field(0.8, description="text may deny “between” from this distance off the line")
    between_length: Metres = Field(
        4.0, description="“between” is used only with anchors whose centres are at most this far apart"
    )
    between_anchor: Metres = Field(
        0.5, description="“between” is used only with anchors whose longest side is at least this"
    )
    closest_ratio: float = Field(
        1.5, gt=1, description="text may say “closest to” where every rival is this many times farther"
    )
    closest_gap: Metres = Field(
        0.5, description="text may say “closest to” where, in addition, every rival is farther by this"
    )
    size_ratio: float = Field(
        1.5, gt=1, description="text may say “the bigger” of two where the volume of its box is this many times larger"
    )
    sector_true: Degrees = Field(15.0, description="text may use a compass word up to this angle off its direction")
    sector_false: Degrees = Field(
        30.0, description="a compass word tells a thing from rivals that are beyond this angle off its direction"
    )
    sector_denied: Degrees = Field(
        60.0, description="a condition with a compass word is false beyond this angle off its direction"
    )
    sector_horizontal_true: Metres = Field(
        0.5, description="text may use a compass word from this horizontal distance of centres"
    )
    bearing_true: Degrees = Field(
        30.0, lt=45, description="text may say “left”, “right”, “ahead” and “behind” up to this angle off the direction"
    )
    bearing_false: Degrees = Field(
        60.0,
        gt=45,
        le=90,
        description="text may deny “left”, “right”, “ahead” and “behind” from this angle off the direction",
    )
    bearing_distance: Metres = Field(
        1.0,
        description="left, right, ahead and behind are used only for things whose centres are at least "
        "this far from the start on the ground",
    )
    level: Degrees = Field(
        22.5, lt=90, description="a pair is level if the elevation between the centres is smaller than this"
    )
    degenerate_horizontal: Metres = Field(
        0.1, description="edges are marked as degenerate if the horizontal distance of the centres is smaller than this"
    )
    surface_within: Metres = Field(
        1.15, description="surface distances are measured where boxes are at most this far apart"
    )

    @model_validator(mode="after")
    def _margins_are_on_the_right_side(self) -> Thresholds:
        for low, middle, high, name in (
            (self.near_true, self.near, self.near_false, "near"),
            (self.far_false, self.far, self.far_true, "far"),
            (self.height_false, self.height, self.height_true, "height"),
            (self.sector_true, SECTOR_HALF_WIDTH, self.sector_false, "sector"),
        ):
            if not low < middle < high:
                raise ValueError(
                    f"{name}: {middle:g} must lie between its thresholds in text, got {low:g} and {high:g}"
                )
        for true, false, name in (
            (self.over_horizontal_true, self.over_horizontal, "over_horizontal"),
            (self.top_false, self.top_true, "top"),
            (self.on_gap_true, self.on_gap_false, "on_gap"),
            (self.between_false, self.between_true, "between"),
            (self.between_true, 0.5, "between_true"),
            (self.between_off_true, self.between_off_false, "between_off"),
            (self.sector_false, self.sector_denied, "sector_denied"),
        ):
            if not true < false:
                raise ValueError(f"{name}: {true:g} must be below {false:g}")
        if self.surface_within < self.near_true:
            raise ValueError(f"surface_within: {self.surface_within:g} must be at least near_true, {self.near_true:g}")
        return self
