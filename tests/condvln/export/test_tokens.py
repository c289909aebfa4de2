"""Tokens: the stock file's own numbers, and the vocabulary's laws."""

from __future__ import annotations

import gzip
import json
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from condvln.export.tokens import PAD_INDEX, TOKEN_LENGTH, UNK_INDEX, Vocabulary, tokenize


def test_stock_file_tokenises_to_its_own_numbers(real_data: Path) -> None:
    document = json.loads(gzip.decompress((real_data / "vlnce" / "val_seen_sample.json.gz").read_bytes()))
    vocabulary = Vocabulary.from_document(document["instruction_vocab"])
    assert vocabulary.document() == document["instruction_vocab"]
    for episode in document["episodes"]:
        instruction = episode["instruction"]
        assert vocabulary.padded(instruction["instruction_text"]) == instruction["instruction_tokens"]


@pytest.mark.parametrize(
    ("text", "tokens"),
    [
        ("Go on, stop.", ["go", "on", "stop", "."]),
        ("There's a T-shirt?", ["there", "'", "s", "a", "t-shirt"]),
        ("the dog's bed", ["the", "dog", "'", "s", "bed"]),
        ('a "b" (c)', ["a", '"', "b", '" (', "c", ")"]),
        ("", []),
        (" ,? ", []),
    ],
)
def test_words_are_cut_as_habitat_lab_cuts_them(text: str, tokens: list[str]) -> None:
    assert tokenize(text) == tokens


@given(st.lists(st.text(max_size=40), max_size=8))
def test_own_vocabulary_knows_every_word_in_any_order(texts: list[str]) -> None:
    vocabulary = Vocabulary.of(texts)
    assert vocabulary == Vocabulary.of(reversed(texts))
    assert list(vocabulary.words[2:]) == sorted(vocabulary.words[2:])
    for text in texts:
        tokens = vocabulary.encode(text)
        assert [vocabulary.words[token] for token in tokens] == tokenize(text)
        assert len(vocabulary.padded(text)) == TOKEN_LENGTH
        assert vocabulary.padded(text)[: len(tokens)] == tokens[:TOKEN_LENGTH]


def test_unknown_words_and_long_texts() -> None:
    vocabulary = Vocabulary.of(["walk to the sink"])
    assert vocabulary.encode("walk to the ☃") == [*vocabulary.encode("walk to the"), UNK_INDEX]
    assert vocabulary.padded("walk", 3) == [vocabulary.words.index("walk"), PAD_INDEX, PAD_INDEX]
    assert vocabulary.padded("sink " * 300, 200) == [vocabulary.words.index("sink")] * 200


@pytest.mark.parametrize("words", [("<pad>",), ("<unk>", "<pad>"), ("<pad>", "<unk>", "a", "a"), ()])
def test_a_vocabulary_without_its_first_two_or_with_a_repeat_is_refused(words: tuple[str, ...]) -> None:
    with pytest.raises(ValueError, match="vocabulary"):
        Vocabulary(words)
