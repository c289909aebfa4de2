"""The instruction vocabulary and the tokens that VLN-CE's text encoders read.

Texts are tokenised as in habitat-lab's vocabulary (``habitat/datasets/utils.py``): lower case, ``'s`` is a word, commas
and question marks are dropped, runs of letters, digits, underscores and hyphens are words, and whatever is between two
words is one token. This rule gives the tokens stored in R2R_VLNCE v1-3.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import filterfalse
from typing import Any, Final

import numpy as np
import numpy.typing as npt
import pyarrow as pa
import pyarrow.compute as pc

__all__ = ["PAD", "PAD_INDEX", "TOKEN_LENGTH", "UNK", "UNK_INDEX", "Vocabulary", "longer_than", "tokenize"]

PAD: Final = "<pad>"
UNK: Final = "<unk>"
PAD_INDEX: Final = 0
UNK_INDEX: Final = 1
_PADDING: Final = b",%d" % PAD_INDEX

TOKEN_LENGTH: Final = 200
"""Number of tokens to which an instruction is padded, as in the preprocessed R2R_VLNCE v1-3, whose users stack
instructions into one array.
"""

_DROPPED: Final = str.maketrans("", "", ",?")
_WORD: Final = re.compile(r"([^\w-]+)")
_MARK: Final = "[^0-9A-Za-z_ -]"
"""Non-ASCII letters: the two regular expressions may treat them differently."""


def tokenize(text: str) -> list[str]:
    """Return the words and punctuation of ``text`` in order, in lower case."""
    return [word for part in _WORD.split(_prepared(text)) if (word := part.strip())]


def _prepared(text: str) -> str:
    return text.lower().replace("'s", " 's").translate(_DROPPED)


def _tokens_apart(piece: str) -> list[str] | None:
    """Return the tokens of ``piece``, a part of a text between two spaces; None if they depend on the part before,
    since the piece begins with a mark, and marks on both sides of a space are one token.
    """
    found = _prepared(piece)
    return None if found and _WORD.match(found) else tokenize(piece)


def longer_than(texts: pa.Array, limit: int) -> npt.NDArray[np.bool_]:
    """Return, for each of ``texts``, whether it has more than ``limit`` tokens.

    A fast upper bound comes from counting spaces and punctuation (each mark is a token and may separate two words);
    only texts above the limit by this bound are tokenised.
    """
    spaces, marks = pc.count_substring(texts, " "), pc.count_substring_regex(texts, _MARK)
    bounds = pc.add(pc.add(spaces, pc.multiply(marks, 2)), 1).to_numpy(zero_copy_only=False)
    longer = np.zeros(len(texts), dtype=bool)
    for row in np.flatnonzero(bounds > limit).tolist():
        longer[row] = len(tokenize(texts[row].as_py())) > limit
    return longer


class _BeginsWithMarkError(Exception):
    """The tokens of a piece of text depend on the piece before."""


class _Told(dict[str, bytes]):
    """The token indices of each piece of text between two spaces as JSON numbers, each after a comma; made when they
    are first needed.
    """

    def __init__(self, index: Mapping[str, int]) -> None:
        super().__init__()
        self._of_word = index

    def __missing__(self, piece: str) -> bytes:
        words = _tokens_apart(piece)
        if words is None:
            raise _BeginsWithMarkError
        self[piece] = told = _json_after_commas([self._of_word.get(word, UNK_INDEX) for word in words])
        return told


def _json_after_commas(numbers: Iterable[int]) -> bytes:
    return b"".join(b",%d" % number for number in numbers)


@dataclass(frozen=True)
class Vocabulary:
    """A list of words, in the order of their indices; the first two are PAD and UNK."""

    words: tuple[str, ...]

    def __post_init__(self) -> None:
        if self.words[:2] != (PAD, UNK) or len(set(self.words)) != len(self.words):
            raise ValueError("the vocabulary does not start with <pad>, <unk>, or it names a word twice")
        index = {word: index for index, word in enumerate(self.words)}
        object.__setattr__(self, "_index", index)
        object.__setattr__(self, "_told", _Told(index))

    @classmethod
    def of(cls, texts: Iterable[str]) -> Vocabulary:
        """Build a vocabulary from all words of ``texts``, sorted by code point, independent of the order of the
        texts.
        """
        found: set[str] = set()
        known: set[str] = set()
        for text in texts:
            pieces = set(filterfalse(known.__contains__, text.split()))
            apart = [_tokens_apart(piece) for piece in pieces]
            if None in apart:
                found.update(tokenize(text))
            else:
                found.update(*filter(None, apart))
                known |= pieces
        return cls((PAD, UNK, *sorted(found - {PAD, UNK})))

    @classmethod
    def from_document(cls, document: dict[str, Any]) -> Vocabulary:
        """Read the vocabulary of a VLN-CE file, such as the stock vocabulary that a trained agent's embeddings belong
        to.
        """
        return cls(tuple(document["word_list"]))

    def encode(self, text: str) -> list[int]:
        """Return the indices of the tokens of ``text``; unknown words become UNK."""
        index: dict[str, int] = self._index  # type: ignore[attr-defined]
        return [index.get(word, UNK_INDEX) for word in tokenize(text)]

    def padded(self, text: str, length: int = TOKEN_LENGTH) -> list[int]:
        """Return :meth:`encode`'s result, padded with PAD to ``length``.

        A longer text is cut to its first ``length`` tokens, because encoders take rows of one length;
        ``instruction_text`` stays complete.
        """
        tokens = self.encode(text)[:length]
        return tokens + [PAD_INDEX] * (length - len(tokens))

    def padded_json(self, text: str, length: int = TOKEN_LENGTH) -> tuple[bytes, int]:
        """Return :meth:`padded`'s result as JSON, and how many tokens the whole text has."""
        told: _Told = self._told  # type: ignore[attr-defined]
        try:
            joined = b"".join(map(told.__getitem__, text.split()))
        except _BeginsWithMarkError:
            joined = _json_after_commas(self.encode(text))
        count = joined.count(b",")
        if count > length:
            joined = _json_after_commas(self.encode(text)[:length])
        return b"[" + (joined + _PADDING * (length - count))[1:] + b"]", count

    def document(self) -> dict[str, Any]:
        """Return ``instruction_vocab`` of a VLN-CE file, keys in the stock order."""
        words: Sequence[str] = list(self.words)
        return {
            "word_list": words,
            "word2idx_dict": {word: index for index, word in enumerate(words)},
            "stoi": {word: index for index, word in enumerate(words)},
            "itos": words,
            "num_vocab": len(words),
            "UNK_INDEX": UNK_INDEX,
            "PAD_INDEX": PAD_INDEX,
        }
