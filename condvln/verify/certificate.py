"""The certificate of an episode: which facts were checked by which rules, and all disagreements between the files and
the scene.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Final, Literal, NamedTuple

from schemas.config import (
    AgentConfig,
    Config,
    EpisodeConfig,
    GoalsConfig,
    PlacesConfig,
    SamplingConfig,
    TextConfig,
    Thresholds,
)

__all__ = [
    "FACTS",
    "Certificate",
    "Disagreement",
    "VerifierRules",
]

FACTS: Final[Mapping[str, str]] = {
    # text
    "text_reading": "the text has exactly one reading",
    "text_conditions": "the conditions in the text equal those of the program",
    "text_branches": "for every combination of truths the text leads to the program's leaf",
    "heading": "the heading stated in the text equals the start's",
    "heading_stated": "a text with compass words states the start's heading",
    "directions": "a text uses compass or egocentric directions only as configured",
    "words": "number of words in the text",
    # scene
    "room_named": "a room is named by its type in the scene",
    "room_unique": "a room's name fits exactly one room",
    "room_anchor_needed": "a room is named by an object only if its type is ambiguous",
    "seeable": "every object named in the text is recognised from where an agent can stand in its room",
    "anchor_unique": "an anchor is the only object of its label in its room",
    "anchor_extent": "the extent of an anchor is known",
    "whole_object": "no object named in the text is a piece of one that a region border cuts",
    "anchor_fit": "an anchor is fixed, or larger than the object, not small and not portable",
    "referent_unique": "a phrase without a qualifier fits exactly one object",
    "qualifier_needed": "a qualifier is used only if the label fits several objects",
    "qualifier_sufficient": "a qualified phrase is true of one object and false of all others, with margin",
    "referent_upright": "a qualified phrase refers to an object that has not fallen over",
    "referent_clear": "a phrase refers to objects of one room only, whose boxes are what their labels say",
    "referent_single": "a qualified phrase refers to an object that no other box may be a part of",
    "absence_known": "absence is claimed only for completely annotated rooms",
    "absence_seen": "an agent can see that a room has nothing with a label that is said to be, or not to be, there",
    "absent_is_elsewhere": "a label claimed absent occurs in another room of the scene",
    "bearing_room": "objects said to be left, right, ahead or behind are in the room of the start only",
    "condition_decided": "a condition is true or false with margin",
    "predicate_asked": "a condition's predicate is true and false often enough in scenes of this family",
    "condition_definite": "a condition is definite exactly if its label fits one object of the room",
    "referents": "ids of the object and room that a stop's phrase refers to",
    "condition_referents": "ids of the room and the anchors that a condition refers to",
    "condition_truth": "truth of a condition",
    "witnesses": "the objects that make a condition true",
    "gold_leaf": "leaf that the text and the scene lead to",
    # program
    "axes": "depth, chain, composition, moves, leads; evidence is recorded for the gold path, its worst level decides",
    "leads": "the leads in the text equal those of the program, which has one wherever a condition is in another room",
    "distinct_goals": "all leaves have different goals, and no leaf visits an object twice",
    "room_types": "named rooms have different types",
    "labels_apart": "conditions are about objects that can't have the same name, or look for one thing elsewhere",
    "most_moves": "a leaf of a program with four leaves has at most two moves",
    "room_order": "the stops of a leaf never return to a room",
    "condition_matters": "for some truths of the others, each condition changes the goal",
    "independent_conditions": "each condition's truth is independent of its own wording and of the other conditions",
    # places
    "navmesh": "path and hash of the navmesh, or of the viewpoint graph",
    "success_distance": "success distance by the number of rooms",
    "standable": "starts, subgoals and goals are navigable",
    "island": "starts, subgoals and goals lie on one island that is wide enough",
    "start_rotation": "the start's rotation is about the vertical axis",
    "leaf_objects": "a leaf's subgoals are the rooms of the leads on the way to it and then, with its goal, its moves",
    "lead_place": "a lead ends in its room, the first one in another room than that of the start",
    "goal_reach": "a stop lies near its object's box, on its floor and in its room",
    "goal_side": "there is no wall between the goals of one object",
    "goal_order": "a leaf's first goal is the nearest to the start",
    "route_end": "a leaf's route ends at the goal nearest to its previous stop",
    "in_the_way": "starts, goals and paths avoid furniture that the navmesh ignores",
    "geodesic_distance": "metres from the start to the nearest goal",
    "route_length": "metres from the start through the subgoals to the goal at the end of the route",
    "reference_path": "corners of the shortest path through the subgoals",
    "distance_range": "the distance from the start to every leaf is in the range",
    "detour": "in scenes of several rooms, a leaf's route is not much longer than the way past its leads to it",
    "start_apart": "the start lies outside twice the success distance of every stop; on viewpoints, stops differ",
    "leaves_apart": "leaves are at least two success distances plus the gap apart; on viewpoints, 3 m along the graph",
    "path_apart": "no leaf's path enters another leaf's success ball",
    "budget": "the step budget equals the configured one, or follows from the number of words and the leaves' actions; "
    "on viewpoints, it is twice the longest path",
    # paths over viewpoints
    "viewpoints": "every place of a path is a viewpoint that the scan's graph includes",
    "panoramas": "a viewpoint of a path is a panorama of the scan, at the same place",
    "viewpoint_edges": "consecutive viewpoints of a path are joined by an edge that is unobstructed both ways",
    "viewpoint_path": "the R2R path is the one through the viewpoints of the start and of the gold leaf's stops",
    "viewpoint_length": "the R2R path's distance is the sum of its edges",
    # sight
    "surfaces": "whether boxes replaced surfaces in visibility tests",
    "degrees": "how large the evidence for each condition on the gold path appears from the best place",
    "lead_seen": "what decides a condition is recognised from where the lead to it ends",
    "stop_seen": "every stop is recognised from all points at which one may stop",
    "observability": "from where the evidence for each condition on the gold path is visible",
    "first_view": "whether it is visible from the start without turning",
    # looking paths
    "looking_path": "the looking path leads over the navmesh from the start through the gold leaf's stops to its goal",
    "looking_length": "length of the looking path",
    "looking_detour": "the looking path is not much longer than the gold leaf's route",
    "looking_actions": "the actions lead along the looking path, past the stops, and end with the goal ahead",
    "looking_budget": "the actions leave a third of the step budget",
    "looking_decided": "the frame at which the evidence seen so far decides each condition on the gold path",
    "looking_acted": "each condition is decided before the walk comes to a stop that only the branch taken has",
    # files
    "record": "the VLN-CE record agrees with the manifest",
    "ground_truth": "ground-truth locations lie along the gold path, and actions lead to the goal",
    "looking_record": "the record along the looking path differs from the stock one in its path alone",
    "looking_truth": "the ground truth along the looking path has the manifest's actions and where they lead",
    "split_named": "a row names its own split",
    "id_of_hash": "an episode's integer id follows from its hash",
    "unique_id": "an episode's id is unique",
    "unique_episode": "the text and start are unique in the scene",
    "split_leakage": "a scene belongs to one group of splits",
    "program_leakage": "a program of a scene is in one split only",
    "program_once": "a program of a scene has one start only, except in counterfactual groups",
    "group": "a counterfactual group is complete; members differ in one condition's truth and two exchanged leaves",
    "readable": "the row and its scene can be read",
}
"""Every kind of fact that is checked, with its description."""


class Disagreement(NamedTuple):
    """A fact on which files and scene disagree, with the claimed and the found value; `place` names the part of the
    episode that the fact is about.
    """

    fact: str
    place: str
    claimed: Any
    found: Any

    def __str__(self) -> str:
        place = f" of {self.place}" if self.place else ""
        return f"{self.fact}{place}: the files say {self.claimed}, found {self.found}"


@dataclass(slots=True)
class Certificate:
    """The result for one episode, for one path over viewpoints, or for one text that has no episode.

    checked : how often each kind of fact was checked
    conditions : what was found about each condition, in the program's order
    unproven : facts that can't be proven of this episode or text, each with the reason
    """

    episode_id: int | str
    source: str
    scene_id: str
    split: str
    checked: dict[str, int] = field(default_factory=lambda: defaultdict(int))
    conditions: list[dict[str, Any]] = field(default_factory=list)
    disagreements: list[Disagreement] = field(default_factory=list)
    unproven: dict[str, str] = field(default_factory=dict)
    kind: Literal["episode", "path", "text"] = "episode"

    @property
    def proven(self) -> bool:
        """Whether every checked fact holds."""
        return not self.disagreements

    def same(self, fact: str, claimed: Any, found: Any, place: str = "") -> bool:
        """Record and return whether two values are equal."""
        return self.holds(fact, claimed == found, claimed, found, place)

    def close(self, fact: str, claimed: float, found: float, tolerance: float, place: str = "") -> bool:
        """Record and return whether two numbers differ by at most `tolerance`; NaN and infinities never agree."""
        return self.holds(fact, abs(claimed - found) <= tolerance, claimed, found, place)

    def holds(self, fact: str, agreed: bool, claimed: Any, found: Any, place: str = "") -> bool:
        """Count one check of a fact. If `agreed` is false, also record the claimed and the found value as a
        disagreement. Return `agreed`.
        """
        assert fact in FACTS, fact
        self.checked[fact] += 1
        if not agreed:
            self.disagreements.append(Disagreement(fact, place, claimed, found))
        return agreed

    def document(self) -> dict[str, Any]:
        """Return the certificate as JSON."""
        return {
            "episode_id": self.episode_id,
            "source": self.source,
            "scene_id": self.scene_id,
            "split": self.split,
            "kind": self.kind,
            "proven": self.proven,
            "checked": dict(sorted(self.checked.items())),
            "conditions": self.conditions,
            "unproven": self.unproven,
            "disagreements": [disagreement._asdict() for disagreement in self.disagreements],
        }


@dataclass(frozen=True, slots=True)
class VerifierRules:
    """The parts of a configuration that decide whether an episode is valid."""

    thresholds: Thresholds = field(default_factory=Thresholds)
    places: PlacesConfig = field(default_factory=PlacesConfig)
    goals: GoalsConfig = field(default_factory=GoalsConfig)
    episodes: EpisodeConfig = field(default_factory=EpisodeConfig)
    text: TextConfig = field(default_factory=TextConfig)
    agent: AgentConfig = field(default_factory=AgentConfig)
    anchor_size: float = SamplingConfig().anchor_size
    language: str = "en"
    directions: str = "compass"

    @classmethod
    def of(cls, config: Config) -> VerifierRules:
        """Return the rules of a configuration."""
        return cls(
            config.thresholds,
            config.places,
            config.goals,
            config.episodes,
            config.text,
            config.agent,
            config.sampling.anchor_size,
            config.instructions.language,
            config.instructions.directions,
        )
