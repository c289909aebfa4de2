"""Guessers of the gold leaf. Some pick a leaf by its position in the tree or in the text, or by its distance; others
learn from other scenes which leaf is usually gold, which statements are usually true, which words predict a leaf.
"""

from __future__ import annotations

import re
from collections import Counter, defaultdict
from collections.abc import Callable, Hashable, Iterable, Iterator, Mapping, Sequence
from functools import cache, lru_cache
from itertools import pairwise, product
from math import log
from typing import Final

import numpy as np
from numpy.typing import NDArray

from condvln.bias.guesser_view import Asked, GuesserView
from condvln.bias.regression import NO_GUESS, Guesses, progressive, regressed
from condvln.instructions.language import LANGUAGES, language
from condvln.labels import vocabulary
from condvln.labels.lists import goes_with, worth
from schemas.program import CATEGORIES, SHAPES, Category, leaf_truths, route_through

__all__ = ["FIXED", "LEARNED", "Guesser", "Learner", "content_words", "usual_truths"]

Guesser = Callable[[GuesserView], int]


@cache
def _constant(category: Category, truth: bool) -> int:
    branches = SHAPES[category].branches
    return route_through(branches, [truth] * len(branches))[1]


def always_then(view: GuesserView) -> int:
    """Return the leaf that is reached if every condition is true."""
    return _constant(view.category, True)


def always_else(view: GuesserView) -> int:
    """Return the leaf that is reached if every condition is false."""
    return _constant(view.category, False)


def last_named(view: GuesserView) -> int:
    """Return the leaf whose goal the text names last. A text may give the else part first."""
    text = view.text.lower()
    places = [text.rfind(_noun(leaf.labels[-1])) for leaf in view.leaves]
    return places.index(max(places))


@lru_cache(maxsize=4096)
def _noun(label: str) -> str:
    return vocabulary.entry(label).noun if vocabulary.fit_for_text(label) else label


def nearest(view: GuesserView) -> int:
    """Return the leaf whose goal is nearest to the start by geodesic distance."""
    return _least([leaf.distance for leaf in view.leaves])


def farthest(view: GuesserView) -> int:
    """Return the leaf whose goal is farthest from the start by geodesic distance."""
    return _least([-leaf.distance for leaf in view.leaves])


def longest_route(view: GuesserView) -> int:
    """Return the leaf whose route through all its stops is longest."""
    return _least([-leaf.route for leaf in view.leaves])


def _least(values: list[float]) -> int:
    return values.index(min(values))


FIXED: Final[Mapping[str, Guesser]] = {
    "always then": always_then,
    "always else": always_else,
    "last leaf": last_named,
    "nearest target": nearest,
    "farthest target": farthest,
    "longest route": longest_route,
}
"""Guessers without learning, by their names in reports."""


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
_SENTENCE_END: Final = re.compile(r"(?<=[.?!])\s+")
MOST_TIMES: Final = 4
"""Largest count of one word in one text; more occurrences count as this many."""

Key = Callable[[Asked], Hashable]
"""Returns what makes two statements the same."""

Kind = Callable[[GuesserView], Iterable[Hashable]]
"""Yields the features of one kind that a regression learns from."""


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


@cache
def usual_truths() -> NDArray[np.float64]:
    """Return how often each condition is true if all leaves are equally often gold, by category (its place in
    `CATEGORIES`) and place in the program.
    """
    found = np.zeros((len(CATEGORIES), max(len(shape.branches) for shape in SHAPES.values())))
    for code, name in enumerate(CATEGORIES):
        share = _usual_truth(name)
        found[code, : len(share)] = share
    found.flags.writeable = False
    return found


def majority_leaf(views: Sequence[GuesserView]) -> Guesses:
    """Guess the leaf that was gold most often in the same category."""
    seen: defaultdict[Category, Counter[int]] = defaultdict(Counter)

    def guess(view: GuesserView) -> int:
        return max(range(len(view.leaves)), key=lambda leaf: seen[view.category][leaf])

    return _block_by_block(views, lambda view: seen[view.category].update([view.gold]), guess)


