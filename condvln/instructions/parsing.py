"""Parse a text to its reading, by a grammar made from the same data as the text.

The grammar is LALR(1), so that a text has at most one parse by construction. It is also a plain context-free grammar,
so an Earley parser can check this without relying on LALR(1).
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import cache
from itertools import pairwise, product
from typing import Any, Final

from lark import Lark, Token, Tree
from lark.exceptions import LarkError, UnexpectedInput

from condvln.instructions.language import Language, Slot, Template, language
from condvln.instructions.predicates import PREDICATES
from condvln.instructions.reach import Mention, within_reach
from condvln.instructions.text_reading import Phrase, Place, Reading
from schemas.errors import FormatError
from schemas.program import BEARINGS, CATEGORIES, SHAPES, Category, Predicate, anchors_of

__all__ = ["grammar_source", "parse", "parser", "reading_from_tree", "template_of"]

PUNCTUATION: Final = {",": "COMMA", ";": "SEMICOLON", ":": "COLON", ".": "STOP", "?": "QUESTION"}
ANSWERS: Final = ("yes_one", "yes_it", "yes_any", "no_one", "no_it", "no_any")
"""Rules of the phrases that answer a question; all but two show what kind of question it was."""

_RULES: Final = {"leaf": "moves", "again": "yes", "not_again": "no", "lacks": "no"}
"""Grammar rules of slots that have another name; an answer may be given in full."""

_ARTICLES: Final = (
    ("a", "indefinite"),
    ("lo", "pronoun"),
    ("cercano", "nearest"),
    ("ninguno", "none"),
    ("alguno", "some"),
    ("ningun", "no"),
)
"""Words of phrases that agree with a noun, and their lists of forms."""

_TOKEN: Final = re.compile(r"\(\d\)|[^\s,;:.?]+|[,;:.?]")
"""Pattern of the words, numbers in brackets and punctuation of a template."""

Node = Tree[Token]


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


def grammar_source(words: Language) -> str:
    """Return the lark grammar of a language."""
    return _GrammarWriter(words).source()


class _GrammarWriter:
    """Writes the grammar of a language. Each phrase is one terminal, even if several slots use the same phrase, so that
    the lexer takes the longest match.
    """

    def __init__(self, words: Language) -> None:
        self.words = words
        self.terminals: dict[str, str] = {}

    def source(self) -> str:
        w, rules = self.words, []
        for name, phrases in w.slots.items():
            if name not in ("then", "second", "last", "there", "same_place", *ANSWERS) and phrases:
                rules.append(f"_{name}: {self._any(phrases)}")
        rules.append(f"_joint: {self._any([*w.slots['then'], *w.slots['second'], *w.slots['last']])}")
        there = " | there" if w.slots["there"] else ""
        if there:
            rules.append(f"there: {self._any(w.slots['there'])}")
        lying = "[_lying] " if w.lying else ""
        if lying:
            rules.append(f"_lying: {self._any([w.lying])}")
        rules += self._answers()
        rules += [f"{_rule(predicate)}: {self._any(phrases)}" for predicate, phrases in w.predicates.items()]
        rules += [f"{_rule(name)}: {self._any(words.values())}" for name, words in w.superlatives.items()]
        rules += [f"direction_{_rule(name)}: {self._any([text])}" for name, text in w.directions.items()]
        rules += [f"{_rule(bearing)}: {self._any(phrases)}" for bearing, phrases in w.bearings.items()]
        rules += [f"{_rule(bearing)}_stop: {self._any(phrases)}" for bearing, phrases in w.bearing_stops.items()]
        compared = "_THE superlative _noun" if w.superlative_first else "_THE _noun superlative"
        one_anchor = " | ".join(_rule(p) for p in w.predicates if anchors_of(p) == 1)
        rules += [
            "start: [_facing direction] [_scope room COMMA] body",
            "direction: (" + " | ".join(f"direction_{_rule(d)}" for d in w.directions) + ") STOP",
            "moves: _go object (_joint object)*",
            "bare_moves: _to object (_joint object)* -> moves",
            f"object: _THE _noun [_where_of] | _THE _noun ({lying}qualifier [_where_anchor] | bearing_stop)",
            *([f"    | _THE _noun _where_of {lying}qualifier"] if w.room_first else []),
            f"    | {compared} [_where_of]",
            *(["    | compound"] if w.compounds[0] else []),
            "compound: _THE ROOM NOUN",
            "_where: _in room" + (" | here" if w.slots["same_place"] else ""),
            *([f"here: {self._any(w.slots['same_place'])}"] if w.slots["same_place"] else []),
            f"_where_anchor: _of_anchor room{there}",
            f"_where_of: _of room{there}",
            "room: _THE (ROOM | BOTH) [_with _THE _noun]",
            "    | _THAT (ROOM | BOTH) -> same_room",
            f"qualifier: ({one_anchor}) _THE _noun | {_rule('between')} _THE _noun {self._terminal(w.both)} _THE _noun",
            "bearing: " + " | ".join(_rule(b) for b in w.bearings),
            "bearing_stop: " + " | ".join(f"{_rule(b)}_stop" for b in w.bearing_stops),
            "superlative: " + " | ".join(_rule(p) for p in w.superlatives),
            f"asserted: {self._either('exists')} _noun [qualifier] [_where] -> some",
            *(["    | _in room _exists _noun [qualifier] -> some"] if w.room_first else []),
            *(["    | room _has _noun [qualifier] -> some"] if w.slots["has"] else []),
            f"    | _THE _noun [_where_of] {self._either('is')} (qualifier | bearing) -> the",
            f"    | COMMA _in room COMMA _THE _noun {self._either('is')} (qualifier | bearing) -> the",
            *([f"    | compound {self._either('is')} (qualifier | bearing) -> the"] if w.compounds[0] else []),
            f"denied: {self._either('absent')} _noun [qualifier] [_where] -> some",
            *(["    | _in room _absent _noun [qualifier] -> some"] if w.room_first else []),
            *(["    | room _has_no _noun [qualifier] -> some"] if w.slots["has"] else []),
            "    | _THE _noun [_where_of] _is_not (qualifier | bearing) -> the",
            "    | COMMA _in room COMMA _THE _noun _is_not (qualifier | bearing) -> the",
            *(["    | compound _is_not (qualifier | bearing) -> the"] if w.compounds[0] else []),
            "neither: _neither_a _noun _nor_a _noun",
            "joined: asserted | (_there_also | _also_a) _noun [qualifier] [_where] -> some"
            + (" | _also _noun [qualifier] [_where] -> some" if w.slots["also"] else ""),
            *(["    | _in room (_there_also | _also_a) _noun [qualifier] -> some"] if w.room_first else []),
            "not_joined: denied" + (" | _nor _noun [qualifier] [_where] -> some" if w.slots["nor"] else ""),
            "question: _is_there _noun [qualifier] [_where] QUESTION -> some",
            "    | _asks_is _THE _noun [_where_of] (qualifier | bearing) QUESTION -> the",
            *(["    | _asks_is compound (qualifier | bearing) QUESTION -> the"] if w.compounds[0] else []),
            "see: _see asserted",
            "    | _look _noun [qualifier] [_where] -> some",
            "    | _look_at _THE _noun [_where_of] -> the",
            *(["    | _look_at compound -> the"] if w.compounds[0] else []),
            *(
                [] if w.room_first else ["    | _check room _for _noun [qualifier] -> some"]
            ),  # it is "see" with the room first
            "_noun: NOUN | BOTH",
            "is_it: _it_is (qualifier | bearing)",
            "is_it_not: _it_is_not (qualifier | bearing)",
            f"yes: {' | '.join(self._answering('yes'))} | is_it | asserted",
            f"no: {' | '.join(self._answering('no'))} | is_it_not | denied",
        ]
        bodies: dict[str, str] = {}
        for category in CATEGORIES:
            for k, template in enumerate(w.templates[category]):
                whole = " ".join(self._parts(template.pieces))
                # Templates that differ only in {yes A} and {again A} are parsed as one.
                for right in _split(whole):
                    bodies.setdefault(right, f"{category}_{k}")
        for name in dict.fromkeys(bodies.values()):
            rules.append(f"{name}: " + " | ".join(right for right, its in bodies.items() if its == name))
        rules.append("body: " + " | ".join(dict.fromkeys(bodies.values())))
        return "\n".join([*rules, *self._terminal_lines()]) + "\n"

    def _answers(self) -> list[str]:
        """Return the grammar rules of the answers "yes" and "no". Answers that fit every kind of question have a rule
        of their own.
        """
        slots, rules = self.words.slots, []
        for word in ("yes", "no"):
            one, it = slots[f"{word}_one"], slots[f"{word}_it"]
            kinds = {"one": set(one) - set(it), "it": set(it) - set(one), "any": set(one) & set(it)}
            rules += [f"{word}_{kind}: {self._any(sorted(those))}" for kind, those in kinds.items() if those]
        return rules

    def _answering(self, word: str) -> list[str]:
        """Return the names of the grammar rules for the answer `word`, which is "yes" or "no"."""
        return [rule.split(":")[0] for rule in self._answers() if rule.startswith(f"{word}_")]

    def _either(self, slot: str) -> str:
        """Return what the grammar accepts at `slot`: the slot's rule, or either of two rules if the slot has further
        phrases for use after a denial.
        """
        slots = self.words.slots
        return f"(_{slot} | _{slot}_again)" if set(slots[f"{slot}_again"]) - set(slots[slot]) else f"_{slot}"

    def _parts(self, pieces: Sequence[str | Slot]) -> Iterator[str]:
        """Yield the grammar of each piece of a template. The comma before "but no lamp" is left out by the renderer."""
        for piece, after in pairwise((*pieces, "")):
            part = self._part(piece)
            joined = isinstance(after, Slot) and after.form in ("joined", "not_joined")
            yield part.replace("COMMA ", "COMMA? ") if joined else part

    def _part(self, piece: str | Slot) -> str:
        if isinstance(piece, Slot):
            if piece.bare:
                return "bare_moves"
            return _RULES.get(piece.form, piece.form)
        return " ".join(PUNCTUATION.get(token) or self._terminal(token) for token in _TOKEN.findall(piece.lower()))

    def _any(self, texts: Iterable[str]) -> str:
        return " | ".join(dict.fromkeys(self._terminal(text.strip()) for text in texts))

    def _terminal(self, phrase: str) -> str:
        pattern = _pattern(self.words.expanded(phrase))
        for slot, kind in _ARTICLES:
            articles = sorted(set(self.words.articles.get(kind, {}).values()), key=lambda x: (-len(x), x))
            pattern = pattern.replace(rf"\{{{slot}\}}", f"(?:{'|'.join(articles)})")
        return self.terminals.setdefault(pattern, f"_PHRASE_{len(self.terminals)}")

    def _terminal_lines(self) -> list[str]:
        w = self.words
        nouns = {noun.text.lower() for _, noun in w.nouns_of_all_rooms}
        rooms = {noun.text.lower() for noun in w.rooms.values()}
        named = {
            "NOUN": _alternatives(nouns - rooms, rooms),
            "ROOM": _alternatives(rooms - nouns, nouns),
            "BOTH": _alternatives(nouns & rooms) if nouns & rooms else "(?!)x",
            "_THE": _alternatives(w.articles["definite"].values()),
            "_THAT": _alternatives(w.articles["that"].values()),
        }
        lines = [f"{name}: /{pattern}/" for pattern, name in self.terminals.items()]
        lines += [f"{name}: /{pattern}/" for name, pattern in named.items()]
        lines += [f'{name}: "{character}"' for character, name in PUNCTUATION.items()]
        return [*lines, "%ignore /\\s+/"]


def _split(right: str) -> Iterator[str]:
    """Yield a template's sequence of symbols, and the variants of this sequence in which some colons or semicolons end
    a sentence.
    """
    marks = ("SEMICOLON", "COLON")
    parts = right.split(" ")
    places = [k for k, part in enumerate(parts) if part in marks]
    for taken in product((False, True), repeat=len(places)):
        said = list(parts)
        for place, split in zip(places, taken, strict=True):
            said[place] = "STOP" if split else said[place]
        yield " ".join(said)


def _rule(name: str) -> str:
    """Return the rule name of a predicate or direction."""
    return name.replace(" ", "_").replace("-", "_")


def _pattern(phrase: str) -> str:
    escaped = r"\s+".join(re.escape(word) for word in phrase.split()).replace("/", r"\/")
    return rf"{escaped}(?![\w-])"


def _alternatives(texts: Iterable[str], others: Iterable[str] = ()) -> str:
    """Return a pattern that matches any of `texts`, except where a text is the beginning of one of `others`: "the
    television" is not matched in "the television room".
    """
    longest_first = sorted({text.lower() for text in texts}, key=lambda text: (-len(text), text))
    patterns = []
    for text in longest_first:
        rests = sorted(other.removeprefix(text) for other in others if other.startswith(f"{text} "))
        guard = f"(?!{'|'.join(_spaced(rest) for rest in rests)})" if rests else ""
        patterns.append(_spaced(text) + guard)
    return "(?:" + "|".join(patterns) + r")(?![\w-])"


def _spaced(text: str) -> str:
    """Return a pattern that matches the words of `text` with any white space between them."""
    return (r"\s+" if text.startswith(" ") else "") + r"\s+".join(re.escape(word) for word in text.split())


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
        self.predicates: dict[str, Predicate] = {_rule(p): p for p in PREDICATES}
        self.words = words
        self.scope: Place | None = None
        self.last_room: Place | None = None
        self.asked_room: Place | None = None
        self.introduced: dict[Place, Mention] = {}
        self.category: Category = "simple"
        self.here = Mention(Slot("leaf", 0), 0)
        self.known: dict[str, set[Place]] = {}

    def reading(self, tree: Node) -> Reading:
        heading, scope, body = _parts(tree, "direction", "room", "body")
        if heading is not None:
            name = str(_subtrees(heading)[0].data)
            heading = next(d for d in self.words.directions if f"direction_{_rule(d)}" == name)
        self.scope = None if scope is None else self._place(scope)
        (sentences,) = _subtrees(body)
        return self._filled(sentences, *_named(body), heading)

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
                self.last_room = self.last_room if slot.form == "lacks" else None
            elif before is None and phrase.room is None and phrase.definite:
                phrase = replace(phrase, room=self.asked_room)
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
