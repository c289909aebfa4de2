"""Check a program by itself: that its recorded axes are right, and that it breaks none of the rules against degenerate
programs.
"""

from __future__ import annotations

from functools import cache
from itertools import product

from condvln.verify.certificate import Certificate
from condvln.verify.words import words
from schemas.config.constants import MOST_MOVES_OF_FOUR_LEAVES
from schemas.evaluation import ManifestEpisode
from schemas.program import SHAPES, Category, Condition, Program

__all__ = ["check_program", "leaf_of"]


def check_program(row: ManifestEpisode, certificate: Certificate) -> None:
    """Check the recorded axes of a row's program (category, depth and so on), and that the program breaks none of the
    rules against degenerate programs.
    """
    program = row.program
    claimed = (row.category, row.depth, row.chain, row.composition, row.moves)
    moves = len(program.leaves[row.gold_leaf].moves) if 0 <= row.gold_leaf < len(program.leaves) else None
    found = (program.category, _depth(program, 0), _chain(program), _composition(program), moves)
    certificate.same("axes", claimed, found)
    _check_evidence(row, certificate)
    goals = [leaf.moves[-1].object_id for leaf in program.leaves]
    visited = [[move.object_id for move in leaf.moves] for leaf in program.leaves]
    certificate.holds("distinct_goals", len(set(goals)) == len(goals), "different goals", goals)
    for k, stops in enumerate(visited):
        certificate.holds("distinct_goals", len(set(stops)) == len(stops), "different stops", stops, f"leaf {k}")
    for k, leaf in enumerate(program.leaves):
        if len(program.leaves) == 4:
            count = len(leaf.moves)
            certificate.holds("most_moves", count <= MOST_MOVES_OF_FOUR_LEAVES, "two moves", count, f"leaf {k}")
        rooms = [move.room.room_id for move in leaf.moves]
        back = [room for at, room in enumerate(rooms) if room in rooms[:at] and rooms[at - 1] != room]
        certificate.holds("room_order", not back, "rooms left once", rooms, f"leaf {k}")
    rooms_named = {(c.room.room_id, c.room.label) for c in program.conditions}
    rooms_named |= {(move.room.room_id, move.room.label) for leaf in program.leaves for move in leaf.moves}
    types = sorted(label for _, label in rooms_named)
    certificate.holds("room_types", len(set(types)) == len(types), "one room of a type", types)
    for k in range(len(program.conditions)):
        matters = any(goals[one] != goals[other] for one, other in _rivals(program.category, k))
        certificate.holds("condition_matters", matters, "another goal", "none", f"condition {k}")
    meant = [words().meant_by(condition.label) for condition in program.conditions]
    for k, condition in enumerate(program.conditions):
        settled = _settled(condition, meant[k])
        certificate.holds("independent_conditions", not settled, "open", "settled", f"condition {k}")
        for j, other in enumerate(program.conditions[:k]):
            own_label = other.label not in meant[k]
            certificate.holds("labels_apart", own_label, "another label", other.label, f"condition {k}")
            apart = not (_follows(condition, meant[k], other) or _follows(other, meant[j], condition))
            certificate.holds("independent_conditions", apart, "independent", f"condition {j}", f"condition {k}")


def _check_evidence(row: ManifestEpisode, certificate: Certificate) -> None:
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


def _depth(program: Program, at: int) -> int:
    """Return how deep tests are nested in THEN parts, counted from the test at index `at`. The depth is 1 if no test is
    in the THEN part of another test, and 0 if `at` is negative (a leaf).
    """
    if at < 0:
        return 0
    branch = program.branches[at]
    return max(1 + _depth(program, branch.then), _depth(program, branch.otherwise))


def _chain(program: Program) -> int:
    count, at = 0, 0
    while at >= 0:
        count, at = count + 1, program.branches[at].otherwise
    return count


def _goal_rooms(program: Program, at: int) -> set[str]:
    if at < 0:
        return {program.leaves[-1 - at].moves[-1].room.room_id}
    branch = program.branches[at]
    return _goal_rooms(program, branch.then) | _goal_rooms(program, branch.otherwise)


def _composition(program: Program) -> str:
    everywhere = {condition.room.room_id for condition in program.conditions}
    everywhere |= {move.room.room_id for leaf in program.leaves for move in leaf.moves}
    if len(everywhere) == 1:
        return "C0"
    for branch in program.branches:
        parts = [
            {program.conditions[branch.condition].room.room_id},
            _goal_rooms(program, branch.then),
            _goal_rooms(program, branch.otherwise),
        ]
        if len(set().union(*parts)) == sum(map(len, parts)):
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
