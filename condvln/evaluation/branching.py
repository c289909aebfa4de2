"""Which branch an agent took, and where it left the right one."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np

from schemas.program import Program

__all__ = ["NO_LEAF", "committed_leaf", "decisions", "first_divergence"]

NO_LEAF: Final = -1
"""The agent stopped at no leaf, or did not stop."""


def committed_leaf(distances: Sequence[float], radius: float) -> int:
    """The nearest leaf among those nearer than ``radius`` (metres from where the agent stopped); :data:`NO_LEAF` for
    none."""
    nearest = int(np.argmin(distances))
    return nearest if distances[nearest] < radius else NO_LEAF


def decisions(program: Program, leaf: int) -> tuple[tuple[int, bool], ...]:
    """Conditions asked on the way to ``leaf`` and the answer that leads there, from the root."""

    def search(at: int) -> tuple[tuple[int, bool], ...] | None:
        if at < 0:
            return () if -1 - at == leaf else None
        branch = program.branches[at]
        for target, answer in ((branch.then, True), (branch.otherwise, False)):
            below = search(target)
            if below is not None:
                return ((branch.condition, answer), *below)
        return None

    found = search(0)
    if found is None:
        raise ValueError(f"the program has no leaf {leaf}")
    return found


def first_divergence(program: Program, gold: int, committed: int) -> int | None:
    """How many decisions of the gold route the agent got right before its first wrong one; None if it made none wrong.

    The condition that it got wrong is ``decisions(program, gold)[…][0]`` at that place.
    """
    if committed in (gold, NO_LEAF):
        return None
    right, taken = decisions(program, gold), decisions(program, committed)
    return next(place for place, (a, b) in enumerate(zip(right, taken, strict=False)) if a != b)
