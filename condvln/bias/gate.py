"""The bias gate: run every guesser on the episodes of an export and test whether any beats chance.

Each guesser is tested on all episodes, on each source, on each category of a source, and on the episodes whose
conditions use a given predicate. The p-values of all tests are corrected together.

Only one episode of each counterfactual group is guessed, the one with the smallest hash of its id. The members of a
group mirror each other: their guesses are not independent, and together they would hide a bias of the other episodes.
Whether gold leaves are evenly distributed is tested on all episodes.
"""

from __future__ import annotations

import hashlib
import heapq
import os
from collections import Counter, defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from condvln.bias.guesser_view import GuesserView
from condvln.bias.guessers import FIXED, LEARNED
from condvln.bias.regression import NO_GUESS
from condvln.bias.report import ALL, PRESENCE, BiasReport, Finding, Uniformity
from condvln.bias.significance import binomial_tail, holm, interval, p_by_scenes, p_uniform
from condvln.manifest import export_manifests, manifest_lines
from schemas.program import CATEGORIES

__all__ = ["CELL_CAP", "LEAST_EPISODES", "UNIFORM_FROM", "BiasGate", "judge", "judge_export"]

CELL_CAP: Final = 5_000
"""Largest number of episodes guessed per source and category, taken by the smallest hashes of their ids. So many are
enough to detect a bias of 3 %, and an export of any size fits in memory.
"""
LEAST_EPISODES: Final = 30
"""Smallest number of guesses for a separate test of a category or predicate; smaller ones count in the overall tests
only.
"""
UNIFORM_FROM: Final = 200
"""Number of episodes from which the gold leaves of a source and category are tested for evenness."""


def judge_export(folder: str | os.PathLike[str]) -> BiasReport:
    """Run the bias gate on all splits of an export folder together.

    Raises
    ------
    InputError : the folder has no manifest, or a manifest can't be read
    """
    return judge(_manifest_rows(Path(folder)))


def judge(rows: Iterable[Mapping[str, Any]]) -> BiasReport:
    """Run the bias gate on manifest rows (JSON objects) in any order.

    Raises
    ------
    FormatError : a row is not a valid manifest row
    """
    gate = BiasGate()
    for row in rows:
        gate.add(row)
    return gate.report()


class BiasGate:
    """The bias gate of an export that is being written: it is shown each manifest row, and judges all at the end."""

    def __init__(self) -> None:
        self._sample = _Sample()

    def add(self, row: Mapping[str, Any]) -> None:
        """Take note of one manifest row, in any order of the rows.

        Raises
        ------
        FormatError : it is not a valid manifest row
        """
        self._sample.add(GuesserView.of(row))

    def report(self) -> BiasReport:
        """Run every guesser on the rows, and test whether any beats chance."""
        return _judged(self._sample)


def _judged(sample: _Sample) -> BiasReport:
    views = sample.views()
    findings = list(_findings(views)) if len(views) >= LEAST_EPISODES else []
    cells = [
        Uniformity(source, category, tuple(counts), p_uniform(counts))
        for (source, category), counts in sorted(sample.gold.items())
        if sum(counts) >= UNIFORM_FROM
    ]
    corrected = holm([*(f.p for f in findings), *(cell.p for cell in cells)])
    tested = {(f.source, f.category) for f in findings if f.predicate == ALL}
    return BiasReport(
        episodes=len(views),
        groups=len(sample.groups),
        findings=tuple(replace(f, p_holm=p) for f, p in zip(findings, corrected, strict=False)),
        uniformity=tuple(replace(cell, p_holm=p) for cell, p in zip(cells, corrected[len(findings) :], strict=True)),
        untested=tuple((*cell, sum(n)) for cell, n in sorted(sample.gold.items()) if cell not in tested),
    )


class _Sample:
    """The episodes to guess, and how often each leaf is gold among all episodes."""

    def __init__(self) -> None:
        self.gold: dict[tuple[str, str], list[int]] = {}
        self.groups: dict[tuple[str, str], tuple[int, GuesserView]] = {}
        self._cells: dict[tuple[str, str], list[tuple[int, str, GuesserView]]] = {}

    def add(self, view: GuesserView) -> None:
        """Add one episode to the sample."""
        counts = self.gold.setdefault((view.source, view.category), [0] * len(view.leaves))
        counts[view.gold] += 1
        rank = int.from_bytes(hashlib.blake2b(view.episode_hash.encode(), digest_size=8).digest(), "big")
        if view.group is None:
            self._keep(rank, view)
            return
        key = (view.scene, view.group)
        known = self.groups.get(key)
        if known is None or rank < known[0]:
            self.groups[key] = (rank, view)

    def _keep(self, rank: int, view: GuesserView) -> None:
        cell = self._cells.setdefault((view.source, view.category), [])
        entry = (-rank, view.episode_hash, view)
        if len(cell) < CELL_CAP:
            heapq.heappush(cell, entry)
        else:
            heapq.heappushpop(cell, entry)

    def views(self) -> list[GuesserView]:
        """Return the episodes to guess, in an order that does not depend on the order in which they were added."""
        for rank, view in self.groups.values():
            self._keep(rank, view)
        found = [view for cell in self._cells.values() for _, _, view in cell]
        return sorted(found, key=lambda g: (g.source, g.category, g.scene, g.episode_hash))


