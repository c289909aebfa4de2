"""Text → reading, by a grammar made from the same data as the text.

The grammar is LALR(1), so that it has at most one parse per text by construction; it is also a plain context-free
grammar, on which an Earley parser with explicit ambiguity can be asked the same without that guarantee.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from functools import cache
from typing import Any, Final

from lark import Lark, Token, Tree
from lark.exceptions import LarkError, UnexpectedInput

from condvln.instructions.language import Language, Slot, language
from condvln.instructions.reading import Phrase, Place, Reading
from schemas.errors import FormatError
from schemas.program import CATEGORIES, SHAPES, Category, Predicate

__all__ = ["grammar_source", "parse", "parser", "reading_from_tree"]

PUNCTUATION: Final = {",": "COMMA", ";": "SEMICOLON", ":": "COLON", ".": "STOP"}

Node = Tree[Token]


@cache
def parser(code: str = "en", kind: str = "lalr") -> Lark:
    """The parser of a language; `kind` "earley" keeps all readings of a text apart."""
    source = grammar_source(language(code))
    if kind == "earley":
        return Lark(source, parser="earley", ambiguity="explicit")
    return Lark(source, parser="lalr")


def parse(text: str, code: str = "en") -> Reading:
    """The one reading of `text`.

    Raises
    ------
    FormatError
        The text is not of this language's grammar, or names one condition in two ways that differ.
    """
    words = language(code)
    try:
        tree = parser(code).parse(words.expanded(text.lower()))
    except UnexpectedInput as fault:
        context = fault.get_context(text, 30) if fault.pos_in_stream is not None else ""
        raise FormatError(
            "the text can't be read back", place=f"column {fault.column}: {context.splitlines()[0] if context else ''}"
        ) from fault
    except LarkError as fault:
        raise FormatError(f"the text can't be read back: {fault}") from fault
    return reading_from_tree(tree, words)


def grammar_source(words: Language) -> str:
    """The lark grammar of a language."""
    return _GrammarWriter(words).source()


class _GrammarWriter:
    """One terminal per phrase, shared by the slots that have it, so that the lexer takes the longest that fits."""

    def __init__(self, words: Language) -> None:
        self.words = words
        self.terminals: dict[str, str] = {}

    def source(self) -> str:
        w, rules = self.words, []
        for name in w.slots:
            if name not in ("go", "first"):
                rules.append(f"{_rule(name)}: {self._any(w.slots[name].texts)}")
        # A lone stop and the first of several may begin with the same words.
        rules.append(f"_begin: {self._any(sorted({*w.slots['go'].texts, *w.slots['first'].texts}))}")
        for predicate, phrases in w.predicates.items():
            rules.append(f"{_rule(predicate)}: {self._any(phrases.texts)}")
        for name, text in w.directions.items():
            rules.append(f"direction_{_rule(name)}: {self._any([text])}")
        rules += [
            "start: [_facing direction] [_scope room STOP] body",
            "direction: (" + " | ".join(f"direction_{_rule(d)}" for d in w.directions) + ") STOP",
            "moves: _begin object (_then object)* [_finally object]",
            "object: _THE NOUN [qualifier] [_in room | same]",
            "room: _THE ROOM [_with _THE NOUN]",
            "qualifier: (" + " | ".join(_rule(p) for p in w.predicates) + ") _THE NOUN",
            "asserted: _exists NOUN [qualifier] [_in room | _anywhere] -> there_is",
            "    | room _has NOUN [qualifier] -> room_has",
            "    | _again NOUN -> such",
            "denied: _absent NOUN [qualifier] [_in room | _anywhere] -> there_is",
            "    | room _lacks NOUN [qualifier] -> room_has",
            "    | _never NOUN -> such",
            "check: _check asserted",
        ]
        guards: dict[str, str] = {}
        bodies: list[str] = []
        for category in CATEGORIES:
            for k, template in enumerate(w.templates[category]):
                parts = [self._part(piece, guards) for piece in template]
                bodies.append(f"{category}_{k}")
                rules.append(f"{category}_{k}: {' '.join(filter(None, parts))}")
        rules += [f"{name}: {right}" for name, right in sorted(guards.items())]
        rules.append("body: " + " | ".join(bodies))
        return "\n".join([*rules, *self._terminal_lines()]) + "\n"

    def _part(self, piece: str | Slot, guards: dict[str, str]) -> str:
        if isinstance(piece, str):
            return " ".join(PUNCTUATION[c] for c in piece if not c.isspace())
        if piece.kind == "leaf":
            return "moves"
        if piece.kind == "guard":
            sides = ["asserted" if asserted else "denied" for _, asserted in piece.literals]
            name = "guard_" + "_".join([*sides, piece.joint]).strip("_")
            guards[name] = "_if " + (f" _{piece.joint} " if piece.joint else "").join(sides)
            return name
        return "check" if piece.kind == "check" else _rule(piece.kind)

    def _any(self, texts: Iterable[str]) -> str:
        return " | ".join(self._terminal(text.strip()) for text in texts)

    def _terminal(self, phrase: str) -> str:
        pattern = _pattern(self.words.expanded(phrase))
        for slot, kind in (("a", "indefinite"), ("none", "none")):
            articles = sorted(set(self.words.articles[kind].values()), key=lambda x: (-len(x), x))
            pattern = pattern.replace(rf"\{{{slot}\}}", f"(?:{'|'.join(articles)})")
        return self.terminals.setdefault(pattern, f"_PHRASE_{len(self.terminals)}")

    def _terminal_lines(self) -> list[str]:
        w = self.words
        named = {
            "NOUN": _alternatives(noun.text for noun in w.nouns.values()),
            "ROOM": _alternatives(noun.text for noun in w.rooms.values()),
            "_THE": _alternatives(w.articles["definite"].values()),
        }
        lines = [f"{name}: /{pattern}/" for pattern, name in self.terminals.items()]
        lines += [f"{name}: /{pattern}/" for name, pattern in named.items()]
        lines += [f'{name}: "{character}"' for character, name in PUNCTUATION.items()]
        return [*lines, "%ignore /\\s+/"]


def _rule(name: str) -> str:
    """Rule of a slot; those that carry no meaning begin with "_", so that the tree leaves them out."""
    plain = name.replace(" ", "_").replace("-", "_")
    meaning = name == "same" or " " in name or name in ("near", "above", "below") or name in _DIRECTIONS
    return plain if meaning else f"_{plain}"


_DIRECTIONS: Final = frozenset(
    ("north", "north-east", "east", "south-east", "south", "south-west", "west", "north-west")
)


def _pattern(phrase: str) -> str:
    escaped = r"\s+".join(re.escape(word) for word in phrase.split()).replace("/", r"\/")
    return rf"{escaped}(?![\w-])"


def _alternatives(texts: Iterable[str]) -> str:
    longest_first = sorted({text.lower() for text in texts}, key=lambda text: (-len(text), text))
    return "(?:" + "|".join(r"\s+".join(re.escape(x) for x in t.split()) for t in longest_first) + r")(?![\w-])"


def reading_from_tree(tree: Node, words: Language) -> Reading:
    """What a parse tree says."""
    return _TreeReader(words).reading(tree)


class _TreeReader:
    def __init__(self, words: Language) -> None:
        self.labels = {noun.text.lower(): label for label, noun in words.nouns.items()}
        self.rooms = {noun.text.lower(): label for label, noun in words.rooms.items()}
        self.predicates: dict[str, Predicate] = {_rule(p): p for p in words.predicates}  # type: ignore[misc]
        self.words = words
        self.scope: Place | None = None

    def reading(self, tree: Node) -> Reading:
        heading, scope, body = _parts(tree, "direction", "room", "body")
        if heading is not None:
            name = str(_subtrees(heading)[0].data)
            heading = next(d for d in self.words.directions if f"direction_{_rule(d)}" == name)
        self.scope = None if scope is None else self._place(scope)
        (sentences,) = _subtrees(body)
        category, number = str(sentences.data).rsplit("_", 1)
        return self._filled(sentences, category, int(number), heading)  # type: ignore[arg-type]

    def _filled(self, sentences: Node, category: Category, number: int, heading: str | None) -> Reading:
        slots = [s for s in self.words.templates[category][number] if isinstance(s, Slot)]
        slots = [s for s in slots if s.kind in ("leaf", "guard", "check")]
        conditions: dict[int, Phrase] = {}
        leaves: dict[int, tuple[Phrase, ...]] = {}
        such: list[tuple[int, str]] = []
        for slot, subtree in zip(slots, _subtrees(sentences), strict=True):
            if slot.kind == "leaf":
                leaves[slot.leaf] = self._moves(subtree)
                continue
            for (index, _), literal in zip(slot.literals, _subtrees(subtree), strict=True):
                if literal.data == "such":
                    such.append((index, self._label(literal)))
                    continue
                phrase = self._literal(literal)
                if conditions.setdefault(index, phrase) != phrase:
                    raise FormatError(f"the text names one condition as {conditions[index]} and as {phrase}")
        for index, label in such:
            named = [k for k, phrase in conditions.items() if phrase.label == label]
            if named != [index]:
                raise FormatError(f"'such a {label}' does not point at the condition it should")
        shape = SHAPES[category]
        return Reading(
            category=category,
            conditions=tuple(conditions[k] for k in range(len(shape.branches))),
            leaves=tuple(leaves[k] for k in range(shape.leaves)),
            heading=heading,
        )

    def _moves(self, tree: Node) -> tuple[Phrase, ...]:
        stops: list[Phrase] = []
        for stop in _subtrees(tree):
            room = self._room_of(stop)
            if any(child.data == "same" for child in _subtrees(stop)):
                if not stops:
                    raise FormatError("the text says 'the same room' of a first stop")
                room = stops[-1].room
            stops.append(Phrase(self._label(stop), self._qualifier(stop), room))
        return tuple(stops)

    def _literal(self, tree: Node) -> Phrase:
        # "asserted" and "denied" are told apart by the rule around them; their alternatives look alike.
        return Phrase(self._label(tree), self._qualifier(tree), self._room_of(tree))

    def _room_of(self, tree: Node) -> Place | None:
        rooms = [child for child in _subtrees(tree) if child.data == "room"]
        return self._place(rooms[0]) if rooms else self.scope

    def _place(self, tree: Node) -> Place:
        room, *anchor = _tokens(tree)
        return Place(self.rooms[_plain(room)], self.labels[_plain(anchor[0])] if anchor else None)

    def _label(self, tree: Node) -> str:
        return self.labels[_plain(_tokens(tree)[0])]

    def _qualifier(self, tree: Node) -> tuple[Predicate, str] | None:
        for child in _subtrees(tree):
            if child.data == "qualifier":
                (relation,) = _subtrees(child)
                return self.predicates[str(relation.data)], self._label(child)
        return None


def _subtrees(tree: Node) -> list[Node]:
    return [child for child in tree.children if isinstance(child, Tree)]


def _tokens(tree: Node) -> list[str]:
    return [str(child) for child in tree.children if isinstance(child, Token) and child.type in ("NOUN", "ROOM")]


def _plain(text: str) -> str:
    return " ".join(text.split())


def _parts(tree: Node, *names: str) -> Sequence[Any]:
    found = {str(child.data): child for child in _subtrees(tree)}
    return [found.get(name) for name in names]
