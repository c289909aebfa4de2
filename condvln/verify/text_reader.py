"""Find the meaning of a text without using the templates that the text was made from.

A text is valid if exactly one function from truths to stops results that gives stops exactly once for every case. A
listener who refers every answer to the latest question must also get this function, since otherwise the text would be
hard to follow.
"""

from __future__ import annotations

from dataclasses import dataclass

from condvln.verify.clause_reader import MAX_CONDITIONS, ClauseReader, chosen, in_rooms
from condvln.verify.phrasebook import phrasebook
from condvln.verify.phrases import Moves, Phrase
from condvln.verify.text_table import TextTable

__all__ = ["MAX_CONDITIONS", "TextReading", "Unreadable", "read"]


class Unreadable(Exception):
    """The text has no reading, or several; the message says where or why."""


@dataclass(frozen=True, slots=True)
class TextReading:
    """The reading of a text.

    conditions : in the order of their first mention
    moves : moves[c] for the case c whose bit k is the truth of condition k
    """

    conditions: tuple[Phrase, ...]
    moves: tuple[Moves, ...]
    heading: str | None


def read(text: str, code: str = "en") -> TextReading:
    """Return the reading of `text`, which must have exactly one, in language `code`.

    Raises
    ------
    Unreadable
        It has none, or more than one, or one that is not the first that a listener would assume.
    """
    book = phrasebook(code)
    known = TextTable.of(book).function(text)
    return read_in_full(text, code) if known is None else TextReading(*known)


def read_in_full(text: str, code: str = "en") -> TextReading:
    """Return what `read` returns, by following all ways to read the whole text."""
    book = phrasebook(code)
    reader = ClauseReader(book, text)
    found = []
    for state, moves, heading in reader.readings():
        choice = chosen(state)
        if choice is not None:
            placed = in_rooms(state.named, moves)
            found.append(((state.named, tuple([placed[rule] for rule in choice]), heading), state.early))
    if not found:
        reader = ClauseReader(book, text, alone=True)
        list(reader.readings())
        raise Unreadable(f"no reading; parsing stops before {reader.rest()!r}")
    functions = {function for function, _ in found}
    if len(functions) > 1:
        raise Unreadable(f"the text is ambiguous: it has {len(functions)} readings")
    if all(early for _, early in found):
        raise Unreadable("an answer does not refer to the question before it")
    return TextReading(*found[0][0])
