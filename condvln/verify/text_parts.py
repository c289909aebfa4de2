"""The parts of a text between its marks, and what each may say.

A part ends with a mark, or before a comma. A comma before a further stop is inside a part.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, Final

from condvln.verify.part_forms import LAST, STOPPING, WORD, Form, FormTable, Outline, Said, Thing
from condvln.verify.phrasebook import Phrasebook
from condvln.verify.phrases import Named, Phrase, beside
from condvln.verify.word_reader import LONGEST_KEPT

__all__ = ["Part", "PartTable"]

MOST_PARTS: Final = 1 << 15
"""Parts that are kept for later texts."""
LONGEST_PART: Final = 1 << 10
"""Most characters of a part that is kept."""
MOST_APART: Final = 8
"""Most rooms that a text may name by an object."""
_UNSEEN: Final[Any] = object()
_ENDS: Final = {".": ".", ";": ";", ":": ";"}
"""Marks that end a part which says stops, and the marks that clauses read like them."""
_ONLY_STOPS: Final = {
    (comma, parser, end): Outline(
        (*comma, WORD, end), ({},) * (len(comma) + 2), {(parser, len(comma)): ((len(comma) + 1, 0),)}, related=False
    )
    for comma in ("", ",")
    for parser in STOPPING
    for end in _ENDS.values()
}
"""The outlines of parts that say stops only, by the comma before them, the parser of the stops, and the mark."""
_JOINTS: Final = frozenset(("then", "second", "last"))
"""Kinds of phrases before a further stop."""


class Part(Form):
    """What a part of a text says: a form, with the labels, relations and rooms of its claims in place of numbers."""

    __slots__ = ()


class _Stop(Thing):
    """A further stop, and the room named last after it, by their names."""

    __slots__ = ()


class PartTable:
    """The parts of earlier texts in one language."""

    def __init__(self, book: Phrasebook) -> None:
        self._book = book
        phrases = dict(_phrases(book.tree, ()))
        joints = [words for words, kinds in phrases.items() if kinds & _JOINTS]
        after_comma = {words[1] for words in phrases if words[0] == ","}
        after_comma |= {short for short, apart in book.contractions.items() if apart[0] in after_comma}
        inside = rf",(?=\s*(?:{_any_of(after_comma)})(?![^\s,.;:?]))"
        self._split = re.compile(rf",(?:[^,.;:?]|{inside})*[.;:?]?|(?:[^,.;:?]|{inside})+[.;:?]?|[.;:?]").findall
        clear = sorted((words for words in joints if _is_clear(words, phrases)), key=len, reverse=True)
        self._joint = re.compile(rf"(?:{'|'.join(map(_spaced, clear)) or '(?!)'})(?=\s)").split
        self._goes = {" ".join(words): parser for words, parser in _beginnings(phrases)}
        goes = sorted(self._goes, key=len, reverse=True)
        self._go = re.compile(rf"\s*(,?)\s*({'|'.join(map(re.escape, goes)) or '(?!)'})(?=\s)").match
        self._forms = FormTable(book)
        self._parts: dict[tuple[bool, tuple[Named, ...]], dict[str, Part | None]] = {}
        self._stops: dict[tuple[bool, tuple[Named, ...]], dict[str, _Stop | None]] = {}
        self._kept = 0

    def split(self, text: str) -> list[str]:
        """Return the parts of a text in lower case."""
        found: list[str] = self._split(text)
        return found

    def part(self, words: str, scoped: bool, before: tuple[Named, ...]) -> Part | None:
        """Return what the part `words` of a text says; None if it has to be read together with the text around it.

        scoped : whether the text names the room of all objects that are named without a room
        before : the rooms that the text before this part names by an object
        """
        table = self._parts.get((scoped, before))
        found = _UNSEEN if table is None else table.get(words, _UNSEEN)
        if found is _UNSEEN:
            if len(words) > LONGEST_PART or len(before) > MOST_APART:
                return None
            found = self._only_stops(words, scoped, before) or self._parsed(words, scoped, before)
            self._make_room()
            self._parts.setdefault((scoped, before), {})[words] = found
        return found  # type: ignore[no-any-return]

    def _make_room(self) -> None:
        self._kept += 1
        if self._kept > MOST_PARTS:
            self._parts.clear()
            self._stops.clear()
            self._kept = 1

    def _parsed(self, words: str, scoped: bool, before: tuple[Named, ...]) -> Part | None:
        tokens = self._book.tokens(words)
        if not 0 < len(tokens) <= LONGEST_KEPT:
            return None
        form, values = self._forms.form(tokens, scoped, before)
        if form is None:
            return None
        return Part(
            form.outline,
            tuple([_named(name, values) for name in form.names]),
            tuple(
                [Said(tuple([_phrase(x, values) for x in moves]), _room(room, values)) for moves, room in form.stops]
            ),
            tuple([_named(room, values) for room in form.apart]),
            None if form.heading is None else values[int(form.heading)],
            _room(form.scope, values),
        )

    def _only_stops(self, words: str, scoped: bool, before: tuple[Named, ...]) -> Part | None:
        """Return what a part says that consists of stops, from what each stop says; None if it may be something else
        than stops.
        """
        begin, end = self._go(words), words[-1]
        if begin is None or end not in _ENDS:
            return None
        said: Said | None = None
        apart = dict.fromkeys(before)
        for one in self._joint(words[begin.end() : -1]):
            found = self._stop(one, scoped, tuple(apart))
            if found is None:
                return None
            stop, room, own = found
            apart.update(dict.fromkeys(own))
            if said is None:
                said = Said((stop,), room)
                continue
            if stop.room == LAST:
                if said.room is None:
                    return None
                stop = stop._replace(room=said.room)
            said = Said((*said.moves, beside(stop, said.moves[-1])), said.room if room == LAST else room)
        assert said is not None
        comma, go = begin.groups()
        own = tuple([room for room in apart if room not in before])
        return Part(_ONLY_STOPS[comma, self._goes[go], _ENDS[end]], (), (said,), own, None, None)

    def _stop(self, words: str, scoped: bool, before: tuple[Named, ...]) -> _Stop | None:
        """Return the stop that `words` name, if they can't be anything else."""
        table = self._stops.get((scoped, before))
        found = _UNSEEN if table is None else table.get(words, _UNSEEN)
        if found is _UNSEEN:
            found, tokens = None, self._book.tokens(words)
            if 0 < len(tokens) <= LONGEST_KEPT and len(before) <= MOST_APART:
                thing, values = self._forms.thing(tokens, scoped, before)
                if thing is not None:
                    apart = tuple([_named(room, values) for room in thing.apart])
                    found = _Stop(_phrase(thing.stop, values), _room(thing.room, values), apart)
            self._make_room()
            self._stops.setdefault((scoped, before), {})[words] = found
        return found  # type: ignore[no-any-return]


