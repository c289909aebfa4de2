"""A language's phrases as a trie of words, built from the grammar's data files, and the phrases at each word of a text.

Only phrases are taken from the data. The structure of sentences is decided by ``phrases`` and ``text_reader``, not by
the templates from which the texts were made.
"""

from __future__ import annotations

import csv
import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any, Final, TypeVar

import yaml

from condvln.verify.words import package_data, words
from schemas.base import Json

__all__ = ["ENDS", "PAIRED", "Match", "Phrasebook", "WordReader", "parsed_once", "phrasebook"]

END: Final = ""
"""Key of a node for the phrases that end there; it can't be a word, since no word is empty."""

MARKS: Final = ",.;:?"
"""Punctuation; each mark is a token."""
ENDS: Final = frozenset(MARKS) - {","}
"""Punctuation that ends a sentence or a part of one."""

PAIRED: Final = frozenset({"between"})
"""Predicates with two anchors."""

_TOKEN: Final = re.compile(r"[^\s,.;:?]+|[,.;:?]")
_ARTICLES: Final = {
    "{a}": "indefinite",
    "{lo}": "pronoun",
    "{cercano}": "nearest",
    "{ninguno}": "none",
    "{alguno}": "some",
    "{ningun}": "no",
}

Match = tuple[int, str, frozenset[str]]
"""A phrase that begins at some word: its end, its value, and the noun classes that it agrees with."""

F = TypeVar("F")
Parser = Callable[[Any, int, Any], F]
"""A method of `WordReader` with a position and the room named last as its arguments."""


@dataclass(eq=False)
class Phrasebook:
    """The phrases of one language.

    tree : words to nodes; under `END` the phrases that end there
    contractions : the words that a contraction stands for
    lying : whether stops have words between noun and relation ("que está")
    room_first : whether a room comes before "there is" ("en la cocina hay") and before the relation of a stop
    """

    tree: Json
    contractions: Mapping[str, tuple[str, ...]]
    classes: frozenset[str]
    lying: bool
    room_first: bool

    def tokens(self, text: str) -> list[str]:
        """Return the words and punctuation of a text, in lower case, with contractions expanded."""
        found: list[str] = _TOKEN.findall(text.lower())
        if not self.contractions:
            return found
        return [word for token in found for word in self.contractions.get(token, (token,))]

    def add(self, text: str, kind: str, value: str, classes: Iterable[str]) -> None:
        """Add one phrase."""
        node = self.tree
        for token in self.tokens(text):
            node = node.setdefault(token, {})
        node.setdefault(END, []).append((kind, value, frozenset(classes)))


@cache
def phrasebook(code: str = "en") -> Phrasebook:
    """Return the phrasebook of a language code, read once per process."""
    document = yaml.load(
        package_data("instructions", "grammar", f"{code}.yaml").read_text(encoding="utf-8"), Loader=yaml.CSafeLoader
    )
    articles: Mapping[str, Mapping[str, str]] = document["articles"]
    together = {short: tuple(apart.split()) for apart, short in (document.get("contractions") or {}).items()}
    book = Phrasebook(
        {},
        together,
        frozenset(articles["definite"]),
        lying=bool(document.get("lying")),
        room_first=bool(document.get("room_first")),
    )
    for slot in document["phrases"]:
        for phrase in _phrases(document, slot):
            for text, classes in _with_articles(phrase, articles):
                book.add(text, slot, "", classes)
    for connective, phrases in document["connectives"].items():
        for phrase in phrases:
            book.add(phrase, connective, "", book.classes)
    if book.lying:
        book.add(document["lying"], "lying", "", book.classes)
    for section, kind in (("bearings", "bearing"), ("bearing_stops", "bearing_stop")):
        for bearing, phrases in document[section].items():
            for phrase in phrases:
                book.add(phrase, kind, bearing, book.classes)
    for predicate, phrases in document["predicates"].items():
        direction = document["directions"].get(predicate.removesuffix(" of"), "")
        for phrase in phrases:
            for text, _ in _with_articles(phrase.replace("{direction}", direction), articles):
                book.add(text, "predicate", predicate, book.classes)
    book.add(document["both"], "both", "", book.classes)
    superlatives: Mapping[str, Any] = document["superlatives"]
    place = "superlative" if superlatives["before_noun"] else "superlative_behind"
    for predicate in ("bigger", "smaller"):
        for noun_class, word in superlatives[predicate].items():
            book.add(word, place, predicate, (noun_class,))
    for name, word in document["directions"].items():
        book.add(word, "direction", name, book.classes)
    for text, classes in _with_articles("{the}", {**articles, "{the}": articles["definite"]}):
        book.add(text, "the", "", classes)
    for noun_class, text in articles["that"].items():
        book.add(text, "that", "", (noun_class,))
    for kind, entries in (("noun", _nouns(code, "nouns")), ("room", _nouns(code, "rooms"))):
        for label, (noun, noun_class) in entries.items():
            book.add(noun, kind, label, (noun_class,))
    for those in (document.get("nouns_in") or {}).values():
        for label, (noun, noun_class) in those.items():
            book.add(noun, "noun", label, (noun_class,))
    return book


