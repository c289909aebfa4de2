"""A language as data: phrases, articles, nouns and the sentence templates of each category.

``grammar/<code>.yaml`` holds phrases and templates; nouns of languages other than English stand beside it in
``nouns.<code>.csv`` and ``rooms.<code>.csv`` (English ones come from the vocabulary). Renderer and parser both work
from what is loaded here, so that they cannot drift apart.
"""

from __future__ import annotations

import csv
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from itertools import accumulate
from typing import Any, Final

import yaml

from condvln.instructions.predicates import PREDICATES
from condvln.labels import vocabulary
from schemas.program import CATEGORIES, SHAPES, Category

__all__ = ["LANGUAGES", "LEAF_LETTERS", "PHRASINGS", "Language", "Noun", "Phrases", "Slot", "language"]

LANGUAGES: Final = ("en", "es")
"""Codes of the languages that are shipped."""

PHRASINGS: Final = 8
"""Every slot of every language has at least so many phrasings."""

CONDITION_LETTERS: Final = "ABC"
LEAF_LETTERS: Final = "xyzw"

SLOTS: Final = (
    "if", "else", "check", "yes", "no", "nest", "and", "but",
    "exists", "absent", "again", "never", "has", "lacks", "anywhere",
    "go", "first", "then", "finally", "in", "same", "with", "scope", "facing",
)  # fmt: skip
"""Phrase slots that every language fills, beside one per predicate."""

_SLOT: Final = re.compile(r"\{([^}]*)\}")
_GUARD: Final = re.compile(r"if (not )?([ABC])(?: (and|but) (not )?([ABC]))?")


@dataclass(frozen=True, slots=True)
class Noun:
    """A noun and its class, which decides its articles."""

    text: str
    kind: str


@dataclass(frozen=True, slots=True)
class Phrases:
    """The phrasings of one slot, with their weights summed up."""

    texts: tuple[str, ...]
    sums: tuple[float, ...]


@dataclass(frozen=True, slots=True)
class Slot:
    """A slot of a template.

    kind : "guard", "check", "leaf", or the name of a phrase slot
    literals : for guards and checks the (condition index, asserted or denied) named, in order
    joint : what joins two literals, "and" or "but"
    leaf : for leaves the index
    """

    kind: str
    literals: tuple[tuple[int, bool], ...] = ()
    joint: str = ""
    leaf: int = -1


Piece = str | Slot
Template = tuple[Piece, ...]


@dataclass(frozen=True, eq=False)
class Language:
    """One language."""

    code: str
    slots: Mapping[str, Phrases]
    predicates: Mapping[str, Phrases]
    directions: Mapping[str, str]
    templates: Mapping[Category, tuple[Template, ...]]
    articles: Mapping[str, Mapping[str, str]]
    contractions: Mapping[str, str]
    nouns: Mapping[str, Noun]
    rooms: Mapping[str, Noun]

    def definite(self, noun: Noun) -> str:
        """ "the lamp"."""
        return f"{self.articles['definite'][noun.kind]} {noun.text}"

    def filled(self, phrase: str, noun: Noun) -> str:
        """A phrase of existence with its noun: "there is {a}" → "there is a lamp"."""
        article = {"a": self.articles["indefinite"][noun.kind], "none": self.articles["none"][noun.kind]}
        return f"{phrase.format(**article)} {noun.text}"

    def contracted(self, text: str) -> str:
        """Text with its prepositions and articles run together where the language does so."""
        for apart, together in self.contractions.items():
            text = re.sub(rf"\b{apart}\b", together, text)
        return text

    def expanded(self, text: str) -> str:
        """The inverse of `contracted`, on lower-case text."""
        for apart, together in self.contractions.items():
            text = re.sub(rf"\b{together}\b", apart, text)
        return text


@cache
def language(code: str = "en") -> Language:
    """The language of a code.

    Templates hold no words, so that a language that has none of its own has those of English.
    """
    document = _document(code)
    templates = document.get("templates") or _document("en")["templates"]
    return Language(
        code=code,
        slots={name: _phrases(document["slots"][name]) for name in SLOTS},
        predicates={p: _predicate(document, p) for p in PREDICATES},
        directions=document["directions"],
        templates={c: tuple(_template(t, c) for t in templates[c]) for c in CATEGORIES},
        articles=document["articles"],
        contractions=document["contractions"],
        nouns=_nouns(code),
        rooms=_rooms(code),
    )


def _document(code: str) -> Mapping[str, Any]:
    text = files("condvln.instructions").joinpath("grammar", f"{code}.yaml").read_text(encoding="utf-8")
    document: Mapping[str, Any] = yaml.safe_load(text)
    return document


def _nouns(code: str) -> dict[str, Noun]:
    """Nouns of the labels that text may name."""
    fit = {label: vocabulary.entry(label) for label in vocabulary.labels if vocabulary.fit_for_text(label)}
    if code == "en":
        return {label: Noun(entry.noun, entry.article) for label, entry in fit.items()}
    return {label: noun for label, noun in _named(f"nouns.{code}.csv").items() if label in fit}


def _rooms(code: str) -> dict[str, Noun]:
    """Nouns of the room types that text may name."""
    fit = {x: vocabulary.room(x) for x in vocabulary.room_labels if vocabulary.room(x).fit_for_text}
    if code == "en":
        return {label: Noun(entry.noun, entry.article) for label, entry in fit.items()}
    return {label: noun for label, noun in _named(f"rooms.{code}.csv").items() if label in fit}


def _named(table: str) -> dict[str, Noun]:
    text = files("condvln.instructions").joinpath("grammar", table).read_text(encoding="utf-8")
    return {row["label"]: Noun(row["noun"], row["class"]) for row in csv.DictReader(text.splitlines())}


def _phrases(weights: Mapping[str, float]) -> Phrases:
    return Phrases(tuple(weights), tuple(accumulate(map(float, weights.values()))))


def _predicate(document: Mapping[str, Any], predicate: str) -> Phrases:
    word = document["directions"].get(predicate.removesuffix(" of"), "")
    return _phrases(
        {phrase.replace("{direction}", word): weight for phrase, weight in document["predicates"][predicate].items()}
    )


def _template(text: str, category: Category) -> Template:
    pieces: list[Piece] = []
    for k, part in enumerate(_SLOT.split(text)):
        if k % 2:
            pieces.append(_slot(part))
        elif part:
            pieces.append(part)
    shape = SHAPES[category]
    asked = [index for piece in pieces if isinstance(piece, Slot) for index, _ in piece.literals]
    leaves = sorted(piece.leaf for piece in pieces if isinstance(piece, Slot) and piece.kind == "leaf")
    if set(asked) != set(range(len(shape.branches))) or leaves != list(range(shape.leaves)):
        raise AssertionError(f"template does not name each condition and, once, each leaf of {category}: {text}")
    return tuple(pieces)


def _slot(text: str) -> Slot:
    if text in LEAF_LETTERS:
        return Slot("leaf", leaf=LEAF_LETTERS.index(text))
    if text.startswith("check "):
        return Slot("check", ((CONDITION_LETTERS.index(text[-1]), True),))
    guard = _GUARD.fullmatch(text)
    if guard is None:
        if text not in SLOTS:
            raise AssertionError(f"unknown slot {{{text}}} in a template")
        return Slot(text)
    denied, one, joint, also_denied, other = guard.groups()
    literals: Sequence[tuple[str, bool]] = [(one, denied is None)]
    if other:
        literals = [*literals, (other, also_denied is None)]
    return Slot("guard", tuple((CONDITION_LETTERS.index(x), asserted) for x, asserted in literals), joint or "")
