"""The oracle-linear twin: what is left of an instruction once its conditions are resolved."""

from __future__ import annotations

from schemas.program import ObjectRef, Program

__all__ = ["oracle_linear"]


def oracle_linear(program: Program) -> tuple[ObjectRef, ...]:
    """The moves of the gold leaf alone, waypoints in their order; the last is the goal."""
    return program.leaves[program.gold_leaf()].moves
