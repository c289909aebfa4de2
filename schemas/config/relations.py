"""Thresholds of the predicates."""

from __future__ import annotations

from typing import Final

from pydantic import Field, model_validator

from schemas.base import Degrees, Metres, Section, Share

__all__ = ["SECTOR_HALF_WIDTH", "Thresholds"]

SECTOR_HALF_WIDTH: Final = 22.5
"""Half of one of the eight compass sectors, degrees. The sectors tile the circle, so it is not a key."""


class Thresholds(Section):
    """Thresholds of the predicates.

    Each predicate has three thresholds: where its edge is emitted, a strict one beyond which text may use it as true
    (``*_true``), and a loose one beyond which text may use it as false (``*_false``). What lies between is never used
    in text, so that a small error of annotation can't turn an instruction false.
    """

    near: Metres = 1.0
    """maximum distance between two boxes at which “near” is emitted"""
    near_true: Metres = 0.5
    """maximum distance between two objects, both between their boxes and between their surfaces, at which text may say
    “near”"""
    near_over: Metres = 0.25
    """maximum height of the bottom of one thing above the top of the other at which text may say “near”"""
    near_false: Metres = 2.25
    """minimum distance between footprints at which text treats “near” as false"""
    held_footprint: Share = 0.25
    """minimum share of a thing's footprint that must lie over a second thing for the second to carry the first; text
    never says “near” of such a pair"""
    held_inside: Share = 0.5
    """maximum share of one box inside the other; text never says “near” of a pair with a larger share"""
    far: Metres = 3.0
    """minimum distance between two boxes at which “far from” is emitted"""
    far_true: Metres = 3.45
    """minimum distance between two boxes at which text may say “far from”"""
    far_false: Metres = 2.55
    """maximum distance between two boxes at which text treats “far from” as false"""
    height: Metres = 0.30
    """minimum height of one thing's centre above the other's at which “higher than” and “lower than” are emitted"""
    height_true: Metres = 0.45
    """minimum height of one thing's centre above the other's at which text may say “higher”, “lower”, “above” and
    “below”"""
    height_false: Metres = 0.15
    """maximum height of one thing's centre above the other's at which text treats “above” and “below” as false"""
    over_horizontal: Metres = 0.50
    """maximum horizontal distance between two centres at which “above” and “below” are emitted"""
    over_horizontal_true: Metres = 0.42
    """maximum horizontal distance between two centres at which text may say “above” and “below”"""
    over_footprint_true: Share = 0.2
    """minimum share of the smaller footprint that must lie over the other for text to say “above” and “below”"""
    over_gap_true: Metres = 0.10
    """minimum vertical gap between two things at which text may say “above” and “below”; a smaller gap counts as
    support"""
    over_apart_false: Metres = 0.30
    """minimum distance between footprints at which text treats “above”, “below” and “under” as false"""
    top_true: Metres = 0.15
    """minimum difference in height between the tops of two things at which text may say “higher” and “lower”; the thing
    with the higher centre must have the higher top"""
    other_way: Metres = 0.05
    """minimum difference in height, of the centres and of the tops of two things, at which text treats “higher” as
    false of the lower thing and “lower” as false of the higher one"""
    off_floor: Metres = 0.30
    """minimum height of a thing's bottom above the floor, for “higher” and “lower” to be used of it"""
    on_gap_true: Metres = 0.03
    """maximum height difference between the thing's bottom and the other's top at which text may say “on”"""
    on_gap_false: Metres = 0.15
    """minimum height of a thing's bottom above the other's top at which text treats “on” as false"""
    on_footprint_true: Share = 0.5
    """minimum share of the thing's footprint that must lie over the other's for text to say “on”"""
    on_floor: Metres = 0.10
    """maximum height of a thing's bottom above the floor at which the thing stands on the floor"""
    under_footprint_true: Share = 0.8
    """minimum share of the thing's footprint that must lie under the other for text to say “under”"""
    in_share_true: Share = 0.8
    """minimum share of the thing's box that must be inside the other for text to say “in”"""
    between_true: Share = 0.3
    """minimum distance of a thing from both ends of the line between the anchors' centres, as a share of the line, at
    which text may say “between”"""
    between_false: Share = 0.1
    """distance of a thing from either end of the line between the anchors' centres, as a share of the line, below which
    text treats “between” as false"""
    between_off_true: Metres = 0.4
    """maximum distance of a thing from the line between the anchors' centres at which text may say “between”"""
    between_off_false: Metres = 0.8
    """minimum distance of a thing from the line between the anchors' centres at which text treats “between” as false"""
    between_length: Metres = 4.0
    """maximum distance between the centres of two anchors with which “between” is used"""
    between_anchor: Metres = 0.5
    """minimum length of the longest side of an anchor with which “between” is used"""
    closest_ratio: float = Field(1.5, gt=1)
    """minimum ratio of every rival's distance from the anchor to the thing's own, for text to say “closest to”"""
    closest_gap: Metres = 0.5
    """minimum difference between every rival's distance from the anchor and the thing's own, for text to say “closest
    to”"""
    size_ratio: float = Field(1.5, gt=1)
    """minimum ratio of the volume of a thing's box to that of the other's, for text to say “the bigger” of the two"""
    size_side: float = Field(1.05, ge=1)
    """maximum ratio of the height, and of each horizontal side, of the smaller of two things to that of the bigger, for
    text to say “the bigger” of the two"""
    sector_true: Degrees = 15.0
    """text may use a compass word up to this angle between the word's direction and the true one"""
    sector_false: Degrees = 45.0
    """minimum angle of a rival off the direction of a compass word, for the word to distinguish a thing from this
    rival"""
    sector_denied: Degrees = 60.0
    """angle off the direction of a compass word beyond which a condition with this word is false"""
    sector_edge: Degrees = 27.0
    """maximum angle off the direction of a compass word as seen from the nearest point of either thing's footprint, for
    text to use the word"""
    sector_horizontal_true: Metres = 0.5
    """minimum horizontal distance between two centres at which text may use a compass word"""
    sector_within: Metres = 3.0
    """maximum horizontal distance between two centres at which text may use a compass word, or deny it: farther apart,
    people don't think of one thing as north of the other"""
    bearing_true: Degrees = Field(30.0, lt=45)
    """maximum angle off the direction at which text may say “left”, “right”, “ahead” and “behind”"""
    bearing_false: Degrees = Field(60.0, gt=45, le=90)
    """minimum angle off the direction at which text treats “left”, “right”, “ahead” and “behind” as false"""
    bearing_distance: Metres = 1.0
    """minimum distance on the ground from the start to a thing's centre, for left, right, ahead and behind to be
    used"""
    level: Degrees = Field(22.5, lt=90)
    """two things are level if the line between their centres rises by less than this angle"""
    degenerate_horizontal: Metres = 0.1
    """horizontal distance between the centres below which an edge is marked as degenerate"""
    surface_within: Metres = 1.15
    """maximum distance between two boxes at which the distance between their surfaces is measured"""

    @model_validator(mode="after")
    def _margins_are_on_the_right_side(self) -> Thresholds:
        for low, middle, high, names in (
            (self.near_true, self.near, self.near_false, ("near_true", "near", "near_false")),
            (self.far_false, self.far, self.far_true, ("far_false", "far", "far_true")),
            (self.height_false, self.height, self.height_true, ("height_false", "height", "height_true")),
            (self.sector_true, SECTOR_HALF_WIDTH, self.sector_false, ("sector_true", "half a sector", "sector_false")),
        ):
            if not low < middle < high:
                first, between, last = names
                raise ValueError(
                    f"{first} ({low:g}) must be below {between} ({middle:g}), and {last} ({high:g}) must be above it"
                )
        for true, false, name in (
            (self.over_horizontal_true, self.over_horizontal, "over_horizontal"),
            (self.on_gap_true, self.on_gap_false, "on_gap"),
            (self.between_false, self.between_true, "between"),
            (self.between_true, 0.5, "between_true"),
            (self.between_off_true, self.between_off_false, "between_off"),
            (self.sector_false, self.sector_denied, "sector_denied"),
            (self.sector_edge, self.sector_false, "sector_edge"),
        ):
            if not true < false:
                raise ValueError(f"{name}: {true:g} must be below {false:g}")
        if self.surface_within < self.near_true:
            raise ValueError(f"surface_within: {self.surface_within:g} must be at least near_true, {self.near_true:g}")
        return self
