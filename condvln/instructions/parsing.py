"""Parse a text to its reading, by a grammar made from the same data as the text."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from functools import cache
from typing import Any

from lark import Lark, Token, Tree
from lark.exceptions import LarkError, UnexpectedInput

from condvln.instructions.grammar_source import ANSWERS, grammar_source, rule_of
from condvln.instructions.language import Language, Slot, Template, language
from condvln.instructions.predicates import PREDICATES
from condvln.instructions.text_reading import Mention, Phrase, Place, Reading, last_lead, within_reach
from schemas.errors import FormatError
from schemas.program import BEARINGS, SHAPES, Category, Predicate

__all__ = ["parse", "parser", "reading_from_tree", "template_of"]

Node = Tree[Token]
_NAMES_ROOM = ("room", "same_room", "compound")


@cache
def parser(code: str = "en", kind: str = "lalr") -> Lark:
    """Return the parser of a language; `kind` "earley" keeps all readings of a text."""
    source = grammar_source(language(code))
    if kind == "earley":
        return Lark(source, parser="earley", ambiguity="explicit")
    return Lark(source, parser="lalr")


def parse(text: str, code: str = "en") -> Reading:
    """Return the only reading of `text`.

    Raises
    ------
    FormatError
        The text is not in this language's grammar, or names one condition in two different ways.
    """
    words = language(code)
    return reading_from_tree(_tree(text, words), words)


def template_of(text: str, code: str = "en") -> tuple[Category, Template]:
    """Return the category and template of `text`. Raises FormatError as :func:`parse` does."""
    words = language(code)
    (body,) = _parts(_tree(text, words), "body")
    category, number = _named(body)
    return category, words.templates[category][number]


def _tree(text: str, words: Language) -> Node:
    try:
        return parser(words.code).parse(words.expanded(text.lower()))
    except UnexpectedInput as fault:
        context = fault.get_context(text, 30) if fault.pos_in_stream is not None else ""
        raise FormatError(
            "the text can't be parsed", place=f"column {fault.column}: {context.splitlines()[0] if context else ''}"
        ) from fault
    except LarkError as fault:
        raise FormatError(f"the text can't be parsed: {fault}") from fault


def reading_from_tree(tree: Node, words: Language) -> Reading:
    """Return the reading of a parse tree."""
    return _TreeReader(words).reading(tree)


class _TreeReader:
    """Interprets a tree from left to right, since "there" refers to the room named last.

    known : rooms of the things that the text has named with their room, by label
    asked_room : room of the previous condition; also that of the next one if it asks about a definite object and names
        no room
    """

    def __init__(self, words: Language) -> None:
        self.labels = {noun.text.lower(): label for label, noun in words.nouns_of_all_rooms}
        self.rooms = {noun.text.lower(): label for label, noun in words.rooms.items()}
        self.predicates: dict[str, Predicate] = {rule_of(p): p for p in PREDICATES}
        self.words = words
        self.scope: Place | None = None
        self.last_room: Place | None = None
        self.asked_room: Place | None = None
        self.introduced: dict[Place, Mention] = {}
        self.category: Category = "simple"
        self.here = Mention(Slot("leaf", 0), 0)
        self.known: dict[str, set[Place]] = {}
        self.leads: dict[int, Place] = {}

    def reading(self, tree: Node) -> Reading:
        heading, scope, lead, body = _parts(tree, "direction", "room", "lead", "body")
        if heading is not None:
            name = str(_subtrees(heading)[0].data)
            heading = next(d for d in self.words.directions if f"direction_{rule_of(d)}" == name)
        self.scope = None if scope is None else self._place(scope)
        if lead is not None:
            self._go(_subtrees(lead)[0], 0)
        # A lead to the only room that the text names is to the room of all that it names.
        first = next(tree.find_data("led"), lead)
        if first is not None and len([*tree.find_pred(lambda node: node.data in _NAMES_ROOM)]) == 1:
            self.scope = self._place(_subtrees(first)[0])
        (sentences,) = _subtrees(body)
        return self._filled(sentences, *_named(body), heading)

    def _go(self, room: Node, index: int) -> None:
        """Keep the room of the lead to a condition."""
        self.here = Mention(Slot("see", index), self.here.steps)
        self.leads[index] = self._place(room)

    def _filled(self, sentences: Node, category: Category, number: int, heading: str | None) -> Reading:
        self.category = category
        template = self.words.templates[category][number]
        slots = [(p, steps) for p, steps in zip(template.pieces, template.steps, strict=False) if isinstance(p, Slot)]
        conditions: dict[int, Phrase] = {}
        leaves: dict[int, tuple[Phrase, ...]] = {}
        for (slot, steps), subtree in zip(slots, _subtrees(sentences), strict=True):
            self.here = Mention(slot, steps)
            if slot.form == "leaf":
                leaves[slot.index] = self._stops(_subtrees(subtree))
                continue
            if slot.form == "neither":
                self._check_pair(subtree, conditions, slot)
                continue
            if subtree.data == "led":
                room, subtree = _subtrees(subtree)
                self._go(room, slot.index)
            answers = subtree.data in ("yes", "no")
            if answers:
                (subtree,) = _subtrees(subtree)
                if subtree.data in ("is_it", "is_it_not"):
                    asked, relation = conditions[slot.index], self._stop(subtree).qualifier
                    if not asked.definite or asked.qualifier is not None:
                        raise FormatError(f"the answer to {asked} does not fit the question")
                    conditions[slot.index] = replace(asked, qualifier=relation)
                    self._know(conditions[slot.index], definite=True)
                    continue
                if subtree.data in ANSWERS:
                    kind = str(subtree.data).partition("_")[2]
                    if kind != "any" and (kind == "it") != conditions[slot.index].definite:
                        raise FormatError(f"the answer to {conditions[slot.index]} does not fit the question")
                    continue
            phrase = self._asked(subtree)
            before = conditions.get(slot.index)
            if before is not None and phrase.room in (None, self.scope):
                # It was asked about before, so its room is known, and its relation where only the noun is said.
                if phrase.qualifier is None and not phrase.definite:
                    phrase = replace(phrase, qualifier=before.qualifier)
                phrase = replace(phrase, room=before.room)
                self.last_room = None
            elif before is None and phrase.room is None:
                led = last_lead(category, slot.index, self.leads)
                phrase = replace(phrase, room=led or (self.asked_room if phrase.definite else None))
            if conditions.setdefault(slot.index, phrase) != phrase:
                raise FormatError(f"the text names one condition as {conditions[slot.index]} and as {phrase}")
            self.asked_room = phrase.room
            self._know(phrase, definite=phrase.definite)
        shape = SHAPES[category]
        return Reading(
            category=category,
            conditions=tuple(conditions[k] for k in range(len(shape.branches))),
            leaves=tuple(leaves[k] for k in range(shape.leaves)),
            heading=heading,
            leads=tuple(self.leads.get(k) for k in range(len(shape.branches))),
        )

    def _check_pair(self, tree: Node, conditions: Mapping[int, Phrase], slot: Slot) -> None:
        """Check that "neither a lamp nor a bed" repeats the nouns of two earlier conditions."""
        self.last_room = None
        asked = [conditions[slot.index], conditions[slot.other]]
        if self._labels(tree) != tuple(one.label for one in asked) or any(one.definite for one in asked):
            raise FormatError(f"'neither' does not repeat {asked[0]} and {asked[1]}")

    def _stops(self, trees: Iterable[Node]) -> tuple[Phrase, ...]:
        """Return the stops of a leaf. A stop without a room is in the room of the stop before it. If the first stop has
        no room, `_known` finds the room with which the text has already named this stop.
        """
        found: list[Phrase] = []
        for tree in trees:
            stop = self._stop(tree)
            at_start = stop.qualifier is not None and stop.qualifier[0] in BEARINGS
            if stop.room is None and not at_start:
                stop = replace(stop, room=found[-1].room if found else self._known(stop))
            self._know(stop, definite=True)
            found.append(stop)
        return tuple(found)

    def _known(self, stop: Phrase) -> Place | None:
        """Return the room with which the text has already named the object of a stop, or one of the stop's anchors;
        None if the text has named none of these with a room.
        """
        rooms = {room for label in _labels(stop) for room in self.known.get(label, ())}
        if len(rooms) > 1:
            raise FormatError(f"the text says 'the {stop.label}' where {len(rooms)} rooms could be meant")
        return next(iter(rooms), None)

    def _know(self, named: Phrase, *, definite: bool) -> None:
        if named.room is not None:
            for label in _labels(named)[0 if definite else 1 :]:
                self.known.setdefault(label, set()).add(named.room)

    def _asked(self, tree: Node) -> Phrase:
        """Return the phrase of a condition. In a request to check something, the condition is the clause inside the
        request.
        """
        inner = [child for child in _subtrees(tree) if child.data in ("some", "the")]
        clause = inner[0] if inner else tree
        return replace(self._stop(clause), definite=clause.data == "the")

    def _stop(self, tree: Node) -> Phrase:
        """Return the object and room that a stop names. The words are read in order, since the room may come before or
        after the object.
        """
        label, room = "", self.scope
        qualifier: tuple[Predicate, tuple[str, ...]] | None = None
        for child in tree.children:
            if isinstance(child, Token):
                label = self.labels[_plain(child)] if child.type in ("NOUN", "BOTH") else label
            elif isinstance(child, Tree):
                if child.data in ("room", "same_room"):
                    room = self._place(child)
                elif child.data == "compound":
                    room = self._place(child)
                    label = self.labels[_plain(_tokens(child)[1])]
                elif child.data in ("there", "here"):
                    if self.last_room is None:
                        raise FormatError("the text says 'there' before it names a room")
                    room = self.last_room
                elif child.data == "qualifier":
                    (relation,) = _subtrees(child)
                    qualifier = self.predicates[str(relation.data)], self._labels(child)
                elif child.data in ("superlative", "bearing", "bearing_stop"):
                    (relation,) = _subtrees(child)
                    qualifier = self.predicates[str(relation.data).removesuffix("_stop")], ()
                    if child.data == "bearing_stop":
                        # Such a stop is in the room of the start, and no room was named last.
                        room = self.last_room = None
        return Phrase(label, qualifier, room)

    def _place(self, tree: Node) -> Place:
        room, *anchor = _tokens(tree)
        label = self.rooms[_plain(room)]
        if anchor and tree.data == "room":
            self.last_room = Place(label, self.labels[_plain(anchor[0])])
            self.introduced[self.last_room] = self.here
            return self.last_room
        before = [place for place in self.introduced if place.label == label]
        if len(before) > 1 or (tree.data == "same_room" and not before):
            raise FormatError(f"the text says 'the {_plain(room)}' where {len(before)} rooms could be meant")
        self.last_room = before[0] if before else Place(label)
        if tree.data == "same_room":
            if not within_reach(self.category, self.introduced[self.last_room], self.here):
                raise FormatError(f"the text says 'that {_plain(room)}' too far from where it names this room")
            self.introduced[self.last_room] = self.here
        return self.last_room

    def _labels(self, tree: Node) -> tuple[str, ...]:
        return tuple(self.labels[_plain(token)] for token in _tokens(tree))


def _labels(named: Phrase) -> tuple[str, ...]:
    """Return the labels of an object and of its anchors."""
    return (named.label, *(named.qualifier[1] if named.qualifier is not None else ()))


def _named(body: Node) -> tuple[Category, int]:
    """Return the category and index of the template of a text's body."""
    (sentences,) = _subtrees(body)
    category, number = str(sentences.data).rsplit("_", 1)
    return category, int(number)  # type: ignore[return-value]


def _subtrees(tree: Node) -> list[Node]:
    return [child for child in tree.children if isinstance(child, Tree)]


def _tokens(tree: Node) -> list[str]:
    return [
        str(child) for child in tree.children if isinstance(child, Token) and child.type in ("NOUN", "ROOM", "BOTH")
    ]


def _plain(text: str) -> str:
    return " ".join(text.split())


def _parts(tree: Node, *names: str) -> Sequence[Any]:
    found = {str(child.data): child for child in _subtrees(tree)}
    return [found.get(name) for name in names]
