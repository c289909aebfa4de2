"""A language as data: voices, phrases, articles, nouns and the sentence templates of each category.

``grammar/<code>.yaml`` holds voices, phrases and templates. Nouns of languages other than English are in
``nouns.<code>.csv`` and ``rooms.<code>.csv`` (English nouns come from the vocabulary). Renderer and parser both use the
data loaded here, so they can't diverge.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache, cached_property
from itertools import accumulate, pairwise
from typing import Any, Final, Literal

import yaml

from condvln.instructions.predicates import PREDICATES
from condvln.labels import vocabulary
from condvln.own_tables import own_rows, own_text
from schemas.program import BEARINGS, CATEGORIES, SHAPES, SUPERLATIVES, Category, Predicate

__all__ = [
    "LANGUAGES",
    "LEAF_LETTERS",
    "LONGEST_SENTENCE",
    "SLOTS",
    "Form",
    "Language",
    "Noun",
    "Piece",
    "Slot",
    "Template",
    "Voice",
    "language",
    "sentences",
]

LANGUAGES: Final = ("en", "es")
"""Codes of the shipped languages."""

CONDITION_LETTERS: Final = "ABC"
LEAF_LETTERS: Final = "xyzw"

SLOTS: Final = (
    "exists", "absent", "exists_again", "absent_again", "neither_a", "nor_a",
    "is_there", "is", "is_not", "asks_is",
    "see", "check", "for", "look", "look_at", "it_is", "it_is_not", "yes_one", "no_one", "yes_it", "no_it",
    "has", "has_no", "to",
    "also", "nor", "also_a", "there_also", "same_place",
    "go", "once", "then", "last", "second", "in", "of", "of_anchor", "there", "with", "scope",
    "facing",
)  # fmt: skip
"""Phrase slots that every voice has, besides one per predicate."""

Form = Literal["asserted", "denied", "joined", "not_joined", "neither", "question", "see", "yes", "no", "leaf"]

_WORDS_OF: Final[Mapping[Form, int]] = {
    "asserted": 8, "denied": 8, "joined": 7, "not_joined": 7, "neither": 6, "question": 8, "see": 9, "yes": 2,
    "no": 2, "leaf": 0,
}  # fmt: skip
"""Approximate number of words of a slot's phrase."""

_ANSWER_WORDS: Final[Mapping[Form, int]] = {"yes": 3, "no": 3, "neither": 6}
"""Approximate number of words of the answers, whatever was asked."""
_ASKING: Final = frozenset({"asserted", "denied", "joined", "not_joined", "question", "see"})
"""Forms that state a condition in full, so that a text may begin with them."""
_STATING: Final = frozenset({"asserted", "denied", "joined", "not_joined"})
"""Forms that state a condition in a clause of its own."""
MOST_STATED: Final = 2
"""How often a text states a condition that is named with its relation each time."""

_SLOT: Final = re.compile(r"\{([^}]*)\}")
_FORMS: Final[Mapping[str, Form]] = {
    "see ": "see", "yes ": "yes", "no ": "no",
    "+-": "not_joined", "+": "joined", "-": "denied", "": "asserted",
}  # fmt: skip


@dataclass(frozen=True, slots=True)
class Noun:
    """A noun and its class, which determines its articles."""

    text: str
    kind: str


@dataclass(frozen=True, slots=True)
class Slot:
    """A slot of a template: the place where the phrase of a condition (in some form) or of a leaf is filled in.

    index : index of this condition or leaf
    other : index of the second condition of "neither a lamp nor a bed"; -1 in other slots
    bare : for a leaf, whether the verb is left out: "if not, to the lamp"
    """

    form: Form
    index: int
    other: int = -1
    bare: bool = False


Piece = str | Slot
"""A piece of a template: literal words, or a slot."""


