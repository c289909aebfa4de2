"""Rules against degenerate instructions, and the other reasons for which a draw of a program is rejected. Each has a
name and is counted by the sampler; the rules apply to whole programs.

Rules consider what the text says, not what is true, except that rooms and objects are distinguished by id. Two labels
clash if a speaker might use one word for both (``Vocabulary.overlapping``).
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cache, cached_property
from itertools import groupby, product
from typing import Final

from condvln.kept import kept
from condvln.labels import Vocabulary
from schemas.program import SHAPES, Category, Condition, ObjectRef, Predicate, Program

__all__ = [
    "PLACES",
    "REASONS",
    "RULES",
    "Claim",
    "GivenUp",
    "Presupposed",
    "clash",
    "degeneracies",
    "idle_conditions",
    "is_circular",
    "leading_to",
    "outcomes",
    "returns_to_room",
    "searches",
    "true_shares",
]

RULES: Final[dict[str, str]] = {
    "tautology": "a condition's own words decide its truth: by its room's name, or by its anchor",
    "implied": "one condition's truth follows from another one, or from what that one presupposes",
    "one_label": "two conditions are about objects that may have the same name, so 'if there is one' is ambiguous",
    "given_away": "the presuppositions of stops or room names reveal a condition's truth",
    "names_stop": "a condition is about something that is also a stop in that room, so 'the lamp' is ambiguous",
    "circular": "a room is named by an object that the text also names as a stop, an anchor or a question there",
    "two_things": "a word names objects in two rooms, so 'the TV' might be taken for the other one",
    "one_target": "two leaves have the same goal",
    "repeated_stop": "an object is visited twice in one leaf",
    "zigzag": "a leaf's stops leave a room and return to it",
    "idle_condition": "a condition never changes the goal, whatever the other conditions' truths",
}
"""Every rule by name, and what it forbids."""


PLACES: Final[tuple[Predicate, ...]] = ("on", "in")
"""Relations that say where one looks for a thing."""


@dataclass(frozen=True, slots=True)
class Claim:
    """What a condition's text states: a label in a room, perhaps in relation to one or two anchors.

    presence : the text only states that such an object exists
    placed : it states on or in what the object is
    """

    room_id: str
    room_anchor: str | None
    label: str
    anchors: tuple[str, ...] = ()
    presence: bool = True
    placed: bool = False

    @property
    def labels(self) -> tuple[str, ...]:
        """Return the labels in the text of the claim: of the object, of its anchors and of its room's anchor."""
        tag = () if self.room_anchor is None else (self.room_anchor,)
        return (self.label, *self.anchors, *tag)

    @classmethod
    def of(cls, condition: Condition) -> Claim:
        """Return the claim that a condition makes."""
        room, relation = condition.room, condition.qualifier
        if relation is None:
            return cls(room.room_id, room.anchor_label, condition.label)
        placed = relation.predicate in PLACES
        return cls(room.room_id, room.anchor_label, condition.label, relation.anchor_labels, False, placed)

    def goes_on_from(self, other: Claim, vocabulary: Vocabulary) -> bool:
        """Return whether the claim looks for the object of `other` elsewhere in the room: "if the book is on the desk",
        and if not, "if it is on the bed". That the first one fails decides nothing about the second one.
        """
        same = self.placed and other.placed and (self.room_id, self.label) == (other.room_id, other.label)
        return same and not any(vocabulary.overlapping(one).intersection(other.anchors) for one in self.anchors)


@dataclass(frozen=True)
class Presupposed:
    """What the phrases of stops presuppose: the objects that they name, and the relations that their qualifiers state.

    stops : (room id, label) of each stop
    things : the same, and (room id, label) of each anchor of a qualifier or room name ("the … with the piano")
    pairs : (room id, label, label of the anchor) of each relation that a qualifier states
    """

    stops: frozenset[tuple[str, str]]
    things: frozenset[tuple[str, str]]
    pairs: frozenset[tuple[str, str, str]]

    @cached_property
    def stop_labels(self) -> frozenset[str]:
        """Labels of stops in all rooms."""
        return frozenset(label for _, label in self.stops)

    @cached_property
    def thing_labels(self) -> frozenset[str]:
        """Labels of everything presupposed, in all rooms."""
        return frozenset(label for _, label in self.things)

    @cached_property
    def stop_labels_in(self) -> dict[str, frozenset[str]]:
        """Labels of stops by room id."""
        rooms = {room for room, _ in self.stops}
        return {one: frozenset(label for room, label in self.stops if room == one) for one in rooms}

    @kept
    def labels_outside(self, room_id: str) -> frozenset[str]:
        """Return the labels of everything presupposed in all rooms except `room_id`."""
        return frozenset(label for room, label in self.things if room != room_id)

    @classmethod
    def by(cls, stops: Iterable[ObjectRef]) -> Presupposed:
        """Return what the phrases of all `stops` together presuppose."""
        stops = tuple(stops)
        named = {(s.room.room_id, s.label) for s in stops}
        qualified = [
            (s.room.room_id, s.label, anchor) for s in stops if s.qualifier for anchor in s.qualifier.anchor_labels
        ]
        rooms = {(s.room.room_id, s.room.anchor_label) for s in stops if s.room.anchor_label}
        things = named | {(room, anchor) for room, _, anchor in qualified} | rooms
        return cls(frozenset(named), frozenset(things), frozenset(qualified))


def searches(category: Category) -> bool:
    """Return whether a category has several conditions, each asked only if those before it fail, so that they may look
    for one thing in several places.
    """
    return SHAPES[category].depth == 1 < SHAPES[category].chain


