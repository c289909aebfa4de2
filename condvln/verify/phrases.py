"""Parse the noun phrases and clauses of a text: what may begin at a word, and where it ends.

All possible parses are followed; ``text_reader`` decides which of them form a whole text.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from typing import Final, NamedTuple

from condvln.verify.phrasebook import ENDS, PAIRED, Phrasebook, WordReader, parsed_once
from condvln.verify.standpoint import BEARINGS

__all__ = ["Moves", "Named", "Phrase", "PhraseReader", "beside"]


class Named(NamedTuple):
    """A room as named in text: the room type, and the label of the object by which the text tells the room from others
    ("the bedroom with the desk").
    """

    label: str
    anchor: str | None


class Phrase(NamedTuple):
    """An object as named in text: label, qualifier (predicate, labels of the anchors) and room; qualifier or room is
    None if the text does not name it.

    known : for a condition, whether it is about one object that is known to exist ("the lamp is near the bed")
    """

    label: str
    qualifier: tuple[str, tuple[str, ...]] | None
    room: Named | None
    known: bool = False

    def __str__(self) -> str:
        qualifier = "" if self.qualifier is None else f" {self.qualifier[0]} {' and '.join(self.qualifier[1])}"
        room = "" if self.room is None else f" in {self.room.label}"
        anchor = "" if self.room is None or self.room.anchor is None else f" with {self.room.anchor}"
        return f"{'the ' if self.known else ''}{self.label}{qualifier}{room}{anchor}"


Moves = tuple[Phrase, ...]


_Qualifier = tuple[str, tuple[str, ...]]
"""A predicate and the labels of its anchors."""
_Place = tuple[int, Named | None]
"""A position in the text, and the room named last before it."""

FARTHEST: Final = 2
"""Largest number of marks between a room's name and "that bedroom"."""

_OWNED: Final = {"exists": "has", "absent": "has_no"}
"""Slot of the claim "the kitchen has a lamp", by that of "there's a lamp"."""
_STOPS: Final = frozenset(".;:")
"""Punctuation that ends a clause which states stops."""


def beside(thing: Phrase, before: Phrase) -> Phrase:
    """Return the stop `thing` in the room of the previous stop, `before`. If `thing` has a room or an egocentric
    direction, it is returned unchanged.
    """
    at_start = thing.qualifier is not None and thing.qualifier[0] in BEARINGS
    return thing._replace(room=before.room) if thing.room is None and not at_start else thing