@dataclass(frozen=True, slots=True)
class Template:
    """The sentences of a category, and the names of the voices that use them.

    questions : indices of the conditions that are worded as questions
    whether : indices of the requests to look that are answered by "if so" or "if not". They must be worded with
        "whether" or "if": "check the kitchen for a lamp; if so" is no English
    answered : (index, form of the answer) of the requests to look that a slot answers next. They may be worded as "look
        at the lamp", since the answer can say the rest: "if it's near the bed"
    restated : indices of the conditions that are stated more than `MOST_STATED` times, which wearies if they are long
    paired : indices of the conditions that are denied as "neither a lamp nor a bed", so that each needs an article
    leading : indices of the leaves that are said before their condition ("go to the lamp if …"); they have one stop
    stated : form in which each condition is first said. A lead to the room of any condition but the first one needs a
        request to look: "if not, go to the kitchen and see if …"
    is_choosy : whether some programs can't be worded by it: those with several stops in `leading`, or without articles
        in `paired`
    parts : for each part between two marks, the number of its own words, and its slots: whether it is a leaf, its
        index, and its number of words, 0 if that depends on the program
    steps : for each piece, the number of leaves and of marks (full stops, question marks, colons, semicolons) before it
    """

    pieces: tuple[Piece, ...]
    voices: frozenset[str]
    questions: frozenset[int] = frozenset()
    whether: frozenset[int] = frozenset()
    answered: Mapping[int, Form] = field(default_factory=dict, hash=False)
    restated: frozenset[int] = frozenset()
    paired: frozenset[int] = frozenset()
    leading: frozenset[int] = frozenset()
    stated: Mapping[int, Form] = field(default_factory=dict, hash=False)
    is_choosy: bool = False
    parts: tuple[tuple[int, tuple[tuple[bool, int, int], ...]], ...] = ()
    steps: tuple[int, ...] = ()

    def allows(self, leads: Sequence[bool]) -> bool:
        """Return whether the template has a place for the leads of a program: `leads` says which conditions have one,
        the first condition first.
        """
        later = [self.stated[k] for k, led in enumerate(leads) if led and k > 0]
        return not (leads[0] and self.leading) and all(form == "see" for form in later)

    @property
    def length(self) -> int:
        """Return the approximate number of words of the template. The words of leaves are not counted: they are the
        same in all templates.
        """
        own = sum(len(piece.split()) for piece in self.pieces if isinstance(piece, str))
        return own + sum(_WORDS_OF[piece.form] for piece in self.pieces if isinstance(piece, Slot))


@dataclass(frozen=True, eq=False)
class Voice:
    """Phrases that are used together in one text.

    weight : relative frequency of the voice
    slots : phrases by slot; a text uses one of them throughout
    templates : this voice's templates by category; short_templates : those of them with the fewest words
    """

    name: str
    weight: float
    slots: Mapping[str, tuple[str, ...]]
    templates: Mapping[Category, tuple[Template, ...]]
    short_templates: Mapping[Category, tuple[Template, ...]]


