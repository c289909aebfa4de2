"""The episodes that a guesser sees as columns of numbers: words of texts, statements of conditions, names of leaves.

Each is computed once for all guessers of a source.
"""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Hashable, Iterable, Sequence
from functools import cached_property
from typing import Final, NamedTuple

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from numpy.typing import NDArray

from condvln.bias.blocks import progressive
from condvln.bias.guesser_view import GuesserView
from schemas.program import CATEGORIES

__all__ = ["CodedViews", "Indices", "Leaves", "Lengths", "Statements", "Words", "numbered"]

Indices = NDArray[np.int64]

_SENTENCE_END: Final = re.compile(r"(?<=[.?!])\s+")


class Words(NamedTuple):
    """The words of all texts, one text after the other; punctuation counts as a word.

    text : (words,) index of the text; word : (words,) index into `names`
    """

    names: list[str]
    text: Indices
    word: Indices


class Lengths(NamedTuple):
    """Lengths of texts, (texts,) each: words, sentences, and words of the longest sentence."""

    words: Indices
    sentences: Indices
    longest: Indices


class Statements(NamedTuple):
    """What all conditions state, one episode after the other, (conditions,) each. Names are numbered.

    episode, place : index of the episode, and of the condition in it
    begins : (episodes + 1,) index of each episode's first condition
    related : 1 if it has a predicate, else 0
    """

    episode: Indices
    place: Indices
    begins: Indices
    label: Indices
    room: Indices
    predicate: Indices
    anchor: Indices
    related: Indices
    definite: Indices
    truth: Indices


class Leaves(NamedTuple):
    """What all leaves name, one episode after the other, (leaves,) each. Names are numbered.

    episode, place : index of the episode, and of the leaf in it
    by_leaf, by : (stops,) of each stop before a goal, the index of its leaf among all, and its label
    """

    episode: Indices
    place: Indices
    goal: Indices
    room: Indices
    moves: Indices
    by_leaf: Indices
    by: Indices


class CodedViews(list[GuesserView]):
    """Views of the episodes of a source, which must not be changed, with their columns."""

    @classmethod
    def of(cls, views: Sequence[GuesserView]) -> CodedViews:
        """Return `views` with their columns; the same object if they have them already."""
        return views if isinstance(views, CodedViews) else cls(views)

    @cached_property
    def progress(self) -> list[tuple[Indices, Indices]]:
        """What is learned from and what is guessed, step by step: see :func:`~condvln.bias.blocks.progressive`."""
        return [*progressive([view.scene for view in self])]

    @cached_property
    def extremes(self) -> dict[Hashable, tuple[Indices, Indices]]:
        """The likeliest and the unlikeliest leaf of each episode by a kind of statement, kept by guessers that share
        the work.
        """
        return {}

    @cached_property
    def category(self) -> Indices:
        """Index into ``CATEGORIES`` of each episode."""
        return np.array([CATEGORIES.index(view.category) for view in self], dtype=np.int64)

    @cached_property
    def layouts(self) -> list[tuple[Indices, CodedViews]]:
        """The indices of the episodes of each layout, and these episodes."""
        names = sorted({view.layout for view in self} - {""})
        found = [np.array([k for k, view in enumerate(self) if view.layout == name], dtype=np.int64) for name in names]
        return [(mine, CodedViews([self[k] for k in mine.tolist()])) for mine in found]

    @cached_property
    def words(self) -> Words:
        """The words of the texts, in lower case."""
        # Arrow splits and numbers words in half of the time in which Python makes strings of them.
        parts = pc.split_pattern(pa.array([_spaced(view.text) for view in self], pa.large_string()), " ")
        coded = parts.flatten().dictionary_encode()
        names, word = coded.dictionary.to_pylist(), coded.indices.to_numpy().astype(np.int64)
        text = np.repeat(np.arange(len(self)), np.diff(parts.offsets.to_numpy()))
        if "" in names:  # between two spaces, or a text without words
            empty = names.index("")
            said = word != empty
            text, word = text[said], word[said] - (word[said] > empty)
            del names[empty]
        return Words(names, text, word)

    @cached_property
    def lengths(self) -> Lengths:
        """The lengths of the texts."""
        sentences = [_sentence_lengths(view.text) for view in self]
        counts = ([sum(one) for one in sentences], [len(one) for one in sentences], [max(one) for one in sentences])
        return Lengths(*(np.array(one, dtype=np.int64) for one in counts))

    @cached_property
    def statements(self) -> Statements:
        """What the conditions state."""
        asked = [one for view in self for one in view.asked]
        label, room, predicate, anchor, truth, definite = zip(*asked, strict=True) if asked else [()] * 6
        episode, place, begins = _repeated([len(view.asked) for view in self])
        return Statements(
            episode,
            place,
            begins,
            numbered(label)[0],
            numbered(room)[0],
            numbered(predicate)[0],
            numbered(anchor)[0],
            np.array([*map(bool, predicate)], dtype=np.int64),
            np.array(definite, dtype=np.int64),
            np.array(truth, dtype=np.int64),
        )

    @cached_property
    def leaves(self) -> Leaves:
        """What the leaves name."""
        labels = [leaf.labels for view in self for leaf in view.leaves]
        episode, place, _ = _repeated([len(view.leaves) for view in self])
        moves = [*map(len, labels)]
        return Leaves(
            episode,
            place,
            numbered([stops[-1] for stops in labels])[0],
            numbered([leaf.room for view in self for leaf in view.leaves])[0],
            np.array(moves, dtype=np.int64),
            _repeated([count - 1 for count in moves])[0],
            numbered([label for stops in labels for label in stops[:-1]])[0],
        )


def numbered(names: Iterable[Hashable]) -> tuple[Indices, list[Hashable]]:
    """Return the number of each name, in the order in which they are first seen, and the different names."""
    index: defaultdict[Hashable, int] = defaultdict()
    index.default_factory = index.__len__
    return np.fromiter(map(index.__getitem__, names), dtype=np.int64), [*index]


def _repeated(sizes: Sequence[int]) -> tuple[Indices, Indices, Indices]:
    """Return for each part of some wholes the index of its whole and its place in it, and where each whole begins."""
    begins = np.cumsum([0, *sizes], dtype=np.int64)
    whole = np.repeat(np.arange(len(sizes)), sizes)
    return whole, np.arange(len(whole)) - begins[whole], begins


def _sentence_lengths(text: str) -> list[int]:
    """Return the number of words of each sentence of a text."""
    if not text.isprintable() or "  " in f" {text} ":
        return [len(one.split()) for one in _SENTENCE_END.split(text)]
    # The same where words have single spaces between them, in a fifth of the time.
    text = text.replace("? ", ". ").replace("! ", ". ")
    return [one.count(" ") + 1 for one in text.split(". ")]


def _spaced(text: str) -> str:
    """Return a text in lower case, with spaces between words and before punctuation, which counts as a word."""
    text = text.lower()
    for mark in ",.;:?":
        text = text.replace(mark, f" {mark}")
    # The only space that can be printed is the usual one.
    return text if text.isprintable() else " ".join(text.split())
