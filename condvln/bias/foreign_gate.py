"""The bias gate on other people's files: can a guesser that sees only the text predict how a conditional episode ends?

Two questions are asked of each file. *Which clause*: if one clause of a text ends at the start (or on another floor)
and the other does not, the file's own path shows which clause was right; chance is a half. *Stays or goes*: of these
texts, and of conditional ones that could not be split, whether the path ends within `STAYS_WITHIN` of its start; chance
is the share of the more frequent answer. Guessers learn from other scenes only, as in the gate on exports.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from condvln.bias.blocks import NO_GUESS, progressive
from condvln.bias.clauses import Clauses, Motion, is_conditional, motion, read_clauses
from condvln.bias.foreign_episodes import ForeignEpisode, read_foreign
from condvln.bias.learners import content_words
from condvln.bias.regression import regressed
from condvln.bias.report import BiasReport, Finding
from condvln.bias.significance import binomial_tail, holm, interval, p_by_scenes
from condvln.language.measures import words

__all__ = ["LEAST_GUESSES", "STAYS_WITHIN", "ForeignReport", "judge_files"]

STAYS_WITHIN: Final = 2.0
"""Largest horizontal distance in metres from start to end of a path that "stays"."""
FLOOR_HEIGHT: Final = 1.5
"""Least height difference in metres of a path that changes floor; below a third of it, it does not."""
LEAST_GUESSES: Final = 30
"""Smallest number of texts for which a question is tested."""
CLAUSE: Final = "which clause"
STAYS: Final = "stays or goes"
_WORDS_A_CLASS: Final = 5

Guesses = NDArray[np.int64]


@dataclass(frozen=True, slots=True)
class _View:
    """What a guesser sees of a text, and the right answer. `scene` only says which texts share a scene."""

    scene: str
    text: str
    clauses: Clauses | None
    gold: int


@dataclass(frozen=True)
class FileCounts:
    """Numbers of texts in a file: all texts, those with a condition, those that could be split, and those whose path
    shows which clause was right. `mean_words` is the mean length of all texts.
    """

    texts: int
    conditional: int
    read: int
    decided: int
    scenes: int
    mean_words: float


@dataclass(frozen=True)
class ForeignReport:
    """The counts of texts in each file, by the file's path, and the results of all tests on all files."""

    files: Mapping[str, FileCounts]
    bias: BiasReport

    def document(self) -> dict[str, Any]:
        """The report as JSON."""
        return {
            "files": {
                name: {
                    "texts": one.texts,
                    "conditional": one.conditional,
                    "read": one.read,
                    "decided": one.decided,
                    "scenes": one.scenes,
                    "mean_words": round(one.mean_words, 2),
                }
                for name, one in self.files.items()
            },
            **self.bias.document(),
        }


def judge_files(paths: Sequence[Path]) -> ForeignReport:
    """Run the gate on each file separately and return all results; the p-values of all tests are corrected together.

    Raises
    ------
    InputError : a file can't be read
    """
    files: dict[str, FileCounts] = {}
    findings: list[Finding] = []
    for path in paths:
        episodes = list(read_foreign(path))
        files[str(path)], views = _questions(episodes)
        name = path.name if len(paths) > 1 else ""
        for question, asked in views.items():
            findings += _findings(f"{name}: {question}" if name else question, asked, question == CLAUSE)
    corrected = holm([f.p for f in findings]) if findings else []
    judged = tuple(replace(f, p_holm=p) for f, p in zip(findings, corrected, strict=True))
    return ForeignReport(files, BiasReport(sum(one.conditional for one in files.values()), 0, judged, ()))


def _questions(episodes: Iterable[ForeignEpisode]) -> tuple[FileCounts, dict[str, list[_View]]]:
    views: dict[str, list[_View]] = {CLAUSE: [], STAYS: []}
    counts, scenes = Counter[str](), set()
    for episode in episodes:
        counts["texts"] += 1
        counts["words"] += len(words(episode.text))
        scenes.add(episode.scene)
        if not is_conditional(episode.text):
            continue
        counts["conditional"] += 1
        clauses = read_clauses(episode.text)
        counts["read"] += clauses is not None
        ends = _ends(clauses)
        clause = _clause(ends, episode)
        if clause is not None:
            counts["decided"] += 1
            views[CLAUSE].append(_View(episode.scene, episode.text, clauses, clause))
        if episode.displacement is not None and (clauses is None or "stays" in ends):
            stays = episode.displacement < STAYS_WITHIN
            views[STAYS].append(_View(episode.scene, episode.text, clauses, int(stays)))
    total = counts["texts"]
    found = FileCounts(
        total, counts["conditional"], counts["read"], counts["decided"], len(scenes), counts["words"] / max(1, total)
    )
    return found, views


def _ends(clauses: Clauses | None) -> tuple[Motion, ...]:
    """Return how far each of the two clauses leads, see `motion`; empty if the text does not have two clauses."""
    if clauses is None or not clauses.otherwise:
        return ()
    return motion(clauses.then, clauses), motion(clauses.otherwise, clauses)


