"""What a text says, found without the templates that it was made from.

A text is read the way a person reads it: clause by clause, each "if", question and answer narrowing down under which
circumstances its stops are meant. Circumstances are sets of assignments of truth to the conditions named so far (a
bit mask), so that a reading is a function from what is true to where to go. Every way to attach an answer or an
"otherwise" to what was asked before is followed; a text is sound when exactly one function comes out that says once,
and only once, where to go in every case. That function must also be the one of a listener who takes every answer for
the latest question: who has to think back has not understood.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final, NamedTuple

from condvln.verify.phrasebook import phrasebook
from condvln.verify.phrases import Moves, Named, Phrase, PhraseReader

__all__ = ["MAX_CONDITIONS", "TextReading", "Unreadable", "read"]

MAX_CONDITIONS: Final = 3
"""Most conditions of any category."""

_CASES: Final = 1 << MAX_CONDITIONS
_ALWAYS: Final = (1 << _CASES) - 1
_HOLDS: Final = tuple(sum(1 << case for case in range(_CASES) if case >> k & 1) for k in range(MAX_CONDITIONS))
"""The cases, as bits, in which condition k is true."""


class Unreadable(Exception):
    """The text has no reading, or several; the message says where or why."""


@dataclass(frozen=True, slots=True)
class TextReading:
    """conditions in the order of their first mention; moves[c] for the case c whose bit k is the truth of k."""

    conditions: tuple[Phrase, ...]
    moves: tuple[Moves, ...]
    heading: str | None


class _Ask(NamedTuple):
    """Something asked or supposed: in which cases at all, of which condition, and in which cases the "if" holds.

    guard : of an "if", the cases it is for; None of a question
    """

    context: int
    condition: int
    guard: int | None


class _State(NamedTuple):
    """A text read so far.

    room : named last; rules : (cases, moves); asks : in their order; open : places in `asks` of the "if"s without an
    "otherwise" yet; listed : in a list, the cases of the entries so far; None outside of lists
    early : an answer was not taken for the latest question
    """

    at: int
    room: Named | None
    named: tuple[Phrase, ...]
    rules: tuple[tuple[int, Moves], ...]
    asks: tuple[_Ask, ...]
    open: tuple[int, ...]
    listed: int | None
    early: bool


def read(text: str, code: str = "en") -> TextReading:
    """The one reading of `text`.

    Raises
    ------
    Unreadable
        It has none, or more than one, or one that a listener would not come to first.
    """
    reader = _Reader(phrasebook(code), text)
    found = list(reader.readings())
    if not found:
        raise Unreadable(f"no reading; it breaks off before {reader.rest()!r}")
    functions = {reading for reading, _ in found}
    if len(functions) > 1:
        raise Unreadable(f"{len(functions)} readings: it could be meant in as many ways")
    if all(early for _, early in found):
        raise Unreadable("an answer does not belong to the question before it")
    conditions, moves, heading = found[0][0]
    return TextReading(conditions, moves, heading)


_Function = tuple[tuple[Phrase, ...], tuple[Moves, ...], str | None]


class _Reader(PhraseReader):
    """All readings of one text."""

    def readings(self) -> Iterator[tuple[_Function, bool]]:
        """Meanings of the whole text, perhaps repeated, and whether they think back to an earlier question."""
        for at, heading in self._opening():
            for start, scope in self._scopes(at):
                self.scope = scope
                for state in self._sentences(_State(start, scope, (), (), (), (), None, False), _ALWAYS):
                    table = _table(state)
                    if table is not None:
                        yield (state.named, table, heading), state.early

    # -- sentences -----------------------------------------------------------------------------------------------------

    def _sentences(self, state: _State, base: int) -> Iterator[_State]:
        """Clauses to the end of the text; `base` are the cases that the clauses of this sentence are about."""
        for end, _, _ in self._of(state.at, "list"):
            if self._is(end, ".") or self._is(end, ":"):
                yield from self._sentences(state._replace(at=end + 1, listed=0), base)
        for end, _, _ in self._of(state.at, "number"):
            yield from self._sentences(state._replace(at=end), base)
        for after, its_base in self._clause(state, _ALWAYS, base):
            mark = self.tokens[after.at] if after.at < len(self.tokens) else ""
            if mark in (".", "?"):
                if after.at + 1 == len(self.tokens):
                    yield after
                else:
                    yield from self._sentences(after._replace(at=after.at + 1), _ALWAYS)
            elif mark in (";", ":"):
                yield from self._sentences(after._replace(at=after.at + 1), its_base)

    def _clause(self, state: _State, context: int, base: int) -> Iterator[tuple[_State, int]]:
        """One clause with all that hangs on it, and the base of the clauses after it."""
        at = state.at
        for end, _, _ in self._of(at, "filler"):
            yield from self._clause(state._replace(at=end + self._is(end, ",")), context, base)
        for end, _, _ in self._of(at, "but"):
            yield from self._clause(state._replace(at=end), context, base)
        for end, _, _ in self._of(at, "if"):
            yield from self._supposed(state._replace(at=end), context & base, base)
            yield from self._answered(state._replace(at=end), base)
        for end, _, _ in self._of(at, "otherwise"):
            for place in state.open:
                ask = state.asks[place]
                assert ask.guard is not None
                meant = state._replace(
                    at=end,
                    open=tuple(other for other in state.open if other != place),
                    early=state.early or place != len(state.asks) - 1,
                )
                yield from self._comma(meant, ask.context & ~ask.guard, base)
        yield from self._request(state, context & base, base)

    def _supposed(self, state: _State, context: int, base: int) -> Iterator[tuple[_State, int]]:
        """A claim behind "if", and what follows from it."""
        if state.listed is not None:
            context &= ~state.listed
        for claimed, present, what, room in self._said(state.at, state.room):
            end = next((after for after, _, _ in self._of(claimed, "either")), claimed)
            for k, named in self._condition(state, what):
                asked = [ask.context for ask in state.asks if ask.condition == k]
                within = context & asked[0] if asked else context  # asked again, under the same circumstances
                guard = _HOLDS[k] if present else _ALWAYS & ~_HOLDS[k]
                opened = state._replace(
                    at=end,
                    room=room,
                    named=named,
                    asks=(*state.asks, _Ask(within, k, guard)),
                    open=(*state.open, len(state.asks)),
                    listed=None if state.listed is None else state.listed | guard,
                )
                yield from self._but(opened, within & guard, base)

    def _answered(self, state: _State, base: int) -> Iterator[tuple[_State, int]]:
        """An answer behind "if", and what follows from it: "so", "there is one", "it isn't", "neither is true"."""
        for slot, answer, kind in _ANSWERS:
            for end, _, _ in self._of(state.at, slot):
                for place, ask in enumerate(state.asks):
                    if kind is not None and state.named[ask.condition].known != kind:
                        continue
                    cases = ask.context & (_HOLDS[ask.condition] if answer else ~_HOLDS[ask.condition])
                    early = state.early or place != len(state.asks) - 1
                    yield from self._but(state._replace(at=end, early=early), cases, base)
        for slot, count in (("neither", (2,)), ("none", (2, 3))):
            for end, _, _ in self._of(state.at, slot):
                guards = [ask.guard for ask in state.asks if ask.guard is not None]
                if len(guards) == len(state.asks) and len(guards) in count:
                    cases = _ALWAYS
                    for guard in guards:
                        cases &= ~guard
                    yield from self._but(state._replace(at=end), cases, base)

    def _but(self, state: _State, context: int, base: int) -> Iterator[tuple[_State, int]]:
        """What follows from an answer or a claim, or from it and one claim more: "if not, but there's a chair, …"."""
        yield from self._comma(state, context, base)
        if self._is(state.at, ","):
            for joint in ("and", "but"):
                for end, _, _ in self._of(state.at + 1, joint):
                    yield from self._supposed(state._replace(at=end), context, base)

    def _comma(self, state: _State, context: int, base: int) -> Iterator[tuple[_State, int]]:
        """What to do in the cases `context`: walk, look further, or suppose something more."""
        if not context or not self._is(state.at, ","):
            return
        at = state.at + 1
        starts = [at, *(end for end, _, _ in self._of(at, "filler"))]
        for end, moves, room in (found for start in starts for found in self._stops(start, state.room)):
            yield state._replace(at=end, room=room, rules=(*state.rules, (context, moves))), base
        yield from self._request(state._replace(at=at), context, context)
        for end, _, _ in self._of(at, "if"):
            yield from self._supposed(state._replace(at=end), context, base)

    def _request(self, state: _State, context: int, base: int) -> Iterator[tuple[_State, int]]:
        for end, what, room in self._requests(state.at, state.room):
            for k, named in self._condition(state, what):
                asking = (*state.asks, _Ask(context, k, None))
                yield state._replace(at=end, room=room, named=named, asks=asking), base

    def _condition(self, state: _State, what: Phrase) -> Iterator[tuple[int, tuple[Phrase, ...]]]:
        """Number of a condition, and all that are named with it.

        A known thing without a room is in that of the condition before it.
        """
        known = [k for k, one in enumerate(state.named) if one == what or _is_again(what, one)]
        if known:
            yield from ((k, state.named) for k in known)
        elif len(state.named) < MAX_CONDITIONS:
            if what.known and what.room is None and state.asks:
                what = what._replace(room=state.named[state.asks[-1].condition].room)
            yield len(state.named), (*state.named, what)


def _is_again(what: Phrase, before: Phrase) -> bool:
    """Whether a relation is one that was named before, now without its room."""
    return what.room is None and what.qualifier is not None and what == before._replace(room=None)


_ANSWERS: Final = (
    ("so", True, None),
    ("not", False, None),
    ("yes_one", True, False),
    ("no_one", False, False),
    ("yes_it", True, True),
    ("no_it", False, True),
)
"""Slot of an answer, what it says, and whether it speaks of a definite thing (None: of either)."""


def _table(state: _State) -> tuple[Moves, ...] | None:
    """The moves of each case of the conditions named; None unless every case has them exactly once."""
    covered = 0
    for cases, _ in state.rules:
        if not cases or covered & cases:
            return None
        covered |= cases
    if covered != _ALWAYS:
        return None
    return tuple(
        next(moves for cases, moves in state.rules if cases >> case & 1) for case in range(1 << len(state.named))
    )
