"""What a text says, found without the templates that it was made from.

A text is read the way a person reads it: clause by clause, each "if", question and answer narrowing down under which
circumstances its stops are meant. Circumstances are sets of assignments of truth to the conditions named so far (a
bit mask), so that a reading is a function from what is true to where to go. Every way to attach an answer or an
"otherwise" to what was asked before is followed; a text is sound when exactly one function comes out that says once,
and only once, where to go in every case. That function must also be the one of a listener who takes every answer for
the latest question: who has to think back has not understood.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, Final, NamedTuple

from condvln.verify.phrasebook import SO_FAR, Matches, Phrasebook, phrasebook

__all__ = ["MAX_CONDITIONS", "Moves", "Named", "Phrase", "Reading", "Unreadable", "read"]

MAX_CONDITIONS: Final = 3
"""Most conditions of any category."""

_CASES: Final = 1 << MAX_CONDITIONS
_ALWAYS: Final = (1 << _CASES) - 1
_HOLDS: Final = tuple(sum(1 << case for case in range(_CASES) if case >> k & 1) for k in range(MAX_CONDITIONS))
"""The cases, as bits, in which condition k is true."""


class Unreadable(Exception):
    """The text has no reading, or several; the message says where or why."""


class Named(NamedTuple):
    """A room as named: its type, and the label of the thing that tells it apart."""

    label: str
    anchor: str | None


class Phrase(NamedTuple):
    """A thing as named: label, (predicate, label of the anchor), and the room; None where the text names none.

    known : of a condition, whether it speaks of one thing that is known to be there ("the lamp is near the bed")
    """

    label: str
    qualifier: tuple[str, str] | None
    room: Named | None
    known: bool = False

    def __str__(self) -> str:
        qualifier = "" if self.qualifier is None else " {} {}".format(*self.qualifier)
        room = "" if self.room is None else f" in {self.room.label}"
        anchor = "" if self.room is None or self.room.anchor is None else f" with {self.room.anchor}"
        return f"{'the ' if self.known else ''}{self.label}{qualifier}{room}{anchor}"


Moves = tuple[Phrase, ...]


@dataclass(frozen=True, slots=True)
class Reading:
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


_Match = tuple[int, str, frozenset[str]]
_Place = tuple[int, Named | None]
"""A place in the text, and the room named last before it."""

_STOPS: Final = frozenset(".;:")
"""Marks that end a clause which says where to go."""


def read(text: str, code: str = "en") -> Reading:
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
    return Reading(conditions, moves, heading)


_Function = tuple[tuple[Phrase, ...], tuple[Moves, ...], str | None]


class _Reader:
    """All readings of one text. The words that begin at a place are looked up once, whatever led there."""

    def __init__(self, book: Phrasebook, text: str) -> None:
        self.book = book
        self.tokens = book.tokens(text)
        self.furthest = 0
        self.scope: Named | None = None
        self._matches: dict[int, Matches] = {}

    def rest(self) -> str:
        """Some words from the furthest place that was reached."""
        return " ".join(self.tokens[self.furthest : self.furthest + 6])

    def readings(self) -> Iterator[tuple[_Function, bool]]:
        """Meanings of the whole text, perhaps repeated, and whether they think back to an earlier question."""
        for at, heading in self._opening():
            for start, scope in self._scopes(at):
                self.scope = scope
                for state in self._sentences(_State(start, scope, (), (), (), (), None, False), _ALWAYS):
                    table = _table(state)
                    if table is not None:
                        yield (state.named, table, heading), state.early

    # -- words and phrases ---------------------------------------------------------------------------------------------

    def _here(self, at: int) -> Matches:
        """By kind, the phrases that begin at a place."""
        found = self._matches.get(at)
        if found is None:
            if at > self.furthest:
                self.furthest = at
            node: Any = self.book.tree
            for token in self.tokens[at:]:
                below = node.get(token)
                if below is None:
                    break
                node = below
            found = self._matches[at] = node[SO_FAR]
        return found

    def _of(self, at: int, kind: str) -> Sequence[_Match]:
        """(end, value, classes) of the phrases of a kind that begin at a place."""
        here = self._matches.get(at)
        if here is None:
            here = self._here(at)
        if kind not in here:
            return ()
        return [(at + words, value, classes) for words, value, classes in here[kind]]

    def _is(self, at: int, mark: str) -> bool:
        return at < len(self.tokens) and self.tokens[at] == mark

    def _opening(self) -> Iterator[tuple[int, str | None]]:
        yield 0, None
        for end, _, _ in self._of(0, "facing"):
            for stop, direction, _ in self._of(end, "direction"):
                if self._is(stop, "."):
                    yield stop + 1, direction

    def _scopes(self, at: int) -> Iterator[_Place]:
        yield at, None
        for end, _, _ in self._of(at, "scope"):
            for stop, room in self._rooms(end):
                if self._is(stop, ","):
                    yield stop + 1, room

    def _agreeing(self, at: int, kind: str, classes: frozenset[str]) -> Iterator[tuple[int, str]]:
        for end, label, own in self._of(at, kind):
            if own & classes:
                yield end, label

    def _definite(self, at: int, kind: str) -> Iterator[tuple[int, str]]:
        for end, _, classes in self._of(at, "the"):
            yield from self._agreeing(end, kind, classes)

    def _rooms(self, at: int) -> Iterator[tuple[int, Named]]:
        for end, label in self._definite(at, "room"):
            yield end, Named(label, None)
            for after, _, _ in self._of(end, "with"):
                for stop, anchor in self._definite(after, "noun"):
                    yield stop, Named(label, anchor)

    def _related(self, at: int) -> Iterator[tuple[int, tuple[str, str]]]:
        for end, predicate, _ in self._of(at, "predicate"):
            for stop, anchor in self._definite(end, "noun"):
                yield stop, (predicate, anchor)

    def _qualified(self, at: int) -> Iterator[tuple[int, tuple[str, str] | None]]:
        yield at, None
        yield from self._related(at)

    def _where(
        self, at: int, last: Named | None, belonging: bool = False
    ) -> Iterator[tuple[int, Named | None, Named | None]]:
        """(end, the room, the room named last) of "in the bedroom", of "there", and of nothing.

        belonging : right behind a definite noun, where some languages have other words ("la cama del dormitorio")
        """
        yield at, self.scope, last
        for end, _, _ in self._of(at, "of" if belonging else "in"):
            for stop, room in self._rooms(end):
                yield stop, room, room
        if last is not None:
            for end, _, _ in self._of(at, "there_of" if belonging else "there"):
                yield end, last, last

    def _things(self, at: int, last: Named | None) -> Iterator[tuple[int, Phrase, Named | None]]:
        """Stops as the moves name them: "the lamp near the bed in the bedroom"."""
        for end, label in self._definite(at, "noun"):
            for stop, qualifier in self._qualified(end):
                for after, room, named in self._where(stop, last, belonging=qualifier is None):
                    yield after, Phrase(label, qualifier, room), named

    # -- conditions ----------------------------------------------------------------------------------------------------

    def _some(self, slot: str, at: int, last: Named | None) -> Iterator[tuple[int, Phrase, Named | None]]:
        """ "there's a lamp near the bed in the bedroom", by the phrases of a slot."""
        for end, _, classes in self._of(at, slot):
            for after, label in self._agreeing(end, "noun", classes):
                for stop, qualifier in self._qualified(after):
                    for place, room, named in self._where(stop, last):
                        yield place, Phrase(label, qualifier, room), named

    def _held(self, slot: str, at: int) -> Iterator[tuple[int, Phrase, Named | None]]:
        """ "the bedroom has a lamp near the bed", by the phrases of a slot between room and thing."""
        for end, room in self._rooms(at):
            for after, _, classes in self._of(end, slot):
                for stop, label in self._agreeing(after, "noun", classes):
                    for place, qualifier in self._qualified(stop):
                        yield place, Phrase(label, qualifier, room), room

    def _known(self, slot: str | None, at: int, last: Named | None) -> Iterator[tuple[int, Phrase, Named | None]]:
        """ "the lamp in the bedroom is near the bed", by the phrases of a slot; of None there is no verb in between."""
        for end, label in self._definite(at, "noun"):
            for after, room, named in self._where(end, last, belonging=True):
                verbs = [after] if slot is None else [stop for stop, _, _ in self._of(after, slot)]
                for verb in verbs:
                    for stop, qualifier in self._related(verb):
                        yield stop, Phrase(label, qualifier, room, True), named

    def _said(self, at: int, last: Named | None) -> Iterator[tuple[int, bool, Phrase, Named | None]]:
        """Claims: (end, whether it is said to hold, what, room named last)."""
        for present, some, held, known in ((True, "exists", "has", "is"), (False, "absent", "lacks", "is_not")):
            for found in (self._some(some, at, last), self._held(held, at), self._known(known, at, last)):
                for end, what, named in found:
                    yield end, present, what, named

    def _requests(self, at: int, last: Named | None) -> Iterator[tuple[int, Phrase, Named | None]]:
        """Requests to look, and questions with their mark."""
        for end, _, _ in self._of(at, "filler"):
            yield from self._requests(end, last)
        for end, _, _ in self._of(at, "see"):
            for stop, present, what, named in self._said(end, last):
                if present:
                    yield stop, what, named
        yield from self._some("look", at, last)
        for end, _, _ in self._of(at, "check"):
            yield from self._held("for", end)
        questions = [*self._some("is_there", at, last)]
        questions += [found for end, _, _ in self._of(at, "does") for found in self._held("have", end)]
        questions += [found for end, _, _ in self._of(at, "asks_is") for found in self._known(None, end, last)]
        yield from ((end, what, named) for end, what, named in questions if self._is(end, "?"))

    def _stops(self, at: int, last: Named | None) -> Iterator[tuple[int, Moves, Named | None]]:
        """Where to go, up to the end of a clause: nothing comes between the last stop and the mark."""
        for start, _, _ in self._of(at, "go"):
            ahead: list[tuple[int, Moves, Named | None]] = [
                (stop, (thing,), named) for stop, thing, named in self._things(start, last)
            ]
            while ahead:
                end, moves, named = ahead.pop()
                if end < len(self.tokens) and self.tokens[end] in _STOPS:
                    yield end, moves, named
                for slot in ("then", "second", "last"):
                    for after, _, _ in self._of(end, slot):
                        ahead += [(stop, (*moves, thing), room) for stop, thing, room in self._things(after, named)]

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
        for end, present, what, room in self._said(state.at, state.room):
            for k, named in self._condition(state, what):
                guard = _HOLDS[k] if present else _ALWAYS & ~_HOLDS[k]
                opened = state._replace(
                    at=end,
                    room=room,
                    named=named,
                    asks=(*state.asks, _Ask(context, k, guard)),
                    open=(*state.open, len(state.asks)),
                    listed=None if state.listed is None else state.listed | guard,
                )
                yield from self._comma(opened, context & guard, base)

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
        """What follows from an answer, or from it and one claim more: "if not, but there's a chair, …"."""
        yield from self._comma(state, context, base)
        if self._is(state.at, ","):
            for end, _, _ in self._of(state.at + 1, "but"):
                yield from self._supposed(state._replace(at=end), context, base)

    def _comma(self, state: _State, context: int, base: int) -> Iterator[tuple[_State, int]]:
        """What to do in the cases `context`: walk, look further, or suppose something more."""
        if not context or not self._is(state.at, ","):
            return
        at = state.at + 1
        for end, moves, room in self._stops(at, state.room):
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
        """Number of a condition, and all that are named with it."""
        if what in state.named:
            yield state.named.index(what), state.named
        elif len(state.named) < MAX_CONDITIONS:
            yield len(state.named), (*state.named, what)


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
