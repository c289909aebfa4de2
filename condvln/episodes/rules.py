"""The reasons for which placing may reject an instruction."""

from __future__ import annotations

from typing import Final

__all__ = ["DRAWING", "PLACING", "REASONS"]

DRAWING: Final = "programs"
PLACING: Final = "episodes"
"""What rejects, in the column ``stage`` of the rejections table: draws of programs that fail, and candidates that can't
be placed.
"""

REASONS: Final[dict[str, str]] = {
    "no_heading": "no start in the room has objects to the left, right, front and back as the text states",
    "object_without_goal_point": "no navigable point of the main floor lies near the object",
    "leaves_too_close": "two leaves' goals are less than 2τ + the leaf gap apart",
    "moves_too_close": "two stops of one leaf lie less than 2τ apart",
    "no_start_in_range": "no start has every leaf within the distance range and every stop outside 2τ",
    "unreachable": "no path between two consecutive stops",
    "detour": "no start in range has every leaf's route within detour_factor times its distance, plus detour_slack",
    "path_enters_other_leaf": "on the way to one leaf the path enters another leaf's τ ball",
    "path_through_furniture": "a path on the navmesh crosses an object that stands on the floor",
    "over_step_budget": "twice the ground-truth actions exceed the step ceiling",
    "follower_stuck": "the ground-truth follower does not reach a goal with discrete actions",
    "observability_missed": "no start has the observability that the cell asks for",
    "route_missed": "no start has routes to all leaves of the length that the cell asks for",
    "program_placed": "the same program is already placed",
    "label_over_cap": "a target's label already has its share of the scene's leaves",
    "quota_full": "the cell already has all its episodes",
    "gold_leaf_full": "the cell already has its share of episodes with this gold leaf",
    "id_collision": "another episode with a smaller hash has the same integer id",
    "no_navmesh": "the scene has no navmesh to place episodes on",
    "no_start": "no navigable start on an island wide enough",
}
"""All reasons for which placing rejects a candidate, as counted in the rejections table."""
