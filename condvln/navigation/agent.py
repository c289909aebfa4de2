"""The body that walks: what a navmesh must have been built for."""

from __future__ import annotations

from dataclasses import dataclass

__all__ = ["Agent"]


@dataclass(frozen=True, slots=True)
class Agent:
    """An upright cylinder; the defaults are Habitat's and VLN-CE's.

    radius, height, max_climb in metres; max_slope in degrees.
    """

    radius: float = 0.1
    height: float = 1.5
    max_climb: float = 0.2
    max_slope: float = 45.0
