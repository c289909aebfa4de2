"""Check a program by itself: that its recorded axes are right, and that it breaks none of the rules against degenerate
programs.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache, lru_cache
from itertools import chain, product
from typing import NamedTuple

from condvln.verify.certificate import Certificate
from condvln.verify.files import UnplacedText
from condvln.verify.words import words
from schemas.config.constants import MOST_MOVES_OF_FOUR_LEAVES
from schemas.evaluation import ManifestEpisode
from schemas.program import SHAPES, Branch, Category, Condition, Program

__all__ = ["check_program", "leads_to", "leaf_of", "sharing", "tree_of"]


def check_program(row: ManifestEpisode | UnplacedText, certificate: Certificate) -> None:
    """Check the recorded axes of a row's program (category, depth and so on), and that the program breaks none of the
    rules against degenerate programs.
    """
    program = row.program
    conditions, leaves = program.conditions, program.leaves
    named = {(one.room.room_id, one.room.label) for one in program.named}
    visited = [[move.object_id for move in leaf.moves] for leaf in leaves]
    rooms = [[move.room.room_id for move in leaf.moves] for leaf in leaves]
    goals = [stops[-1] for stops in visited]
    tree = tree_of(program)
    everywhere = {room_id for room_id, _ in named}
    composition = "C0" if len(everywhere) == 1 else _composition(program, tree, [its[-1] for its in rooms])
    claimed = (row.category, row.depth, row.chain, row.composition, row.moves, row.leads)
    there = 0 <= row.gold_leaf < len(leaves)
    moves = (len(visited[row.gold_leaf]), len(leads_to(program, row.gold_leaf))) if there else (None, None)
    certificate.same("axes", claimed, (program.category, tree.depth, tree.chain, composition, *moves))
    _check_leads(program, certificate)
    _check_evidence(row, certificate)
    certificate.holds("distinct_goals", len(set(goals)) == len(goals), "different goals", goals)
    for k, stops in enumerate(visited):
        certificate.holds("distinct_goals", len(set(stops)) == len(stops), "different stops", stops, f"leaf {k}")
    for k, its_rooms in enumerate(rooms):
        count = len(its_rooms)
        if len(leaves) == 4:
            certificate.holds("most_moves", count <= MOST_MOVES_OF_FOUR_LEAVES, "two moves", count, f"leaf {k}")
        again = any(room in its_rooms[:at] and its_rooms[at - 1] != room for at, room in enumerate(its_rooms))
        certificate.holds("room_order", not again, "rooms left once", its_rooms, f"leaf {k}")
    types = sorted([label for _, label in named])
    certificate.holds("room_types", len(set(types)) == len(types), "one room of a type", types)
    for k in range(len(conditions)):
        matters = any(goals[one] != goals[other] for one, other in _rivals(program.category, k))
        certificate.holds("condition_matters", matters, "another goal", "none", f"condition {k}")
    _check_independence(program, certificate)


def _check_leads(program: Program, certificate: Certificate) -> None:
    """Check that a program with leads has one for each condition in another room than the one before it."""
    here: dict[int, str | None] = {0: next((one.room.room_id for one in program.named if one.is_bearing), None)}
    wanted = []
    for at, branch in enumerate(program.branches):
        room = program.conditions[branch.condition].room
        wanted.append(None if room.room_id == here[at] else room)
        here[branch.then] = here[branch.otherwise] = room.room_id
    leads = [branch.lead for branch in program.branches]
    certificate.holds("leads", leads == wanted or not any(leads), leads, wanted)


def leads_to(program: Program, leaf: int) -> list[Branch]:
    """Return the branches with a lead on the way to a leaf, in order."""
    sides = zip(program.branches, tree_of(program).sides, strict=True)
    return [branch for branch, (_, *both) in sides if branch.lead is not None and leaf in chain(*both)]


def sharing(program: Program, condition: int) -> list[int]:
    """Return the leaves that share the way to a condition: those behind the last lead before it, all without one."""
    sides = {branch: (*then, *other) for branch, (_, then, other) in enumerate(tree_of(program).sides)}
    own = next(set(sides[k]) for k, branch in enumerate(program.branches) if branch.condition == condition)
    led = [its for k, its in sides.items() if program.branches[k].lead is not None and own.issubset(its)]
    return sorted(led[-1]) if led else [*range(len(program.leaves))]


def _check_independence(program: Program, certificate: Certificate) -> None:
    """Check that no condition is decided by its own words or by another condition, and that their labels differ but for
    those that look for one thing elsewhere.
    """
    conditions = program.conditions
    meant = [words().meant_by(condition.label) for condition in conditions]
    for k, condition in enumerate(conditions):
        settled = _settled(condition, meant[k])
        certificate.holds("independent_conditions", not settled, "open", "settled", f"condition {k}")
        for j, other in enumerate(conditions[:k]):
            elsewhere = _looks_elsewhere(condition, other) and _only_if_not(program, k, j)
            own_label = elsewhere or other.label not in meant[k]
            certificate.holds("labels_apart", own_label, "another label", other.label, f"condition {k}")
            apart = elsewhere or not (_follows(condition, meant[k], other) or _follows(other, meant[j], condition))
            certificate.holds("independent_conditions", apart, "independent", f"condition {j}", f"condition {k}")


def _looks_elsewhere(one: Condition, other: Condition) -> bool:
    """Return whether both conditions ask on or in what one thing of a room is, and name different places."""
    if one.qualifier is None or other.qualifier is None or (one.room, one.label) != (other.room, other.label):
        return False
    (place, *_), (before, *_) = one.qualifier.anchor_labels, other.qualifier.anchor_labels
    asked = {one.qualifier.predicate, other.qualifier.predicate}
    return asked <= {"on", "in"} and before not in words().meant_by(place) and place not in words().meant_by(before)


def _only_if_not(program: Program, condition: int, other: int) -> bool:
    """Return whether a condition is asked only where an `other` one fails."""
    sides = {asked: (then, otherwise) for asked, then, otherwise in tree_of(program).sides}
    return {leaf for side in sides[condition] for leaf in side} <= set(sides[other][1])


def _check_evidence(row: ManifestEpisode | UnplacedText, certificate: Certificate) -> None:
    """Check that evidence is recorded for the conditions on the gold path, and that the worst level of this evidence is
    the observability of the row.

    Whether the evidence is visible is checked with rays in :mod:`condvln.verify.observability`.
    """
    if row.observability is None:
        certificate.same("axes", row.evidence, None, "evidence")
        return
    evidence = row.evidence or ()
    claimed = (row.observability, row.evidence_in_view, [place.condition for place in evidence])
    worst = max((place.observability for place in evidence), default=None)
    asked = sorted(row.program.route()[0])
    certificate.same("axes", claimed, (worst, all(place.in_view for place in evidence), asked), "evidence")
    early = [place.condition for place in evidence if place.in_view and place.observability != "O0"]
    certificate.holds("axes", not early, "in the first view only what is seen from the start", early, "evidence")


class _Tree(NamedTuple):
    """What follows from the branches of a program alone.

    depth : how deep tests are nested in THEN parts; 1 if no test is in the THEN part of another test
    chain : number of tests in the ELSE parts from the root on, with the root
    sides : for each branch its condition, and the leaves of its THEN and of its ELSE part
    """

    depth: int
    chain: int
    sides: tuple[tuple[int, tuple[int, ...], tuple[int, ...]], ...]


def tree_of(program: Program) -> _Tree:
    """Return what follows from a program's branches."""
    return _tree(tuple([(branch.condition, branch.then, branch.otherwise) for branch in program.branches]))


