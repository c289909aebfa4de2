"""The names of the ways in which an instruction can't be placed."""

from __future__ import annotations

from typing import Final

__all__ = ["REASONS"]

REASONS: Final[dict[str, str]] = {
    "no_heading": "from no start in the room do things lie left, right, ahead and behind as the text needs",
    "object_without_goal_point": "no navigable point of the main floor lies near the object",
    "leaves_too_close": "two leaves' goals are less than 2τ + the leaf gap apart",
    "moves_too_close": "two stops of one leaf lie less than 2τ apart",
    "no_start_in_range": "no start has every leaf within the distance range and every stop outside 2τ",
    "unreachable": "no path between two stops",
    "detour": "from no start in range is the route to every leaf within detour_factor times its distance, plus "
    "detour_slack",
    "path_enters_other_leaf": "on the way to one leaf the path enters another leaf's τ ball",
    "path_through_furniture": "the navmesh leads through an object that stands there",
    "over_step_budget": "twice the ground-truth actions exceed the step ceiling",
    "follower_stuck": "an agent that knows the map does not get there with discrete steps",
    "observability_missed": "no start shows the evidence as the cell asks for it",
    "route_missed": "no start has the routes to all leaves as long as the cell asks for",
    "program_placed": "the same program has its place already",
    "label_over_cap": "a target's label already has its share of the scene's leaves",
    "quota_full": "the cell has all the episodes asked for",
    "gold_leaf_full": "the cell has its share of episodes whose gold leaf is this one",
    "id_collision": "its integer id is that of another episode, whose hash is smaller",
    "no_navmesh": "the scene has no navmesh to place episodes on",
    "no_start": "no navigable start on an island wide enough",
}
"""Every reason counted in the rejections table by this stage."""