class PhraseReader(WordReader):
    """Finds the noun phrases and claims in one text."""

    def __init__(self, book: Phrasebook, text: str) -> None:
        super().__init__(book, text)
        self._apart: list[tuple[int, Named]] | None = None

    # -- words and phrases ---------------------------------------------------------------------------------------------

    def _opening(self) -> Iterator[tuple[int, str | None]]:
        yield 0, None
        for end, _, _ in self.of(0, "facing"):
            for stop, direction, _ in self.of(end, "direction"):
                if self.is_mark(stop, "."):
                    yield stop + 1, direction

    def _scopes(self, at: int) -> Iterator[_Place]:
        yield at, None
        for end, _, _ in self.of(at, "scope"):
            for stop, room in self._rooms(end):
                if self.is_mark(stop, ","):
                    yield stop + 1, room

    def _led(self, at: int, ends: str) -> Iterator[tuple[int, Named]]:
        """Parse a lead: "go to the kitchen." at the beginning of a text if `ends` is that mark; before a request "go to
        the kitchen and" or "once you're in the kitchen,". Yield (end, room).
        """
        for slot in ("go", "once") if ends == "and" else ("go",):
            for end, _, _ in self.of(at, slot):
                for stop, room in self._rooms(end):
                    if slot == "go" and ends == "and":
                        yield from ((after, room) for after, _, _ in self.of(stop, "and"))
                    elif self.is_mark(stop, "," if slot == "once" else ends):
                        yield stop + 1, room

    def _led_scope(self) -> Named | None:
        """Return the room of the only lead of a text if the text names no other room: all that it names is there."""
        parsed = self.furthest
        named = [at for at in range(len(self.tokens)) if self._names_room(at)]
        leads = {room for at in range(len(self.tokens)) for ends in (".", "and") for _, room in self._led(at, ends)}
        self.furthest = parsed
        return leads.pop() if len(named) == 1 == len(leads) else None

    def _names_room(self, at: int) -> bool:
        """Return whether the words from `at` on name a room, not a thing of a longer name: "the kitchen cabinet"."""
        for article in ("the", "that"):
            for start, _, classes in self.of(at, article):
                rooms = [end for end, _ in self._agreeing(start, "room", classes)]
                if rooms and max(rooms) > max((end for end, _ in self._agreeing(start, "noun", classes)), default=0):
                    return True
        return False

    def _agreeing(self, at: int, kind: str, classes: frozenset[str]) -> Iterator[tuple[int, str]]:
        for end, label, own in self.of(at, kind):
            if own & classes:
                yield end, label

    def _definite(self, at: int, kind: str) -> Iterator[tuple[int, str]]:
        for end, _, classes in self.of(at, "the"):
            yield from self._agreeing(end, kind, classes)

    def _rooms(self, at: int) -> Iterator[tuple[int, Named]]:
        """Parse a room's name: "the bedroom with the desk", or "the bedroom". "The bedroom" also means the bedroom with
        the desk if the text has named that room before. Yield (end, room).
        """
        for end, label in self._definite(at, "room"):
            before = {room for place, room in self._set_apart() if place < at and room.label == label}
            if len(before) < 2:
                yield end, before.pop() if before else Named(label, None)
            for after, _, _ in self.of(end, "with"):
                for stop, anchor in self._definite(after, "noun"):
                    yield stop, Named(label, anchor)
        for middle, _, classes in self.of(at, "that"):
            for end, label in self._agreeing(middle, "room", classes):
                before = {room for place, room in self._set_apart() if place < at and room.label == label}
                if len(before) == 1 and self._marks_since(middle, label) <= FARTHEST:
                    yield end, before.pop()

    def _in_its_room(self, at: int) -> Iterator[tuple[int, str, Named]]:
        """Parse a room followed by the noun of an object in this room, as in "the kitchen sink". Yield (end, label,
        room). Words that are also a single noun, such as "the kitchen cabinet", are left out.
        """
        for start, _, classes in self.of(at, "the"):
            longest = max((end for end, _ in self._agreeing(start, "noun", classes)), default=start)
            for middle, room in self._agreeing(start, "room", classes):
                ends = [(end, label) for end, label, _ in self.of(middle, "noun") if end > longest]
                if ends:
                    yield *max(ends), Named(room, None)

    def _set_apart(self) -> Sequence[tuple[int, Named]]:
        """Return (position, room) for each place in the text that names a room by an object, such as "the bedroom with
        the desk".
        """
        if self._apart is None:
            parsed = self.furthest
            self._apart = list(self._all_apart())
            self.furthest = parsed
        return self._apart

    def _all_apart(self) -> Iterator[tuple[int, Named]]:
        for at in range(len(self.tokens)):
            for middle, label in self._definite(at, "room"):
                for after, _, _ in self.of(middle, "with"):
                    # The longest noun wins: "the table lamp" is not a table.
                    ends = dict(self._definite(after, "noun"))
                    if ends:
                        yield at, Named(label, ends[max(ends)])

    def _marks_since(self, noun: int, label: str) -> int:
        """Return the number of marks between the noun of "that bedroom", at word `noun`, and the place before it where
        the text names such a room last.
        """
        named = [place for place, room in self._set_apart() if place < noun and room.label == label]
        named += [
            at
            for at in range(max(named), noun - 1)
            for end, _, classes in self.of(at, "that")
            if any(room == label for _, room in self._agreeing(end, "room", classes))
        ]
        return sum(token in ENDS for token in self.tokens[max(named) : noun])

    def _related(self, at: int) -> Iterator[tuple[int, _Qualifier]]:
        for end, predicate, _ in self.of(at, "predicate"):
            for stop, anchor in self._definite(end, "noun"):
                if predicate not in PAIRED:
                    yield stop, (predicate, (anchor,))
                    continue
                for after, _, _ in self.of(stop, "both"):
                    for place, other in self._definite(after, "noun"):
                        yield place, (predicate, (anchor, other))

    def _compared(self, at: int) -> Iterator[tuple[int, str, _Qualifier]]:
        """Parse phrases such as "the bigger lamp", with the adjective before or after the noun. Yield (end, label,
        qualifier).
        """
        for start, _, article in self.of(at, "the"):
            for middle, predicate, ending in self.of(start, "superlative"):
                for end, label in self._agreeing(middle, "noun", article & ending):
                    yield end, label, (predicate, ())
            for middle, label, own in self.of(start, "noun"):
                for end, predicate, ending in self.of(middle, "superlative_behind"):
                    if own & article & ending:
                        yield end, label, (predicate, ())

    def _qualified(self, at: int, lying: bool = False) -> Iterator[tuple[int, _Qualifier | None]]:
        """Parse an optional relation. Yield (end, qualifier), first with qualifier None for an omitted relation, then
        for each relation that begins here.

        lying : whether words like "que está" come before the relation
        """
        yield at, None
        for start in [at, *(end for end, _, _ in self.of(at, "lying"))] if lying else [at]:
            yield from self._related(start)

    def _where(
        self, at: int, last: Named | None, belonging: bool = False, behind: bool = False
    ) -> Iterator[tuple[int, Named | None, Named | None]]:
        """Parse an optional room: "in the bedroom", "there", or no words at all. Yield (end, room, room named last).

        belonging : directly after a definite noun, where some languages use other words ("la cama del dormitorio")
        """
        yield at, self.scope, last
        for end, _, _ in self.of(at, "of" if belonging else "of_anchor" if behind else "in"):
            for stop, room in self._rooms(end):
                yield stop, room, room
        if last is not None and not belonging and not behind:
            for end, _, _ in self.of(at, "same_place"):
                yield end, last, last
        if last is not None and (belonging or behind):
            for end, _, _ in self.of(at, "there"):
                yield end, last, last

    @parsed_once
    def _things(self, at: int, last: Named | None) -> Iterator[tuple[int, Phrase, Named | None]]:
        """Parse one stop as named in moves: "the lamp near the bed in the bedroom"."""
        for end, label in self._definite(at, "noun"):
            for stop, qualifier in self._qualified(end, lying=self.book.lying):
                for after, room, named in self._where(
                    stop, last, belonging=qualifier is None, behind=qualifier is not None
                ):
                    yield after, Phrase(label, qualifier, room), named
            for stop, room, named in self._where(end, last, belonging=True) if self.book.room_first else ():
                for after, qualifier in self._qualified(stop, lying=self.book.lying) if stop > end else ():
                    if qualifier is not None:
                        yield after, Phrase(label, qualifier, room), named
            for stop, bearing, _ in self.of(end, "bearing_stop"):
                # It is where the agent starts; "there" would be ambiguous after it.
                yield stop, Phrase(label, (bearing, ()), None), None
        for end, label, room in self._in_its_room(at):
            yield end, Phrase(label, None, room), room
        for end, label, compared in self._compared(at):
            for after, room, named in self._where(end, last, belonging=True):
                yield after, Phrase(label, compared, room), named

    # -- conditions ----------------------------------------------------------------------------------------------------

    def _some(self, slot: str, at: int, last: Named | None) -> Iterator[tuple[int, Phrase, Named | None]]:
        """Parse claims such as "there's a lamp near the bed". One of the phrases of `slot` takes the place of
        "there's".
        """
        for end, _, classes in self.of(at, slot):
            for after, label in self._agreeing(end, "noun", classes):
                for stop, qualifier in self._qualified(after):
                    for place, room, named in self._where(stop, last):
                        yield place, Phrase(label, qualifier, room), named
        for end, _, _ in self.of(at, "in") if self.book.room_first else ():
            for start, room in self._rooms(end):
                yield from self._some_in(room, slot, start)
        for end, room in self._rooms(at) if slot in _OWNED else ():
            yield from self._some_in(room, _OWNED[slot], end)

    def _some_in(self, room: Named, slot: str, at: int) -> Iterator[tuple[int, Phrase, Named | None]]:
        """Parse the rest of a claim that begins with its room: "the kitchen has a lamp near the sink"."""
        for end, _, classes in self.of(at, slot):
            for after, label in self._agreeing(end, "noun", classes):
                for stop, qualifier in self._qualified(after):
                    yield stop, Phrase(label, qualifier, room), room

    def _there(self, at: int, last: Named | None) -> Iterator[tuple[int, str, Named | None, Named | None]]:
        """Parse an object that is known to exist. Yield (end, label, its room, room named last)."""
        for end, label in self._definite(at, "noun"):
            for after, room, named in self._where(end, last, belonging=True):
                yield after, label, room, named
        for after, label, room in self._in_its_room(at):
            yield after, label, room, room

    def _known(self, slot: str | None, at: int, last: Named | None) -> Iterator[tuple[int, Phrase, Named | None]]:
        """Parse claims such as "the lamp in the bedroom is near the bed". The verb is one of the phrases of `slot`;
        with `slot` None there is no verb.
        """
        for after, label, room, named in self._there(at, last):
            for verb in [after] if slot is None else [stop for stop, _, _ in self.of(after, slot)]:
                for stop, qualifier in self._relations(verb):
                    yield stop, Phrase(label, qualifier, room, True), named

    def _relations(self, at: int) -> Iterable[tuple[int, _Qualifier]]:
        """Parse a relation or an egocentric direction behind a verb."""
        yield from self._related(at)
        yield from ((end, (bearing, ())) for end, bearing, _ in self.of(at, "bearing"))

    def _known_in(self, slot: str, at: int) -> Iterator[tuple[int, Phrase, Named | None]]:
        """Parse claims such as ", in the bedroom that has the desk, the lamp is near the bed". The verb is one of the
        phrases of `slot`.
        """
        for end, _, _ in self.of(at + 1, "in") if self.is_mark(at, ",") else ():
            for stop, room in self._rooms(end):
                for after, what, named in self._known(slot, stop + 1, room) if self.is_mark(stop, ",") else ():
                    if what.room == self.scope:
                        yield after, what._replace(room=room), named

    @parsed_once
    def _said(self, at: int, last: Named | None) -> Iterator[tuple[int, bool, Phrase, Named | None]]:
        """Parse claims. Yield (end, True if asserted or False if denied, claim, room named last)."""
        for present, some, known in (
            (True, "exists", "is"),
            (True, "exists_again", None),
            (False, "absent", "is_not"),
            (False, "absent_again", None),
        ):
            others = () if known is None else (self._known(known, at, last), self._known_in(known, at))
            for found in (self._some(some, at, last), *others):
                for end, what, named in found:
                    yield end, present, what, named

    @parsed_once
    def _joined(self, at: int, last: Named | None) -> Iterator[tuple[int, bool, Phrase, Named | None]]:
        """Parse claims without their verb: "a lamp in the kitchen" behind "if there's a bed and"."""
        for present, slot in ((True, "also"), (True, "also_a"), (True, "there_also"), (False, "nor")):
            for end, what, named in self._some(slot, at, last):
                yield end, present, what, named

    def _neither(self, at: int) -> list[tuple[int, str, str]]:
        """Parse "there's neither a lamp nor a bed". Return (end, label, other label) for each parse."""
        return [
            (stop, one, other)
            for end, _, classes in self.of(at, "neither_a")
            for after, one in self._agreeing(end, "noun", classes)
            for middle, _, its in self.of(after, "nor_a")
            for stop, other in self._agreeing(middle, "noun", its)
        ]

    @parsed_once
    def _requests(self, at: int, last: Named | None) -> Iterator[tuple[int, Phrase, Named | None]]:
        """Parse requests to look, and questions with their question mark."""
        for end, _, _ in self.of(at, "see"):
            for stop, present, what, named in self._said(end, last):
                if present:
                    yield stop, what, named
        for end, _, _ in self.of(at, "check"):
            for stop, room in self._rooms(end):
                yield from self._some_in(room, "for", stop)
        for end, _, _ in self.of(at, "look_at"):
            for stop, label, own, named in self._there(end, last):
                yield stop, Phrase(label, None, own, True), named
        yield from self._some("look", at, last)
        questions = [*self._some("is_there", at, last)]
        questions += [found for end, _, _ in self.of(at, "asks_is") for found in self._known(None, end, last)]
        yield from ((end, what, named) for end, what, named in questions if self.is_mark(end, "?"))

    @parsed_once
    def _stops(self, at: int, last: Named | None) -> Iterator[tuple[int, Moves, Named | None]]:
        """Parse moves to one or more stops, up to the end of a clause. Punctuation or "if" must follow directly after
        the moves.
        """
        for start, _, _ in self.of(at, "go"):
            yield from self._things_in_turn(start, last)

    @parsed_once
    def _verbless_stops(self, at: int, last: Named | None) -> Iterator[tuple[int, Moves, Named | None]]:
        """Parse moves whose verb was said before: "to the lamp"."""
        for start, _, _ in self.of(at, "to"):
            yield from self._things_in_turn(start, last)

    def _things_in_turn(self, start: int, last: Named | None) -> Iterator[tuple[int, Moves, Named | None]]:
        ahead: list[tuple[int, Moves, Named | None]] = [
            (stop, (thing,), named) for stop, thing, named in self._things(start, last)
        ]
        known: set[tuple[int, Moves, Named | None]] = set()
        while ahead:
            end, moves, named = ahead.pop()
            # The same words may be of several slots; without this, each further stop would multiply the ways.
            if (end, moves, named) in known:
                continue
            known.add((end, moves, named))
            if end < len(self.tokens) and (self.tokens[end] in _STOPS or self.of(end, "if")):
                yield end, moves, named
            for slot in ("then", "second", "last"):
                for after, _, _ in self.of(end, slot):
                    ahead += [
                        (stop, (*moves, beside(thing, moves[-1])), room)
                        for stop, thing, room in self._things(after, named)
                    ]
