"""Guessers that learn from other scenes: which leaf is usually gold, which statements are usually true, which words
predict a leaf.
"""

from __future__ import annotations

import re
import sys
from collections import Counter, defaultdict
from collections.abc import Callable, Hashable, Iterable, Iterator, Mapping, Sequence
from functools import cache, lru_cache, reduce
from itertools import pairwise, product
from operator import add
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from condvln.bias.blocks import NO_GUESS, progressive
from condvln.bias.guesser_view import Asked, GuesserView
from condvln.bias.regression import Guesses, regressed
from condvln.instructions.language import LANGUAGES, language
from condvln.labels import vocabulary
from schemas.program import CATEGORIES, SHAPES, Category

__all__ = ["LEARNED", "Learner", "content_words", "leaf_truths"]

Learner = Callable[[Sequence[GuesserView]], Guesses]
"""A learner returns one guess per episode of a source. It learns each block from the blocks before it, so that the
first block gets `NO_GUESS`.
"""

PRIOR_WEIGHT: Final = 2.0
"""Weight of the prior in observations: a statement seen once should hardly change the estimate."""
LEAST_EPISODES: Final = 30
"""Smallest number of episodes of a category for which a regression is fitted."""
WORDS_A_CLASS: Final = 10
"""Width in words of a length class: texts of one class count as equally long."""
MOST_TIMES: Final = 4
"""Largest count of one word in one text; more occurrences count as this many."""
TEXTS_KEPT: Final = 16_384
"""Number of texts whose words are kept for the next guesser."""
_SENTENCE_END: Final = re.compile(r"(?<=[.?!])\s+")

Words = Callable[[GuesserView], Iterable[Hashable]]
"""The words of a text that a regression learns from; a pair of words is one, too."""


@cache
def leaf_truths(category: Category) -> tuple[tuple[tuple[int, bool], ...], ...]:
    """Return, for each leaf, the (condition index, truth) pairs on the path from the root of the tree to the leaf."""
    shape = SHAPES[category]
    found: dict[int, tuple[tuple[int, bool], ...]] = {}
    ahead: list[tuple[int, tuple[tuple[int, bool], ...]]] = [(0, ())]
    while ahead:
        at, way = ahead.pop()
        if at < 0:
            found[-1 - at] = way
            continue
        branch = shape.branches[at]
        ahead.append((branch.then, (*way, (branch.condition, True))))
        ahead.append((branch.otherwise, (*way, (branch.condition, False))))
    return tuple(found[leaf] for leaf in range(shape.leaves))


@cache
def _usual_truth(category: Category) -> tuple[float, ...]:
    """Return how often each condition is true if all leaves are equally often gold.

    Conditions that are not on the path to the gold leaf count as true with probability 1/2.
    """
    shape = SHAPES[category]
    n = len(shape.branches)
    share = np.zeros(n)
    for leaf in range(shape.leaves):
        fitting = [
            truths
            for truths in product((True, False), repeat=n)
            if all(truths[k] == truth for k, truth in leaf_truths(category)[leaf])
        ]
        share += np.mean(fitting, axis=0) / shape.leaves
    return tuple(share.tolist())


def majority_leaf(views: Sequence[GuesserView]) -> Guesses:
    """Guess the leaf that was gold most often in the same category."""
    guesses = np.full(len(views), NO_GUESS, dtype=np.int64)
    seen: defaultdict[str, Counter[int]] = defaultdict(Counter)
    counted = 0
    for learned, guessed in progressive([view.scene for view in views]):
        for k in learned[counted:].tolist():
            seen[views[k].category][views[k].gold] += 1
        counted = len(learned)
        for k in guessed.tolist():
            counts = seen[views[k].category]
            guesses[k] = max(range(len(views[k].leaves)), key=lambda leaf: (counts[leaf], -leaf))
    return guesses


def _prior(key: Callable[[Asked], tuple[str, ...]], *, against: bool = False) -> Learner:
    """Return a learner that picks the likeliest leaf, judged by how often statements with the same `key` were true in
    the episodes that it learned from; with `against`, the unlikeliest leaf. If the statements of some scenes are asked
    so that they balance those of the others, the unlikeliest leaf is gold too often.

    `key` maps a condition to the statement that is counted. A condition's position in the tree alone changes how often
    it is true, so the estimate uses the ratio of observed to expected counts.
    """

    def learner(views: Sequence[GuesserView]) -> Guesses:
        guesses = np.full(len(views), NO_GUESS, dtype=np.int64)
        asked = _Statements.of(views, key)
        category = np.array([CATEGORIES.index(view.category) for view in views])
        seen = np.zeros((asked.different, 4))
        counted = 0
        for learned, guessed in progressive([view.scene for view in views]):
            asked.add_to(seen, learned[counted:])
            counted = len(learned)
            for code in np.unique(category[guessed]).tolist():
                mine = guessed[category[guessed] == code]
                scores = asked.scores(seen, mine, CATEGORIES[code])
                guesses[mine] = (scores.argmin if against else scores.argmax)(axis=0)
        return guesses

    return learner


