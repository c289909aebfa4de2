"""A supply of candidates from a list: all of a cell come at once, whatever is asked of them."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from condvln.episodes.candidates import Candidate
from schemas.config import InstructionCell

__all__ = ["Listed"]


class Listed:
    """Candidates of a list, in its order; like ``condvln.episodes.candidates.CandidateSupply``."""

    def __init__(self, candidates: Iterable[Candidate]) -> None:
        self._candidates = list(candidates)
        self.labels = len({leaf.goal.label for one in self._candidates for leaf in one.program.leaves})
        grouped = [one for one in self._candidates if one.group_id is not None]
        groups = list(dict.fromkeys(one.group_id for one in grouped))
        self._groups = [[one for one in grouped if one.group_id == name] for name in groups]
        self.group_leaves = sum(len(one.program.leaves) for one in grouped) / max(1, len(groups))

    def group(self) -> Sequence[Candidate]:
        return self._groups.pop(0) if self._groups else ()

    def leads_of(self, cell: InstructionCell) -> int:
        return 0

    def more(
        self, cell: InstructionCell, count: int, golds: Sequence[int], moves: Sequence[float] | None
    ) -> Sequence[Candidate]:
        assert count > 0
        assert golds
        found = [one for one in self._candidates if one.cell == cell]
        self._candidates = [one for one in self._candidates if one.cell != cell]
        return found
