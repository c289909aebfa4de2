"""Parse large JSON documents lazily: long arrays stay text, and each entry is parsed on access.

A parsed document takes several times the memory of its text. Large documents consist of a long array of objects that
are read one after the other, so only the current entry needs to be in memory.
"""

from __future__ import annotations

import json
from array import array
from collections.abc import Iterator, Sequence
from json.decoder import WHITESPACE, scanstring  # type: ignore[attr-defined]
from typing import Any, overload

__all__ = ["TextArray", "parse_large"]


class TextArray(Sequence[Any]):
    """An array of a document, kept as valid JSON text with the position of each entry.

    starts : offset of each entry in the text, and of the text after the last one
    """

    def __init__(self, text: str, starts: array[int], decoder: json.JSONDecoder) -> None:
        self._text = text
        self._starts = starts
        self._decoder = decoder

    def __len__(self) -> int:
        return len(self._starts) - 1

    @overload
    def __getitem__(self, index: int) -> Any: ...
    @overload
    def __getitem__(self, index: slice) -> list[Any]: ...
    def __getitem__(self, index: int | slice) -> Any:
        if isinstance(index, slice):
            return [self[i] for i in range(*index.indices(len(self)))]
        if not 0 <= index < len(self):
            raise IndexError(index)
        return self._decoder.raw_decode(self._text, self._starts[index])[0]

    def __iter__(self) -> Iterator[Any]:
        return (self[i] for i in range(len(self)))


def parse_large(text: str, decoder: json.JSONDecoder) -> Any:
    """Parse a document as ``decoder.decode`` does, except that each array directly below the top-level object becomes a
    `TextArray`.

    The whole document is checked: every entry is parsed once and discarded.

    Raises
    ------
    ValueError : as for ``decoder.decode``
    """
    at = _blank(text, 0)
    if text[at : at + 1] != "{":
        return decoder.decode(text)
    pairs: list[tuple[str, Any]] = []
    at = _blank(text, at + 1)
    while text[at : at + 1] != "}" or pairs:
        if text[at : at + 1] != '"':
            raise json.JSONDecodeError("Expecting property name enclosed in double quotes", text, at)
        key, at = scanstring(text, at + 1, True)
        at = _after(text, at, ":")
        if text[at : at + 1] == "[":
            value, at = _entries(text, at, decoder)
        else:
            value, at = decoder.raw_decode(text, at)
        pairs.append((key, value))
        at = _blank(text, at)
        if text[at : at + 1] == "}":
            break
        at = _after(text, at, ",")
    end = _blank(text, at + 1)
    if end != len(text):
        raise json.JSONDecodeError("Extra data", text, end)
    return decoder.object_pairs_hook(pairs)


def _entries(text: str, at: int, decoder: json.JSONDecoder) -> tuple[TextArray, int]:
    starts = array("q")
    at = _blank(text, at + 1)
    while text[at : at + 1] != "]" or len(starts):
        starts.append(at)
        _, at = decoder.raw_decode(text, at)
        at = _blank(text, at)
        if text[at : at + 1] == "]":
            break
        at = _after(text, at, ",")
    starts.append(at)
    return TextArray(text, starts, decoder), at + 1


def _after(text: str, at: int, mark: str) -> int:
    at = _blank(text, at)
    if text[at : at + 1] != mark:
        raise json.JSONDecodeError(f"Expecting {mark!r} delimiter", text, at)
    return _blank(text, at + 1)


def _blank(text: str, at: int) -> int:
    found = WHITESPACE.match(text, at)
    assert found is not None
    return int(found.end())