class _Statements(NamedTuple):
    """The statements of all conditions of some episodes, one after the other.

    different : number of different statements; begins : (episodes,) place of each episode's first condition
    statement, truth, share : number and truth of each, and how often it is true if all leaves are equally often gold
    """

    different: int
    begins: NDArray[np.int64]
    statement: NDArray[np.int64]
    truth: NDArray[np.int64]
    share: NDArray[np.float64]

    @classmethod
    def of(cls, views: Sequence[GuesserView], key: Callable[[Asked], tuple[str, ...]]) -> _Statements:
        """Return the statements of `views`; `key` says which conditions state the same."""
        numbers: dict[tuple[str, ...], int] = {}
        asked = [one for view in views for one in view.asked]
        statement = np.array([numbers.setdefault(key(one), len(numbers)) for one in asked], dtype=np.int64)
        return cls(
            len(numbers),
            np.cumsum([0, *(len(view.asked) for view in views)], dtype=np.int64),
            statement,
            np.array([one.truth for one in asked], dtype=np.int64),
            np.array([share for view in views for share in _usual_truth(view.category)]),
        )

    def add_to(self, seen: NDArray[np.float64], episodes: NDArray[np.int64]) -> None:
        """Add the statements of `episodes` to `seen`, (statements, 4): how often each was false and true, and how often
        that is to be expected.
        """
        sizes = self.begins[episodes + 1] - self.begins[episodes]
        firsts = np.repeat(self.begins[episodes] - (np.cumsum(sizes) - sizes), sizes)
        places = firsts + np.arange(len(firsts))
        statement, share = self.statement[places], self.share[places]
        np.add.at(seen, (statement, self.truth[places]), 1.0)
        np.add.at(seen[:, 2], statement, 1.0 - share)
        np.add.at(seen[:, 3], statement, share)

    def scores(self, seen: NDArray[np.float64], episodes: NDArray[np.int64], category: Category) -> NDArray[np.float64]:
        """Return a score for each leaf of each of `episodes`, which are of one category, (leaves, episodes): larger if
        statements were often true and false as on the way to this leaf.
        """
        usual = np.array(_usual_truth(category))
        prior = PRIOR_WEIGHT * np.stack([1.0 - usual, usual], axis=1)
        counts = seen[self.statement[self.begins[episodes][:, None] + np.arange(len(usual))]]
        odds = np.log((counts[..., :2] + prior) / (counts[..., 2:] + prior))
        ways = leaf_truths(category)
        return np.array([reduce(add, [odds[:, k, int(truth)] for k, truth in way]) for way in ways])


def _in_layout(learner: Learner) -> Learner:
    """Return a learner that applies `learner` to each layout separately, so that the guesses for a layout are learned
    only from episodes of the same layout.
    """

    def guesser(views: Sequence[GuesserView]) -> Guesses:
        guesses = np.full(len(views), NO_GUESS, dtype=np.int64)
        for layout in sorted({view.layout for view in views} - {""}):
            mine = np.array([k for k, view in enumerate(views) if view.layout == layout])
            guesses[mine] = learner([views[k] for k in mine])
        return guesses

    return guesser


def _regression(words: Words) -> Learner:
    """Return a learner that fits one multinomial logistic regression per category; the features are what `words` yields
    for an episode.
    """

    def learner(views: Sequence[GuesserView]) -> Guesses:
        guesses = np.full(len(views), NO_GUESS, dtype=np.int64)
        for category in sorted({view.category for view in views}):
            mine = np.array([k for k, view in enumerate(views) if view.category == category])
            if len(mine) >= LEAST_EPISODES:
                guesses[mine] = regressed([views[k] for k in mine], words)
        return guesses

    return learner


def _words(view: GuesserView) -> tuple[str, ...]:
    return _split(view.text)


@lru_cache(maxsize=TEXTS_KEPT)
def _split(text: str) -> tuple[str, ...]:
    """Return the words of a text in lower case; punctuation counts as a word."""
    text = text.lower()
    for mark in ",.;:?":
        text = text.replace(mark, f" {mark}")
    return tuple(map(sys.intern, text.split()))


def _text_words(view: GuesserView) -> Iterator[Hashable]:
    """Yield the words and word pairs of a text. Punctuation counts as a word, so that "; if so" differs from "if
    so".
    """
    found = _words(view)
    yield from found
    yield from pairwise(found)


