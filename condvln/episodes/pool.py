"""Filling a scene's pool of episodes from candidate programs, within quotas and without favouring a label."""

from __future__ import annotations

import math
from collections import Counter, defaultdict
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace
from typing import Final

from condvln.episodes.candidates import Candidate
from condvln.episodes.observability import FIRST_VIEW, Observation, Observer
from condvln.episodes.placing import Fit, Placement, Placer, Prospect, Rejected
from schemas.config import InstructionCell
from schemas.program import SHAPES, Program

__all__ = ["Pool", "PooledEpisode", "fill_pool"]

QUARTERS: Final = tuple(k * math.pi / 2 for k in range(4))
"""Turns of a start whose first view must show the evidence; they keep a compass point a compass point."""

FEW_LABELS_SLACK: Final = 1.25
"""Where a scene has so few labels that the cap can't hold, a label may have this much more than an equal share."""


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

    candidates : how many there were, by cell, of groups under None; each is an episode or is rejected once
    """

    episodes: list[PooledEpisode] = field(default_factory=list)
    candidates: Counter[InstructionCell | None] = field(default_factory=Counter)
    rejections: Counter[tuple[InstructionCell | None, str]] = field(default_factory=Counter)
    examples: dict[tuple[InstructionCell | None, str], str] = field(default_factory=dict)

    def reject(self, candidate: Candidate, reason: str) -> None:
        """Count one rejection, keeping the first id as its example."""
        key = (candidate.cell, reason)
        self.rejections[key] += 1
        self.examples.setdefault(key, candidate.instruction_id)

    @property
    def placed(self) -> Counter[InstructionCell | None]:
        """Episodes by cell, of groups under None."""
        return Counter(episode.candidate.cell for episode in self.episodes)


def fill_pool(
    candidates: Iterable[Candidate],
    placer: Placer,
    cells: Sequence[InstructionCell],
    label_cap: float,
    names_compass: Callable[[Program], bool],
    observer: Observer | None = None,
    groups: int = 0,
) -> Pool:
    """Place candidates in their order until every cell has what is wanted.

    Within a cell no gold index gets more than its equal share, so that position says nothing. `label_cap` bounds the
    share of leaves that any label is the target of. The programs of a counterfactual group are placed together, from
    one start, before all others, or not at all.

    Parameters
    ----------
    cells, groups : all that is wanted of the scene
    names_compass : whether a program's text names the start heading
    observer : tells observability; without it none is told, and none may be asked for
    """
    queue = list(candidates)
    members: defaultdict[str, list[Candidate]] = defaultdict(list)
    for candidate in queue:
        if candidate.group_id is not None:
            members[candidate.group_id].append(candidate)
    wanted = sum(cell.count * SHAPES[cell.category].leaves for cell in cells)
    if members:
        leaves = [len(c.program.leaves) for group in members.values() for c in group]
        wanted += round(groups * sum(leaves) / len(members))
    filling = _Filling(placer, math.ceil(label_cap * wanted), names_compass, observer)
    for group in members.values():
        filling.try_group(group, groups)
    for candidate in queue:
        if candidate.cell is not None:
            filling.try_one(candidate, candidate.cell)
    return filling.filled(label_cap)


class _Filling:
    def __init__(
        self,
        placer: Placer,
        most_of_label: int,
        names_compass: Callable[[Program], bool],
        observer: Observer | None,
    ) -> None:
        self._placer, self._names_compass, self._observer = placer, names_compass, observer
        self._most_of_label = most_of_label
        self._pool = Pool()
        self._groups = 0
        self._taken: Counter[InstructionCell] = Counter()
        self._golds: defaultdict[InstructionCell, Counter[int]] = defaultdict(Counter)
        self._labels: Counter[str] = Counter()
        self._seen: set[Program] = set()

    def filled(self, label_cap: float) -> Pool:
        """The pool, trimmed and observed."""
        _trim(self._pool, label_cap)
        if self._observer is not None:
            found = self._observer.observe([(e.program, e.placement.prospect) for e in self._pool.episodes])
            self._pool.episodes = [replace(e, observation=o) for e, o in zip(self._pool.episodes, found, strict=True)]
        return self._pool

    def try_one(self, candidate: Candidate, cell: InstructionCell) -> None:
        """An episode, or a reason why not."""
        program = candidate.program
        gold = program.gold_leaf()
        self._pool.candidates[cell] += 1
        quota = -(-cell.count // len(program.leaves))
        if program in self._seen:
            self._pool.reject(candidate, "program_placed")
        elif self._taken[cell] >= cell.count or self._golds[cell][gold] >= quota:
            self._pool.reject(candidate, "quota_full")
        elif self._placed([candidate], self._names_compass(program), self._fit(cell, program), cell.route):
            self._taken[cell] += 1
            self._golds[cell][gold] += 1

    def try_group(self, members: Sequence[Candidate], wanted: int) -> None:
        """An episode of each member, or one reason why none."""
        self._pool.candidates[None] += len(members)
        full = self._groups >= wanted
        if full or any(member.program in self._seen for member in members):
            for member in members:
                self._pool.reject(member, "quota_full" if full else "program_placed")
        elif self._placed(members, any(self._names_compass(member.program) for member in members)):
            self._groups += 1

    def _placed(
        self,
        members: Sequence[Candidate],
        compass: bool,
        fit: Fit | None = None,
        lengths: tuple[float, float] | None = None,
    ) -> bool:
        """Whether these, which have the same leaves in some order, are placed now, from one start."""
        first = members[0]
        try:
            targets = Counter(leaf.goal.label for member in members for leaf in member.program.leaves)
            if any(self._labels[label] + count > self._most_of_label for label, count in targets.items()):
                raise Rejected("label_over_cap")
            placement = self._placer.place(
                first.program, first.instruction_id, compass=compass, fit=fit, lengths=lengths
            )
        except Rejected as rejected:
            for member in members:
                self._pool.reject(member, rejected.reason)
            return False
        self._labels += targets
        for member in members:
            places = [first.program.leaves.index(leaf) for leaf in member.program.leaves]
            own = replace(placement, leaves=tuple(placement.leaves[k] for k in places))
            self._seen.add(member.program)
            self._pool.episodes.append(PooledEpisode(member, own))
        return True

    def _fit(self, cell: InstructionCell, program: Program) -> Fit | None:
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
        last = next(e for e in reversed(pool.episodes) if any(leaf.goal.label == label for leaf in e.program.leaves))
        group = last.candidate.group_id
        dropped = [e for e in pool.episodes if e is last or (group is not None and e.candidate.group_id == group)]
        pool.episodes = [e for e in pool.episodes if e not in dropped]
        for episode in dropped:
            labels -= Counter(leaf.goal.label for leaf in episode.program.leaves)
            pool.reject(episode.candidate, "label_over_cap")
