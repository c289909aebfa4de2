"""Rules against degenerate instructions. Each has a name, is counted by the sampler, and holds for whole programs.

All rules work on what the text says, not on what is true, except that rooms and objects are distinguished by id. Two
labels clash where a speaker might use one word for both (``Vocabulary.overlapping``).
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cache, cached_property
from itertools import groupby, product
from typing import Final

from condvln.labels import Vocabulary
from schemas.program import SHAPES, Category, Condition, ObjectRef, Program

__all__ = [
    "REASONS",
    "Claim",
    "Presupposed",
    "clash",
    "degeneracies",
    "idle_conditions",
    "is_circular",
    "outcomes",
    "repeats_anchor",
    "returns_to_room",
]

REASONS: Final[dict[str, str]] = {
    "tautology": "a condition is settled by its own words: by its room's name, or by its own anchor",
    "implied": "one condition's truth follows from another, or from what another takes for granted",
    "one_label": "two conditions ask about things that may have one name, so that 'if there is one' may mean either",
    "given_away": "what the stops or room names take for granted tells a condition's truth",
    "names_stop": "a condition asks for something that is also a stop in that room, so that 'the lamp' may mean either",
    "circular": "a phrase names an object by its room and that room by the same object",
    "one_target": "two leaves have the same goal",
    "repeated_stop": "an object is visited twice in one leaf",
    "zigzag": "a leaf's stops leave a room and come back to it",
    "idle_condition": "under no assignment of the others does this condition change the goal",
}
"""Every rule and what it forbids."""


@dataclass(frozen=True, slots=True)
class Claim:
    """What a condition's text asks: a label in a room, perhaps in relation to one or two anchors.

    presence : it asks nothing but whether such a thing is there
    """

    room_id: str
    room_anchor: str | None
    label: str
    anchors: tuple[str, ...] = ()
    presence: bool = True

    @classmethod
    def of(cls, condition: Condition) -> Claim:
        """The claim a condition makes."""
        anchors = condition.qualifier.anchor_labels if condition.qualifier else ()
        return cls(
            condition.room.room_id, condition.room.anchor_label, condition.label, anchors, condition.qualifier is None
        )


@dataclass(frozen=True)
class Presupposed:
    """Presuppositions of the stops' phrases, by room id.

    stops : labels of stops; things : those, the anchors of their qualifiers and of room names ("the … with the piano");
    pairs : (label, anchor) that a qualifier states
    """

    stops: frozenset[tuple[str, str]]
    things: frozenset[tuple[str, str]]
    pairs: frozenset[tuple[str, str, str]]

    @cached_property
    def stop_labels(self) -> frozenset[str]:
        """Labels of stops, whatever the room."""
        return frozenset(label for _, label in self.stops)

    @cached_property
    def thing_labels(self) -> frozenset[str]:
        """Labels of all that is presupposed, whatever the room."""
        return frozenset(label for _, label in self.things)

    @cached_property
    def stop_labels_in(self) -> dict[str, frozenset[str]]:
        """Labels of stops by room id."""
        rooms = {room for room, _ in self.stops}
        return {one: frozenset(label for room, label in self.stops if room == one) for one in rooms}

    @classmethod
    def by(cls, stops: Iterable[ObjectRef]) -> Presupposed:
        """Presuppositions of all phrases of `stops` together."""
        stops = tuple(stops)
        named = {(s.room.room_id, s.label) for s in stops}
        qualified = [
            (s.room.room_id, s.label, anchor) for s in stops if s.qualifier for anchor in s.qualifier.anchor_labels
        ]
        rooms = {(s.room.room_id, s.room.anchor_label) for s in stops if s.room.anchor_label}
        things = named | {(room, anchor) for room, _, anchor in qualified} | rooms
        return cls(frozenset(named), frozenset(things), frozenset(qualified))


def clash(claim: Claim, others: Sequence[Claim], given: Presupposed, vocabulary: Vocabulary) -> str | None:
    """The first rule that a condition breaks beside the `others` and the stops' phrases; None if it breaks none."""
    words = vocabulary.overlapping(claim.label)
    if words.intersection(claim.anchors) or claim.room_anchor in words:
        return "tautology"
    # What is absent here can be a stop only elsewhere; asking presence of no stop anywhere keeps the two truths alike.
    everywhere = claim.presence
    named = given.stop_labels if everywhere else given.stop_labels_in.get(claim.room_id, frozenset())
    if not words.isdisjoint(named):
        return "names_stop"
    if everywhere and not words.isdisjoint(given.thing_labels):
        return "given_away"
    for claimed in claim.anchors:
        anchor_words = vocabulary.overlapping(claimed)
        for room, label, anchor in given.pairs:
            if room == claim.room_id and (
                (label in words and anchor in anchor_words) or (label in anchor_words and anchor in words)
            ):
                return "given_away"
    same_room = [other for other in others if other.room_id == claim.room_id]
    for other in same_room:
        if other.label in words:
            return "implied"
        # "a lamp near the bed" takes the bed for granted.
        if claim.presence and words.intersection(other.anchors):
            return "implied"
        if other.presence and vocabulary.overlapping(other.label).intersection(claim.anchors):
            return "implied"
    if any(other.label in words for other in others):
        return "one_label"
    return "implied" if _closes_cycle(claim, same_room, vocabulary) else None


