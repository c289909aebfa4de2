"""What a text says, found without the templates that it was made from.

A text is read the way a person reads it: clause by clause, each "if", question and answer narrowing down under which
circumstances its stops are meant. Circumstances are sets of assignments of truth to the conditions named so far (a
bit mask), so that a reading is a function from what is true to where to go. Every way to attach an "otherwise" to an
open "if", or an answer to an open question, is followed; a text is sound when exactly one function comes out that says
once, and only once, where to go in every case.
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
    """A thing as named: label, (predicate, label of the anchor), and the room; None where the text names none."""

    label: str
    qualifier: tuple[str, str] | None
    room: Named | None

    def __str__(self) -> str:
        qualifier = "" if self.qualifier is None else " {} {}".format(*self.qualifier)
        room = "" if self.room is None else f" in {self.room.label}"
        anchor = "" if self.room is None or self.room.anchor is None else f" with {self.room.anchor}"
        return f"{self.label}{qualifier}{room}{anchor}"


Moves = tuple[Phrase, ...]


@dataclass(frozen=True, slots=True)
class Reading:
    """conditions in the order of their first mention; moves[c] for the case c whose bit k is the truth of k."""

    conditions: tuple[Phrase, ...]
    moves: tuple[Moves, ...]
    heading: str | None


class _State(NamedTuple):
    """A text read so far.

    rules : (cases, moves); ifs : (context, cases) without an "otherwise" yet; asked : (context, cases) of the
    questions, with whether "if so" and "if not" are still to come
    """

    at: int
    named: tuple[Phrase, ...]
    rules: tuple[tuple[int, Moves], ...]
    ifs: tuple[tuple[int, int], ...]
    asked: tuple[tuple[int, int, bool, bool], ...]

    def on(self, at: int) -> _State:
        """The same at a later place."""
        return _State(at, self.named, self.rules, self.ifs, self.asked)


_Match = tuple[int, str, frozenset[str]]

_STOPS: Final = frozenset(".;:")
"""Marks that end a clause which says where to go."""

_SAME_ROOM: Final = Named("", "the same room")


def read(text: str, code: str = "en") -> Reading:
    """The one reading of `text`.

    Raises
    ------
    Unreadable
        It has none, or more than one.
    """
    reader = _Reader(phrasebook(code), text)
    found = list(reader.readings())
    if not found:
        raise Unreadable(f"no reading; it breaks off before {reader.rest()!r}")
    if any(other != found[0] for other in found[1:]):
        raise Unreadable(f"{len(set(found))} readings: it could be meant in as many ways")
    conditions, moves, heading = found[0]
    return Reading(conditions, moves, heading)


class _Reader:
    """All readings of one text. What begins at a place is found once, whatever led there."""

    def __init__(self, book: Phrasebook, text: str) -> None:
        self.book = book
        self.tokens = book.tokens(text)
        self.furthest = 0
        self.scope: Named | None = None
        self._matches: dict[int, Matches] = {}
        self._phrases: dict[int, list[tuple[int, Phrase]]] = {}
        self._literals: dict[int, list[tuple[int, bool, Phrase | str]]] = {}
        self._moves: dict[int, list[tuple[int, Moves]]] = {}

    def rest(self) -> str:
        """Some words from the furthest place that was reached."""
        return " ".join(self.tokens[self.furthest : self.furthest + 6])

    def readings(self) -> Iterator[tuple[tuple[Phrase, ...], tuple[Moves, ...], str | None]]:
        """Meanings of the whole text, perhaps repeated."""
        for at, heading in self._opening():
            for start, scope in self._scopes(at):
                self.scope = scope
                for memory in (self._phrases, self._literals, self._moves):
                    memory.clear()  # a scope decides what a thing without a room means
                for state in self._sentences(_State(start, (), (), (), ()), _ALWAYS):
                    table = _table(state)
                    if table is not None:
                        yield state.named, table, heading

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
        found = here[kind]
        if len(found) == 1:
            words, value, classes = found[0]
            return ((at + words, value, classes),)
        return [(at + words, value, classes) for words, value, classes in found]

    def _is(self, at: int, mark: str) -> bool:
        return at < len(self.tokens) and self.tokens[at] == mark

    def _opening(self) -> Iterator[tuple[int, str | None]]:
        yield 0, None
        for end, _, _ in self._of(0, "facing"):
            for stop, direction, _ in self._of(end, "direction"):
                if self._is(stop, "."):
                    yield stop + 1, direction

    def _scopes(self, at: int) -> Iterator[tuple[int, Named | None]]:
        yield at, None
        for end, _, _ in self._of(at, "scope"):
            for stop, room in self._rooms(end):
                if self._is(stop, "."):
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

    def _qualified(self, at: int) -> Iterator[tuple[int, tuple[str, str] | None]]:
        yield at, None
        for end, predicate, _ in self._of(at, "predicate"):
            for stop, anchor in self._definite(end, "noun"):
                yield stop, (predicate, anchor)

    def _things(self, at: int) -> list[tuple[int, Phrase]]:
        """Stops as the moves name them: "the lamp near the bed in the bedroom"."""
        if at not in self._phrases:
            found = []
            for end, label in self._definite(at, "noun"):
                for stop, qualifier in self._qualified(end):
                    found.append((stop, Phrase(label, qualifier, self.scope)))
                    for after, _, _ in self._of(stop, "in"):
                        found += [(last, Phrase(label, qualifier, room)) for last, room in self._rooms(after)]
                    found += [(last, Phrase(label, qualifier, _SAME_ROOM)) for last, _, _ in self._of(stop, "same")]
            self._phrases[at] = found
        return self._phrases[at]

    def _said(self, at: int) -> list[tuple[int, bool, Phrase | str]]:
        """Claims of presence or absence: (end, presence, what); a label alone where it says "such a lamp"."""
        if at not in self._literals:
            self._literals[at] = [*self._there(at), *self._held(at), *self._such(at)]
        return self._literals[at]

    def _there(self, at: int) -> Iterator[tuple[int, bool, Phrase]]:
        for slot, present in (("exists", True), ("absent", False)):
            for end, _, classes in self._of(at, slot):
                for after, label in self._agreeing(end, "noun", classes):
                    for stop, qualifier in self._qualified(after):
                        yield stop, present, Phrase(label, qualifier, self.scope)
                        for last, _, _ in self._of(stop, "anywhere"):
                            yield last, present, Phrase(label, qualifier, self.scope)
                        for inside, _, _ in self._of(stop, "in"):
                            for last, room in self._rooms(inside):
                                yield last, present, Phrase(label, qualifier, room)

    def _held(self, at: int) -> Iterator[tuple[int, bool, Phrase]]:
        for end, room in self._rooms(at):
            for slot, present in (("has", True), ("lacks", False)):
                for after, _, classes in self._of(end, slot):
                    for stop, label in self._agreeing(after, "noun", classes):
                        for last, qualifier in self._qualified(stop):
                            yield last, present, Phrase(label, qualifier, room)

    def _such(self, at: int) -> Iterator[tuple[int, bool, str]]:
        for slot, present in (("again", True), ("never", False)):
            for end, _, classes in self._of(at, slot):
                for stop, label in self._agreeing(end, "noun", classes):
                    yield stop, present, label

    def _stops(self, at: int) -> list[tuple[int, Moves]]:
        """Where to go, up to the end of a clause: nothing stands between the last stop and the mark."""
        if at not in self._moves:
            found: list[tuple[int, Moves]] = []
            for slot in ("go", "first"):
                for end, _, _ in self._of(at, slot):
                    # "the same room" needs a stop before.
                    firsts = [(stop, (thing,)) for stop, thing in self._things(end) if thing.room is not _SAME_ROOM]
                    for stop, moves in firsts:
                        found += self._further(stop, moves)
            ended = [(end, moves) for end, moves in found if end < len(self.tokens) and self.tokens[end] in _STOPS]
            self._moves[at] = list(dict.fromkeys(ended))
        return self._moves[at]

    def _further(self, at: int, moves: Moves) -> Iterator[tuple[int, Moves]]:
        yield at, moves
        for slot in ("then", "finally"):
            for end, _, _ in self._of(at, slot):
                for stop, thing in self._things(end):
                    if thing.room is _SAME_ROOM:
                        thing = Phrase(thing.label, thing.qualifier, moves[-1].room)
                    more = (*moves, thing)
                    if slot == "then":
                        yield from self._further(stop, more)
                    else:
                        yield stop, more

    # -- sentences -----------------------------------------------------------------------------------------------------

    def _sentences(self, state: _State, base: int) -> Iterator[_State]:
        """Clauses to the end of the text; `base` are the cases that the clauses of this sentence are about."""
        for after, its_base in self._clause(state, base, base):
            if self._is(after.at, "."):
                if after.at + 1 == len(self.tokens):
                    yield after
                else:
                    yield from self._sentences(after.on(after.at + 1), _ALWAYS)
            elif self._is(after.at, ";") or self._is(after.at, ":"):
                yield from self._sentences(after.on(after.at + 1), its_base)

    def _clause(self, state: _State, context: int, base: int) -> Iterator[tuple[_State, int]]:
        """One clause with all that hangs on it, and the base of the clauses after it."""
        at = state.at
        here = self._here(at)
        for end, _, _ in self._of(at, "if") if "if" in here else ():
            for after, cases in self._guards(state.on(end)):
                opened = _State(after.at, after.named, after.rules, (*after.ifs, (context, cases)), after.asked)
                yield from self._comma(opened, context & cases, base)
        for end, _, _ in self._of(at, "else") if "else" in here else ():
            for k, (around, cases) in enumerate(state.ifs):
                closed = state.ifs[:k] + state.ifs[k + 1 :]
                meant = _State(end, state.named, state.rules, closed, state.asked)
                yield from self._comma(meant, around & ~cases, base)
        for end, _, _ in self._of(at, "check") if "check" in here else ():
            for after, cases in self._claims(state.on(end), asserted_only=True):
                asking = (*after.asked, (context, cases, True, True))
                yield _State(after.at, after.named, after.rules, after.ifs, asking), base
        for slot, answer in (("yes", True), ("no", False)):
            for end, _, _ in self._of(at, slot) if slot in here else ():
                for k, (around, cases, yes, no) in enumerate(state.asked):
                    if yes if answer else no:
                        left = (around, cases, yes and not answer, no and answer)
                        asked = (*state.asked[:k], left, *state.asked[k + 1 :])
                        answered = _State(end, state.named, state.rules, state.ifs, asked)
                        yield from self._comma(answered, around & (cases if answer else ~cases), base)

    def _comma(self, state: _State, context: int, base: int) -> Iterator[tuple[_State, int]]:
        if self._is(state.at, ","):
            yield from self._consequence(state.on(state.at + 1), context, base)

    def _consequence(self, state: _State, context: int, base: int) -> Iterator[tuple[_State, int]]:
        """What to do in the cases `context`: walk, look further, or ask at once."""
        for end, moves in self._stops(state.at):
            rules = (*state.rules, (context, moves))
            yield _State(end, state.named, rules, state.ifs, state.asked), base
        for end, _, _ in self._of(state.at, "nest"):
            if self._is(end, ":"):
                yield from self._clause(state.on(end + 1), context, context)
        yield from self._clause(state, context, base)

    def _guards(self, state: _State) -> Iterator[tuple[_State, int]]:
        """One claim, or two that are joined."""
        for after, cases in self._claims(state):
            yield after, cases
            for slot in ("and", "but"):
                for end, _, _ in self._of(after.at, slot):
                    for last, others in self._claims(after.on(end)):
                        yield last, cases & others

    def _claims(self, state: _State, asserted_only: bool = False) -> Iterator[tuple[_State, int]]:
        """A claim and the cases in which it holds."""
        for end, present, what in self._said(state.at):
            if asserted_only and not present:
                continue
            named = state.named
            if isinstance(what, str):
                meant = [k for k, phrase in enumerate(named) if phrase.label == what]
                if len(meant) != 1:
                    continue
                k = meant[0]
            elif what in named:
                k = named.index(what)
            else:
                k, named = len(named), (*named, what)
            if k < MAX_CONDITIONS:
                said = _State(end, named, state.rules, state.ifs, state.asked)
                yield said, _HOLDS[k] if present else _ALWAYS & ~_HOLDS[k]


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