def _phrases(node: Mapping[str, Any], before: tuple[str, ...]) -> Iterator[tuple[tuple[str, ...], frozenset[str]]]:
    """Yield (words, kinds) of each phrase below a node of a phrasebook."""
    for word, below in node.items():
        if not word:
            yield before, frozenset(kind for kind, _, _ in below)
        elif not word.isspace():
            yield from _phrases(below, (*before, word))


def _is_clear(joint: tuple[str, ...], phrases: Mapping[tuple[str, ...], frozenset[str]]) -> bool:
    """Return whether words before a further stop can be nothing else: no phrase goes beyond either end of them, and no
    others lead from their first word to their end.
    """
    count = len(joint)
    for words, kinds in phrases.items():
        if words == joint and not kinds <= _JOINTS:
            return False
        for k in range(len(words)):
            if words[k] == joint[0] and (k or len(words) > count):
                shared = min(len(words) - k, count)
                if words[k : k + shared] == joint[:shared]:
                    return False
    reached = {0, 1 if joint[0] == "," else 0}
    for k in range(count):
        for words in phrases if k in reached else ():
            shared = min(len(words), count - k)
            if words[0] == joint[k] and words[:shared] == joint[k : k + shared]:
                if k + len(words) >= count and words != joint:
                    return False
                reached.add(k + len(words))
    return True


def _beginnings(phrases: Mapping[tuple[str, ...], frozenset[str]]) -> Iterator[tuple[tuple[str, ...], str]]:
    """Yield the words before a first stop that can be nothing else at the beginning of a part, each with the parser of
    such stops.
    """
    articles = {words[0] for words, kinds in phrases.items() if "the" in kinds}
    for words, kinds in phrases.items():
        if kinds not in (frozenset(("go",)), frozenset(("to",))):
            continue
        count = len(words)
        others = [other for other in phrases if other != words and (other[0] in (words[0], ","))]
        if not any(
            other[1 : count + 1] == words[: len(other) - 1]
            if other[0] == ","
            else other == words[: len(other)] or (other[:count] == words and other[count] in articles)
            for other in others
        ):
            yield words, "_stops" if "go" in kinds else "_verbless_stops"


def _any_of(words: Any) -> str:
    return "|".join(map(re.escape, sorted(words))) or "(?!)"


def _spaced(words: Sequence[str]) -> str:
    """Return a pattern for words with white space between them."""
    first, *rest = words
    begin = r"\s*," if first == "," else rf"\s+{re.escape(first)}"
    for before, word in zip(words, rest, strict=False):
        begin += (r"\s*" if before == "," else r"\s+") + re.escape(word)
    return begin


def _phrase(phrase: Phrase, names: Sequence[str]) -> Phrase:
    """Return a phrase with names in the place of numbers. All other words stay as they are."""
    label, qualifier, room, known = phrase
    if qualifier is not None:
        qualifier = _relation(qualifier, names)
    return Phrase(names[int(label)], qualifier, _room(room, names), known)


def _relation(qualifier: tuple[str, tuple[str, ...]], names: Sequence[str]) -> tuple[str, tuple[str, ...]]:
    predicate, anchors = qualifier
    predicate = names[int(predicate)] if predicate.isdecimal() else predicate
    return predicate, tuple([names[int(anchor)] for anchor in anchors])


def _room(room: Named | None, names: Sequence[str]) -> Named | None:
    if room is None or not room.label.isdecimal():
        return room
    return Named(names[int(room.label)], None if room.anchor is None else names[int(room.anchor)])


def _named(name: Any, names: Sequence[str]) -> Any:
    """Return a label, a room, or a relation with its label with names in the place of numbers."""
    if isinstance(name, str):
        return names[int(name)]
    if isinstance(name, Named):
        return _room(name, names)
    label, qualifier = name
    return None if label is None else names[int(label)], _relation(qualifier, names)