@dataclass(frozen=True, eq=False)
class Language:
    """The data for wording programs in one language.

    slots : all phrases of each slot, over all voices
    elliptic : answers that repeat the verb of "there is", used only after a question with that verb
    found : answers after "look for" alone ("if you find one"); none in English
    connectives : words that connect clauses, by function
    predicates : phrases of predicates with anchors; both : the word between two anchors
    lying : words between the noun of a stop and its relation ("que está"); empty in English
    unlinked : predicates that follow the noun of a stop without these words
    restates_noun : whether an earlier condition is denied by its noun alone, if the text has this noun only there
    compounds : labels and room types that make a noun of two words ("the kitchen sink")
    room_first : whether the room comes before "there is" ("en la cocina hay") and before the relation of a stop ("la
        planta del salón que está cerca del sofá")
    bearings : egocentric phrases; a text uses the phrases at the same index of all lists; bearing_stops : egocentric
            phrases that follow the noun of a stop
    superlatives : "bigger" and "smaller" by class of noun; superlative_first : whether they precede the noun
    voices : the voices that an instruction may use
    nouns_in : by room type, nouns that differ from those in other rooms
    """

    code: str
    voices: tuple[Voice, ...]
    slots: Mapping[str, tuple[str, ...]]
    elliptic: frozenset[str]
    found: frozenset[str]
    connectives: Mapping[str, tuple[str, ...]]
    predicates: Mapping[Predicate, tuple[str, ...]]
    lying: str
    unlinked: frozenset[str]
    restates_noun: bool
    compounds: tuple[frozenset[str], frozenset[str]]
    room_first: bool
    bearings: Mapping[Predicate, tuple[str, ...]]
    bearing_stops: Mapping[Predicate, tuple[str, ...]]
    both: str
    superlatives: Mapping[Predicate, Mapping[str, str]]
    superlative_first: bool
    directions: Mapping[str, str]
    templates: Mapping[Category, tuple[Template, ...]]
    articles: Mapping[str, Mapping[str, str]]
    contractions: Mapping[str, str]
    nouns: Mapping[str, Noun]
    nouns_in: Mapping[str, Mapping[str, Noun]]
    rooms: Mapping[str, Noun]

    def noun(self, label: str, room: str) -> Noun:
        """Return the noun of `label` in rooms of type `room`. The room matters where, as for "sink" in Spanish, a
        language has two words.
        """
        special = self.nouns_in.get(room) if self.nouns_in else None
        return special[label] if special is not None and label in special else self.nouns[label]

    @property
    def nouns_of_all_rooms(self) -> list[tuple[str, Noun]]:
        """Return all pairs of a label and its noun, including nouns that are used in rooms of one type only."""
        special = [pair for those in self.nouns_in.values() for pair in those.items()]
        return [*self.nouns.items(), *dict.fromkeys(special)]

    @cached_property
    def noun_texts(self) -> frozenset[str]:
        """The text of each noun, and every sequence of words with which a noun begins. A compound such as "kitchen
        sink" is not used if it is one of these texts.
        """
        nouns = [noun.text.split() for _, noun in self.nouns_of_all_rooms]
        return frozenset(" ".join(words[:k]) for words in nouns for k in range(1, len(words) + 1))

    def definite(self, noun: Noun) -> str:
        """Return the noun with its definite article: "the lamp"."""
        return f"{self.articles['definite'][noun.kind]} {noun.text}"

    def compared(self, predicate: Predicate, noun: Noun) -> str:
        """Return a noun with a word that compares sizes: "the bigger lamp"."""
        word = self.superlatives[predicate][noun.kind]
        named = f"{word} {noun.text}" if self.superlative_first else f"{noun.text} {word}"
        return f"{self.articles['definite'][noun.kind]} {named}"

    def filled(self, phrase: str, noun: Noun) -> str:
        """Return a phrase with its noun filled in: "there's {a}" becomes "there's a lamp"."""
        if "{" in phrase:
            phrase = phrase.replace("{a}", self.articles["indefinite"][noun.kind])
            if "{" in phrase:
                phrase = phrase.replace("{ningun}", self.articles["no"][noun.kind])
        return f"{phrase} {noun.text}"

    def that(self, noun: Noun) -> str:
        """Return the noun with the article that points back: "that bedroom"."""
        return f"{self.articles['that'][noun.kind]} {noun.text}"

    def compound(self, noun: Noun, room: Noun) -> str:
        """Return a noun with the noun of its room before it, and the article: "the kitchen sink"."""
        return f"{self.articles['definite'][room.kind]} {room.text} {noun.text}"

    def agreeing(self, phrase: str, noun: Noun) -> str:
        """Return a relation's phrase in which the adjective, if there is one, agrees in class with `noun`, the noun
        before the phrase.
        """
        return phrase.replace("{cercano}", self.articles["nearest"][noun.kind]) if "{" in phrase else phrase

    def answered(self, phrase: str, noun: Noun) -> str:
        """Return an answer phrase with the pronoun of `noun` filled in: "{lo} hay" becomes "la hay"."""
        if "{" not in phrase:
            return phrase
        pronoun, none, some = (self.articles[name][noun.kind] for name in ("pronoun", "none", "some"))
        return phrase.replace("{lo}", pronoun).replace("{ninguno}", none).replace("{alguno}", some)

    def contracted(self, text: str) -> str:
        """Return `text` with prepositions and articles contracted where the language contracts them (Spanish: "de el"
        becomes "del").
        """
        for apart, together in self.contractions.items():
            # Contractions are before a noun and after a word; a regular expression takes a tenth of the rendering's
            # time.
            text = text.replace(f" {apart} ", f" {together} ")
        return text

    def expanded(self, text: str) -> str:
        """Return `text`, which is in lower case, with contractions expanded: the inverse of `contracted`."""
        for apart, together in self.contractions.items():
            text = re.sub(rf"\b{together}\b", apart, text)
        return text


