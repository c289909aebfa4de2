"""Filling a scene's pool of episodes from candidate programs, within quotas and without favouring a label."""

from __future__ import annotations

import math
from collections import Counter, defaultdict
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, replace
from typing import Final

from condvln.episodes.observability import Observation, Observer
from condvln.episodes.placing import Placement, Placer, Rejected
from schemas.program import Category, Program

__all__ = ["Pool", "PooledEpisode", "fill_pool"]

FEW_LABELS_SLACK: Final = 1.25
"""Where a scene has so few labels that the cap can't hold, a label may have this much more than an equal share."""


@dataclass(frozen=True, eq=False, slots=True)
class PooledEpisode:
    """A program that found its place, and from where what it asks can be seen."""

    instruction_id: str
    program: Program
    placement: Placement
    observation: Observation | None = None


@dataclass
class Pool:
    """What one scene yields: its episodes in the order of their candidates, and why the others failed."""

    episodes: list[PooledEpisode] = field(default_factory=list)
    rejections: Counter[tuple[Category, str]] = field(default_factory=Counter)
    examples: dict[tuple[Category, str], str] = field(default_factory=dict)

    def reject(self, instruction_id: str, program: Program, reason: str) -> None:
        """Count one rejection, keeping the first id as its example."""
        key = (program.category, reason)
        self.rejections[key] += 1
        self.examples.setdefault(key, instruction_id)


def fill_pool(
    candidates: Iterable[tuple[str, Program]],
    placer: Placer,
    wanted: Mapping[Category, int],
    label_cap: float,
    names_compass: Callable[[Program], bool],
    observer: Observer | None = None,
) -> Pool:
    """Place candidates in their order until every category has what is wanted.

    Within a category no gold index gets more than its equal share, so that position says nothing. `label_cap` bounds
    the share of leaves that any label is the target of. Without an `observer` observability is not told.
    """
    pool = Pool()
    queue = list(candidates)
    taken: Counter[Category] = Counter()
    golds: dict[Category, Counter[int]] = defaultdict(Counter)
    labels: Counter[str] = Counter()
    allowed = math.ceil(label_cap * sum(_leaves(category, queue) * count for category, count in wanted.items()))
    seen: set[Program] = set()
    for instruction_id, program in queue:
        category = program.category
        if taken[category] >= wanted.get(category, 0):
            pool.reject(instruction_id, program, "quota_full")
            continue
        gold = program.gold_leaf()
        quota = -(-wanted[category] // len(program.leaves))
        targets = Counter(leaf.goal.label for leaf in program.leaves)
        if golds[category][gold] >= quota or program in seen:
            pool.reject(instruction_id, program, "quota_full")
            continue
        if any(labels[label] + count > allowed for label, count in targets.items()):
            pool.reject(instruction_id, program, "label_over_cap")
            continue
        try:
            placement = placer.place(program, instruction_id, compass=names_compass(program))
        except Rejected as rejected:
            pool.reject(instruction_id, program, rejected.reason)
            continue
        seen.add(program)
        taken[category] += 1
        golds[category][gold] += 1
        labels += targets
        pool.episodes.append(PooledEpisode(instruction_id, program, placement))
    _trim(pool, label_cap)
    if observer is not None:
        found = observer.observe([(e.program, e.placement) for e in pool.episodes])
        pool.episodes = [replace(e, observation=o) for e, o in zip(pool.episodes, found, strict=True)]
    return pool


def _leaves(category: Category, queue: list[tuple[str, Program]]) -> int:
    return next((len(program.leaves) for _, program in queue if program.category == category), 0)


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
        pool.reject(dropped.instruction_id, dropped.program, "label_over_cap")
