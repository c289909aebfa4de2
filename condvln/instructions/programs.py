"""Properties of a program alone: its ids, its composition class, its rows in the ``instructions`` table, its tree as
text.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Iterator, Mapping
from functools import cache
from typing import Any, Final

import orjson
import pyarrow as pa

from condvln.instructions.degeneracy import true_shares
from condvln.labels import vocabulary
from condvln.labels.lists import belongs_by, goes_with, labels_with_role
from schemas.episode import Composition
from schemas.program import SHAPES, Branch, Condition, Leaf, ObjectRef, Predicate, Program, Qualifier, RoomRef
from schemas.tables import INSTRUCTIONS

__all__ = [
    "ID_LENGTH",
    "composition",
    "excess_of_sent",
    "instruction_id",
    "instruction_table",
    "instructions_with_text",
    "oddness",
    "oracle_linear",
    "program_key",
    "program_tree",
    "programs_from_table",
    "with_leads",
]


ID_LENGTH = 20
"""Hexadecimal digits kept of a SHA-256: 80 bits, so that a million instructions collide with probability 4e-13."""


def program_key(program: Program) -> str:
    """Return the SHA-256 of the program's canonical JSON, truths and witnesses included: equal keys mean equal
    programs. Whether a condition is definite follows from the scene, and is left out; so is a lead where there is none.
    """
    document = program.model_dump()
    for condition in document["conditions"]:
        del condition["definite"]
    for branch in document["branches"]:
        if branch["lead"] is None:
            del branch["lead"]
    return hashlib.sha256(orjson.dumps(document, option=orjson.OPT_SORT_KEYS)).hexdigest()


def instruction_id(family: str, scene_id: str, program: Program) -> str:
    """Return the id of one program in one scene."""
    key = f"{family}\x1f{scene_id}\x1f{program_key(program)}"
    return hashlib.sha256(key.encode()).hexdigest()[:ID_LENGTH]


ASIDE: Final[Mapping[Predicate, int]] = {"on": 0, "in": 0, "near": 1}
"""How little it helps to find a thing to know this relation of it; 2 for all others."""


def oddness(program: Program) -> int:
    """Return how little the parts of a program have to do with each other, by ``affinity.csv``; 0 is best.

    Where a relation holds, one goes to its anchor (0); else to a place where what is asked about may lie (0). Any other
    goal counts 1 if the thing is used there, 2 if it is used together with the goal, and 3 if neither, or if one is
    sent away from where the thing is or to where it is not. A goal in another room counts 1 more, unless the thing is
    not in the room at all. Each stop before a goal counts 1, and 1 more if nobody uses both together.

    A condition counts 2 if it is about what nobody carries about (role portable) and so would look for; 1 if it asks
    what is near, 2 if it asks for any relation but near, on and in, or only whether a room has a thing; and 2 if the
    thing is not used at the anchor. Each after the first counts 1 if its thing is used with none asked about before,
    and 1 if it is about another room.
    """
    found = 0
    for branch in program.branches:
        condition = program.conditions[branch.condition]
        anchors = () if condition.qualifier is None else condition.qualifier.anchors
        for end, holds in ((branch.then, True), (branch.otherwise, False)):
            if end < 0:
                goal = program.leaves[-1 - end].moves[-1]
                at_anchor = goal.object_id in [anchor.object_id for anchor in anchors]
                if anchors and holds != at_anchor:
                    found += 3
                elif not anchors or not holds:
                    outside = (holds or anchors) and goal.room.room_id != condition.room.room_id
                    found += _distance(condition.label, goal.label) + bool(outside)
    for leaf in program.leaves:
        found += sum(1 + (move.label not in goes_with().get(leaf.moves[-1].label, ())) for move in leaf.moves[:-1])
    for k, one in enumerate(program.conditions):
        found += 2 * (one.label not in labels_with_role("portable"))
        found += 2 if one.qualifier is None else ASIDE.get(one.qualifier.predicate, 2)
        if one.qualifier is not None:
            found += 2 * any(anchor not in belongs_by().get(one.label, ()) for anchor in one.qualifier.anchor_labels)
        if before := program.conditions[:k]:
            found += all(other.label not in {one.label, *goes_with().get(one.label, ())} for other in before)
            found += one.room.room_id not in [other.room.room_id for other in before]
    return found


def excess_of_sent(program: Program) -> float:
    """Return how many more of the relations to whose anchor one is sent where they hold are true than by chance: the
    first condition of a chain is true less often than false (`true_shares`).
    """
    found = 0.0
    for branch in program.branches:
        condition = program.conditions[branch.condition]
        if branch.then < 0 and condition.qualifier is not None:
            goal = program.leaves[-1 - branch.then].moves[-1].object_id
            if goal in [anchor.object_id for anchor in condition.qualifier.anchors]:
                found += condition.truth - true_shares(program.category)[branch.condition]
    return found


def _distance(asked: str, goal: str) -> int:
    """Return how little a thing that is asked about has to do with a goal: see `oddness`."""
    if goal in belongs_by().get(asked, ()):
        return 0 if goal in labels_with_role("surface") else 1
    return 2 if goal in goes_with().get(asked, ()) else 3


def composition(program: Program) -> Composition:
    """Return the composition class of a program: C0, C1 or C2.

    C0: only one room is named. C2: for some branch, the room of its condition, the rooms of the goals below THEN and
    those below ELSE are disjoint. C1: everything else.
    """
    goals = [leaf.moves[-1].room.room_id for leaf in program.leaves]
    asked = [condition.room.room_id for condition in program.conditions]
    named = {*goals, *asked}
    named.update([move.room.room_id for leaf in program.leaves for move in leaf.moves])
    if len(named) == 1:
        return "C0"
    for condition, below_then, below_else in _sides(SHAPES[program.category].branches):
        room = asked[condition]
        then, otherwise = {goals[k] for k in below_then}, {goals[k] for k in below_else}
        if room not in then and room not in otherwise and then.isdisjoint(otherwise):
            return "C2"
    return "C1"


def _leaves_below(branches: tuple[Branch, ...], target: int) -> tuple[int, ...]:
    """Return the indices of the leaves below `target`, the target of a branch. A `target` ≥ 0 is the index of a branch;
    else `target` is ``-1 - leaf``.
    """
    if target < 0:
        return (-1 - target,)
    branch = branches[target]
    return _leaves_below(branches, branch.then) + _leaves_below(branches, branch.otherwise)


@cache
def _sides(branches: tuple[Branch, ...]) -> tuple[tuple[int, tuple[int, ...], tuple[int, ...]], ...]:
    """Return for each branch its condition and the leaves below THEN and below ELSE."""
    below = [tuple(_leaves_below(branches, to) for to in (one.then, one.otherwise)) for one in branches]
    return tuple((one.condition, then, otherwise) for one, (then, otherwise) in zip(branches, below, strict=True))


def oracle_linear(program: Program, leaf: int | None = None) -> tuple[RoomRef | ObjectRef, ...]:
    """Return the stops of a leaf, the gold one if None: leads on the way to it, then its waypoints, then its goal."""
    number = program.gold_leaf() if leaf is None else leaf
    return (*program.leads(number), *program.leaves[number].moves)


def with_leads(program: Program) -> Program:
    """Return `program` with a lead on each branch whose condition is about another room than the one before it; at
    first, about another room than that of the start.
    """
    here, branches = {0: program.start_room}, list[Branch]()
    for at, branch in enumerate(program.branches):  # a branch comes before those below it
        room = program.conditions[branch.condition].room
        branches.append(branch.model_copy(update={"lead": None if room.room_id == here[at] else room}))
        here[branch.then] = here[branch.otherwise] = room.room_id
    return program.model_copy(update={"branches": tuple(branches)})


def instruction_table(
    scene_id: str,
    programs: Iterable[tuple[str, Program]],
) -> pa.Table:
    """Return `programs`, pairs of instruction id and program, as INSTRUCTIONS rows in the given order, without text and
    counterfactual group.
    """
    given = list(programs)
    names, found = [name for name, _ in given], [program for _, program in given]
    golds = [program.gold_leaf() for program in found]
    documents = [program.model_dump() for program in found]
    columns: dict[str, Any] = {
        "scene_id": [scene_id] * len(names),
        "instruction_id": names,
        "group_id": [None] * len(names),
        "category": [program.category for program in found],
        "depth": [program.depth for program in found],
        "chain": [program.chain for program in found],
        "composition": [composition(program) for program in found],
        "oddness": [oddness(program) for program in found],
        "n_conditions": [len(program.conditions) for program in found],
        "n_relational": [sum([one.kind == "relation" for one in program.conditions]) for program in found],
        "n_leaves": [len(program.leaves) for program in found],
        "gold_leaf": golds,
        "moves": [len(program.leaves[gold].moves) for program, gold in zip(found, golds, strict=True)],
        "leads": [len(program.leads(gold)) for program, gold in zip(found, golds, strict=True)],
        "conditions": [one["conditions"] for one in documents],
        "branches": [one["branches"] for one in documents],
        "leaves": [one["leaves"] for one in documents],
        "text": [None] * len(names),
        "words": [None] * len(names),
    }
    arrays = [pa.array(columns[field.name], field.type) for field in INSTRUCTIONS]
    return pa.Table.from_arrays(arrays, schema=INSTRUCTIONS)


def instructions_with_text(table: pa.Table, texts: Mapping[str, str], groups: Mapping[str, str | None]) -> pa.Table:
    """Return INSTRUCTIONS rows with their text, number of words, and counterfactual group, by instruction id; null if
    missing.
    """
    names = table["instruction_id"].to_pylist()
    said = [texts.get(name) for name in names]
    new: dict[str, list[Any]] = {
        "group_id": [groups.get(name) for name in names],
        "text": said,
        "words": [None if text is None else len(text.split()) for text in said],
    }
    arrays = [
        pa.array(new[field.name], field.type) if field.name in new else table[field.name] for field in INSTRUCTIONS
    ]
    return pa.table(arrays, schema=INSTRUCTIONS)


def programs_from_table(table: pa.Table) -> list[tuple[str, Program]]:
    """Return (instruction id, program) of each row, in the table's order."""
    columns = ["instruction_id", "category", "conditions", "branches", "leaves"]
    return [
        (row["instruction_id"], Program.model_validate({name: row[name] for name in columns[1:]}))
        for row in table.select(columns).to_pylist()
    ]


def program_tree(program: Program) -> str:
    """Return the tree of `program` as text. ✔ and ✘ mark true and false conditions, ★ marks the gold leaf."""
    return "\n".join(_branch(program, 0, "", program.gold_leaf()))


def _branch(program: Program, at: int, indent: str, gold: int) -> Iterator[str]:
    branch = program.branches[at]
    lead = "" if branch.lead is None else f"GO TO {_room(branch.lead)}, "
    yield f"{indent}{lead}IF {_condition(program.conditions[branch.condition])}"
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
