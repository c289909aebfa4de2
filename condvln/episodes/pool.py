"""Filling a scene's pool of episodes from candidate programs, within quotas and without favouring a label."""

from __future__ import annotations

import math
from collections import Counter, defaultdict
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace
from typing import Final

from condvln.episodes.observability import FIRST_VIEW, Observation, Observer
from condvln.episodes.placing import Fit, Placement, Placer, Prospect, Rejected
from condvln.instructions.config import Cell
from schemas.program import SHAPES, Program

__all__ = ["Candidate", "Pool", "PooledEpisode", "fill_pool"]

QUARTERS: Final = tuple(k * math.pi / 2 for k in range(4))
"""Turns of a start whose first view must show the evidence; they keep a compass point a compass point."""

FEW_LABELS_SLACK: Final = 1.25
"""Where a scene has so few labels that the cap can't hold, a label may have this much more than an equal share."""


@dataclass(frozen=True, slots=True)
class Candidate:
    """A program to be placed, and the cell that it was drawn for."""

    instruction_id: str
    program: Program
    cell: Cell


@dataclass(frozen=True, eq=False, slots=True)
class PooledEpisode:
    """A candidate that found its place, and from where what it asks can be seen."""

    candidate: Candidate
    placement: Placement
    observation: Observation | None = None

    @property
    def instruction_id(self) -> str:
        """Id of its instruction."""
        return self.candidate.instruction_id

    @property
    def program(self) -> Program:
        """Its program."""
        return self.candidate.program


@dataclass
class Pool:
    """What one scene yields: its episodes in the order of their candidates, and why the others failed.

    candidates : how many there were, by cell; each is an episode or is rejected once
    """

    episodes: list[PooledEpisode] = field(default_factory=list)
    candidates: Counter[Cell] = field(default_factory=Counter)
    rejections: Counter[tuple[Cell, str]] = field(default_factory=Counter)
    examples: dict[tuple[Cell, str], str] = field(default_factory=dict)

    def reject(self, candidate: Candidate, reason: str) -> None:
        """Count one rejection, keeping the first id as its example."""
        key = (candidate.cell, reason)
        self.rejections[key] += 1
        self.examples.setdefault(key, candidate.instruction_id)

    @property
    def placed(self) -> Counter[Cell]:
        """Episodes by cell."""
        return Counter(episode.candidate.cell for episode in self.episodes)


def fill_pool(
    candidates: Iterable[Candidate],
    placer: Placer,
    cells: Sequence[Cell],
    label_cap: float,
    names_compass: Callable[[Program], bool],
    observer: Observer | None = None,
) -> Pool:
    """Place candidates in their order until every cell has what is wanted.

    Within a cell no gold index gets more than its equal share, so that position says nothing. `label_cap` bounds the
    share of leaves that any label is the target of.

    Parameters
    ----------
    cells : all that is wanted of the scene
    names_compass : whether a program's text names the start heading
    observer : tells observability; without it none is told, and none may be asked for
    """
    return _Filling(placer, cells, label_cap, names_compass, observer).of(candidates)


class _Filling:
    def __init__(
        self,
        placer: Placer,
        cells: Sequence[Cell],
        label_cap: float,
        names_compass: Callable[[Program], bool],
        observer: Observer | None,
    ) -> None:
        self._placer, self._names_compass, self._observer = placer, names_compass, observer
        self._label_cap = label_cap
        self._most_of_label = math.ceil(label_cap * sum(cell.count * SHAPES[cell.category].leaves for cell in cells))
        self._pool = Pool()
        self._taken: Counter[Cell] = Counter()
        self._golds: defaultdict[Cell, Counter[int]] = defaultdict(Counter)
        self._labels: Counter[str] = Counter()
        self._seen: set[Program] = set()

    def of(self, candidates: Iterable[Candidate]) -> Pool:
        for candidate in candidates:
            self._pool.candidates[candidate.cell] += 1
            self._try(candidate)
        _trim(self._pool, self._label_cap)
        if self._observer is not None:
            found = self._observer.observe([(e.program, e.placement.prospect) for e in self._pool.episodes])
            self._pool.episodes = [replace(e, observation=o) for e, o in zip(self._pool.episodes, found, strict=True)]
        return self._pool

    def _try(self, candidate: Candidate) -> None:
        cell, program = candidate.cell, candidate.program
        gold, targets = program.gold_leaf(), Counter(leaf.goal.label for leaf in program.leaves)
        reason = self._refusal(cell, program, gold, targets)
        if reason is not None:
            self._pool.reject(candidate, reason)
            return
        try:
            placement = self._placer.place(
                program, candidate.instruction_id, compass=self._names_compass(program), fit=self._fit(cell, program)
            )
        except Rejected as rejected:
            self._pool.reject(candidate, rejected.reason)
            return
        self._seen.add(program)
        self._taken[cell] += 1
        self._golds[cell][gold] += 1
        self._labels += targets
        self._pool.episodes.append(PooledEpisode(candidate, placement))

    def _refusal(self, cell: Cell, program: Program, gold: int, targets: Counter[str]) -> str | None:
        """Why a candidate need not be placed at all."""
        quota = -(-cell.count // len(program.leaves))
        if program in self._seen:
            return "program_placed"
        if self._taken[cell] >= cell.count or self._golds[cell][gold] >= quota:
            return "quota_full"
        if any(self._labels[label] + count > self._most_of_label for label, count in targets.items()):
            return "label_over_cap"
        return None

    def _fit(self, cell: Cell, program: Program) -> Fit | None:
        asked, observer = cell.observability, self._observer
        if asked is None:
            return None
        assert observer is not None, "a cell asks for an observability and nothing tells it"
        turns = QUARTERS if asked == FIRST_VIEW else QUARTERS[:1]

        def fit(prospect: Prospect) -> float | None:
            for turn in turns:
                yaw = math.remainder(prospect.yaw + turn, 2 * math.pi)
                if observer.observe([(program, replace(prospect, yaw=yaw))])[0].fits(asked):
                    return yaw
            return None

        return fit


def _trim(pool: Pool, label_cap: float) -> None:
    """Drop episodes, last first, until no label is over its share: a small yield must not lean on one label."""
    labels = Counter(leaf.goal.label for e in pool.episodes for leaf in e.program.leaves)
    cap = max(label_cap, FEW_LABELS_SLACK / max(1, len(labels)))
    while labels:
        total = sum(labels.values())
        label, count = max(sorted(labels.items()), key=lambda item: item[1])
        # Rounded up, so that a handful of leaves is not trimmed away for being a handful.
        if count <= math.ceil(cap * total):
            return
        last = max(k for k, e in enumerate(pool.episodes) if any(leaf.goal.label == label for leaf in e.program.leaves))
        dropped = pool.episodes.pop(last)
        labels -= Counter(leaf.goal.label for leaf in dropped.program.leaves)
        pool.reject(dropped.candidate, "label_over_cap")