def _clause(ends: tuple[Motion, ...], episode: ForeignEpisode) -> int | None:
    """Return 0 if the episode's path follows the first clause, 1 if it follows the "otherwise" clause, None if the path
    does not show which. `ends` says how far each of the two clauses leads; empty if there are not two.
    """
    if len(set(ends)) < 2 or episode.displacement is None:
        return None
    if "stays" in ends:
        at = ends.index("stays")
        return at if episode.displacement < STAYS_WITHIN else 1 - at
    if episode.rise is None or FLOOR_HEIGHT / 3 < abs(episode.rise) < FLOOR_HEIGHT:
        return None
    at = ends.index("changes floor")
    return at if abs(episode.rise) >= FLOOR_HEIGHT else 1 - at


def _findings(question: str, views: Sequence[_View], of_clauses: bool) -> Iterator[Finding]:
    if len(views) < LEAST_GUESSES:
        return
    gold = np.array([view.gold for view in views])
    scene = np.unique([view.scene for view in views], return_inverse=True)[1]
    rules = _RULES if of_clauses else {}
    guesses = {name: np.array([rule(v) for v in views], dtype=np.int64) for name, rule in rules.items()}
    guesses["majority"] = _majority(views)
    for name, features in _FEATURES.items():
        guesses[name] = regressed(views, features)
    for name, guess in guesses.items():
        inside = guess != NO_GUESS
        if inside.sum() < LEAST_GUESSES:
            continue
        right, own = guess[inside] == gold[inside], scene[inside]
        share = float(gold[inside].mean())
        # A text does not reveal which answer is more frequent overall, so that is the chance level; for two clauses it
        # is a half.
        chance = 0.5 if of_clauses else max(share, 1.0 - share)
        low, high = interval(right, own)
        tail = binomial_tail(int(right.sum()), {chance: len(right)})
        yield Finding(
            guesser=name,
            source=question,
            category="all",
            episodes=len(right),
            scenes=len(np.unique(own)),
            accuracy=float(right.mean()),
            chance=chance,
            low=low,
            high=high,
            p=max(tail, p_by_scenes(right - chance, own)),
        )


def _majority(views: Sequence[_View]) -> Guesses:
    guesses = np.full(len(views), NO_GUESS, dtype=np.int64)
    for learned, guessed in progressive([view.scene for view in views]):
        guesses[guessed] = int(2 * sum(views[k].gold for k in learned) > len(learned))
    return guesses


def _stays(view: _View) -> int:
    """Return the index of the clause whose route ends at the start position; 0 if none does."""
    ends = _ends(view.clauses)
    return ends.index("stays") if "stays" in ends else 0


def _longest(view: _View) -> int:
    assert view.clauses is not None
    return int(len(view.clauses.otherwise.split()) > len(view.clauses.then.split()))


_RULES: Final[Mapping[str, Callable[[_View], int]]] = {
    "always then": lambda view: 0,
    "always otherwise": lambda view: 1,
    "the clause that stays": _stays,
    "the clause that goes": lambda view: 1 - _stays(view),
    "longer clause": _longest,
    "shorter clause": lambda view: 1 - _longest(view),
}


def _parts(view: _View) -> tuple[tuple[str, str], ...]:
    found = view.clauses
    if found is None:
        return (("text", view.text.lower()),)
    return ("asks", found.condition), ("then", found.then), ("otherwise", found.otherwise)


def _bag(view: _View) -> Iterator[str]:
    """Yield the words and word pairs of the whole text."""
    said = words(view.text)
    yield from said
    yield from (f"{one} {other}" for one, other in pairwise(said))


def _asked(view: _View) -> Iterator[str]:
    """Yield the words of the condition."""
    for name, text in _parts(view):
        if name != "otherwise" and name != "then":
            yield from words(text)


def _in_place(view: _View) -> Iterator[str]:
    """Yield each word of a text, marked with the clause in which the word occurs."""
    for name, text in _parts(view):
        yield from (f"{name} {word}" for word in words(text))


def _form(view: _View) -> Iterator[str]:
    """Yield the pairs of consecutive words in each part of a text. Nouns of objects and rooms are replaced by "_", and
    each pair is marked with the part's name.
    """
    content = content_words()
    for name, text in _parts(view):
        said = [word if word not in content else "_" for word in words(text)]
        yield from (f"{name} {one} {other}" for one, other in pairwise(said))


def _length(view: _View) -> Iterator[str]:
    """Yield the lengths of the text and its clauses."""
    yield f"{len(words(view.text)) // _WORDS_A_CLASS} fives"
    for name, text in _parts(view):
        yield f"{name} {len(words(text)) // _WORDS_A_CLASS} fives"


_FEATURES: Final[Mapping[str, Callable[[_View], Iterable[str]]]] = {
    "what is asked": _asked,
    "form of the text": _form,
    "length": _length,
    "bag of words": _bag,
    "words in place": _in_place,
}
