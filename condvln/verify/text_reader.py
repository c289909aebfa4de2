"""Find the meaning of a text without using the templates that the text was made from.

The text is read clause by clause: each "if", question and answer restricts the cases for which its stops apply. Cases
are assignments of truth to the conditions named so far (a bit mask), so a reading is a function from truths to stops.
All ways to attach an answer or an "otherwise" to earlier conditions are followed. A text is valid if exactly one
function results that gives stops exactly once for every case. A listener who refers every answer to the latest question
must also get this function, since otherwise the text would be hard to follow.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import product
from typing import Final, NamedTuple

from condvln.verify.phrasebook import Phrasebook, phrasebook
from condvln.verify.phrases import Moves, Named, Phrase, PhraseReader
from condvln.verify.standpoint import BEARINGS

__all__ = [
    "TextReading",
    "Unreadable",
    "read",
]

MAX_CONDITIONS: Final = 3
"""Largest number of conditions of any category."""

_CASES: Final = 1 << MAX_CONDITIONS
_ALWAYS: Final = (1 << _CASES) - 1
_HOLDS: Final = tuple(sum(1 << case for case in range(_CASES) if case >> k & 1) for k in range(MAX_CONDITIONS))
"""The cases, as bits, in which condition k is true."""


class _Ask(NamedTuple):
    """A question or an "if" of a text: the cases to which it applies (`context`), and the index of its condition.

    guard : for an "if", the cases in which what it says is true; None for a question
    answer : the cases of the last answer after an "if"; None without one
    """

    context: int
    condition: int
    guard: int | None
    answer: int | None = None


class State(NamedTuple):
    """The state after reading a part of a text.

    room : the room named last
    rules : (cases, number of the moves) so far
    asks : questions and "if"s in order
    open : indices in `asks` of those claimed or answered after an "if" that has no "otherwise" yet
    listed : inside a list, the cases of its entries so far; None outside lists
    early : some answer did not refer to the latest question
    leads : (cases, index of the condition that follows, room) so far
    """

    room: Named | None
    named: tuple[Phrase, ...]
    rules: tuple[tuple[int, int], ...]
    asks: tuple[_Ask, ...]
    open: tuple[int, ...]
    listed: int | None
    early: bool
    leads: tuple[tuple[int, int, Named], ...] = ()

    def led(self, context: int) -> Named | None:
        """Return the room to which the last lead has sent one in all the cases `context`."""
        return next((room for cases, _, room in reversed(self.leads) if not context & ~cases), None)


_Reached = list[tuple[int, State, int]]
"""Positions reached in a text, each with the state there, and the cases that the clauses after it are about."""


class ClauseReader(PhraseReader):
    """Finds all readings of one text. Methods with a list as their first argument append what they find to it."""

    def __init__(self, book: Phrasebook, text: str) -> None:
        super().__init__(book, text)
        self._continued: set[tuple[int, State, int]] = set()
        self._numbers: dict[Moves, int] = {}

    def readings(self) -> Iterator[tuple[State, tuple[Moves, ...], str | None]]:
        """Yield each state at the end of the text, with the moves of its rules and the heading that the text states."""
        for at, heading in self._opening():
            for start, opened in self._scopes(at):
                scope = self.scope = opened or self._led_scope()
                self._continued.clear()
                whole: list[State] = []
                state = State(scope, (), (), (), (), None, False)
                self._sentences(whole, start, state, _ALWAYS)
                for end, room in self._led(start, "."):
                    self._sentences(whole, end, state._replace(room=room, leads=((_ALWAYS, 0, room),)), _ALWAYS)
                told = list(self._numbers)
                for state in whole:
                    yield state, tuple([told[number] for _, number in state.rules]), heading

    # -- sentences -----------------------------------------------------------------------------------------------------

    def _sentences(self, whole: list[State], at: int, state: State, base: int) -> None:
        """Parse clauses to the end of the text, and find the states there. `base` holds the cases that the clauses of
        the present sentence are about.

        More than half of all states are reached in several ways; what follows them is read once.
        """
        known = len(self._continued)
        self._continued.add((at, state, base))
        if len(self._continued) == known:
            return
        for end, _, _ in self.of(at, "list"):
            if self.is_mark(end, ".") or self.is_mark(end, ":"):
                self._sentences(whole, end + 1, state._replace(listed=0), base)
        for end, _, _ in self.of(at, "number"):
            self._sentences(whole, end, state, base)
        reached: _Reached = []
        self._clause(reached, at, state, base)
        for end, after, its_base in reached:
            mark = self.tokens[end] if end < len(self.tokens) else ""
            if mark in (".", "?"):
                if end + 1 == len(self.tokens):
                    whole.append(after)
                else:
                    self._sentences(whole, end + 1, after, _ALWAYS)
            elif mark in (";", ":"):
                self._sentences(whole, end + 1, after, its_base)

    def _clause(self, reached: _Reached, at: int, state: State, base: int) -> None:
        """Parse a clause with everything attached to it."""
        for joint in ("filler", "but"):
            for end, _, _ in self.of(at, joint):
                self._clause(reached, end + self.is_mark(end, ","), state, base)
        for end, _, _ in self.of(at, "if"):
            self._supposed(reached, end, state, base, base)
            self._answered(reached, end, state, base)
        for end, moves, room in self._stops(at, state.room) if not state.asks else ():
            for after, _, _ in self.of(end, "if"):
                for place, claimed, cases in self._claimed(after, state._replace(room=room), base):
                    reached.append((place, self._told(claimed, claimed.room, cases, moves), base))
        for end, _, _ in self.of(at, "otherwise"):
            for place in state.open:
                ask = state.asks[place]
                supposed = ask.guard if ask.answer is None else ask.answer
                assert supposed is not None
                meant = state._replace(
                    open=tuple([other for other in state.open if other != place]),
                    early=state.early or place != len(state.asks) - 1,
                )
                self._comma(reached, end, meant, ask.context & ~supposed, base)
        self._request(reached, at, state, base, base)

    def _told(self, state: State, room: Named | None, cases: int, moves: Moves) -> State:
        """Return the state after one more rule, which names `room` last."""
        number = self._numbers.setdefault(moves, len(self._numbers))
        return state._replace(room=room, rules=(*state.rules, (cases, number)))

    def _supposed(
        self, reached: _Reached, at: int, state: State, context: int, base: int, *, joined: bool = False
    ) -> None:
        """Parse a claim after "if", and its consequences."""
        for end, claimed, cases in self._claimed(at, state, context, joined=joined):
            self._but(reached, end, claimed, cases, base)

    def _claimed(
        self, at: int, state: State, context: int, *, joined: bool = False
    ) -> Iterator[tuple[int, State, int]]:
        """Parse a claim. Yield the position and the state after it, and the cases in which it applies.

        joined : whether it is behind another claim, so that "there's" may be left out: "if there's a lamp but no bed"
        """
        asks, listed = state.asks, state.listed
        if listed is not None:
            context &= ~listed
        claims = self._said(at, state.room)
        for claimed, present, what, room in [*claims, *self._joined(at, state.room)] if joined else claims:
            for k, named in _conditions(state.named, asks, what, state.led(context)):
                within = context
                for ask in asks:
                    if ask.condition == k:  # asked again, so it applies to the same cases as before
                        within &= ask.context
                        break
                guard = _HOLDS[k] if present else _ALWAYS & ~_HOLDS[k]
                opened = state._replace(
                    room=room,
                    named=named,
                    asks=(*asks, _Ask(within, k, guard)),
                    open=(*state.open, len(asks)),
                    listed=None if listed is None else listed | guard,
                )
                yield claimed, opened, within & guard

    def _answered(self, reached: _Reached, at: int, state: State, base: int) -> None:
        """Parse an answer that follows "if" ("so", "there is one", "it isn't", "neither is true"), and the consequences
        of this answer.
        """
        for slot, answer, kind in _ANSWERS:
            for end, _, _ in self.of(at, slot):
                for place, ask in enumerate(state.asks):
                    if kind is None or state.named[ask.condition].known == kind:
                        self._consequences(reached, end, state, place, answer, base)
        for slot, answer in (("it_is", True), ("it_is_not", False)):
            for end, _, _ in self.of(at, slot):
                for stop, qualifier in self._relations(end):
                    for place, ask in enumerate(state.asks):
                        what = state.named[ask.condition]
                        if what.known and what.qualifier is None:
                            whole = what._replace(qualifier=qualifier)
                            named = (*state.named[: ask.condition], whole, *state.named[ask.condition + 1 :])
                            self._consequences(reached, stop, state._replace(named=named), place, answer, base)
        for slot, count in (("neither", (2,)), ("none", (2, 3))):
            for end, _, _ in self.of(at, slot):
                guards = [ask.guard for ask in state.asks if ask.guard is not None]
                if len(guards) == len(state.asks) and len(guards) in count:
                    cases = _ALWAYS
                    for guard in guards:
                        cases &= ~guard
                    self._but(reached, end, state, cases, base)
        self._denied_together(reached, at, state, base)

    def _denied_together(self, reached: _Reached, at: int, state: State, base: int) -> None:
        """Parse "there's neither a lamp nor a bed", about two conditions named before, and the consequences."""
        for end, *labels in self._neither(at):
            ways = [
                [k for k, one in enumerate(state.named) if one.label == label and not one.known] for label in labels
            ]
            for k, j in product(*ways):
                self._but(reached, end, state, _ALWAYS & ~_HOLDS[k] & ~_HOLDS[j], base)

    def _consequences(self, reached: _Reached, at: int, state: State, place: int, answer: bool, base: int) -> None:
        """Parse the consequences of an answer to the question or "if" at index `place`."""
        ask, asks = state.asks[place], state.asks
        guard = _HOLDS[ask.condition] if answer else _ALWAYS & ~_HOLDS[ask.condition]
        answered = state._replace(
            asks=(*asks[:place], ask._replace(answer=guard), *asks[place + 1 :]),
            open=(*[other for other in state.open if other != place], place),
            early=state.early or place != len(asks) - 1,
        )
        self._but(reached, at, answered, ask.context & guard, base)

    def _but(self, reached: _Reached, at: int, state: State, context: int, base: int) -> None:
        """Parse what follows an answer or a claim: the consequences, or one more claim and then the consequences, as in
        "if not, but there's a chair, …".
        """
        behind_comma = self.is_mark(at, ",")
        if behind_comma:
            self._comma(reached, at, state, context, base)
        for joint in ("and", "but"):
            for end, _, _ in self.of(at + behind_comma, joint):
                self._supposed(reached, end, state, context, base, joined=True)

    def _comma(self, reached: _Reached, at: int, state: State, context: int, base: int) -> None:
        """Parse what follows a comma, for the cases `context`: moves, a request to look, or another "if"."""
        if not context or not self.is_mark(at, ","):
            return
        at += 1
        # A case that gets stops twice makes the whole text invalid, whatever follows.
        told_cases = 0
        for cases, _ in state.rules:
            told_cases |= cases
        if not context & told_cases:
            for start in [at, *[end for end, _, _ in self.of(at, "filler")]]:
                told = self._stops(start, state.room)
                # "If not, to the lamp" goes on from a "go to" before it.
                for end, moves, room in [*told, *self._verbless_stops(start, state.room)] if state.rules else told:
                    reached.append((end, self._told(state, room, context, moves), base))
        self._request(reached, at, state, context, context)
        for end, _, _ in self.of(at, "if"):
            self._supposed(reached, end, state, context, base)

    def _request(self, reached: _Reached, at: int, state: State, context: int, base: int) -> None:
        for start, lead in ((at, None), *self._led(at, "and")):
            leads = state.leads if lead is None else (*state.leads, (context, len(state.named), lead))
            led = state._replace(room=lead or state.room, leads=leads)
            for end, what, room in self._requests(start, led.room):
                for k, named in _conditions(led.named, led.asks, what, led.led(context)):
                    asks = (*led.asks, _Ask(context, k, None))
                    reached.append((end, led._replace(room=room, named=named, asks=asks), base))


def _conditions(
    before: tuple[Phrase, ...], asks: tuple[_Ask, ...], what: Phrase, led: Named | None
) -> list[tuple[int, tuple[Phrase, ...]]]:
    """Return each possible index of the condition `what`, together with all conditions named so far, including `what`.

    What is named without a room is where one is `led`; without a lead, a known object is in the room of the condition
    before it.
    """
    known = [k for k, one in enumerate(before) if what == one or (what.room is None and _without_room(what, one))]
    if known:
        return [(k, before) for k in known]
    found = [(k, before) for k, one in enumerate(before) if _by_noun(what, one)]
    if len(before) < MAX_CONDITIONS:
        if what.room is None and led is not None:
            what = what._replace(room=led)
        elif what.known and what.room is None and asks:
            what = what._replace(room=before[asks[-1].condition].room)
        found.append((len(before), (*before, what)))
    return found


_ANSWERS: Final = (
    ("so", True, None),
    ("not", False, None),
    ("yes_one", True, False),
    ("no_one", False, False),
    ("yes_it", True, True),
    ("no_it", False, True),
)
"""Slot of an answer, its truth value, and whether it is about a definite object (None for both)."""


def _without_room(what: Phrase, before: Phrase) -> bool:
    """Return whether `what` repeats `before` but for the room."""
    return what.label == before.label and what.qualifier == before.qualifier and what.known == before.known


def _by_noun(what: Phrase, before: Phrase) -> bool:
    """Return whether `what` repeats `before` by its noun alone, without the relation."""
    same = what.label == before.label and what.room in (None, before.room)
    return same and what.qualifier is None and not what.known and not before.known


def in_rooms(named: Sequence[Phrase], told: Sequence[Moves]) -> list[Moves]:
    """Return the moves of all rules of a text with a room filled in for stops that are named without a room.

    The first stop of a rule gets the room in which the text names this stop or one of its anchors elsewhere, if there
    is exactly one such room. A later stop gets the room of the stop before it.

    named : the conditions of the text
    told : the moves of its rules, in order
    """
    rooms: dict[str, set[Named]] = {}
    for phrase in [*named, *[stop for moves in told for stop in moves]]:
        if phrase.room is None:
            continue
        own = () if not phrase.known and phrase in named else (phrase.label,)
        for label in (*own, *(phrase.qualifier[1] if phrase.qualifier is not None else ())):
            rooms.setdefault(label, set()).add(phrase.room)
    placed = []
    for moves in told:
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
        placed.append(tuple(found))
    return placed


def chosen(state: State) -> tuple[int, ...] | None:
    """Return the index of the rule that applies in each case, i.e. for each combination of the conditions' truths.

    Return None if no rule or several apply in some case, or if a condition decides nothing: its question would have no
    answer.
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
    table = [0] * (1 << len(state.named))
    for rule, (cases, _) in enumerate(state.rules):
        for case in range(len(table)):
            if cases >> case & 1:
                table[case] = rule
    for k in range(len(state.named)):
        if all(rule == table[case ^ 1 << k] for case, rule in enumerate(table)):
            return None
    return tuple(table)