@cache
def language(code: str = "en") -> Language:
    """Return the language whose code is `code`, such as "en"."""
    document = _document(code)
    templates = {
        c: tuple(_template(t, c, document["connectives"]) for t in document["templates"][c]) for c in CATEGORIES
    }
    voices = tuple(_voice(name, own, document["phrases"], templates) for name, own in document["voices"].items())
    return Language(
        code=code,
        voices=voices,
        slots={slot: tuple(dict.fromkeys(p for voice in voices for p in voice.slots[slot])) for slot in SLOTS},
        elliptic=frozenset(document["elliptic"]),
        found=frozenset(document.get("found", ())),
        connectives={name: tuple(phrases) for name, phrases in document["connectives"].items()},
        predicates={p: _predicate(document, p) for p in PREDICATES if p not in (*SUPERLATIVES, *BEARINGS)},
        lying=document.get("lying", ""),
        unlinked=frozenset(document.get("unlinked", ())),
        restates_noun=bool(document.get("restates_noun")),
        compounds=(frozenset(document["compounds"]["nouns"]), frozenset(document["compounds"]["rooms"])),
        room_first=bool(document.get("room_first")),
        bearings={p: tuple(document["bearings"][p]) for p in BEARINGS},
        bearing_stops={p: tuple(document["bearing_stops"][p]) for p in BEARINGS},
        both=document["both"],
        superlatives={p: document["superlatives"][p] for p in SUPERLATIVES},
        superlative_first=document["superlatives"]["before_noun"],
        directions=document["directions"],
        templates=templates,
        articles=document["articles"],
        contractions=document["contractions"],
        nouns=_nouns(code),
        nouns_in={
            room: {label: Noun(*noun) for label, noun in those.items()}
            for room, those in (document.get("nouns_in") or {}).items()
        },
        rooms=_rooms(code),
    )


def _document(code: str) -> Mapping[str, Any]:
    text = own_text("condvln.instructions", f"grammar/{code}.yaml")
    document: Mapping[str, Any] = yaml.load(text, Loader=yaml.CSafeLoader)
    return document


def _voice(
    name: str,
    own: Mapping[str, Any],
    common: Mapping[str, Sequence[str]],
    templates: Mapping[Category, tuple[Template, ...]],
) -> Voice:
    slots = {slot: tuple(own.get(slot, common[slot])) for slot in SLOTS}
    usable = {c: tuple(t for t in those if name in t.voices) for c, those in templates.items()}
    # Not every program can be worded as "neither a lamp nor a bed", or with a stop before the first condition.
    always = {c: tuple(t for t in those if not t.is_choosy) for c, those in usable.items()}
    lacking = [c for c, those in always.items() if not those]
    if lacking:
        raise AssertionError(f"voice {name} has no template of {', '.join(lacking)}")
    return Voice(name, float(own["weight"]), slots, usable, {c: _shortest(those) for c, those in always.items()})


def _shortest(templates: tuple[Template, ...]) -> tuple[Template, ...]:
    least = min(template.length for template in templates)
    return tuple(template for template in templates if template.length == least)


def _nouns(code: str) -> dict[str, Noun]:
    """Return the nouns of the labels that text may name."""
    fit = {label: vocabulary.entry(label) for label in vocabulary.labels if vocabulary.fit_for_text(label)}
    if code == "en":
        return {label: Noun(entry.noun, entry.article) for label, entry in fit.items()}
    return {label: noun for label, noun in _named(f"nouns.{code}.csv").items() if label in fit}


def _rooms(code: str) -> dict[str, Noun]:
    """Return the nouns of the room types that text may name."""
    fit = {x: vocabulary.room(x) for x in vocabulary.room_labels if vocabulary.room(x).fit_for_text}
    if code == "en":
        return {label: Noun(entry.noun, entry.article) for label, entry in fit.items()}
    return {label: noun for label, noun in _named(f"rooms.{code}.csv").items() if label in fit}


def _named(table: str) -> dict[str, Noun]:
    rows = own_rows("condvln.instructions", f"grammar/{table}")
    return {row["label"]: Noun(row["noun"], row["class"]) for row in rows}


def _predicate(document: Mapping[str, Any], predicate: str) -> tuple[str, ...]:
    word = document["directions"].get(predicate.removesuffix(" of"), "")
    return tuple(phrase.replace("{direction}", word) for phrase in document["predicates"][predicate])


