"""What a guesser may see of an episode: its text and the distances to its leaves, but nothing of the scene."""

from __future__ import annotations

from collections.abc import Mapping
from math import isfinite
from typing import Any, NamedTuple

from condvln.scene.scene import layout_of
from schemas.errors import FormatError
from schemas.program import SHAPES, Category

__all__ = ["Asked", "GuesserView", "LeafView"]


class Asked(NamedTuple):
    """A condition and its truth. A guesser may learn from the truths in other episodes, but must not use those in the
    episode to be guessed.

    definite : the condition is about one object that is known to exist
    lead : one is sent to its room first
    """

    label: str
    room: str
    predicate: str
    anchor: str
    truth: bool
    definite: bool = False
    lead: bool = False


class LeafView(NamedTuple):
    """What a guesser sees of one leaf.

    labels : labels of its stops in order, the goal last; room : type of the goal's room
    distance : geodesic metres from the start to the goal; route : metres from the start through all stops
    """

    labels: tuple[str, ...]
    room: str
    distance: float
    route: float


class GuesserView(NamedTuple):
    """What a guesser may see of an episode, and the gold leaf to learn from. ``scene`` only says which episodes share a
    scene.

    layout : name of the layout that the scene is a variant of; empty if there is none. Objects of one layout rarely
        move, so that the words of a text may predict the truth
    """

    episode_hash: str
    source: str
    scene: str
    layout: str
    category: Category
    group: str | None
    text: str
    asked: tuple[Asked, ...]
    leaves: tuple[LeafView, ...]
    gold: int

    @classmethod
    def of(cls, row: Mapping[str, Any]) -> GuesserView:
        """Build the view from a manifest row.

        Raises
        ------
        FormatError : the row is not a valid manifest row
        """
        try:
            program = row["program"]
            led = {branch["condition"] for branch in program.get("branches", ()) if branch.get("lead")}
            view = cls(
                episode_hash=row["episode_hash"],
                source=row["source"],
                scene=f"{row['source']}/{row['scene_id']}",
                layout=layout_of(row["scene_id"]),
                category=row["category"],
                group=row["group_id"],
                text=row["instruction_text"],
                asked=tuple([_asked(condition, k in led) for k, condition in enumerate(program["conditions"])]),
                leaves=tuple([_leaf(*pair) for pair in zip(program["leaves"], row["leaves"], strict=True)]),
                gold=int(row["gold_leaf"]),
            )
            shape = SHAPES[view.category]
            if len(view.leaves) != shape.leaves or len(view.asked) != len(shape.branches):
                raise ValueError(f"the program's tree is not that of the category {view.category}")
            if not 0 <= view.gold < shape.leaves:
                raise ValueError(f"the gold leaf is {view.gold}, but the program has {shape.leaves} leaves")
            return view
        except (AttributeError, KeyError, TypeError, ValueError, IndexError) as error:
            raise FormatError(
                f"not a valid manifest row ({type(error).__name__}: {error})", remedy="Export again"
            ) from error


def _asked(condition: Mapping[str, Any], lead: bool) -> Asked:
    qualifier = condition["qualifier"]
    predicate = anchor = ""
    if qualifier:
        predicate = qualifier["predicate"]
        anchor = " + ".join([a["label"] for a in qualifier["anchors"]])
    truth, definite = bool(condition["truth"]), bool(condition["definite"])
    return Asked(condition["label"], condition["room"]["label"], predicate, anchor, truth, definite, lead)


def _leaf(words: Mapping[str, Any], placed: Mapping[str, Any]) -> LeafView:
    moves = words["moves"]
    distance, route = float(placed["geodesic_distance"]), float(placed["route_length"])
    if not isfinite(distance + route):
        raise ValueError("a distance is not finite")
    return LeafView(tuple([move["label"] for move in moves]), moves[-1]["room"]["label"], distance, route)