def _cues(view: GuesserView) -> Iterator[str]:
    """Yield features of the content: what each condition states and what each leaf names, each prefixed with the index
    of the condition or leaf.
    """
    for k, asked in enumerate(view.asked):
        yield f"{k} {asked.label}"
        yield f"{k} {asked.label} in {asked.room}"
        yield f"{k} is {asked.predicate}"
        yield f"{k} by {asked.anchor}"
        yield f"{k} {asked.label} {asked.predicate} {asked.anchor}"
    for k, leaf in enumerate(view.leaves):
        yield f"leaf {k} {leaf.labels[-1]}"
        yield f"leaf {k} in {leaf.room}"
        yield f"leaf {k} of {len(leaf.labels)} moves"
        yield from (f"leaf {k} by {label}" for label in leaf.labels[:-1])


def _form(view: GuesserView) -> Iterator[Hashable]:
    """Yield the form of a text without its content: length, words other than nouns, which conditions are definite."""
    yield f"{len(view.text.split()) // WORDS_A_CLASS} words"
    for k, asked in enumerate(view.asked):
        yield f"{k} {'definite' if asked.definite else 'indefinite'} {'relation' if asked.predicate else 'presence'}"
    content = content_words()
    words = [word if word not in content else "_" for word in _words(view)]
    yield from pairwise(words)


def _voice(view: GuesserView) -> Iterator[str]:
    """Yield features of the phrasing: which connecting words a text has, how often, and which three come first."""
    phrases = _voice_words()
    said = [*filter(phrases.__contains__, _words(view))]
    yield from (f"{word} {min(count, MOST_TIMES)} times" for word, count in Counter(said).items())
    yield f"first {' '.join(said[:3])}"


def _length(view: GuesserView) -> Iterator[str]:
    """Yield features of the length: word count (coarse and fine), number of sentences, length of the longest
    sentence.
    """
    sentences = [sentence.split() for sentence in _SENTENCE_END.split(view.text)]
    count = sum(map(len, sentences))
    yield f"{count // WORDS_A_CLASS} tens"
    yield f"{count // 3} threes"
    yield f"{len(sentences)} sentences"
    yield f"{max(map(len, sentences)) // 5} fives in the longest"


def _definiteness(view: GuesserView) -> Iterator[str]:
    """Yield one feature per condition, "definite" or "indefinite", and then one feature that joins these words for all
    conditions.
    """
    flags = ["definite" if asked.definite else "indefinite" for asked in view.asked]
    yield from (f"{k} {flag}" for k, flag in enumerate(flags))
    yield " ".join(flags)


def _manner(view: GuesserView) -> Iterator[str]:
    """Yield features of phrasing, length and definiteness only. Neither a single feature nor all of them together may
    predict the gold leaf.
    """
    yield from _voice(view)
    yield from _length(view)
    yield from _definiteness(view)


@cache
def _voice_words() -> frozenset[str]:
    """Return the words of all phrases of all voices and languages, without the nouns of objects and rooms."""
    found: set[str] = set()
    for code in LANGUAGES:
        words = language(code)
        for phrases in (*words.slots.values(), *words.connectives.values()):
            found.update(word.strip(",.;:?¿") for phrase in phrases for word in phrase.lower().split())
    return frozenset(found - content_words() - {""}) | {"?", ";", ":"}


@cache
def content_words() -> frozenset[str]:
    """Return the words in the nouns of objects and rooms."""
    nouns = [vocabulary.entry(x).noun for x in vocabulary.labels if vocabulary.fit_for_text(x)]
    nouns += [vocabulary.room(x).noun for x in vocabulary.room_labels if vocabulary.room(x).fit_for_text]
    return frozenset(word for noun in nouns for word in noun.lower().split())


def _label_and_room(asked: Asked) -> tuple[str, ...]:
    return asked.label, asked.room


def _whole_statement(asked: Asked) -> tuple[str, ...]:
    return asked.label, asked.room, asked.predicate, asked.anchor


def _form_of_statement(asked: Asked) -> tuple[str, ...]:
    return str(asked.definite), asked.predicate


LEARNED: Final[Mapping[str, Learner]] = {
    "majority leaf": majority_leaf,
    "label and room": _prior(_label_and_room),
    "against label and room": _prior(_label_and_room, against=True),
    "whole statement": _prior(_whole_statement),
    "against whole statement": _prior(_whole_statement, against=True),
    "statement in its layout": _in_layout(_prior(_whole_statement)),
    "against statement in its layout": _in_layout(_prior(_whole_statement, against=True)),
    "definite or not": _prior(_form_of_statement),
    "against definite or not": _prior(_form_of_statement, against=True),
    "form of the text": _regression(_form),
    "voice and length": _regression(_manner),
    "bag of words": _regression(_text_words),
    "words in place": _regression(_cues),
}
"""Learning guessers, by their names in reports."""
