"""Print an instruction's decision tree as text, with truths, witnesses and the gold branch marked."""

from __future__ import annotations

from collections.abc import Iterator

from condvln.labels import vocabulary
from schemas.program import Condition, Leaf, ObjectRef, Program, Qualifier, RoomRef

__all__ = ["program_tree"]


def program_tree(program: Program) -> str:
    """Return the tree of `program` as text. ✔ and ✘ mark true and false conditions, ★ marks the gold leaf."""
    return "\n".join(_branch(program, 0, "", program.gold_leaf()))


def _branch(program: Program, at: int, indent: str, gold: int) -> Iterator[str]:
    branch = program.branches[at]
    yield f"{indent}IF {_condition(program.conditions[branch.condition])}"
    for word, target in (("THEN", branch.then), ("ELSE", branch.otherwise)):
        if target >= 0:
            yield f"{indent}{word}"
            yield from _branch(program, target, indent + "    ", gold)
        else:
            leaf = -1 - target
            mark = "  ★" if leaf == gold else ""
            yield f"{indent}{word} [{leaf}] {_leaf(program.leaves[leaf])}{mark}"


def _condition(condition: Condition) -> str:
    found = f" ✔ {', '.join(condition.witnesses)}" if condition.truth else " ✘"
    return f"{_noun(condition.label)}{_qualified(condition.qualifier)} in {_room(condition.room)}?{found}"


def _leaf(leaf: Leaf) -> str:
    return " → ".join(_object(move) for move in leaf.moves)


def _object(item: ObjectRef) -> str:
    return f"{_noun(item.label)}{_qualified(item.qualifier)} ({item.object_id})"


def _qualified(qualifier: Qualifier | None) -> str:
    if qualifier is None:
        return ""
    if not qualifier.anchors:
        return f", the {qualifier.predicate}"
    return f" {qualifier.predicate} {' and '.join(map(_noun, qualifier.anchor_labels))}"


def _room(room: RoomRef) -> str:
    anchor = "" if room.anchor_label is None else f" with {_noun(room.anchor_label)}"
    return f"{vocabulary.room(room.label).noun}{anchor}"


def _noun(label: str) -> str:
    return vocabulary.entry(label).noun
