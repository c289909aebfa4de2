"""The verdict on one statement, and the numbers that the verdict is based on."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

__all__ = ["FALSE", "TRUE", "UNDECIDED", "Judgement", "judged"]

TRUE, FALSE, UNDECIDED = 1, -1, 0


class Judgement(NamedTuple):
    """A verdict (true, false, or undecided), and the metres, degrees and shares that the verdict is based on."""

    verdict: int
    numbers: Mapping[str, float | None]


def judged(
    true: bool, false: bool, shares: Mapping[str, float | None] | None = None, **millimetres: float | None
) -> Judgement:
    """Return the judgement that follows from `true` and `false`; it is undecided if neither is set. `shares` are stored
    unchanged, all other numbers are converted from millimetres to metres.
    """
    verdict = TRUE if true else FALSE if false else UNDECIDED
    metres = {k: None if v is None else round(v / 1000.0, 3) for k, v in millimetres.items()}
    return Judgement(verdict, {**metres, **(shares or {})})
