"""Texts that say the same up to their names, read once.

A text is the sequence of its parts, and what clauses can do with a part is its outline. So texts with the same
outlines, and with the same of their claims' names equal, have the same readings up to names and stops. The first such
text is read with numbers in the place of names, and with the stops of a part as one. A text with no reading then, or
several ones, is read in full.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from functools import lru_cache
from typing import Any, Final, NamedTuple

from condvln.verify.clause_reader import ClauseReader, chosen, in_rooms
from condvln.verify.part_forms import LAST, SCOPE, STOPPING
from condvln.verify.phrasebook import Phrasebook
from condvln.verify.phrases import Moves, Named, Phrase
from condvln.verify.text_parts import Part, PartTable
from condvln.verify.word_reader import MOST_KEPT

__all__ = ["Function", "TextTable"]

Function = tuple[tuple[Phrase, ...], tuple[Moves, ...], str | None]
"""Conditions, moves by case, and heading of a text."""

MOST_PARTS: Final = 64
"""Most parts of a text that are read by this table."""


class _Stops(NamedTuple):
    """Stops of a text: those of index `choice` in a part. `last` is the room named last before them: a claim's as a
    number, or that of other stops.
    """

    part: int
    choice: int
    last: Named | _Stops | None


class _Reading(NamedTuple):
    """A reading of texts that are equal up to names; see `State` and `chosen`."""

    named: tuple[Phrase, ...]
    rules: tuple[_Stops, ...]
    choice: tuple[int, ...]
    early: bool


class TextTable:
    """What earlier texts of one language say."""

    def __init__(self, book: Phrasebook) -> None:
        self._book = book
        self._parts = PartTable(book)
        self._readings: dict[Any, tuple[_Reading, ...]] = {}

    @staticmethod
    @lru_cache(maxsize=4)
    def of(book: Phrasebook) -> TextTable:
        """Return the table of a phrasebook, made once."""
        return TextTable(book)

    def function(self, text: str) -> Function | None:
        """Return what a text says if it has exactly one reading, and a listener who refers every answer to the latest
        question gets it; None if it may have another number of readings and has to be read in full.
        """
        words = self._parts.split(text.lower())
        if len(words) > MOST_PARTS:
            return None
        begin, heading, scope = 0, None, None
        before: tuple[Named, ...] = ()
        for _ in range(2):
            opening = self._parts.part(words[begin], False, ()) if begin < len(words) - 1 else None
            if opening is None:
                break
            if opening.heading is not None and not begin:
                begin, heading = 1, opening.heading
            elif opening.scope is not None and words[begin + 1][0] == ",":
                begin, scope, before = begin + 1, opening.scope, opening.apart
                break
        parts: list[Part] = []
        for said in words[begin:]:
            part = self._parts.part(said, scope is not None, before)
            if part is None:
                return None
            if part.apart:
                before = tuple(dict.fromkeys((*before, *part.apart)))
            parts.append(part)
        names: dict[Any, int] = {} if scope is None else {scope: 0}
        outlines = tuple([part.outline for part in parts])
        said_names = [name for part in parts for name in part.names]
        related = any(outline.related for outline in outlines)
        if related:
            # A relation that an answer says may be that of any label.
            said_names = [name[1] if type(name) is tuple else name for name in said_names]
        numbers = tuple([names.setdefault(name, len(names)) for name in said_names])
        key = (outlines, numbers, scope is not None)
        readings = self._readings.get(key)
        if readings is None:
            if len(self._readings) >= MOST_KEPT:
                self._readings.clear()
            readings = self._readings[key] = _readings(self._book, parts, numbers, scoped=scope is not None)
        values = list(names) if related else [name[1] if type(name) is tuple else name for name in names]
        return _one_function(readings, parts, values, scope, heading)


def _readings(book: Phrasebook, parts: Sequence[Part], numbers: Sequence[int], *, scoped: bool) -> tuple[_Reading, ...]:
    """Return all readings of texts with the outlines of these parts.

    numbers : those of the names in the parts' claims, in order
    scoped : the text names the room of all objects without one; its number is 0, and its comma is the first word
    """
    scope = Named("0", None) if scoped else None
    reader = _OutlineReader(book, parts, numbers, scope)
    found: dict[_Reading, None] = {}
    for state, told in reader.from_word(1 if scoped else 0, scope):
        choice = chosen(state)
        if choice is not None:
            rules = tuple([reader.stops[int(moves[0].label)] for moves in told])
            found[_Reading(state.named, rules, choice, state.early)] = None
    return tuple(found)


def _one_function(
    readings: Sequence[_Reading], parts: Sequence[Part], names: Sequence[Any], scope: Named | None, heading: str | None
) -> Function | None:
    """Return what the readings of a text say if it is the same of all, and not all refer an answer to an earlier
    question.
    """
    found: Function | None = None
    early = True
    for reading in readings:
        function = _function(reading, parts, names, scope, heading)
        if function is not None:
            if found is not None and found != function:
                return None
            found, early = function, early and reading.early
    return None if early else found


def _function(
    reading: _Reading, parts: Sequence[Part], names: Sequence[Any], scope: Named | None, heading: str | None
) -> Function | None:
    """Return what a reading says in one text; None if some stop is in the room named last and none was named."""
    told: list[Moves] = []
    for stops in reading.rules:
        moves = parts[stops.part].stops[stops.choice].moves
        for stop in moves:
            if stop.room == LAST or stop.room == SCOPE:
                last = _room(stops.last, parts, names)
                if last is None and any(other.room == LAST for other in moves):
                    return None
                moves = tuple([_placed(other, last, scope) for other in moves])
                break
        told.append(moves)
    named = tuple([_phrase(phrase, names) for phrase in reading.named])
    rooms = [stop.room for moves in told for stop in moves]
    if None in rooms and not (rooms.count(None) == len(rooms) and all(phrase.room is None for phrase in named)):
        told = in_rooms(named, told)
    return named, tuple([told[rule] for rule in reading.choice]), heading


def _phrase(phrase: Phrase, names: Sequence[Any]) -> Phrase:
    """Return a phrase with names in the place of numbers."""
    label, qualifier, room, known = phrase
    relation = None if qualifier is None else names[int(qualifier[0])]
    return Phrase(names[int(label)], relation, None if room is None else names[int(room.label)], known)


def _room(room: Named | _Stops | None, parts: Sequence[Part], names: Sequence[Any]) -> Named | None:
    """Return the room that is meant by a number, or by stops after which it is the room named last."""
    while isinstance(room, _Stops):
        after = parts[room.part].stops[room.choice].room
        if after != LAST:
            return after
        room = room.last
    return None if room is None else names[int(room.label)]


def _placed(stop: Phrase, last: Named | None, scope: Named | None) -> Phrase:
    """Return a stop in the room that `LAST` or `SCOPE` means."""
    if stop.room == LAST:
        return stop._replace(room=last)
    return stop._replace(room=scope) if stop.room == SCOPE else stop


class _OutlineReader(ClauseReader):
    """Reads the outlines of a text's parts. A name is a number, and the stops of a part are one phrase, whose label is
    their index in `stops`. A room named last by stops is a number behind `_BY_STOPS`.
    """

    def __init__(self, book: Phrasebook, parts: Sequence[Part], numbers: Sequence[int], scope: Named | None) -> None:
        super().__init__(book, "", alone=True)
        self.stops: list[_Stops] = []
        self._index: dict[_Stops, int] = {}
        self._found: dict[tuple[str, int], list[tuple[Any, ...]]] = {}
        self.tokens = []
        self._matches = []
        begin = 0
        for k, part in enumerate(parts):
            own = [str(number) for number in numbers[begin : begin + len(part.names)]]
            begin += len(part.names)
            offset = len(self.tokens)
            for (parser, at), results in part.outline.found.items():
                if parser in STOPPING:
                    found = [(offset + end, k, index) for end, index in results]
                else:
                    found = [(offset + end, *[_renumbered(x, own, scope) for x in rest]) for end, *rest in results]
                self._found[parser, offset + at] = found
            self._matches += part.outline.matches
            self.tokens += part.outline.tokens
        self._matches += [{}, {}]

    def _at(self, parser: str, at: int, last: Named | None) -> list[Any]:
        found = self._found.get((parser, at), ())
        return [tuple([last if item == LAST else item for item in one]) for one in found]

    def _said(self, at: int, last: Named | None) -> list[tuple[int, bool, Phrase, Named | None]]:
        return self._at("_said", at, last)

    def _joined(self, at: int, last: Named | None) -> list[tuple[int, bool, Phrase, Named | None]]:
        return self._at("_joined", at, last)

    def _requests(self, at: int, last: Named | None) -> list[tuple[int, Phrase, Named | None]]:
        return self._at("_requests", at, last)

    def _stops(self, at: int, last: Named | None) -> list[tuple[int, Moves, Named | None]]:
        return self._stopping("_stops", at, last)

    def _verbless_stops(self, at: int, last: Named | None) -> list[tuple[int, Moves, Named | None]]:
        return self._stopping("_verbless_stops", at, last)

    def _stopping(self, parser: str, at: int, last: Named | None) -> list[tuple[int, Moves, Named | None]]:
        found: list[tuple[int, Moves, Named | None]] = []
        for end, part, index in self._found.get((parser, at), ()):
            before: Named | _Stops | None = last
            if last is not None and last.anchor == _BY_STOPS:
                before = self.stops[int(last.label)]
            stops = _Stops(part, index, before)
            number = self._index.setdefault(stops, len(self.stops))
            if number == len(self.stops):
                self.stops.append(stops)
            found.append((end, (Phrase(str(number), None, None),), Named(str(number), _BY_STOPS)))
        return found

    def _relations(self, at: int) -> Iterable[tuple[int, tuple[str, tuple[str, ...]]]]:
        return self._at("_relations", at, None)

    def _neither(self, at: int) -> list[tuple[int, str, str]]:
        return self._at("_neither", at, None)


_BY_STOPS: Final = "stops"
"""Marks a room that stops name last."""


def _renumbered(item: Any, numbers: Sequence[str], scope: Named | None) -> Any:
    """Return a part of what a parser finds with the numbers that its names have in the text."""
    if isinstance(item, Phrase):
        label, qualifier, room, known = item
        if qualifier is not None:
            qualifier = (numbers[int(qualifier[0])], ())
        return Phrase(numbers[int(label)], qualifier, _renumbered(room, numbers, scope), known)
    if isinstance(item, Named):
        return item if item == LAST else scope if item == SCOPE else Named(numbers[int(item.label)], None)
    if isinstance(item, str):
        return numbers[int(item)]
    return (numbers[int(item[0])], ()) if isinstance(item, tuple) else item
