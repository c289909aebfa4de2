"""Instructions of a scene that nobody can walk yet: it ships no navmesh and nothing to build one from."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Iterable

import pyarrow as pa

from condvln.episodes.candidates import Candidate
from schemas.config import InstructionCell

__all__ = ["UNPLACED", "unplaced_programs", "unplaced_table"]

UNPLACED = pa.schema([("instruction_id", pa.string())])
"""Ids of instructions that are published without an episode; kept in the unit."""


def unplaced_programs(candidates: Iterable[Candidate]) -> list[str]:
    """Ids of the first programs of each cell, in their order, up to what is wanted of it.

    As in a pool of episodes, no gold index gets more than its equal share of a cell. Where nobody can stand nothing is
    seen and no route begins, so what a cell asks of observability and of routes is left open, and what shares a start
    has none to share.
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
    """The ids as UNPLACED rows."""
    return pa.table({"instruction_id": pa.array(names, pa.string())}, schema=UNPLACED)