def _closes_cycle(claim: Claim, others: Sequence[Claim], vocabulary: Vocabulary) -> bool:
    """Whether relations form a ring of labels: a north of b, b north of c settles c against a."""
    reached, grown = set(vocabulary.overlapping(claim.label)), True
    edges = [(o.label, anchor) for o in others for anchor in o.anchors]
    while grown:
        grown = False
        for one, two in edges:
            if (one in reached) != (two in reached):
                reached |= vocabulary.overlapping(one) | vocabulary.overlapping(two)
                grown = True
    return not reached.isdisjoint(claim.anchors)


def is_circular(ref: ObjectRef, vocabulary: Vocabulary) -> bool:
    """Whether a phrase is like "the desk in the bedroom with the desk"."""
    return ref.room.anchor_label is not None and ref.label in vocabulary.overlapping(ref.room.anchor_label)


def repeats_anchor(named: ObjectRef | Condition, vocabulary: Vocabulary) -> bool:
    """Whether a phrase is like "the chair near the desk in the bedroom with the desk": sound, but clumsy."""
    if named.qualifier is None or named.room.anchor_label is None:
        return False
    return not vocabulary.overlapping(named.room.anchor_label).isdisjoint(named.qualifier.anchor_labels)


def returns_to_room(moves: Sequence[ObjectRef]) -> bool:
    """Whether the stops of a leaf leave a room and come back to it: bedroom, kitchen, bedroom."""
    visited = [room for room, _ in groupby(move.room.room_id for move in moves)]
    return len(set(visited)) < len(visited)


@cache
def outcomes(category: Category) -> dict[tuple[bool, ...], int]:
    """The leaf that each assignment of truths leads to."""
    shape = SHAPES[category]
    table = {}
    for truths in product((True, False), repeat=len(shape.branches)):
        at = 0
        while at >= 0:
            branch = shape.branches[at]
            at = branch.then if truths[branch.condition] else branch.otherwise
        table[truths] = -1 - at
    return table


def idle_conditions(category: Category, goals: Sequence[str]) -> tuple[int, ...]:
    """Conditions that never matter: negating them leaves the goal the same under every assignment of the others."""
    table = outcomes(category)
    return tuple(
        k
        for k in range(len(SHAPES[category].branches))
        if all(
            goals[leaf] == goals[table[(*truths[:k], not truths[k], *truths[k + 1 :])]]
            for truths, leaf in table.items()
        )
    )


def degeneracies(program: Program, vocabulary: Vocabulary) -> tuple[str, ...]:
    """Every rule that a whole program breaks, sorted; empty for a sound one."""
    found = set()
    goals = [leaf.goal.object_id for leaf in program.leaves]
    if len(set(goals)) < len(goals):
        found.add("one_target")
    if any(len({m.object_id for m in leaf.moves}) < len(leaf.moves) for leaf in program.leaves):
        found.add("repeated_stop")
    if any(returns_to_room(leaf.moves) for leaf in program.leaves):
        found.add("zigzag")
    if idle_conditions(program.category, goals):
        found.add("idle_condition")
    moves = [move for leaf in program.leaves for move in leaf.moves]
    if any(is_circular(move, vocabulary) for move in moves):
        found.add("circular")
    given = Presupposed.by(moves)
    claims = [Claim.of(condition) for condition in program.conditions]
    for k, claim in enumerate(claims):
        reason = clash(claim, claims[:k], given, vocabulary)
        if reason:
            found.add(reason)
    return tuple(sorted(found))