def clash(
    claim: Claim, others: Sequence[Claim], given: Presupposed, vocabulary: Vocabulary, *, search: bool = False
) -> str | None:
    """Return the first rule that `claim` violates together with `others` and the stops' phrases, `given`; None if it
    violates none. `search`: the claims may look for one thing in several places (`searches`).
    """
    words = vocabulary.overlapping(claim.label)
    if words.intersection(claim.anchors) or claim.room_anchor in words:
        return "tautology"
    if claim.room_anchor is not None and vocabulary.overlapping(claim.room_anchor).intersection(claim.anchors):
        return "circular"
    # A label that is absent here can be a stop only elsewhere. If presence is never asked of any stop's label, true and
    # false conditions look alike.
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
    unlike = [other for other in others if not (search and claim.goes_on_from(other, vocabulary))]
    for other in (one for one in unlike if one.room_id == claim.room_id):
        if other.label in words:
            return "implied"
        # "a lamp near the bed" presupposes the bed.
        if claim.presence and words.intersection(other.anchors):
            return "implied"
        if other.presence and vocabulary.overlapping(other.label).intersection(claim.anchors):
            return "implied"
    if any(other.label in words for other in unlike):
        return "one_label"
    if _closes_cycle(claim, same_room, vocabulary):
        return "implied"
    outside = given.labels_outside(claim.room_id)
    if len(same_room) < len(others):
        outside = outside.union(*(other.labels for other in others if other.room_id != claim.room_id))
    shared = any(not vocabulary.overlapping(label).isdisjoint(outside) for label in claim.labels)
    return "two_things" if shared else None


def _closes_cycle(claim: Claim, others: Sequence[Claim], vocabulary: Vocabulary) -> bool:
    """Return whether the relation of `claim`, added to the relations of `others`, closes a cycle of labels. Claims in a
    cycle may decide each other: "a north of b" and "b north of c" make "c north of a" false.
    """
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
    """Return whether a phrase names an object twice: "the desk in the bedroom with the desk", or "the chair near the
    desk in the bedroom with the desk".
    """
    if ref.room.anchor_label is None:
        return False
    anchors = ref.qualifier.anchor_labels if ref.qualifier is not None else ()
    return not vocabulary.overlapping(ref.room.anchor_label).isdisjoint((ref.label, *anchors))


def returns_to_room(moves: Sequence[ObjectRef]) -> bool:
    """Return whether the stops of a leaf leave a room and return to it: bedroom, kitchen, bedroom."""
    visited = [room for room, _ in groupby(move.room.room_id for move in moves)]
    return len(set(visited)) < len(visited)


@cache
def outcomes(category: Category) -> dict[tuple[bool, ...], int]:
    """Return the leaf to which each assignment of truths leads."""
    shape = SHAPES[category]
    table = {}
    for truths in product((True, False), repeat=len(shape.branches)):
        at = 0
        while at >= 0:
            branch = shape.branches[at]
            at = branch.then if truths[branch.condition] else branch.otherwise
        table[truths] = -1 - at
    return table


@cache
def leading_to(category: Category, gold: int) -> tuple[tuple[bool, ...], ...]:
    """Return the truths of conditions that lead to a leaf. Truths that don't matter on the way there are fair coins."""
    return tuple(truths for truths, leaf in outcomes(category).items() if leaf == gold)


@cache
def true_shares(category: Category) -> tuple[float, ...]:
    """Return how often each condition of a category is true, if each leaf is gold as often as the others."""
    ways = [leading_to(category, gold) for gold in range(SHAPES[category].leaves)]
    means = [[sum(column) / len(column) for column in zip(*way, strict=True)] for way in ways]
    return tuple(sum(column) / len(means) for column in zip(*means, strict=True))


def idle_conditions(category: Category, goals: Sequence[str]) -> tuple[int, ...]:
    """Return the indices of the conditions that never matter: negating such a condition never changes the goal,
    whatever the truths of the other conditions.
    """
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
    """Return every rule that a whole program violates, sorted; empty if the program is valid."""
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
    if any(vocabulary.overlapping(label) & given.labels_outside(room) for room, label in given.things):
        found.add("two_things")
    claims = [Claim.of(condition) for condition in program.conditions]
    for k, claim in enumerate(claims):
        reason = clash(claim, claims[:k], given, vocabulary, search=searches(program.category))
        if reason:
            found.add(reason)
    return tuple(sorted(found))


REASONS: Final[dict[str, str]] = {
    "nothing_to_ask": "no nameable room has a statement that may be true as well as one that may be false: too few of "
    "its objects are seen from where an agent can stand (about six in a room do), or its annotation is incomplete",
    "no_targets": "too few objects can be named, reached and distinguished",
    "no_waypoint": "no further stop is far enough from the leaf's other stops and the other leaves' goals",
    "one_first_stop": "more than half of the leaves begin with the same stop",
    "no_condition": "every statement of the wanted truth violates a rule",
    "compass_words": "a stop has no name without one more compass word",
    "composition_missed": "the draw does not have the composition that the cell asks for",
    "words_missed": "the text has fewer or more words than the cell asks for",
    "no_twin": "no condition that decides the gold leaf has a counterpart of the opposite truth",
    "duplicate": "the same program was drawn before",
    "too_odd": "the parts of the program have less to do with each other than sampling.most_odd asks for",
    "label_over_cap": "every possible target label already has its share of the scene's leaves",
    **RULES,
}
"""All reasons that the program stage counts in the rejections table."""


class GivenUp(Exception):
    """A draw that can't be completed; `reason` is a key of `REASONS`."""

    def __init__(self, reason: str) -> None:
        self.reason = reason
        super().__init__(reason)