def _block_by_block(
    views: Sequence[GuesserView], learn: Callable[[GuesserView], object], guess: Callable[[GuesserView], int]
) -> Guesses:
    """Return a guess at each episode, made when those of all earlier blocks have been learned."""
    guesses = np.full(len(views), NO_GUESS, dtype=np.int64)
    counted = 0
    for learned, guessed in progressive([view.scene for view in views]):
        for k in learned[counted:].tolist():
            learn(views[k])
        counted = len(learned)
        guesses[guessed] = [guess(views[k]) for k in guessed.tolist()]
    return guesses


def _prior(key: Key, *, against: bool = False) -> Learner:
    """Return a learner that picks the likeliest leaf, judged by how often statements with the same `key` were true in
    the episodes that it learned from; with `against`, the unlikeliest leaf. If the statements of some scenes are asked
    so that they balance those of the others, the unlikeliest leaf is gold too often.

    A condition's position in the tree alone changes how often it is true, so the estimate uses the ratio of observed to
    expected counts.
    """

    def learner(views: Sequence[GuesserView]) -> Guesses:
        # How often each statement was false and true, and how often that is to be expected.
        seen: defaultdict[Hashable, list[float]] = defaultdict(lambda: [0.0] * 4)

        def learn(view: GuesserView) -> None:
            for asked, share in zip(view.asked, _usual_truth(view.category), strict=True):
                counts = seen[key(asked)]
                counts[asked.truth] += 1.0
                counts[2] += 1.0 - share
                counts[3] += share

        def guess(view: GuesserView) -> int:
            odds = []
            for asked, share in zip(view.asked, _usual_truth(view.category), strict=True):
                counts = seen.get(key(asked), [0.0] * 4)
                prior = (PRIOR_WEIGHT * (1.0 - share), PRIOR_WEIGHT * share)
                odds.append([log((counts[k] + prior[k]) / (counts[2 + k] + prior[k])) for k in (0, 1)])
            scores = [sum(odds[k][truth] for k, truth in way) for way in leaf_truths(view.category)]
            return scores.index(min(scores) if against else max(scores))

        return _block_by_block(views, learn, guess)

    return learner


def _in_layout(learner: Learner) -> Learner:
    """Return a learner that applies `learner` to each layout separately, so that the guesses for a layout are learned
    only from episodes of the same layout.
    """

    def guesser(views: Sequence[GuesserView]) -> Guesses:
        guesses = np.full(len(views), NO_GUESS, dtype=np.int64)
        for name in sorted({view.layout for view in views} - {""}):
            mine = [k for k, view in enumerate(views) if view.layout == name]
            guesses[mine] = learner([views[k] for k in mine])
        return guesses

    return guesser


def _regression(*kinds: Kind) -> Learner:
    """Return a learner that fits one multinomial logistic regression per category; the features are those that `kinds`
    find in the episodes.
    """

    def features(view: GuesserView) -> Iterator[Hashable]:
        for k, kind in enumerate(kinds):
            yield from ((k, feature) for feature in kind(view))

    def learner(views: Sequence[GuesserView]) -> Guesses:
        guesses = np.full(len(views), NO_GUESS, dtype=np.int64)
        for category in {view.category for view in views}:
            mine = [k for k, view in enumerate(views) if view.category == category]
            if len(mine) >= LEAST_EPISODES:
                guesses[mine] = regressed([views[k] for k in mine], features)
        return guesses

    return learner


@lru_cache(maxsize=1 << 16)
def _words(text: str) -> tuple[str, ...]:
    """Return the words of a text. Punctuation counts as a word, so that "; if so" differs from "if so"."""
    text = text.lower()
    for mark in ",.;:?":
        text = text.replace(mark, f" {mark}")
    return tuple(text.split())


def _text_words(view: GuesserView) -> Iterator[Hashable]:
    """Yield the words and word pairs of a text."""
    yield from _words(view.text)
    yield from pairwise(_words(view.text))


