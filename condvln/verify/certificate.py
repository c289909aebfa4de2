"""What was checked of one episode, and every fact on which the files and the scene do not agree."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Final

__all__ = ["FACTS", "Certificate", "Disagreement"]

FACTS: Final[Mapping[str, str]] = {
    # text
    "text_reading": "the text has exactly one reading",
    "text_conditions": "the conditions of the text are those of the program",
    "text_branches": "in every case the text sends the agent where the program does",
    "heading": "the heading that the text states is the start's",
    "heading_stated": "a text with compass words states the start's heading",
    "directions": "a text says where things lie by compass words or by bearings only as the configuration says",
    "words": "number of words of the text",
    # scene
    "room_named": "a room goes by the type that the scene has for it",
    "room_unique": "a room's name fits one room",
    "room_anchor_needed": "a room is named by an object only where its type is not enough",
    "seeable": "every thing that the text speaks of can be seen from where an agent can stand in its room",
    "anchor_unique": "the thing that a qualifier refers to is alone in its room",
    "anchor_fit": "an anchor is fixed, or not small, not portable and the larger one",
    "referent_unique": "a phrase without a qualifier fits one thing",
    "qualifier_needed": "a qualifier stands only where the label fits several things",
    "qualifier_sufficient": "a qualified phrase fits one thing with margin and all others not, with margin",
    "absence_known": "absence is claimed only of rooms that are annotated completely",
    "absent_is_elsewhere": "a label claimed absent is that of a thing in another room of the scene",
    "bearing_room": "what is said to lie left, right, ahead or behind is in the room of the start, and in no other",
    "condition_decided": "a condition is true or false with margin",
    "predicate_asked": "a condition asks for a predicate that varies enough in scenes of this family",
    "condition_definite": "a condition speaks of a definite thing exactly where its label fits one thing of the room",
    "referents": "ids of the things and rooms that a stop's phrase means",
    "condition_referents": "ids of the room and the anchor that a condition means",
    "condition_truth": "truth of a condition",
    "witnesses": "the things that make a condition true",
    "gold_leaf": "leaf that the text and the scene lead to",
    # program
    "axes": "depth, chain, composition, moves; evidence has places for what the gold route asks, the worst decides",
    "distinct_goals": "no two leaves have one goal, no leaf visits a thing twice",
    "room_types": "no two rooms of one type are named",
    "labels_apart": "no two conditions ask about things that may have one name",
    "most_moves": "no leaf has more than two moves where a program has four leaves",
    "room_order": "no leaf's stops leave a room and come back to it",
    "condition_matters": "under some truths of the others, each condition changes the goal",
    "independent_conditions": "no condition's truth follows from its own words or from another's",
    # places
    "navmesh": "path and hash of the navmesh",
    "success_distance": "success distance by the number of rooms",
    "standable": "starts, subgoals and goals are navigable",
    "island": "starts, subgoals and goals lie on one island that is wide enough",
    "start_rotation": "the start's rotation is a turn about the vertical",
    "leaf_objects": "the objects of a leaf's subgoals and goal are those of its moves",
    "goal_reach": "a stop lies near its object's box, on its floor and in its room",
    "goal_side": "no wall stands between the goals of one object",
    "goal_order": "a leaf's first goal is the one nearest to the start",
    "route_end": "a leaf's route ends at the goal nearest to where the agent comes from",
    "in_the_way": "starts, goals and paths keep out of furniture that the navmesh ignores",
    "geodesic_distance": "metres from the start to the nearest goal",
    "route_length": "metres from the start by the subgoals to the goal where the route ends",
    "reference_path": "corners of the shortest way by the subgoals",
    "distance_range": "the distance from the start to every leaf is in the range",
    "detour": "where there are several rooms, no leaf's route is much longer than the distance to it",
    "start_apart": "the start lies outside twice the success distance of every stop",
    "leaves_apart": "leaves lie two success distances and the gap apart",
    "path_apart": "no leaf's path enters another leaf's success ball",
    "budget": "the step budget is the configured one, or follows from the words and from what the leaves take",
    # sight
    "surfaces": "whether boxes stood in for surfaces where it was decided what can be seen",
    "observability": "from where the evidence for each condition that the gold route asks is visible",
    "first_view": "whether it is visible from the start without turning",
    # files
    "record": "the VLN-CE record says what the manifest says",
    "ground_truth": "ground-truth locations lie along the gold path, and actions lead to the goal",
    "split_named": "a row names the split that it is in",
    "id_of_hash": "an episode's integer id is that of its hash",
    "unique_id": "an episode's id is its own",
    "unique_episode": "no other episode has this text and start in this scene",
    "split_leakage": "a scene belongs to one group of splits",
    "program_leakage": "a program of a scene stands in one split",
    "program_once": "a program of a scene has one start, outside of counterfactual groups",
    "group": "a counterfactual group is whole, and shares all but one condition's truth and the places of two leaves",
    "readable": "the row and its scene can be read",
}
"""Every kind of fact that is checked."""


@dataclass(frozen=True, slots=True)
class Disagreement:
    """A fact with both its numbers: what the files claim and what was found; `place` says of what part."""

    fact: str
    place: str
    claimed: Any
    found: Any

    def __str__(self) -> str:
        place = f" of {self.place}" if self.place else ""
        return f"{self.fact}{place}: the files say {self.claimed}, found {self.found}"


@dataclass(slots=True)
class Certificate:
    """The verdict on one episode.

    checked : how often each kind of fact was checked; conditions : what was found about each, in the program's order
    """

    episode_id: int | str
    source: str
    scene_id: str
    split: str
    checked: dict[str, int] = field(default_factory=lambda: defaultdict(int))
    conditions: list[dict[str, Any]] = field(default_factory=list)
    disagreements: list[Disagreement] = field(default_factory=list)

    @property
    def proven(self) -> bool:
        """Whether every fact holds."""
        return not self.disagreements

    def same(self, fact: str, claimed: Any, found: Any, place: str = "") -> bool:
        """The two must be equal."""
        return self.holds(fact, claimed == found, claimed, found, place)

    def close(self, fact: str, claimed: float, found: float, tolerance: float, place: str = "") -> bool:
        """The two must differ by no more than `tolerance`; NaN and infinities never agree."""
        return self.holds(fact, abs(claimed - found) <= tolerance, claimed, found, place)

    def holds(self, fact: str, agreed: bool, claimed: Any, found: Any, place: str = "") -> bool:
        """Note one fact, and both its numbers where they do not agree."""
        assert fact in FACTS, fact
        self.checked[fact] += 1
        if not agreed:
            self.disagreements.append(Disagreement(fact, place, claimed, found))
        return agreed

    def document(self) -> dict[str, Any]:
        """The certificate as JSON."""
        return {
            "episode_id": self.episode_id,
            "source": self.source,
            "scene_id": self.scene_id,
            "split": self.split,
            "proven": self.proven,
            "checked": dict(sorted(self.checked.items())),
            "conditions": self.conditions,
            "disagreements": [
                {"fact": d.fact, "place": d.place, "claimed": d.claimed, "found": d.found} for d in self.disagreements
            ],
        }
