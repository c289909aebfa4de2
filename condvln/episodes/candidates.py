"""Candidate programs: what the sampler drew for a scene, in the order in which placing tries them."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Final

import pyarrow as pa

from condvln.instructions.counterfactuals import group_id
from condvln.instructions.programs import ProgramParts, instruction_id
from condvln.instructions.sampling import ProgramSampler
from condvln.instructions.tables import instruction_table, programs_from_table
from schemas.config import InstructionCell
from schemas.program import CATEGORIES, Program
from schemas.tables import INSTRUCTIONS

__all__ = [
    "UNPLACED",
    "Candidate",
    "candidates_from_table",
    "candidates_table",
    "cell_name",
    "draw_candidates",
    "unplaced_programs",
    "unplaced_table",
]

GROUPS: Final = "counterfactual groups"
"""Cell name of the candidates in counterfactual groups."""

UNPLACED: Final = pa.schema([("instruction_id", pa.string())])
"""Schema of the ids of instructions that are published without an episode because their scene has no navmesh; stored in
the unit.
"""

_CELL: Final = pa.field("cell", pa.string(), nullable=False)
_GROUP: Final = INSTRUCTIONS.field("group_id")


@dataclass(frozen=True, slots=True)
class Candidate:
    """A program to be placed, and the cell for which it was drawn; `cell` is None for a member of a counterfactual
    group.
    """

    instruction_id: str
    program: Program
    cell: InstructionCell | None
    group_id: str | None = None


def cell_name(cell: InstructionCell | None) -> str:
    """Return the name of a cell in the tables; None gives the name for counterfactual groups."""
    return GROUPS if cell is None else cell.name


def draw_candidates(sampler: ProgramSampler) -> list[Candidate]:
    """Draw all candidates: the programs of each cell, then the counterfactual groups, which may repeat some
    programs.
    """
    family, scene_id = sampler.scene.family, sampler.scene.scene_id
    parts = ProgramParts()
    found = [
        Candidate(instruction_id(family, scene_id, program, parts), program, cell)
        for category in CATEGORIES
        for cell, program in sampler.drawn(category)
    ]
    for group in sampler.groups():
        name = group_id(family, scene_id, group)
        found += [Candidate(instruction_id(family, scene_id, program, parts), program, None, name) for program in group]
    return found


def candidates_table(scene_id: str, candidates: Sequence[Candidate]) -> pa.Table:
    """Return candidates as table rows: the columns of INSTRUCTIONS, and ``cell``."""
    table = instruction_table(scene_id, ((c.instruction_id, c.program) for c in candidates))
    groups = pa.array([c.group_id for c in candidates], _GROUP.type)
    table = table.set_column(table.schema.get_field_index(_GROUP.name), _GROUP, groups)
    return table.append_column(_CELL, pa.array([cell_name(c.cell) for c in candidates], _CELL.type))


def candidates_from_table(table: pa.Table, cells: Iterable[InstructionCell]) -> list[Candidate]:
    """Return the candidates from the rows of `candidates_table`, in order; `cells` are the cells for which they were
    drawn.
    """
    named = {cell.name: cell for cell in cells}
    columns = (table[name].to_pylist() for name in (_CELL.name, _GROUP.name))
    return [
        Candidate(name, program, None if group is not None else named[cell], group)
        for (name, program), cell, group in zip(programs_from_table(table), *columns, strict=True)
    ]


def unplaced_programs(candidates: Iterable[Candidate]) -> list[str]:
    """Return the ids of the programs to keep if a scene's programs can't be placed: the first ones of each cell, up to
    the number of programs that the cell asks for.

    As in a pool of episodes, no gold index gets more than its equal share of a cell. Without a navmesh there are
    neither starts, views nor routes, so a cell's limits on observability, routes and shared starts are ignored.
    """
    taken: Counter[InstructionCell] = Counter()
    golds: dict[InstructionCell, Counter[int]] = defaultdict(Counter)
    chosen = []
    for candidate in candidates:
        cell, gold = candidate.cell, candidate.program.gold_leaf()
        if cell is None:
            continue
        quota = -(-cell.count // len(candidate.program.leaves))
        if taken[cell] >= cell.count or golds[cell][gold] >= quota:
            continue
        taken[cell] += 1
        golds[cell][gold] += 1
        chosen.append(candidate.instruction_id)
    return chosen


def unplaced_table(names: Iterable[str]) -> pa.Table:
    """Return the program ids `names` as rows of the schema UNPLACED."""
    return pa.table({"instruction_id": pa.array(names, pa.string())}, schema=UNPLACED)
