"""Rules of starts, goals and paths."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, model_validator

from schemas.base import Degrees, Finite, Metres, Section, Share
from schemas.config.constants import STEP_CEILING

__all__ = ["AgentConfig", "EpisodeConfig", "GoalsConfig", "LookingDetour", "PlacesConfig", "SeenDegrees", "StepBudget"]

StepBudget = Annotated[int, Field(ge=1, le=STEP_CEILING)] | Literal["proportional"]
"""Step budget: one number for all episodes, or one per episode from its words and its walk."""

Range = Annotated[tuple[Finite, Finite], Field(json_schema_extra={"unit": "m"})]


class AgentConfig(Section):
    """The body that walks, an upright cylinder that the navmesh must fit; the defaults are Habitat's and VLN-CE's."""

    radius: Metres = 0.1
    """radius of the agent's cylinder"""
    height: Metres = 1.5
    """height of the agent's cylinder"""
    max_climb: Metres = 0.2
    """highest step that the agent climbs"""
    max_slope: Degrees = Field(45.0, le=90)
    """steepest floor that the agent walks on"""


class SeenDegrees(Section):
    """How large a thing must appear to be recognised: the sides of the rectangle of azimuth × elevation around its
    visible part."""

    short: Degrees = Field(2.5, lt=90)
    """least shorter side of the rectangle"""
    long: Degrees = Field(4.0, lt=90)
    """least longer side of the rectangle"""

    @model_validator(mode="after")
    def _is_longer(self) -> SeenDegrees:
        if self.long < self.short:
            raise ValueError(f"long: {self.long:g} must be at least short, {self.short:g}")
        return self


class PlacesConfig(Section):
    """Where an agent may stand, what it sees from there, and when it has arrived."""

    success_distance_single_room: Metres = 0.5
    """success distance τ where the scene is one room"""
    success_distance: Metres = 1.0
    """success distance τ where the scene has several rooms"""
    leaf_gap: Metres = 0.5
    """minimum distance between two leaves, in addition to twice the success distance"""
    island_radius: Metres = 1.5
    """minimum radius of the navmesh island that an episode is on"""
    sight_range: Metres = 15.0
    """maximum distance at which an agent sees"""
    seen_degrees: SeenDegrees = Field(default_factory=SeenDegrees)
    eye_height: Metres = 1.25
    """height of the camera above the agent's feet (habitat-lab's)"""

    def success(self, single_room: bool) -> float:
        """Return the success distance τ of a scene, metres."""
        return self.success_distance_single_room if single_room else self.success_distance

    def leaf_separation(self, single_room: bool) -> float:
        """Return the minimum distance between two leaves of one program, metres."""
        return 2 * self.success(single_room) + self.leaf_gap


class GoalsConfig(Section):
    """Goal points: where an agent stands when it has reached an object."""

    reach: Metres = Field(0.5, le=10)
    """maximum distance of a goal point from the object's box"""
    reach_at_most: Metres = Field(1.0, le=10)
    """maximum distance of a goal point from the object's box, on sides of it with no suitable point within reach"""
    points: int = Field(8, ge=1, le=1000)
    """maximum number of goal points of an object"""

    @model_validator(mode="after")
    def _reaches_rise(self) -> GoalsConfig:
        if self.reach_at_most < self.reach:
            raise ValueError(f"reach_at_most: {self.reach_at_most:g} must be at least reach, {self.reach:g}")
        return self


class LookingDetour(Section):
    """How much longer than the direct route a looking path may be."""

    times: float = Field(2.0, ge=1, allow_inf_nan=False)
    """factor of the length of the direct route"""
    metres: Metres = 6.0
    """length that is added to it"""

    def most(self, route_length: float) -> float:
        """Return the maximum length in metres of the looking path to a leaf whose direct route has a given length."""
        return self.times * route_length + self.metres


class EpisodeConfig(Section):
    """Placement of episodes: distances, routes, starts and the step budget."""

    distance_single_room: Range = (1.0, 10.0)
    """[minimum, maximum] geodesic distance from the start to any leaf where the scene is one room"""
    distance: Range = (2.0, 30.0)
    """[minimum, maximum] geodesic distance from the start to any leaf where the scene has several rooms"""
    detour_factor: float = Field(2.0, ge=1, allow_inf_nan=False)
    """in scenes of several rooms, the route through the stops to any leaf may be at most this factor times the geodesic
    distance to the leaf, plus detour_slack; leads are part of both"""
    detour_slack: Metres = 4.0
    """constant part of the maximum length of the route to a leaf; the other part is detour_factor × the geodesic
    distance to the leaf"""
    starts: int = Field(96, ge=1, le=100_000)
    """number of starts drawn per scene; all programs of the scene share these starts"""
    starts_per_program: int = Field(24, ge=1)
    """maximum number of starts tried for a program before it is given up"""
    max_steps: StepBudget = STEP_CEILING
    """step budget of every episode: a number, at most VLN-CE's 500, or proportional, the larger of text.steps_per_word
    × words and twice the number of ground-truth actions (stock loaders can't represent it); the walk to each leaf takes
    at most half of the budget"""
    looking_detour: LookingDetour = Field(default_factory=LookingDetour)
    floor_seen: Share = 0.8
    """minimum share of a room's floor that must be visible to know that something is absent"""
    object_seen: Share = 0.05
    """minimum share of an object's surface that must be visible to know that it is there"""

    @model_validator(mode="after")
    def _distances_are_ranges(self) -> EpisodeConfig:
        for name in ("distance_single_room", "distance"):
            least, most = getattr(self, name)
            if not 0 <= least < most:
                raise ValueError(
                    f"{name}: the first bound must be at least 0 m and below the second, got [{least:g}, {most:g}]"
                )
        return self

    @property
    def step_ceiling(self) -> int:
        """Return the greatest allowed value of 2 · A, where A is the number of actions of the ground-truth walk to a
        leaf. The walks to all leaves must keep to it.
        """
        return STEP_CEILING if self.max_steps == "proportional" else self.max_steps

    def range(self, single_room: bool) -> tuple[float, float]:
        """Return the allowed geodesic distance from the start to any leaf, (minimum, maximum) in metres."""
        return self.distance_single_room if single_room else self.distance