def _cues(view: GuesserView) -> Iterator[Hashable]:
    """Yield features of the content: what each condition states and what each leaf names, each with the index of the
    condition or leaf.
    """
    for k, asked in enumerate(view.asked):
        yield k, "label", asked.label
        yield k, "label and room", asked.label, asked.room
        yield k, "predicate", asked.predicate
        yield k, "anchor", asked.anchor
        yield k, "statement", asked.label, asked.predicate, asked.anchor
    for k, leaf in enumerate(view.leaves):
        yield k, "goal", leaf.labels[-1]
        yield k, "room", leaf.room
        yield k, "moves", len(leaf.labels)
        yield from ((k, "by", label) for label in leaf.labels[:-1])


def _form(view: GuesserView) -> Iterator[Hashable]:
    """Yield the form of a text without its content: length, words other than nouns, which conditions are definite, and
    which have leads.
    """
    yield len(view.text.split()) // WORDS_A_CLASS
    yield from ((k, asked.definite, bool(asked.predicate), asked.lead) for k, asked in enumerate(view.asked))
    content = content_words()
    yield from pairwise("_" if word in content else word for word in _words(view.text))


def _voice(view: GuesserView) -> Iterator[Hashable]:
    """Yield features of the phrasing: which connecting words a text has, how often, and which three come first."""
    phrases = _voice_words()
    said = [word for word in _words(view.text) if word in phrases]
    yield from ((word, min(count, MOST_TIMES)) for word, count in Counter(said).items())
    yield "first", *said[:3]


def _length(view: GuesserView) -> Iterator[Hashable]:
    """Yield features of the length: word count (coarse and fine), number of sentences, length of the longest
    sentence.
    """
    sentences = [len(one.split()) for one in _SENTENCE_END.split(view.text)]
    yield "words", sum(sentences) // WORDS_A_CLASS
    yield "words in threes", sum(sentences) // 3
    yield "sentences", len(sentences)
    yield "longest", max(sentences) // 5


def _worth(view: GuesserView) -> Iterator[Hashable]:
    """Yield how natural each condition and each goal is."""
    for k, asked in enumerate(view.asked):
        own = worth(asked.label, asked.room)
        yield k, "asked", round(10 * (own.relation if asked.predicate else own.presence))
    for k, leaf in enumerate(view.leaves):
        yield k, "goal", round(10 * worth(leaf.labels[-1], leaf.room).goto)


def _purpose(view: GuesserView) -> Iterator[Hashable]:
    """Yield with which leaves' goals each thing that is asked about goes, and which goal is its anchor."""
    for k, asked in enumerate(view.asked):
        alike = goes_with().get(asked.label, frozenset())
        fits = ["anchor" if leaf.labels[-1] == asked.anchor else leaf.labels[-1] in alike for leaf in view.leaves]
        yield k, "goals", *fits
        yield from ((k, leaf, fit) for leaf, fit in enumerate(fits))


def _definiteness(view: GuesserView) -> Iterator[Hashable]:
    """Yield one feature per condition, whether it is definite, and then one feature that joins these of all
    conditions.
    """
    yield from ((k, asked.definite) for k, asked in enumerate(view.asked))
    yield "all", *(asked.definite for asked in view.asked)


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


def _label_and_room(asked: Asked) -> Hashable:
    return asked.label, asked.room


def _whole_statement(asked: Asked) -> Hashable:
    return asked.label, asked.room, asked.predicate, asked.anchor


def _form_of_statement(asked: Asked) -> Hashable:
    return asked.definite, asked.predicate, asked.lead


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
    # neither one of these features nor all together may predict the gold leaf
    "voice and length": _regression(_voice, _length, _definiteness),
    "worth": _regression(_worth),
    "purpose": _regression(_purpose),
    "bag of words": _regression(_text_words),
    "words in place": _regression(_cues),
}
"""Learning guessers, by their names in reports."""
