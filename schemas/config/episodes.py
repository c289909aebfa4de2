"""Rules of starts, goals and paths."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, model_validator

from schemas.base import Finite
from schemas.config.constants import STEP_CEILING
from schemas.config.section import Degrees, Metres, Section, Share

__all__ = ["AgentConfig", "EpisodeConfig", "GoalsConfig", "PlacesConfig", "StepBudget"]

StepBudget = Annotated[int, Field(ge=1, le=STEP_CEILING)] | Literal["proportional"]
"""Step budget: one number for all episodes, or one per episode from its words and its walk."""

Range = Annotated[tuple[Finite, Finite], Field(json_schema_extra={"unit": "m"})]


class AgentConfig(Section):
    """The body that walks, an upright cylinder that the navmesh must fit; the defaults are Habitat's and VLN-CE's."""

    radius: Metres = Field(0.1, description="radius of the agent's cylinder")
    height: Metres = Field(1.5, description="height of the agent's cylinder")
    max_climb: Metres = Field(0.2, description="highest step that the agent climbs")
    max_slope: Degrees = Field(45.0, le=90, description="steepest floor that the agent walks on")


class PlacesConfig(Section):
    """Where an agent may stand, what it sees from there, and when it has arrived."""

    success_distance_single_room: Metres = Field(0.5, description="success distance τ where the scene is one room")
    success_distance: Metres = Field(1.0, description="success distance τ where the scene has several rooms")
    leaf_gap: Metres = Field(
        0.5, description="minimum distance between two leaves, in addition to twice the success distance"
    )
    island_radius: Metres = Field(1.5, description="minimum radius of the navmesh island that an episode is on")
    sight_range: Metres = Field(5.0, description="maximum distance at which an agent sees")
    eye_height: Metres = Field(1.25, description="height of the camera above the agent's feet (habitat-lab's)")

    def success(self, single_room: bool) -> float:
        """Return the success distance τ of a scene, metres."""
        return self.success_distance_single_room if single_room else self.success_distance

    def leaf_separation(self, single_room: bool) -> float:
        """Return the minimum distance between two leaves of one program, metres."""
        return 2 * self.success(single_room) + self.leaf_gap


class GoalsConfig(Section):
    """Goal points: where an agent stands when it has reached an object."""

    reach: Metres = Field(0.5, le=10, description="maximum distance of a goal point from the object's box")
    reach_at_most: Metres = Field(
        1.0,
        le=10,
        description="maximum distance of a goal point from the object's box, for an object with no "
        "navigable point within reach",
    )
    points: int = Field(8, ge=1, le=1000, description="maximum number of goal points of an object")

    @model_validator(mode="after")
    def _reaches_rise(self) -> GoalsConfig:
        if self.reach_at_most < self.reach:
            raise ValueError(f"reach_at_most: {self.reach_at_most:g} must be at least reach, {self.reach:g}")
        return self


class EpisodeConfig(Section):
    """Placement of episodes: distances, routes, starts and the step budget."""

    distance_single_room: Range = Field(
        (1.0, 10.0),
        description="[minimum, maximum] geodesic distance from the start to any leaf where the scene is one room",
    )
    distance: Range = Field(
        (2.0, 30.0),
        description="[minimum, maximum] geodesic distance from the start to any leaf where the scene has several rooms",
    )
    detour_factor: float = Field(
        2.0,
        ge=1,
        allow_inf_nan=False,
        description="in scenes of several rooms, the route through the stops to any leaf may be at most "
        "this factor times the geodesic distance to the leaf, plus detour_slack",
    )
    detour_slack: Metres = Field(
        4.0,
        description="constant part of the maximum length of the route to a leaf; the other part is "
        "detour_factor × the geodesic distance to the leaf",
    )
    starts: int = Field(
        96,
        ge=1,
        le=100_000,
        description="number of starts drawn per scene; all programs of the scene share these starts",
    )
    starts_per_program: int = Field(
        24, ge=1, description="maximum number of starts tried for a program before it is given up"
    )
    max_steps: StepBudget = Field(
        STEP_CEILING,
        description="step budget of every episode: a number, at most VLN-CE's 500, or proportional, the larger of "
        "text.steps_per_word × words and twice the number of ground-truth actions (stock loaders can't represent "
        "it); the walk to each leaf takes at most half of the budget",
    )
    floor_seen: Share = Field(
        0.8, description="minimum share of a room's floor that must be visible to know that something is absent"
    )
    object_seen: Share = Field(
        0.05, description="minimum share of an object's surface that must be visible to know that it is there"
    )

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
