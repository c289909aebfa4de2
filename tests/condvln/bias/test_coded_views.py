"""Features of texts as columns of numbers, against the same features found text by text."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from condvln.bias import coded_views
from condvln.bias.coded_views import CodedViews
from condvln.bias.guesser_view import GuesserView
from condvln.bias.learners import Kind, _cues, _definiteness, _form, _length, _text_words, _voice, content_words
from condvln.bias.learners import _voice_words as voice_words
from condvln.bias.regression import coded_features, combined, dense


def words(view: GuesserView) -> list[str]:
    text = view.text.lower()
    for mark in ",.;:?":
        text = text.replace(mark, f" {mark}")
    return text.split()


def text_words(view: GuesserView) -> Iterator[object]:
    yield from words(view)
    yield from pairwise(words(view))


def form(view: GuesserView) -> Iterator[object]:
    yield len(view.text.split()) // 10
    yield from ((k, asked.definite, bool(asked.predicate)) for k, asked in enumerate(view.asked))
    yield from pairwise(["_" if word in content_words() else word for word in words(view)])


def voice(view: GuesserView) -> Iterator[object]:
    said = [word for word in words(view) if word in voice_words()]
    yield from ((word, min(count, 4)) for word, count in Counter(said).items())
    yield "first", *said[:3]


def length(view: GuesserView) -> Iterator[object]:
    sentences = [one.split() for one in view.text.replace("? ", "?\n").replace(". ", ".\n").split("\n")]
    count = sum(map(len, sentences))
    yield from (("tens", count // 10), ("threes", count // 3), ("sentences", len(sentences)))
    yield "longest", max(map(len, sentences)) // 5


def definiteness(view: GuesserView) -> Iterator[object]:
    yield from ((k, asked.definite) for k, asked in enumerate(view.asked))
    yield "all", *(asked.definite for asked in view.asked)


def cues(view: GuesserView) -> Iterator[object]:
    for k, asked in enumerate(view.asked):
        yield from ((k, asked.label), (k, asked.label, asked.room), (k, "is", asked.predicate), (k, "by", asked.anchor))
        yield k, asked.label, asked.predicate, asked.anchor
    for k, leaf in enumerate(view.leaves):
        yield from (("leaf", k, leaf.labels[-1]), ("leaf", k, "in", leaf.room), ("leaf", k, len(leaf.labels)))
        yield from (("leaf", k, "by", label) for label in leaf.labels[:-1])


@pytest.mark.parametrize(
    ("kind", "found"),
    [
        (_text_words, text_words),
        (_form, form),
        (_voice, voice),
        (_length, length),
        (_definiteness, definiteness),
        (_cues, cues),
    ],
)
def test_features_are_those_found_text_by_text(
    made_rows, kind: Kind, found: Callable[[GuesserView], Iterable[object]]
) -> None:
    """Each feature by the set of texts that have it."""
    views = [GuesserView.of(row) for row in made_rows(3, scenes=6, each=4)]
    views += [views[0]._replace(text="Go? To the lamp. Then, then, then, then, then stop.")]
    views += [views[1]._replace(text="Sofa")]
    expected: dict[object, set[int]] = {}
    for k, view in enumerate(views):
        for feature in found(view):
            expected.setdefault(feature, set()).add(k)
    table = coded_features(len(views), kind(CodedViews(views))).toarray()
    assert set(table.ravel().tolist()) <= {0.0, 1.0}
    columns = [tuple(np.flatnonzero(column).tolist()) for column in table.T]
    assert Counter(columns) == Counter(tuple(sorted(texts)) for texts in expected.values())


def test_words_are_those_between_spaces_of_any_kind(made_rows) -> None:
    view = GuesserView.of(next(iter(made_rows(3, scenes=1, each=1))))
    texts = ["Go  on", "", "¿Ve\u00a0al baño ;\tsi no, para?", " Stop .", "a\x1fb\u2028c\n", "Go on."]
    views = CodedViews([view._replace(text=text) for text in texts])
    found = views.words
    said = [[found.names[word] for word in found.word[found.text == k]] for k in range(len(texts))]
    assert said == [words(view) for view in views]
    assert found.names == [*dict.fromkeys(word for view in views for word in words(view))]


def test_combinations_have_different_numbers() -> None:
    rng = np.random.default_rng(1)
    for most in (1, 3, 10**9):
        codes = rng.integers(0, most, (4, 300))
        pairs = set(zip(combined(*codes).tolist(), zip(*codes.tolist(), strict=True), strict=True))
        assert len(pairs) == len({number for number, _ in pairs}) == len({parts for _, parts in pairs})
        assert dense(codes[0]).tolist() == np.unique(codes[0], return_inverse=True)[1].tolist()


@given(st.text("ab.?! \t ", max_size=12))
def test_sentences_have_as_many_words_as_they_are_split_into(text: str) -> None:
    expected = [len(one.split()) for one in re.split(r"(?<=[.?!])\s+", text)]
    assert coded_views._sentence_lengths(text) == expected
