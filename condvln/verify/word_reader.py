"""The words of one text: which phrases begin at a word, and what words meant in earlier texts."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Callable, Iterator, Sequence
from typing import Any, Final, TypeVar

from condvln.verify.phrasebook import MARKS, SO_FAR, Matches, Phrasebook

__all__ = ["ENDS", "LONGEST_KEPT", "MOST_KEPT", "Match", "WordReader", "kept", "parsed_once"]

Match = tuple[int, str, frozenset[str]]
"""A phrase that begins at some word: its end, its value, and the noun classes that it agrees with."""

ENDS: Final = frozenset(MARKS) - {","}
"""Punctuation that ends a sentence or a part of one. No phrase goes beyond it."""
LONGEST_KEPT: Final = 64
"""Words of the longest part of a sentence whose meaning is kept for later texts."""
MOST_MEANINGS: Final = 8
"""Most meanings of a part of a sentence that are kept, which bounds the memory for texts made to be ambiguous."""
MOST_KEPT: Final = 1 << 14
"""Parts of sentences whose meanings are kept."""

F = TypeVar("F")
_Parser = Callable[[Any, int, Any], Iterator[F]]
_Parsed = Callable[[Any, int, Any], Sequence[F]]


def parsed_once(*first: str) -> Callable[[_Parser[F]], _Parsed[F]]:
    """Return a decorator for parsers of `WordReader`, whose arguments are a position and the room named last. Each
    position of a text is parsed once, although several readings lead to it.

    first : the kinds of phrases that the results may begin with
    """
    kinds = frozenset(first)

    def of(parse: _Parser[F]) -> _Parsed[F]:
        name = parse.__name__

        def parsed(self: WordReader, at: int, last: Any) -> Sequence[F]:
            if self.here(at).keys().isdisjoint(kinds):
                return ()
            key = (name, at, last, self.scope)
            found = self.parsed.get(key)
            if found is None:
                found = self.parsed[key] = list(parse(self, at, last))
            return found

        return parsed

    return of


def kept(*first: str) -> Callable[[_Parser[F]], _Parsed[F]]:
    """Return a decorator as `parsed_once`, whose results are also kept for other texts with the same words.

    The results are tuples that begin with a position. They must not depend on words beyond a comma; behind a comma, not
    on words beyond another mark.
    """
    kinds = frozenset(first)

    def of(parse: _Parser[F]) -> _Parsed[F]:
        name = parse.__name__

        def parsed(self: WordReader, at: int, last: Any) -> Sequence[F]:
            if self.here(at).keys().isdisjoint(kinds) and not self.is_mark(at, ","):
                return ()
            key = (name, at, last, self.scope)
            found = self.parsed.get(key)
            if found is None:
                found = self.parsed[key] = self.from_earlier(key, lambda: parse(self, at, last))
            return found

        return parsed

    return of


class WordReader:
    """Finds the phrases that begin at each word of a text, each looked up only once.

    alone : whether to parse all words of the text itself, which `rest` needs
    scope : the room named at the beginning of the text, which applies to all objects without a room
    """

    def __init__(self, book: Phrasebook, text: str, *, alone: bool = False) -> None:
        self.book = book
        self.tokens = book.tokens(text)
        self.letters = book.spelled(self.tokens)
        self.pauses = [at for at, token in enumerate(self.tokens) if token in MARKS]
        self._ends = [at for at in self.pauses if self.tokens[at] != ","]
        self.alone = alone
        self.furthest = 0
        self.scope: Any = None
        self.parsed: dict[tuple[str, int, Any, Any], list[Any]] = {}
        self._matches: list[Matches | None] = [None] * (len(self.tokens) + 2)

    def rest(self) -> str:
        """Return some words of the text, starting at the furthest position that was parsed."""
        return " ".join(self.tokens[self.furthest : self.furthest + 6])

    def here(self, at: int) -> Matches:
        """Return the phrases that begin at the word `at`, by kind."""
        found = self._matches[at]
        return self._look_up(at) if found is None else found

    def _look_up(self, at: int) -> Matches:
        if at > self.furthest:
            self.furthest = at
        node: Any = self.book.tree
        for token in self.tokens[at : at + self.book.longest]:
            below = node.get(token)
            if below is None:
                break
            node = below
        found: Matches = node[SO_FAR]
        self._matches[at] = found
        return found

    def of(self, at: int, kind: str) -> Sequence[Match]:
        """Return (end, value, classes) of each phrase of a kind that begins at the word `at`."""
        here = self._matches[at]
        if here is None:
            here = self._look_up(at)
        found = here.get(kind)
        if found is None:
            return ()
        if len(found) == 1:
            ((words, value, classes),) = found
            return ((at + words, value, classes),)
        return [(at + words, value, classes) for words, value, classes in found]

    def is_mark(self, at: int, mark: str) -> bool:
        """Return whether the word `at` is this punctuation mark."""
        return at < len(self.tokens) and self.tokens[at] == mark

    # -- earlier texts -------------------------------------------------------------------------------------------------

    def told_before(self, at: int, words: str) -> tuple[Any, ...]:
        """Return what the text before the word `at` contributes to the meaning of `words`: here, nothing."""
        return ()

    def from_earlier(self, key: tuple[str, int, Any, Any], parse: Callable[[], Iterator[Any]]) -> list[Any]:
        """Return what `parse` yields, taken from an earlier text that had the same words up to the next comma and told
        the same before them, if there was one.

        key : name of the parser, position, room named last, scope
        """
        if self.alone:
            return list(parse())
        name, at, last, scope = key
        ends = self._ends if self.is_mark(at, ",") else self.pauses
        after = bisect_left(ends, at)
        words = self.letters[at : ends[after] + 1 if after < len(ends) else None]
        return self.once((name, last, scope, words, self.told_before(at, words)), at, parse)

    def once(self, told: tuple[Any, ...], at: int, parse: Callable[[], Iterator[Any]]) -> list[Any]:
        """Return what `parse` yields at the word `at`, from an earlier text if one has `told` the same. The last two
        entries of `told` are the words, one character each, and what was told before them.
        """
        if self.alone or len(told[-2]) > LONGEST_KEPT or len(told[-1]) > LONGEST_KEPT:
            return list(parse())
        known = self.book.parsed.get(told)
        if known is not None:
            return [(at + length, *rest) for length, *rest in known]
        found = list(parse())
        if len(found) <= MOST_MEANINGS:
            if len(self.book.parsed) >= MOST_KEPT:
                self.book.parsed.clear()
            self.book.parsed[told] = [(end - at, *rest) for end, *rest in found]
        return found
