"""Find the meaning of a text without using the templates that the text was made from.

The text is read clause by clause: each "if", question and answer restricts the cases for which its stops apply. Cases
are assignments of truth to the conditions named so far (a bit mask), so a reading is a function from truths to stops.
All ways to attach an answer or an "otherwise" to earlier conditions are followed. A text is valid if exactly one
function results that gives stops exactly once for every case. A listener who refers every answer to the latest question
must also get this function, since otherwise the text would be hard to follow.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import product
from typing import Final, NamedTuple

from condvln.verify.phrasebook import Phrasebook, phrasebook
from condvln.verify.phrases import Moves, Named, Phrase, PhraseReader
from condvln.verify.standpoint import BEARINGS

__all__ = ["MAX_CONDITIONS", "TextReading", "Unreadable", "read"]

MAX_CONDITIONS: Final = 3
"""Largest number of conditions of any category."""

_CASES: Final = 1 << MAX_CONDITIONS
_ALWAYS: Final = (1 << _CASES) - 1
_HOLDS: Final = tuple(sum(1 << case for case in range(_CASES) if case >> k & 1) for k in range(MAX_CONDITIONS))
"""The cases, as bits, in which condition k is true."""


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


class _Ask(NamedTuple):
    """A question or an "if" of a text: the cases to which it applies (`context`), and the index of its condition.

    guard : for an "if", the cases in which what it says is true; None for a question
    answer : the cases of the last answer after an "if"; None without one
    """

    context: int
    condition: int
    guard: int | None
    answer: int | None = None


class _State(NamedTuple):
    """The state after reading a part of a text.

    room : the room named last
    rules : (cases, moves) so far
    asks : questions and "if"s in order
    open : indices in `asks` of those claimed or answered after an "if" that has no "otherwise" yet
    listed : inside a list, the cases of its entries so far; None outside lists
    early : some answer did not refer to the latest question
    """

    at: int
    room: Named | None
    named: tuple[Phrase, ...]
    rules: tuple[tuple[int, Moves], ...]
    asks: tuple[_Ask, ...]
    open: tuple[int, ...]
    listed: int | None
    early: bool

    def going_on(self, at: int) -> _State:
        """Return the same state at another word."""
        return _State(at, *self[1:])


def read(text: str, code: str = "en") -> TextReading:
    """Return the reading of `text`, which must have exactly one, in language `code`.

    Raises
    ------
    Unreadable
        It has none, or more than one, or one that is not the first that a listener would assume.
    """
    reader = _Reader(phrasebook(code), text)
    found = list(reader.readings())
    if not found:
        raise Unreadable(f"no reading; parsing stops before {reader.rest()!r}")
    functions = {reading for reading, _ in found}
    if len(functions) > 1:
        raise Unreadable(f"the text is ambiguous: it has {len(functions)} readings")
    if all(early for _, early in found):
        raise Unreadable("an answer does not refer to the question before it")
    conditions, moves, heading = found[0][0]
    return TextReading(conditions, moves, heading)


_Function = tuple[tuple[Phrase, ...], tuple[Moves, ...], str | None]


class _Reader(PhraseReader):
    """Finds all readings of one text."""

    def __init__(self, book: Phrasebook, text: str) -> None:
        super().__init__(book, text)
        self._continued: set[tuple[_State, int, Named | None]] = set()

    def readings(self) -> Iterator[tuple[_Function, bool]]:
        """Yield each meaning of the whole text, and whether an answer refers to a question before the latest one."""
        for at, heading in self._opening():
            for start, scope in self._scopes(at):
                self.scope = scope
                for state in self._sentences(_State(start, scope, (), (), (), (), None, False), _ALWAYS):
                    table = _table(state)
                    if table is not None:
                        yield (state.named, table, heading), state.early

    # -- sentences -----------------------------------------------------------------------------------------------------

    def _sentences(self, state: _State, base: int) -> Iterator[_State]:
        """Parse clauses to the end of the text. `base` holds the cases that the clauses of the present sentence are
        about.

        More than half of all states are reached in several ways; what follows them is read once.
        """
        known = len(self._continued)
        self._continued.add((state, base, self.scope))
        if len(self._continued) == known:
            return
        for end, _, _ in self._of(state.at, "list"):
            if self._is(end, ".") or self._is(end, ":"):
                yield from self._sentences(state._replace(at=end + 1, listed=0), base)
        for end, _, _ in self._of(state.at, "number"):
            yield from self._sentences(state.going_on(end), base)
        for after, its_base in self._clause(state, _ALWAYS, base):
            mark = self.tokens[after.at] if after.at < len(self.tokens) else ""
            if mark in (".", "?"):
                if after.at + 1 == len(self.tokens):
                    yield after
                else:
                    yield from self._sentences(after.going_on(after.at + 1), _ALWAYS)
            elif mark in (";", ":"):
                yield from self._sentences(after.going_on(after.at + 1), its_base)

    def _clause(self, state: _State, context: int, base: int) -> Iterator[tuple[_State, int]]:
        """Parse a clause with everything attached to it. Yield the new state, and the cases that the following clauses
        are about.
        """
        at = state.at
        for end, _, _ in self._of(at, "filler"):
            yield from self._clause(state.going_on(end + self._is(end, ",")), context, base)
        for end, _, _ in self._of(at, "but"):
            yield from self._clause(state.going_on(end + self._is(end, ",")), context, base)
        for end, _, _ in self._of(at, "if"):
            yield from self._supposed(state.going_on(end), context & base, base)
            yield from self._answered(state.going_on(end), base)
        for end, moves, room in self._stops(at, state.room) if not state.asks else ():
            for after, _, _ in self._of(end, "if"):
                for claimed, cases in self._claimed(state._replace(at=after, room=room), context & base):
                    yield claimed._replace(rules=(*claimed.rules, (cases, moves))), base
        for end, _, _ in self._of(at, "otherwise"):
            for place in state.open:
                ask = state.asks[place]
                supposed = ask.guard if ask.answer is None else ask.answer
                assert supposed is not None
                meant = state._replace(
                    at=end,
                    open=tuple(other for other in state.open if other != place),
                    early=state.early or place != len(state.asks) - 1,
                )
                yield from self._comma(meant, ask.context & ~supposed, base)
        yield from self._request(state, context & base, base)

    def _supposed(
        self, state: _State, context: int, base: int, *, joined: bool = False
    ) -> Iterator[tuple[_State, int]]:
        """Parse a claim after "if", and its consequences."""
        for claimed, cases in self._claimed(state, context, joined=joined):
            yield from self._but(claimed, cases, base)

    def _claimed(self, state: _State, context: int, *, joined: bool = False) -> Iterator[tuple[_State, int]]:
        """Parse a claim. Yield the state after it, and the cases in which it applies.

        joined : whether it is behind another claim, so that "there's" may be left out: "if there's a lamp but no bed"
        """
        if state.listed is not None:
            context &= ~state.listed
        claims = self._said(state.at, state.room)
        for claimed, present, what, room in [*claims, *self._joined(state.at, state.room)] if joined else claims:
            end = next((after for after, _, _ in self._of(claimed, "either")), claimed)
            for k, named in self._condition(state, what):
                asked = [ask.context for ask in state.asks if ask.condition == k]
                # asked again, so it applies to the same cases as before
                within = context & asked[0] if asked else context
                guard = _HOLDS[k] if present else _ALWAYS & ~_HOLDS[k]
                opened = state._replace(
                    at=end,
                    room=room,
                    named=named,
                    asks=(*state.asks, _Ask(within, k, guard)),
                    open=(*state.open, len(state.asks)),
                    listed=None if state.listed is None else state.listed | guard,
                )
                yield opened, within & guard

    def _answered(self, state: _State, base: int) -> Iterator[tuple[_State, int]]:
        """Parse an answer that follows "if" ("so", "there is one", "it isn't", "neither is true"), and the consequences
        of this answer.
        """
        for slot, answer, kind in _ANSWERS:
            for end, _, _ in self._of(state.at, slot):
                for place, ask in enumerate(state.asks):
                    if kind is None or state.named[ask.condition].known == kind:
                        yield from self._consequences(state.going_on(end), place, answer, base)
        for slot, answer in (("it_is", True), ("it_is_not", False)):
            for end, _, _ in self._of(state.at, slot):
                for stop, qualifier in self._relations(end):
                    for place, ask in enumerate(state.asks):
                        what = state.named[ask.condition]
                        if what.known and what.qualifier is None:
                            whole = what._replace(qualifier=qualifier)
                            named = (*state.named[: ask.condition], whole, *state.named[ask.condition + 1 :])
                            yield from self._consequences(state._replace(at=stop, named=named), place, answer, base)
        for slot, count in (("neither", (2,)), ("none", (2, 3))):
            for end, _, _ in self._of(state.at, slot):
                guards = [ask.guard for ask in state.asks if ask.guard is not None]
                if len(guards) == len(state.asks) and len(guards) in count:
                    cases = _ALWAYS
                    for guard in guards:
                        cases &= ~guard
                    yield from self._but(state.going_on(end), cases, base)

        yield from self._denied_together(state, base)

    def _denied_together(self, state: _State, base: int) -> Iterator[tuple[_State, int]]:
        """Parse "there's neither a lamp nor a bed", about two conditions named before, and the consequences."""
        pairs = [
            (stop, one, other)
            for end, _, classes in self._of(state.at, "neither_a")
            for after, one in self._agreeing(end, "noun", classes)
            for middle, _, its in self._of(after, "nor_a")
            for stop, other in self._agreeing(middle, "noun", its)
        ]
        for end, *labels in pairs:
            ways = [
                [k for k, one in enumerate(state.named) if one.label == label and not one.known] for label in labels
            ]
            for k, j in product(*ways):
                yield from self._but(state.going_on(end), _ALWAYS & ~_HOLDS[k] & ~_HOLDS[j], base)

    def _consequences(self, state: _State, place: int, answer: bool, base: int) -> Iterator[tuple[_State, int]]:
        """Parse the consequences of an answer to the question or "if" at index `place`."""
        ask = state.asks[place]
        guard = _HOLDS[ask.condition] if answer else _ALWAYS & ~_HOLDS[ask.condition]
        answered = state._replace(
            early=state.early or place != len(state.asks) - 1,
            asks=(*state.asks[:place], ask._replace(answer=guard), *state.asks[place + 1 :]),
            open=(*(other for other in state.open if other != place), place),
        )
        yield from self._but(answered, ask.context & guard, base)

    def _but(self, state: _State, context: int, base: int) -> Iterator[tuple[_State, int]]:
        """Parse what follows an answer or a claim: the consequences, or one more claim and then the consequences, as in
        "if not, but there's a chair, …".
        """
        yield from self._comma(state, context, base)
        behind_comma = self._is(state.at, ",")
        for joint in ("and", "but"):
            for end, _, _ in self._of(state.at + behind_comma, joint):
                yield from self._supposed(state.going_on(end), context, base, joined=True)

    def _comma(self, state: _State, context: int, base: int) -> Iterator[tuple[_State, int]]:
        """Parse what follows a comma, for the cases `context`: moves, a request to look, or another "if"."""
        if not context or not self._is(state.at, ","):
            return
        at = state.at + 1
        # A case that gets stops twice makes the whole text invalid, whatever follows.
        if not any(context & cases for cases, _ in state.rules):
            starts = [at, *(end for end, _, _ in self._of(at, "filler"))]
            # "If not, to the lamp" goes on from a "go to" before it.
            parsers = [self._stops, self._verbless_stops] if state.rules else [self._stops]
            told = (found for start in starts for parse in parsers for found in parse(start, state.room))
            for end, moves, room in told:
                yield state._replace(at=end, room=room, rules=(*state.rules, (context, moves))), base
        yield from self._request(state.going_on(at), context, context)
        for end, _, _ in self._of(at, "if"):
            yield from self._supposed(state.going_on(end), context, base)

    def _request(self, state: _State, context: int, base: int) -> Iterator[tuple[_State, int]]:
        for end, what, room in self._requests(state.at, state.room):
            for k, named in self._condition(state, what):
                asking = (*state.asks, _Ask(context, k, None))
                yield state._replace(at=end, room=room, named=named, asks=asking), base

    def _condition(self, state: _State, what: Phrase) -> Iterator[tuple[int, tuple[Phrase, ...]]]:
        """Yield each possible index of the condition `what`, together with all conditions named so far, including
        `what`.

        A known object without a room is in the room of the condition before it.
        """
        known = [k for k, one in enumerate(state.named) if what in (one, one._replace(room=None))]
        if known:
            yield from ((k, state.named) for k in known)
            return
        yield from ((k, state.named) for k, one in enumerate(state.named) if _by_noun(what, one))
        if len(state.named) < MAX_CONDITIONS:
            if what.known and what.room is None and state.asks:
                what = what._replace(room=state.named[state.asks[-1].condition].room)
            yield len(state.named), (*state.named, what)


_ANSWERS: Final = (
    ("so", True, None),
    ("not", False, None),
    ("yes_one", True, False),
    ("no_one", False, False),
    ("yes_it", True, True),
    ("no_it", False, True),
)
"""Slot of an answer, its truth value, and whether it is about a definite object (None for both)."""


def _by_noun(what: Phrase, before: Phrase) -> bool:
    """Return whether `what` repeats `before` by its noun alone, without the relation."""
    same = what.label == before.label and what.room in (None, before.room)
    return same and what.qualifier is None and not what.known and not before.known


def _placed(state: _State) -> list[tuple[int, Moves]]:
    """Return the rules of a whole text, with a room filled in for stops that are named without a room. The first stop
    of a rule gets the room in which the text names this stop or one of its anchors elsewhere, if there is exactly one
    such room. A later stop gets the room of the stop before it.
    """
    rooms: dict[str, set[Named]] = {}
    for phrase in [*state.named, *(stop for _, moves in state.rules for stop in moves)]:
        own = () if phrase in state.named and not phrase.known else (phrase.label,)
        for label in (*own, *(phrase.qualifier[1] if phrase.qualifier is not None else ())):
            if phrase.room is not None:
                rooms.setdefault(label, set()).add(phrase.room)
    placed = []
    for cases, moves in state.rules:
        found: list[Phrase] = []
        for stop in moves:
            if stop.room is None and not (stop.qualifier is not None and stop.qualifier[0] in BEARINGS):
                labels = (stop.label, *(stop.qualifier[1] if stop.qualifier is not None else ()))
                one = set().union(*(rooms.get(label, set()) for label in labels))
                room = found[-1].room if found else next(iter(one)) if len(one) == 1 else None
                stop = stop._replace(room=room)
            if stop.room is not None:
                rooms.setdefault(stop.label, set()).add(stop.room)
            found.append(stop)
        placed.append((cases, tuple(found)))
    return placed


def _table(state: _State) -> tuple[Moves, ...] | None:
    """Return the moves for each case, i.e. for each combination of the conditions' truths. Return None if some case
    gets no moves, or gets moves twice, or if a condition decides nothing: its question would have no answer.
    """
    covered = 0
    if any(phrase.known and phrase.qualifier is None for phrase in state.named):
        return None
    for cases, _ in state.rules:
        if not cases or covered & cases:
            return None
        covered |= cases
    if covered != _ALWAYS:
        return None
    rules = _placed(state)
    table = tuple(next(moves for cases, moves in rules if cases >> case & 1) for case in range(1 << len(state.named)))
    conditions = range(len(state.named))
    decides = all(any(moves is not table[case ^ 1 << k] for case, moves in enumerate(table)) for k in conditions)
    return table if decides else None