class Unreadable(Exception):
    """The text has no reading, or several; the message says where or why."""


@dataclass(frozen=True, slots=True)
class TextReading:
    """The reading of a text.

    conditions : in the order of their first mention
    moves : moves[c] for the case c whose bit k is the truth of condition k
    leads : the room of the lead to each condition; None without one
    """

    conditions: tuple[Phrase, ...]
    moves: tuple[Moves, ...]
    heading: str | None
    leads: tuple[Named | None, ...]


def read(text: str, code: str = "en") -> TextReading:
    """Return the reading of `text`, which must have exactly one, in language `code`.

    Raises
    ------
    Unreadable
        It has none, or more than one, or one that is not the first that a listener would assume.
    """
    reader = ClauseReader(phrasebook(code), text)
    found = []
    for state, moves, heading in reader.readings():
        choice = chosen(state)
        if choice is not None:
            placed = in_rooms(state.named, moves)
            led = {k: room for _, k, room in state.leads}
            leads = tuple([led.pop(k, None) for k in range(len(state.named))])
            if not led:
                found.append(((state.named, tuple([placed[rule] for rule in choice]), heading, leads), state.early))
    if not found:
        raise Unreadable(f"no reading; parsing stops before {reader.rest()!r}")
    functions = {function for function, _ in found}
    if len(functions) > 1:
        raise Unreadable(f"the text is ambiguous: it has {len(functions)} readings")
    if all(early for _, early in found):
        raise Unreadable("an answer does not refer to the question before it")
    return TextReading(*found[0][0])