@lru_cache(maxsize=64)
def _tree(branches: tuple[tuple[int, int, int], ...]) -> _Tree:
    """Return what follows from branches: (condition, index of the THEN part, index of the ELSE part) of each."""

    def depth(at: int) -> int:
        return 0 if at < 0 else max(1 + depth(branches[at][1]), depth(branches[at][2]))

    def chain(at: int) -> int:
        return 0 if at < 0 else 1 + chain(branches[at][2])

    def leaves(at: int) -> tuple[int, ...]:
        return (-1 - at,) if at < 0 else (*leaves(branches[at][1]), *leaves(branches[at][2]))

    return _Tree(depth(0), chain(0), tuple([(k, leaves(then), leaves(other)) for k, then, other in branches]))


def _composition(program: Program, tree: _Tree, goal_rooms: Sequence[str]) -> str:
    """Return the composition of a program with several rooms. `goal_rooms` has the room of each leaf's goal."""
    for k, then, otherwise in tree.sides:
        asked = program.conditions[k].room.room_id
        one, other = {goal_rooms[leaf] for leaf in then}, {goal_rooms[leaf] for leaf in otherwise}
        if asked not in one and asked not in other and one.isdisjoint(other):
            return "C2"
    return "C1"


@cache
def leaf_of(category: Category, truths: tuple[bool, ...]) -> int:
    """Return the index of the leaf that the truths of the conditions lead to in a tree of this category."""
    at = 0
    while at >= 0:
        branch = SHAPES[category].branches[at]
        at = branch.then if truths[branch.condition] else branch.otherwise
    return -1 - at


@cache
def _rivals(category: Category, k: int) -> tuple[tuple[int, int], ...]:
    """Return all pairs (leaf, other leaf) such that the truths of the conditions lead to the first, and the same truths
    with only condition `k` inverted lead to the second.
    """
    pairs = set()
    for truths in product((True, False), repeat=len(SHAPES[category].branches)):
        other = tuple(truth != (place == k) for place, truth in enumerate(truths))
        pairs.add((leaf_of(category, truths), leaf_of(category, other)))
    return tuple(sorted(pairs))


def _settled(condition: Condition, own: frozenset[str]) -> bool:
    """Return whether the words of a condition alone decide it, as in "a bed near the bed" or "a piano in the room with
    the piano". `own` are the labels that its label may mean.
    """
    anchors = (*(condition.qualifier.anchor_labels if condition.qualifier else ()), condition.room.anchor_label)
    return any(anchor in own for anchor in anchors)


def _follows(one: Condition, own: frozenset[str], other: Condition) -> bool:
    """Return whether `other` asks or presupposes what `one` asks, whose label may mean the labels `own`."""
    if one.room.room_id != other.room.room_id:
        return False
    if other.label in own:
        return True
    return one.qualifier is None and other.qualifier is not None and not own.isdisjoint(other.qualifier.anchor_labels)
