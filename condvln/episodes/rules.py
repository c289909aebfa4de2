"""The numbers that decide whether an instruction can be placed, and the names of the ways it can fail."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

__all__ = ["REASONS", "EpisodeRules"]


@dataclass(frozen=True, slots=True)
class EpisodeRules:
    """Rules on starts, goals and paths; the same for every leaf. Metres unless said otherwise.

    sight_range, eye_height : how far an agent sees, and from how far above its feet
    floor_seen, object_seen : shares of a room's floor and of an object's surface that count as having seen it
    """

    success_distance_single_room: float = 0.5
    success_distance: float = 1.0
    island_radius: float = 1.5
    distance_single_room: tuple[float, float] = (1.0, 10.0)
    distance: tuple[float, float] = (2.0, 30.0)
    leaf_gap: float = 0.5
    goal_reach: float = 0.5
    goal_reach_at_most: float = 1.0
    goal_points: int = 8
    starts: int = 96
    starts_per_program: int = 24
    path_spacing: float = 0.25
    max_steps: int = 500
    steps_per_word: int = 10
    sight_range: float = 5.0
    eye_height: float = 1.25
    floor_seen: float = 0.8
    object_seen: float = 0.05

    def success(self, single_room: bool) -> float:
        """Success distance τ of a scene."""
        return self.success_distance_single_room if single_room else self.success_distance

    def range(self, single_room: bool) -> tuple[float, float]:
        """Allowed geodesic distance from the start to any leaf."""
        return self.distance_single_room if single_room else self.distance


REASONS: Final[dict[str, str]] = {
    "object_without_goal_point": "no navigable point of the main floor lies near the object",
    "leaves_too_close": "two leaves' goals are less than 2τ + the leaf gap apart",
    "moves_too_close": "two stops of one leaf lie less than 2τ apart",
    "no_start_in_range": "no start has every leaf within the distance range and every stop outside 2τ",
    "unreachable": "no path between two stops",
    "path_enters_other_leaf": "on the way to one leaf the path enters another leaf's τ ball",
    "path_through_furniture": "the navmesh leads through an object that stands there",
    "over_step_budget": "twice the ground-truth actions exceed the step ceiling",
    "follower_stuck": "an agent that knows the map does not get there with discrete steps",
    "observability_missed": "no start shows the evidence as the cell asks for it",
    "route_missed": "no start has the routes to all leaves as long as the cell asks for",
    "program_placed": "the same program has its place already",
    "label_over_cap": "a target's label already has its share of the scene's leaves",
    "quota_full": "the cell has the episodes asked for, in all or of this gold leaf",
    "no_navmesh": "the scene has no navmesh to place episodes on",
    "no_start": "no navigable start on an island wide enough",
}
"""Every reason counted in the rejections table by this stage."""
