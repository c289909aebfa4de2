"""A language's phrases as a trie of words, built from the grammar's data files.

Only phrases are taken from the data. The structure of sentences is decided by ``reading``, not by the templates from
which the texts were made.
"""

from __future__ import annotations

import csv
import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import cache
from typing import Any, Final

from condvln.formats.packaged_yaml import packaged_yaml
from condvln.verify.words import package_data, words

__all__ = ["SO_FAR", "STEPS", "Kinds", "Matches", "Phrasebook", "Step", "phrasebook"]

END: Final = ""
"""Key of a node for the phrases that end there; it can't be a word, since no word is empty."""
SO_FAR: Final = "\n"
"""Key of a node for all phrases on the path to it, by kind; it can't be a word, since no word is white space."""

STEPS: Final = "\t"
"""Key of a node for the same phrases by their number of words: (words, kinds, values); see `Phrasebook.kinds`."""

MARKS: Final = ",.;:?"
"""Punctuation; each mark is a token and its own letter."""
UNKNOWN: Final = "\0"
"""Stands for each word that no phrase has."""

PAIRED: Final = frozenset({"between"})
"""Predicates with two anchors."""

_FIRST_LETTER: Final = 0x100
_TOKEN: Final = re.compile(r"[^\s,.;:?]+|[,.;:?]")
_ARTICLES: Final = {
    "{a}": "indefinite",
    "{lo}": "pronoun",
    "{cercano}": "nearest",
    "{ninguno}": "none",
    "{alguno}": "some",
    "{ningun}": "no",
}

Match = tuple[str, str, frozenset[str]]
"""A match: the kind of phrase, its value, and the noun classes that its article agrees with."""

Node = dict[str, Any]
Matches = dict[str, tuple[tuple[int, str, frozenset[str]], ...]]
"""Matches by kind of phrase: (number of words, value, noun classes)."""
Kinds = tuple[tuple[str, str | None, frozenset[str]], ...]
"""What phrases of the same words are: (kind, value, noun classes) of each, without values that are mere names."""
Step = tuple[int, int, tuple[str, ...]]
"""Number of words of some phrases, the number of their kinds, and the values that are mere names, in order."""

_NAMING: Final = frozenset(("noun", "room", "predicate", "superlative", "superlative_behind", "direction"))
"""Kinds of phrases whose values are only compared with each other. Except for a predicate with two anchors, a text with
other values in their places says the same about these."""


@dataclass(eq=False)
class Phrasebook:
    """The phrases of one language.

    tree : words to nodes; under `END` the phrases that end there, under `SO_FAR` also those on the path
    contractions : the words that a contraction stands for
    lying : whether stops have words between noun and relation ("que está")
    room_first : whether a room comes before "there is" ("en la cocina hay") and before the relation of a stop
    letters : a character for each word of the phrases
    first : the characters of the words with which phrases of a kind begin
    longest : number of words of the longest phrase
    parsed : what the parsers of phrases found in earlier texts; see `WordReader`
    kinds : the kinds of all phrases of the same words, each listed once
    """

    tree: Node
    contractions: Mapping[str, tuple[str, ...]]
    classes: frozenset[str]
    lying: bool
    room_first: bool
    letters: dict[str, str] = field(default_factory=lambda: {mark: mark for mark in MARKS})
    first: dict[str, set[str]] = field(default_factory=dict)
    longest: int = 0
    parsed: dict[Any, Any] = field(default_factory=dict)
    kinds: dict[Kinds, int] = field(default_factory=dict)

    def tokens(self, text: str) -> list[str]:
        """Return the words and punctuation of a text, in lower case, with contractions expanded."""
        found: list[str] = _TOKEN.findall(text.lower())
        if not self.contractions:
            return found
        return [word for token in found for word in self.contractions.get(token, (token,))]

    def spelled(self, tokens: Iterable[str]) -> str:
        """Return words and punctuation with one character for each. All words that no phrase has become one character,
        so that texts with equal results have the same matches at the same places.
        """
        letter = self.letters.get
        return "".join([letter(token, UNKNOWN) for token in tokens])

    def add(self, text: str, kind: str, value: str, classes: Iterable[str]) -> None:
        """Add one phrase."""
        node, tokens = self.tree, self.tokens(text)
        for token in tokens:
            node = node.setdefault(token, {})
            self.letters.setdefault(token, chr(_FIRST_LETTER + len(self.letters)))
        self.longest = max(self.longest, len(tokens))
        self.first.setdefault(kind, set()).add(self.letters[tokens[0]])
        node.setdefault(END, []).append((kind, value, frozenset(classes)))


@cache
def phrasebook(code: str = "en") -> Phrasebook:
    """Return the phrasebook of a language code, read once per process."""
    document = packaged_yaml(package_data("instructions", "grammar", f"{code}.yaml").read_text(encoding="utf-8"))
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
    _gather(book, book.tree, 0, {}, ())
    return book


def _phrases(document: Mapping[str, Any], slot: str) -> list[str]:
    """Return all phrases of a slot: those that all voices share, and those of each single voice."""
    voices = document["voices"].values()
    return list(dict.fromkeys(phrase for said in (document["phrases"], *voices) for phrase in said.get(slot, ())))


def _gather(book: Phrasebook, node: Node, words_so_far: int, before: Matches, steps: tuple[Step, ...]) -> None:
    """Store in each node of the trie the phrases that end at this node or at a node above it."""
    found, ending = dict(before), node.get(END, ())
    for kind, value, classes in ending:
        found[kind] = (*found.get(kind, ()), (words_so_far, value, classes))
    if ending:
        kinds = tuple([(kind, None if _is_name(kind, value) else value, classes) for kind, value, classes in ending])
        names = tuple([value for kind, value, _ in ending if _is_name(kind, value)])
        steps = (*steps, (words_so_far, book.kinds.setdefault(kinds, len(book.kinds)), names))
    for word, below in node.items():
        if word != END:
            _gather(book, below, words_so_far + 1, found, steps)
    node[SO_FAR], node[STEPS] = found, steps


def _is_name(kind: str, value: str) -> bool:
    return kind in _NAMING and value not in PAIRED


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
