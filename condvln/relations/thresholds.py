"""Every number that decides a relation, in one place."""

from __future__ import annotations

from dataclasses import dataclass

__all__ = ["RelationThresholds"]


@dataclass(frozen=True, slots=True)
class RelationThresholds:
    """Thresholds in metres and degrees.

    Each predicate has three: where its edge is emitted, a strict one beyond which text may use it as true
    (``*_true``), and a loose one beyond which text may use it as false (``*_false``). What lies between is never
    used in text, so that a small error of annotation can't turn an instruction false.
    """

    near: float = 1.00
    near_true: float = 0.85
    near_false: float = 1.15
    far: float = 3.00
    far_true: float = 3.45
    far_false: float = 2.55
    height: float = 0.30
    height_true: float = 0.45
    height_false: float = 0.15
    over_horizontal: float = 0.50
    over_horizontal_true: float = 0.42
    over_horizontal_false: float = 0.65
    over_footprint_true: float = 0.20
    """Smallest shared part of the smaller of two footprints for "above" and "below" to be used as true."""
    sector_half_width: float = 22.5
    """Half of one of the eight compass sectors. Not to be changed: the sectors tile the circle."""
    sector_true: float = 15.0
    sector_false: float = 30.0
    sector_horizontal_true: float = 0.50
    level: float = 22.5
    """Elevations of smaller size count as level."""
    degenerate_horizontal: float = 0.10
    """Edges between centres that are horizontally closer are flagged: their azimuth says little."""
    surface_within: float = 1.15
    """Surface distances are measured where the boxes are no further apart; beyond it "near" is false anyway."""

    def __post_init__(self) -> None:
        ordered = (
            (self.near_true, self.near, self.near_false),
            (self.far_false, self.far, self.far_true),
            (self.height_false, self.height, self.height_true),
            (self.over_horizontal_true, self.over_horizontal, self.over_horizontal_false),
            (self.sector_true, self.sector_half_width, self.sector_false),
        )
        for low, middle, high in ordered:
            if not 0 < low < middle < high:
                raise ValueError(f"thresholds must rise strictly from above 0: {low}, {middle}, {high}")
        if self.sector_half_width != 22.5:
            raise ValueError("sector_half_width must be 22.5: eight sectors tile the circle")
        if self.surface_within < self.near_false:
            raise ValueError("surface_within must reach near_false, else a false 'near' could not be proven")