def _template(
    entry: Mapping[str, str], category: Category, connectives: Mapping[str, Sequence[str]] | None = None
) -> Template:
    pieces: list[Piece] = []
    for k, part in enumerate(_SLOT.split(entry["text"])):
        if k % 2:
            pieces.append(_slot(part))
        elif part:
            pieces.append(part)
    shape = SHAPES[category]
    slots = [piece for piece in pieces if isinstance(piece, Slot)]
    asked = {slot.index for slot in slots if slot.form in _ASKING}
    leaves = sorted(slot.index for slot in slots if slot.form == "leaf")
    if asked != set(range(len(shape.branches))) or leaves != list(range(shape.leaves)):
        raise AssertionError(f"template does not ask each condition and name each leaf once: {entry['text']}")
    questions = frozenset(slot.index for slot in slots if slot.form == "question")
    words = connectives or {}
    answers = tuple(
        f"{one} {word}" for one in words.get("if", ()) for name in ("so", "not") for word in words.get(name, ())
    )
    whether = frozenset(
        piece.index
        for piece, after in pairwise(pieces)
        if isinstance(piece, Slot) and piece.form == "see" and isinstance(after, str)
        if after.lower().lstrip(".:; ").startswith(tuple(f"{answer}," for answer in answers))
    )
    answered = {
        piece.index: after.form
        for piece, after in zip(pieces, pieces[2:], strict=False)
        if isinstance(piece, Slot) and isinstance(after, Slot) and piece.form == "see"
        if after.index == piece.index and after.form in ("yes", "no")
    }
    stated = Counter(slot.index for slot in slots if slot.form in _STATING)
    paired = frozenset(k for slot in slots if slot.form == "neither" for k in (slot.index, slot.other))
    stated.update(paired)
    leading = frozenset(slot.index for slot in slots[:1] if slot.form == "leaf")
    ends = (sum(map(p.count, ".?:;")) if isinstance(p, str) else p.form in ("question", "leaf") for p in pieces)
    return Template(
        tuple(pieces),
        frozenset(entry["voices"].split()),
        questions,
        whether,
        answered,
        restated=frozenset(k for k, count in stated.items() if count > MOST_STATED),
        paired=paired,
        leading=leading,
        stated={slot.index: slot.form for slot in reversed(slots) if slot.form in _ASKING},
        is_choosy=bool(paired or leading),
        parts=_parts(pieces),
        steps=tuple(accumulate(ends, initial=0)),
    )


def _parts(pieces: Sequence[Piece]) -> tuple[tuple[int, tuple[tuple[bool, int, int], ...]], ...]:
    """Return the parts between the marks of a template: (number of its own words, slots)."""
    parts: list[tuple[int, tuple[tuple[bool, int, int], ...]]] = []
    own, slots = 0, list[tuple[bool, int, int]]()
    for piece in pieces:
        if isinstance(piece, Slot):
            slots.append((piece.form == "leaf", piece.index, _ANSWER_WORDS.get(piece.form, 0)))
            continue
        for k, text in enumerate(re.split("[.?:;]", piece)):
            if k:
                parts.append((own, tuple(slots)))
                own, slots = 0, []
            own += len(text.replace(",", "").split())
    return tuple(parts)


def _slot(text: str) -> Slot:
    if text.removeprefix("~") in LEAF_LETTERS:
        return Slot("leaf", LEAF_LETTERS.index(text.removeprefix("~")), bare=text.startswith("~"))
    if text.startswith("neither "):
        one, other = text.split()[1:]
        return Slot("neither", CONDITION_LETTERS.index(one), CONDITION_LETTERS.index(other))
    if text.endswith("?"):
        return Slot("question", CONDITION_LETTERS.index(text[:-1]))
    for prefix, form in _FORMS.items():
        if text.startswith(prefix) and text[len(prefix) :] in CONDITION_LETTERS:
            return Slot(form, CONDITION_LETTERS.index(text[len(prefix) :]))
    raise AssertionError(f"unknown slot {{{text}}} in a template")


LONGEST_SENTENCE: Final = 25
"""Number of words above which a sentence is split at its colon or semicolon."""


def sentences(words: Language, text: str) -> str:
    """Return `text` with words contracted where the language does so, long sentences split, and each sentence
    capitalised.
    """
    text = words.contracted(text)
    if ";" in text or ":" in text:
        text = ". ".join(_split(sentence) for sentence in text.split(". "))
    for mark in (". ", "? "):
        text = mark.join([_capital(part) for part in text.split(mark)])
    return text


def _split(sentence: str) -> str:
    """Return a long sentence split at its colon, then at its semicolons. A numbered list is not split."""
    if sentence.count(" ") >= LONGEST_SENTENCE and "(" not in sentence:
        first, _, rest = sentence.partition(": ")
        sentence = f"{first}. {rest}" if rest else sentence
        if max(part.count(" ") for part in sentence.split(". ")) >= LONGEST_SENTENCE:
            sentence = sentence.replace("; ", ". ")
    return sentence


def _capital(sentence: str) -> str:
    """Return a sentence with its first letter capitalised, also after Spanish's opening mark."""
    at = 1 if sentence.startswith("¿") else 0
    return sentence[:at] + sentence[at : at + 1].upper() + sentence[at + 1 :]