def _phrases(document: Mapping[str, Any], slot: str) -> list[str]:
    """Return all phrases of a slot: those that all voices share, and those of each single voice."""
    voices = document["voices"].values()
    return list(dict.fromkeys(phrase for said in (document["phrases"], *voices) for phrase in said.get(slot, ())))


def _with_articles(phrase: str, articles: Mapping[str, Mapping[str, str]]) -> Iterator[tuple[str, frozenset[str]]]:
    """Yield each form that a phrase takes with its articles, and the noun classes that take this form."""
    slots = [(slot, articles[kind]) for slot, kind in {**_ARTICLES, "{the}": "{the}"}.items() if slot in phrase]
    forms: dict[str, set[str]] = {}
    for noun_class in articles["definite"]:
        text = phrase
        for slot, by_class in slots:
            text = text.replace(slot, by_class[noun_class])
        forms.setdefault(text, set()).add(noun_class)
    for text, classes in forms.items():
        yield text, frozenset(classes)


def _nouns(code: str, table: str) -> Mapping[str, tuple[str, str]]:
    """Return (noun, noun class) of each label or room type that text may name."""
    fit = words().nouns if table == "nouns" else words().rooms
    if code == "en":
        return fit
    text = package_data("instructions", "grammar", f"{table}.{code}.csv").read_text(encoding="utf-8")
    rows = csv.DictReader(text.splitlines())
    return {row["label"]: (row["noun"], row["class"]) for row in rows if row["label"] in fit}


def parsed_once(parse: Parser[Iterator[F]]) -> Parser[Sequence[F]]:
    """Parse each position of a text once, although several readings lead to it."""

    def parsed(self: WordReader, at: int, last: Any) -> Sequence[F]:
        key = (parse, at, last, self.scope)
        if key not in self.parsed:
            self.parsed[key] = list(parse(self, at, last))
        return self.parsed[key]

    return parsed


class WordReader:
    """Finds the phrases that begin at each word of a text, each looked up only once.

    scope : the room named at the beginning of the text, which applies to all objects without a room
    furthest : the furthest position that was parsed
    """

    def __init__(self, book: Phrasebook, text: str) -> None:
        self.book = book
        self.tokens = book.tokens(text)
        self.furthest = 0
        self.scope: Any = None
        self.parsed: dict[tuple[Any, int, Any, Any], list[Any]] = {}
        self._matches: dict[int, dict[str, list[Match]]] = {}

    def rest(self) -> str:
        """Return some words of the text, starting at the furthest position that was parsed."""
        return " ".join(self.tokens[self.furthest : self.furthest + 6])

    def here(self, at: int) -> Mapping[str, Sequence[Match]]:
        """Return (end, value, classes) of each phrase that begins at the word `at`, by kind, the shortest first."""
        self.furthest = max(self.furthest, at)
        if at not in self._matches:
            found: dict[str, list[Match]] = {}
            node, end = self.book.tree, at
            while True:
                for kind, value, classes in node.get(END, ()):
                    found.setdefault(kind, []).append((end, value, classes))
                if end >= len(self.tokens) or self.tokens[end] not in node:
                    break
                node, end = node[self.tokens[end]], end + 1
            self._matches[at] = found
        return self._matches[at]

    def of(self, at: int, kind: str) -> Sequence[Match]:
        """Return the phrases of one kind that begin at the word `at`."""
        return self.here(at).get(kind, ())

    def is_mark(self, at: int, mark: str) -> bool:
        """Return whether the word `at` is this punctuation mark."""
        return at < len(self.tokens) and self.tokens[at] == mark