def _findings(views: Sequence[GuesserView]) -> Iterator[Finding]:
    gold = np.array([view.gold for view in views])
    chance = np.array([1.0 / len(view.leaves) for view in views])
    scene = np.unique([view.scene for view in views], return_inverse=True)[1]
    source = np.array([view.source for view in views])
    category = np.array([CATEGORIES.index(view.category) for view in views])
    asked = _asked(views)
    known: dict[bytes, list[_Part]] = {}
    for name, guess in _guesses(views, source).items():
        guessed = guess != NO_GUESS
        parts = known.get(guessed.tobytes())
        if parts is None:
            parts = [_Part.of(*part, chance, scene) for part in _parts(source, category, asked, guessed)]
            known[guessed.tobytes()] = parts
        for part in parts:
            right = guess[part.inside] == gold[part.inside]
            low, high = interval(right, part.scenes)
            yield Finding(
                guesser=name,
                source=part.source,
                category=part.category,
                episodes=len(right),
                scenes=part.different_scenes,
                accuracy=float(right.mean()),
                chance=part.mean_chance,
                low=low,
                high=high,
                p=max(binomial_tail(int(right.sum()), part.trials), p_by_scenes(right - part.chance, part.scenes)),
                predicate=part.predicate,
            )


class _Part(NamedTuple):
    """A subset of the episodes that is tested separately.

    inside : indices of the part's episodes; chance : of each; mean_chance : the mean of these
    scenes : the scene of each, numbered from 0; different_scenes : the number of scenes
    trials : number of episodes by chance
    """

    source: str
    category: str
    predicate: str
    inside: NDArray[np.int64]
    chance: NDArray[np.float64]
    scenes: NDArray[np.int64]
    trials: Mapping[float, int]
    different_scenes: int
    mean_chance: float

    @classmethod
    def of(
        cls,
        source: str,
        category: str,
        predicate: str,
        inside: NDArray[np.int64],
        chance: NDArray[np.float64],
        scene: NDArray[np.int64],
    ) -> _Part:
        """Return the part that consists of the episodes with the indices `inside`. `chance` and `scene` have a value
        for every episode of the sample.
        """
        own = chance[inside]
        different, scenes = np.unique(scene[inside], return_inverse=True)
        trials = Counter(own.tolist())
        return cls(source, category, predicate, inside, own, scenes, trials, len(different), float(own.mean()))


def _guesses(views: Sequence[GuesserView], source: NDArray[np.str_]) -> dict[str, NDArray[np.int64]]:
    """Return, by guesser name, the guessed leaf of each episode. A learner treats each source separately."""
    found = {name: np.array([guesser(g) for g in views], dtype=np.int64) for name, guesser in FIXED.items()}
    found |= {name: np.full(len(views), NO_GUESS, dtype=np.int64) for name in LEARNED}
    for family in np.unique(source):
        mine = np.flatnonzero(source == family)
        own = [views[k] for k in mine.tolist()]
        for name, learner in LEARNED.items():
            found[name][mine] = learner(own)
    return found


def _asked(views: Sequence[GuesserView]) -> dict[str, NDArray[np.bool_]]:
    """Return, for each predicate, a mask of the episodes in which at least one condition uses this predicate."""
    places: defaultdict[str, list[int]] = defaultdict(list)
    for k, view in enumerate(views):
        for asked in view.asked:
            places[asked.predicate or PRESENCE].append(k)
    found = {predicate: np.zeros(len(views), dtype=np.bool_) for predicate in sorted(places)}
    for predicate, mask in found.items():
        mask[places[predicate]] = True
    return found


def _parts(
    source: NDArray[np.str_],
    category: NDArray[np.int64],
    asked: Mapping[str, NDArray[np.bool_]],
    guessed: NDArray[np.bool_],
) -> Iterator[tuple[str, str, str, NDArray[np.int64]]]:
    """Yield each subset of the episodes that is tested separately, as (source, category, predicate, indices of the
    subset's episodes). Only episodes in the mask `guessed` are included; subsets that are too small are left out.

    The parts are: all episodes, each source, each category of a source, and each predicate overall and within a source.
    The text states the predicates, so chance level is unchanged among the episodes that use one.
    """
    families = np.unique(source).tolist()
    everything = [(ALL, np.ones(len(source), dtype=np.bool_))] if len(families) > 1 else []
    for where, member in [*everything, *((family, source == family) for family in families)]:
        inside = guessed & member
        parts = [(ALL, ALL, inside)]
        if where != ALL:
            parts += [(name, ALL, inside & (category == k)) for k, name in enumerate(CATEGORIES)]
        # If every episode uses the predicate, this test would repeat the one of the source.
        parts += [(ALL, name, inside & own) for name, own in asked.items() if (inside & ~own).any()]
        for what, predicate, chosen in parts:
            if chosen.sum() >= LEAST_EPISODES:
                yield where, what, predicate, np.flatnonzero(chosen)


def _manifest_rows(folder: Path) -> Iterator[Mapping[str, Any]]:
    for path in export_manifests(folder):
        for line in manifest_lines(path):
            yield line.fields()
