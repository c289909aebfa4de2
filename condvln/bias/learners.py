"""Guessers that learn from other scenes: which leaf is usually gold, which statements are usually true, which words
predict a leaf.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from functools import cache, reduce
from itertools import product
from operator import add
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_matrix

from condvln.bias.blocks import NO_GUESS
from condvln.bias.coded_views import CodedViews, Indices, Statements, Words
from condvln.bias.guesser_view import GuesserView
from condvln.bias.regression import Guesses, Occurrences, coded_features, combined, dense, guessed_from
from condvln.instructions.language import LANGUAGES, language
from condvln.labels import vocabulary
from schemas.program import CATEGORIES, SHAPES, Category

__all__ = ["LEARNED", "Learner", "content_words", "leaf_truths", "usual_truths"]

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

Key = Callable[[Statements], tuple[Indices, ...]]
"""Returns the columns of statements that make two of them the same."""

Kind = Callable[[CodedViews], Iterable[Occurrences]]
"""Yields the features of one kind that a regression learns from."""


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
    guesses = np.full(len(views), NO_GUESS, dtype=np.int64)
    coded = CodedViews.of(views)
    category = coded.category
    gold = np.array([view.gold for view in views], dtype=np.int64)
    seen = np.zeros((len(CATEGORIES), max(shape.leaves for shape in SHAPES.values())))
    counted = 0
    for learned, guessed in coded.progress:
        new, counted = learned[counted:], len(learned)
        np.add.at(seen, (category[new], gold[new]), 1.0)
        guesses[guessed] = seen.argmax(axis=1)[category[guessed]]
    return guesses


def _prior(key: Key, *, against: bool = False) -> Learner:
    """Return a learner that picks the likeliest leaf, judged by how often statements with the same `key` were true in
    the episodes that it learned from; with `against`, the unlikeliest leaf. If the statements of some scenes are asked
    so that they balance those of the others, the unlikeliest leaf is gold too often.

    `key` returns the columns of conditions that state the same. A condition's position in the tree alone changes how
    often it is true, so the estimate uses the ratio of observed to expected counts.
    """

    def learner(views: Sequence[GuesserView]) -> Guesses:
        coded = CodedViews.of(views)
        if key not in coded.extremes:
            coded.extremes[key] = _extremes(coded, key)
        likeliest, unlikeliest = coded.extremes[key]
        return unlikeliest if against else likeliest

    return learner


def _extremes(views: CodedViews, key: Key) -> tuple[Guesses, Guesses]:
    """Return the likeliest leaf of each episode, and the unlikeliest one, as :func:`_prior` judges them."""
    likeliest, unlikeliest = (np.full(len(views), NO_GUESS, dtype=np.int64) for _ in range(2))
    category, asked = views.category, _Counted.of(views, key)
    seen = np.zeros((asked.different, 4))
    counted = 0
    for learned, guessed in views.progress:
        asked.add_to(seen, learned[counted:])
        counted = len(learned)
        for code in np.unique(category[guessed]).tolist():
            mine = guessed[category[guessed] == code]
            scores = asked.scores(seen, mine, CATEGORIES[code])
            likeliest[mine], unlikeliest[mine] = scores.argmax(axis=0), scores.argmin(axis=0)
    return likeliest, unlikeliest


class _Counted(NamedTuple):
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
    def of(cls, views: CodedViews, key: Key) -> _Counted:
        """Return the statements of `views`; `key` says which conditions state the same."""
        asked = views.statements
        statement = dense(combined(*key(asked)))
        shares = usual_truths()[views.category[asked.episode], asked.place]
        return cls(int(statement.max(initial=-1)) + 1, asked.begins, statement, asked.truth, shares)

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
        for mine, own in CodedViews.of(views).layouts:
            guesses[mine] = learner(own)
        return guesses

    return guesser


def _regression(*kinds: Kind) -> Learner:
    """Return a learner that fits one multinomial logistic regression per category; the features are those that `kinds`
    find in the episodes.
    """

    def learner(views: Sequence[GuesserView]) -> Guesses:
        guesses = np.full(len(views), NO_GUESS, dtype=np.int64)
        coded = CodedViews.of(views)
        found = [(text.astype(np.int32), dense(code).astype(np.int32)) for kind in kinds for text, code in kind(coded)]
        for category in np.unique(coded.category).tolist():
            mine = np.flatnonzero(coded.category == category)
            if len(mine) >= LEAST_EPISODES:
                # A matrix for all categories would be the largest thing in memory.
                own = [_among(mine, *one) for one in found]
                guesses[mine] = guessed_from([views[k] for k in mine.tolist()], coded_features(len(mine), own))
        return guesses

    return learner


def _among(mine: Indices, text: NDArray[np.int32], code: NDArray[np.int32]) -> Occurrences:
    """Return those features of one kind that the texts `mine` have, with the places of the texts in `mine`. Both `mine`
    and `text` are in ascending order.
    """
    first, last = int(mine[0]), int(mine[-1])
    begin, end = np.searchsorted(text, (first, last + 1))
    text, code = text[begin:end], code[begin:end]
    if len(mine) == last + 1 - first:  # as in the gate, which sorts episodes by category
        return text - first, code
    place = np.full(last + 1 - first, -1, dtype=np.int64)
    place[mine - first] = np.arange(len(mine))
    own = place[text - first]
    return own[own >= 0], code[own >= 0]


def _text_words(views: CodedViews) -> Iterator[Occurrences]:
    """Yield the words and word pairs of texts. Punctuation counts as a word, so that "; if so" differs from "if so"."""
    found = views.words
    yield found.text, found.word
    yield _pairs(found, found.word)


def _pairs(found: Words, word: Indices) -> Occurrences:
    """Return the pairs of consecutive words of texts. `word` has a number for each word."""
    inside = found.text[1:] == found.text[:-1]
    return found.text[1:][inside], combined(word[:-1], word[1:])[inside]


def _cues(views: CodedViews) -> Iterator[Occurrences]:
    """Yield features of the content: what each condition states and what each leaf names, each with the index of the
    condition or leaf.
    """
    asked, leaf = views.statements, views.leaves
    for stated in (
        (asked.label,),
        (asked.label, asked.room),
        (asked.predicate,),
        (asked.anchor,),
        (asked.label, asked.predicate, asked.anchor),
    ):
        yield asked.episode, combined(asked.place, *stated)
    for named in (leaf.goal, leaf.room, leaf.moves):
        yield leaf.episode, combined(leaf.place, named)
    yield leaf.episode[leaf.by_leaf], combined(leaf.place[leaf.by_leaf], leaf.by)


def _form(views: CodedViews) -> Iterator[Occurrences]:
    """Yield the form of texts without their content: length, words other than nouns, which conditions are definite."""
    asked, found = views.statements, views.words
    yield np.arange(len(views)), views.lengths.words // WORDS_A_CLASS
    yield asked.episode, combined(asked.place, asked.definite, asked.related)
    content = content_words()
    formal = np.array([name not in content for name in found.names], dtype=np.int64)
    yield _pairs(found, ((np.arange(len(formal)) + 1) * formal)[found.word])


def _voice(views: CodedViews) -> Iterator[Occurrences]:
    """Yield features of the phrasing: which connecting words a text has, how often, and which three come first."""
    phrases, found = _voice_words(), views.words
    said = np.array([name in phrases for name in found.names], dtype=np.bool_)[found.word]
    text, word = found.text[said], found.word[said]
    counts = csr_matrix((np.ones(len(text)), (text, word)), shape=(len(views), len(found.names)))
    times = np.minimum(counts.data, MOST_TIMES).astype(np.int64)
    yield np.repeat(np.arange(len(views)), np.diff(counts.indptr)), combined(counts.indices.astype(np.int64), times)
    begins = np.searchsorted(text, np.arange(len(views) + 1))
    padded = np.append(word, [-1] * 3) + 1
    firsts = [np.where(begins[:-1] + k < begins[1:], padded[begins[:-1] + k], 0) for k in range(3)]
    yield np.arange(len(views)), combined(*firsts)


def _length(views: CodedViews) -> Iterator[Occurrences]:
    """Yield features of the length: word count (coarse and fine), number of sentences, length of the longest
    sentence.
    """
    found, episode = views.lengths, np.arange(len(views))
    for length in (found.words // WORDS_A_CLASS, found.words // 3, found.sentences, found.longest // 5):
        yield episode, length


def _definiteness(views: CodedViews) -> Iterator[Occurrences]:
    """Yield one feature per condition, whether it is definite, and then one feature that joins these of all
    conditions.
    """
    asked = views.statements
    yield asked.episode, combined(asked.place, asked.definite)
    joined = np.bincount(asked.episode, weights=(asked.definite + 1.0) * 3.0**asked.place, minlength=len(views))
    yield np.arange(len(views)), joined.astype(np.int64)


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


def _label_and_room(asked: Statements) -> tuple[Indices, ...]:
    return asked.label, asked.room


def _whole_statement(asked: Statements) -> tuple[Indices, ...]:
    return asked.label, asked.room, asked.predicate, asked.anchor


def _form_of_statement(asked: Statements) -> tuple[Indices, ...]:
    return asked.definite, asked.predicate


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
    "bag of words": _regression(_text_words),
    "words in place": _regression(_cues),
}
"""Learning guessers, by their names in reports."""
