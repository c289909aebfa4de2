"""What the parts of a text may say up to their names, found once for each form of parts.

Two parts have the same form if they have the same phrases at the same places, whatever names they hold (nouns, rooms,
relations), and if the same of these names are equal. A form is parsed with numbers in the place of names.

What a form says to the clauses around it is its outline: claims with numbers for their labels, relations and rooms, and
stops, of which clauses only need to know where they end. So many forms have one outline.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any, Final, NamedTuple

from condvln.verify.phrasebook import MARKS, STEPS, Kinds, Matches, Phrasebook, Step
from condvln.verify.phrases import Moves, Named, Phrase, PhraseReader
from condvln.verify.word_reader import MOST_KEPT

__all__ = ["LAST", "SCOPE", "STOPPING", "WORD", "Form", "FormTable", "Outline", "Said", "Thing"]

LAST: Final = Named("\0last", None)
"""Stands for the room named last before a part."""
SCOPE: Final = Named("\0scope", None)
"""Stands for the room of all objects that are named without a room."""
STOPPING: Final = frozenset(("_stops", "_verbless_stops"))
"""Parsers that find stops."""
MOST_RESULTS: Final = 8
"""Most ways to parse a part from one word that are kept, which bounds the memory for texts made to be ambiguous."""

_CLAUSE_KINDS: Final = frozenset(
    (
        *("list", "number", "filler", "but", "and", "if", "otherwise", "either", "so", "not", "neither", "none"),
        *("yes_one", "no_one", "yes_it", "no_it", "it_is", "it_is_not"),
    )
)
"""Kinds of phrases that hold clauses together."""
WORD: Final = "w"
"""Stands for a word that is not a mark."""
_LIKE: Final = {"?": ".", ":": ";"}
"""Marks that clauses read like another one, except behind the beginning of a list."""
_UNSEEN: Final[Any] = object()
_NO_CLASSES: Final[frozenset[str]] = frozenset()

_Lattice = list[tuple[int, str, Sequence[tuple[int, int, tuple[Any, ...]]]]]
"""Position among the tokens, mark, and phrases of each position that a parser may reach."""
_Found = dict[int, dict[str, list[Any]]]
"""What the parsers find, by position and parser: tuples that begin with the end."""
_Links = dict[int, dict[str, list[int]]]
"""Ends of the phrases between clauses, by position and kind."""


class Said(NamedTuple):
    """Stops that a part may say, and the room named last after them: `LAST` if they name none, None if it is unclear
    which room "there" would mean.
    """

    moves: Moves
    room: Named | None

    @property
    def uses_last(self) -> bool:
        """Whether a stop is in the room named last before the part."""
        return any(stop.room == LAST for stop in self.moves)


@dataclass(frozen=True, eq=False, slots=True)
class Outline:
    """What the parts of some forms say to the clauses around them. Positions are those where a clause may begin or end.

    tokens : the mark at each position, or a letter for a word
    matches : the phrases between clauses that begin at each position
    found : what else may begin there, by parser and position: (end, …) with claims whose label, relation and room are
        numbers, and for stops (end, index of the stops)
    related : whether an answer may say a relation
    """

    tokens: tuple[str, ...]
    matches: tuple[Matches, ...]
    found: dict[tuple[str, int], tuple[Any, ...]]
    related: bool

    @property
    def is_mute(self) -> bool:
        """Whether no clause can begin at the first position."""
        return not self.matches[0] and all(at for _, at in self.found)


class Form(NamedTuple):
    """What a form says, with names as numbers in the order of their first mention.

    names : what the numbers in the outline stand for: a label, a room, or a relation with the label before it
    stops : the stops that the outline refers to
    apart : rooms that the form names by an object
    heading : the direction, of a part that only states the heading
    scope : the room, of a part that only names the room of all objects without one
    """

    outline: Outline
    names: tuple[Any, ...]
    stops: tuple[Said, ...]
    apart: tuple[Named, ...]
    heading: str | None
    scope: Named | None


class Thing(NamedTuple):
    """The only stop that a form may say, with names as numbers, and the room named last after it."""

    stop: Phrase
    room: Named | None
    apart: tuple[Named, ...]


class FormTable:
    """The forms of the parts of earlier texts in one language."""

    def __init__(self, book: Phrasebook) -> None:
        self._book = book
        self._kinds: list[Kinds] = list(book.kinds)
        self._forms: dict[Any, Form | Thing | None] = {}
        self._outlines: dict[Any, Outline] = {}

    def form(self, tokens: Sequence[str], scoped: bool, before: Sequence[Named]) -> tuple[Form | None, list[str]]:
        """Return what a part says, and its names; None if it has to be read together with the text around it.

        scoped : whether the text names the room of all objects that are named without a room
        before : the rooms that the text before this part names by an object
        """
        found, names = self._known(_form, tokens, scoped, before)
        assert not isinstance(found, Thing)
        return found, names

    def thing(self, tokens: Sequence[str], scoped: bool, before: Sequence[Named]) -> tuple[Thing | None, list[str]]:
        """Return the stop that some words name, and the names in them; None if they may be something else too."""
        found, names = self._known(_thing, tokens, scoped, before)
        assert not isinstance(found, Form)
        return found, names

    def _known(
        self, parse: Any, tokens: Sequence[str], scoped: bool, before: Sequence[Named]
    ) -> tuple[Form | Thing | None, list[str]]:
        names: dict[str, int] = {}
        rooms = []
        for label, anchor in before:
            assert anchor is not None
            numbers = [names.setdefault(name, len(names)) for name in (label, anchor)]
            rooms.append(Named(*map(str, numbers)))
        lattice, key = self._lattice(tokens, names)
        its_key = (parse, scoped, *rooms, *key)
        found = self._forms.get(its_key, _UNSEEN)
        if found is _UNSEEN:
            if len(self._forms) >= MOST_KEPT:
                self._forms.clear()
                self._outlines.clear()
            found = None
            if not any(_has_twins(self._kinds[kinds]) for _, _, steps in lattice for _, kinds, _ in steps):
                matches = [_matches(steps, self._kinds) for _, _, steps in lattice]
                reader = _FormReader(self._book, [mark for _, mark, _ in lattice], matches, rooms)
                if reader.is_closed():
                    reader.scope = SCOPE if scoped else None
                    found = parse(reader, self._outlines)
            self._forms[its_key] = found
        return found, list(names)

    def _lattice(self, tokens: Sequence[str], names: dict[str, int]) -> tuple[_Lattice, list[Any]]:
        """Return the positions that a parser may reach in a part, with the phrases there, and a key that is equal for
        parts of the same form. `names` is extended by the names in the part.
        """
        count, tree, longest = len(tokens), self._book.tree, self._book.longest
        reached = bytearray(count + longest + 1)
        reached[0] = 1
        letters = self._book.spelled(tokens)
        if not self._book.first["with"].isdisjoint(letters):
            # Rooms that are named by an object are looked for at every word.
            articles = self._book.first["the"]
            for at, letter in enumerate(letters):
                if letter in articles:
                    reached[at] = 1
        found: list[tuple[int, str, tuple[Step, ...]]] = []
        for at in range(count):
            if not reached[at]:
                continue
            node: Any = tree
            for token in tokens[at : at + longest]:
                below = node.get(token)
                if below is None:
                    break
                node = below
            steps: tuple[Step, ...] = node[STEPS]
            for length, _, _ in steps:
                reached[at + length] = 1
            token = tokens[at]
            if token == ",":
                reached[at + 1] = 1
            found.append((at, token if token in MARKS else WORD, steps))
        place = {at: index for index, (at, _, _) in enumerate(found)}
        place[count] = len(found)
        key: list[Any] = []
        lattice: _Lattice = []
        for index, (at, mark, steps) in enumerate(found):
            numbered = [
                (
                    place[at + length] - index,
                    kinds,
                    tuple([names.setdefault(value, len(names)) for value in values]) if values else (),
                )
                for length, kinds, values in steps
            ]
            key.append(mark)
            key += numbered
            lattice.append((at, mark, numbered))
        return lattice, key


class _FormReader(PhraseReader):
    """Parses a form. The room named last before it is `LAST`, and `rooms` were named by an object before it."""

    def __init__(self, book: Phrasebook, tokens: list[str], matches: Sequence[Matches], rooms: Sequence[Named]) -> None:
        super().__init__(book, "", alone=True)
        self.tokens = tokens
        self.pauses = [at for at, token in enumerate(tokens) if token in MARKS]
        self._matches = [*matches, {}, {}]
        self._rooms_before = [(-1, room) for room in rooms]

    def own_apart(self) -> tuple[Named, ...]:
        """Return the rooms that the form names by an object."""
        return tuple(dict.fromkeys([room for at, room in self._set_apart() if at >= 0]))

    def _set_apart(self) -> Sequence[tuple[int, Named]]:
        if self._apart is None:
            self._apart = [*self._rooms_before, *super()._set_apart()]
        return self._apart

    def is_closed(self) -> bool:
        """Return whether the parsers need nothing from other parts: "that bedroom" needs the distance to a room named
        before, and a claim behind ", in the kitchen," would be in the next part.
        """
        if any("that" in here for here in self._matches if here is not None) and self._set_apart():
            return False
        count = len(self.tokens)
        return not any(
            stop == count
            for at, token in enumerate(self.tokens)
            if token == ","
            for end, _, _ in self.of(at + 1, "in")
            for stop, _ in self._rooms(end)
        )

    def openings(self) -> list[tuple[int, str | Named]]:
        """Return (end, direction) for each heading that the form may state, and (end, room) for each room that it may
        name as the room of all objects without one.
        """
        found: list[tuple[int, str | Named]] = [(end, said) for end, said in self._opening() if said is not None]
        for end, _, _ in self.of(0, "scope"):
            for stop, room in self._rooms(end):
                if stop == len(self.tokens) or self.is_mark(stop, ","):
                    found.append((stop, room))
        return found

    def beginnings(self, at: int) -> dict[str, list[Any]]:
        """Return what the parsers find at a position, by parser, each result once."""
        found: dict[str, Iterable[Any]] = {
            "_said": self._said(at, LAST),
            "_joined": self._joined(at, LAST),
            "_requests": self._requests(at, LAST),
            "_stops": self._stops(at, LAST),
            "_verbless_stops": self._verbless_stops(at, LAST),
            "_neither": self._neither(at),
        }
        return {parser: list(dict.fromkeys(results)) for parser, results in found.items() if results}

    def related(self, at: int) -> list[Any]:
        """Return the relations that begin at a position."""
        return list(dict.fromkeys(self._relations(at)))

    def things(self) -> list[tuple[int, Phrase, Named | None]]:
        """Return (end, stop, room named last after it) for each stop that begins at the first word."""
        return list(dict.fromkeys(self._things(0, LAST)))


def _thing(reader: _FormReader, _: Any) -> Thing | None:
    """Return the stop that the whole form names; None if it is not the only one that moves may go on from."""
    count, whole = len(reader.tokens), []
    for end, stop, room in reader.things():
        if end == count:
            whole.append((stop, room))
        elif reader.tokens[end] != WORD or not reader.here(end).keys().isdisjoint(("if", "then", "second", "last")):
            return None
    return Thing(*whole[0], reader.own_apart()) if len(whole) == 1 else None


def _form(reader: _FormReader, outlines: dict[Any, Outline]) -> Form | None:
    """Return what the parts of a form say. Return None if they have to be read together with the text around them: if a
    claim is about an object in the room named last, or if there are too many ways to parse them.
    """
    found, links = _parse_all(reader)
    for results in found.values():
        for parser, those in results.items():
            if len(those) > MOST_RESULTS:
                return None
            if parser not in STOPPING and any(isinstance(x, Phrase) and x.room == LAST for one in those for x in one):
                return None
    _prune(reader.tokens, found, links)
    names: dict[Any, int] = {}
    stops: list[Said] = []
    outline = _outline(reader.tokens, found, links, names, stops, outlines)
    heading = scope = None
    openings = reader.openings()
    if openings:
        end, opening = openings[0]
        if len(openings) > 1 or end != len(reader.tokens) or not outline.is_mute:
            return None
        heading, scope = (opening, None) if isinstance(opening, str) else (None, opening)
    return Form(outline, tuple(names), tuple(stops), reader.own_apart(), heading, scope)


def _parse_all(reader: _FormReader) -> tuple[_Found, _Links]:
    """Parse a form from each position where a clause may begin or go on."""
    count = len(reader.tokens)
    found: _Found = {}
    links: _Links = {}
    relations: dict[int, list[Any]] = {}
    ahead = [0]
    while ahead:
        at = ahead.pop()
        if at >= count or at in found:
            continue
        found[at] = reader.beginnings(at)
        ahead += [end for results in found[at].values() for end, *_ in results]
        here = reader.here(at)
        links[at] = {kind: [at + words for words, _, _ in here[kind]] for kind in sorted(_CLAUSE_KINDS & here.keys())}
        for kind, ends in links[at].items():
            ahead += ends
            if kind in ("it_is", "it_is_not"):
                for end in ends:
                    relations[end] = reader.related(end)
                    ahead += [stop for stop, _ in relations[end]]
        if reader.tokens[at] == ",":
            ahead.append(at + 1)
    for at, related in relations.items():
        if related:
            found[at]["_relations"] = related
    return found, links


def _prune(tokens: Sequence[str], found: _Found, links: _Links) -> None:
    """Leave out what ends at a position from which no clause can go on, and these positions."""
    dead: set[int] = set()
    for at in sorted(found, reverse=True):
        for those in (found[at], links[at]):
            for name, ends in list(those.items()):
                those[name] = [one for one in ends if (one if isinstance(one, int) else one[0]) not in dead]
                if not those[name]:
                    del those[name]
        mark = tokens[at]
        goes_on = at + 1 not in dead if mark == "," else mark != WORD
        if not (found[at] or links[at] or goes_on):
            dead.add(at)
    # What follows a comma has a position of its own.
    for at in dead - {0, 1 if tokens[0] == "," else 0}:
        del found[at], links[at]
    for at, results in found.items():
        if "_neither" in results:
            links[at]["neither_a"] = [end for end, *_ in results["_neither"]]


def _outline(
    tokens: Sequence[str],
    found: _Found,
    links: _Links,
    names: dict[Any, int],
    stops: list[Said],
    outlines: dict[Any, Outline],
) -> Outline:
    """Return the outline of a form. `names` and `stops` are extended by those that it refers to."""
    places = sorted(found)
    index = {at: k for k, at in enumerate(places)}
    index[len(tokens)] = len(places)
    outlined: dict[tuple[str, int], tuple[Any, ...]] = {}
    for at in places:
        for parser, results in found[at].items():
            if parser in STOPPING:
                outlined[parser, index[at]] = tuple(
                    [(index[end], len(stops) + k) for k, (end, *_) in enumerate(results)]
                )
                stops += [Said(moves, room) for _, moves, room in results]
            else:
                outlined[parser, index[at]] = tuple(
                    [(index[end], *[_numbered(item, names) for item in rest]) for end, *rest in results]
                )
    matches = tuple(
        [
            {
                kind: tuple([(index[end] - index[at], "", _NO_CLASSES) for end in ends])
                for kind, ends in links[at].items()
            }
            for at in places
        ]
    )
    is_list = any("list" in here for here in matches)
    marks = tuple([tokens[at] if is_list else _LIKE.get(tokens[at], tokens[at]) for at in places])
    related = any(parser == "_relations" for parser, _ in outlined)
    key = (marks, tuple([tuple(here.items()) for here in matches]), tuple(outlined.items()))
    known = outlines.get(key)
    if known is None:
        known = outlines[key] = Outline(marks, matches, outlined, related)
    return known


def _numbered(item: Any, names: dict[Any, int]) -> Any:
    """Return a part of a parser's result with the numbers of its label, its relation and its room. `names` is extended
    by new ones; a relation is listed with the label before it.
    """
    if isinstance(item, Phrase):
        label, qualifier, room, known = item
        number = str(names.setdefault(label, len(names)))
        if qualifier is not None:
            qualifier = (str(names.setdefault((label, qualifier), len(names))), ())
        return Phrase(number, qualifier, None if room is None else _numbered(room, names), known)
    if isinstance(item, Named):
        return item if item in (LAST, SCOPE) else Named(str(names.setdefault(item, len(names))), None)
    if isinstance(item, str):
        return str(names.setdefault(item, len(names)))
    return (str(names.setdefault((None, item), len(names))), ()) if isinstance(item, tuple) else item


def _matches(steps: Sequence[tuple[int, int, tuple[int, ...]]], kinds: Sequence[Kinds]) -> Matches:
    """Return the phrases at a position of a form, with numbers in the place of names."""
    found: Matches = {}
    for length, number, values in steps:
        names = iter(values)
        for kind, value, classes in kinds[number]:
            said = str(next(names)) if value is None else value
            found[kind] = (*found.get(kind, ()), (length, said, classes))
    return found


def _has_twins(kinds: Kinds) -> bool:
    """Return whether the same words are two nouns: the order of their labels would count then."""
    return sum(kind == "noun" for kind, _, _ in kinds) > 1
