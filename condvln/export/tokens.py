"""The instruction vocabulary and the tokens that VLN-CE's text encoders read.

Texts are tokenised as in habitat-lab's vocabulary (``habitat/datasets/utils.py``): lower case, ``'s`` is a word, commas
and question marks are dropped, runs of letters, digits, underscores and hyphens are words, and whatever is between two
words is one token. This rule gives the tokens stored in R2R_VLNCE v1-3.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Final

__all__ = ["PAD", "PAD_INDEX", "TOKEN_LENGTH", "UNK", "UNK_INDEX", "Vocabulary", "padded", "tokenize"]

PAD: Final = "<pad>"
UNK: Final = "<unk>"
PAD_INDEX: Final = 0
UNK_INDEX: Final = 1

TOKEN_LENGTH: Final = 200
"""Number of tokens to which an instruction is padded, as in the preprocessed R2R_VLNCE v1-3, whose users stack
instructions into one array.
"""

_DROPPED: Final = str.maketrans("", "", ",?")
_WORD: Final = re.compile(r"([^\w-]+)")


def tokenize(text: str) -> list[str]:
    """Return the words and punctuation of ``text`` in order, in lower case."""
    prepared = text.lower().replace("'s", " 's").translate(_DROPPED)
    return [word for part in _WORD.split(prepared) if (word := part.strip())]


def padded(tokens: list[int], length: int = TOKEN_LENGTH) -> list[int]:
    """Return ``tokens`` cut to ``length``, or padded with PAD: encoders take rows of one length. The text of an episode
    stays complete.
    """
    return tokens[:length] + [PAD_INDEX] * (length - len(tokens))


@dataclass(frozen=True)
class Vocabulary:
    """A list of words, in the order of their indices; the first two are PAD and UNK."""

    words: tuple[str, ...]

    def __post_init__(self) -> None:
        if self.words[:2] != (PAD, UNK) or len(set(self.words)) != len(self.words):
            raise ValueError("the vocabulary does not start with <pad>, <unk>, or it names a word twice")

    @classmethod
    def of(cls, texts: Iterable[str]) -> Vocabulary:
        """Build a vocabulary from all words of ``texts``, sorted by code point, independent of the order of the
        texts.
        """
        found = {word for text in texts for word in tokenize(text)}
        return cls((PAD, UNK, *sorted(found - {PAD, UNK})))

    @classmethod
    def from_document(cls, document: dict[str, Any]) -> Vocabulary:
        """Read the vocabulary of a VLN-CE file, such as the stock vocabulary that a trained agent's embeddings belong
        to.
        """
        return cls(tuple(document["word_list"]))

    def encode(self, text: str) -> list[int]:
        """Return the indices of the tokens of ``text``; unknown words become UNK."""
        return [self._numbers.get(word, UNK_INDEX) for word in tokenize(text)]

    def padded(self, text: str, length: int = TOKEN_LENGTH) -> list[int]:
        """Return :meth:`encode`'s result, cut or padded to ``length``."""
        return padded(self.encode(text), length)

    @cached_property
    def _numbers(self) -> dict[str, int]:
        return {word: number for number, word in enumerate(self.words)}

    def document(self) -> dict[str, Any]:
        """Return ``instruction_vocab`` of a VLN-CE file, keys in the stock order."""
        words = list(self.words)
        return {
            "word_list": words,
            "word2idx_dict": self._numbers,
            "stoi": self._numbers,
            "itos": words,
            "num_vocab": len(words),
            "UNK_INDEX": UNK_INDEX,
            "PAD_INDEX": PAD_INDEX,
        }
