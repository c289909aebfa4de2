"""Instructions of a scene that nobody can walk yet: it ships no navmesh and nothing to build one from."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Iterable, Mapping

import pyarrow as pa

from schemas.program import Category, Program

__all__ = ["UNPLACED", "unplaced_programs", "unplaced_table"]

UNPLACED = pa.schema([("instruction_id", pa.string())])
"""Ids of instructions that are published without an episode; kept in the unit."""


def unplaced_programs(candidates: Iterable[tuple[str, Program]], wanted: Mapping[Category, int]) -> list[str]:
    """Ids of the first programs of each category, in their order, up to what is wanted of it.

    As in a pool of episodes, no gold index gets more than its equal share of a category.
    """
    taken: Counter[Category] = Counter()
    golds: dict[Category, Counter[int]] = defaultdict(Counter)
    seen: set[Program] = set()
    chosen = []
    for name, program in candidates:
        category, gold = program.category, program.gold_leaf()
        quota = -(-wanted.get(category, 0) // len(program.leaves))
        if taken[category] >= wanted.get(category, 0) or golds[category][gold] >= quota or program in seen:
            continue
        seen.add(program)
        taken[category] += 1
        golds[category][gold] += 1
        chosen.append(name)
    return chosen


def unplaced_table(names: Iterable[str]) -> pa.Table:
    """The ids as UNPLACED rows."""
    return pa.table({"instruction_id": pa.array(names, pa.string())}, schema=UNPLACED)
