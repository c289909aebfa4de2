"""The style report: length, variety and clarity of instruction texts. Counted are sentences, n-grams, direction words
and phrases to avoid.

A word is a lower-case run of letters, digits, apostrophes and hyphens. Variety measures depend on the amount of text,
so they are computed over pieces of equal length in words.
"""

from __future__ import annotations

import hashlib
import re
import statistics
from collections import Counter, defaultdict
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any, Final

from condvln.instructions import parse, reading_of
from condvln.instructions.language import LANGUAGES, Template, language
from condvln.instructions.parsing import template_of
from condvln.labels.lists import labels_with_role, worth
from condvln.language.binding import findings
from condvln.language.texts import InstructionText
from condvln.own_tables import own_rows
from schemas.errors import FormatError, InputError
from schemas.program import CATEGORIES, Category

__all__ = [
    "BANNED",
    "COMPASS_WORDS",
    "EGOCENTRIC_WORDS",
    "LONG_SENTENCE",
    "PIECE_WORDS",
    "LanguageReport",
    "banned_in",
    "distinct",
    "language_report",
    "masked",
    "pieces",
    "sentences",
    "words",
]

PIECE_WORDS: Final = 1_700
"""Length in words of a piece over which variety is measured; about 60 instructions of R2R."""
MOST_PIECES: Final = 50
"""Largest number of pieces measured; with this many, the mean changes in the third digit only."""

MASK: Final = "_"
"""Placeholder for the noun of an object or room."""

_WORD: Final = re.compile(rf"{MASK}|[^\W_]+(?:['’-][^\W_]+)*")
_END: Final = re.compile(r"(?<=[.?!])\s+")

COMPASS_WORDS: Final = re.compile(
    r"\b(?:north|south|east|west)(?:-?(?:east|west))?\b|\b(?:norte|sur|este|oeste|nor(?:este|oeste)|sur(?:este|oeste))\b"
)
EGOCENTRIC_WORDS: Final = re.compile(
    r"\b(?:left|right|ahead|straight|behind you|in front of you)\b|\b(?:izquierda|derecha|delante de ti|detrás de ti)\b"
)

BANNED: Final = {row["name"]: re.compile(row["pattern"]) for row in own_rows("condvln.language", "avoid.csv")}
"""Regular expressions, by name, of phrases that test readers found hard, from ``avoid.csv``; matched against lower-case
text."""


def words(text: str) -> list[str]:
    """Return the words of a text in lower case."""
    return _WORD.findall(text.lower())


def sentences(text: str) -> list[str]:
    """Return the sentences of a text, split at the marks that end them."""
    return [sentence for sentence in _END.split(text.strip()) if words(sentence)]


def masked(text: str) -> str:
    """Return a text in lower case with the nouns of objects and rooms replaced by a placeholder."""
    return _nouns().sub(MASK, text.lower())


def pieces(texts: Sequence[str], size: int = PIECE_WORDS) -> Iterator[list[list[str]]]:
    """Yield the words of texts in pieces of `size` words; an incomplete last piece is dropped.

    Fewer words than `size` give one piece. Texts are ordered by their hashes, so that their input order does not
    matter.
    """
    ordered = sorted(texts, key=lambda text: (hashlib.blake2b(text.encode(), digest_size=8).digest(), text))
    piece: list[list[str]] = []
    held = made = 0
    for text in ordered:
        found = words(text)[: size - held]
        piece.append(found)
        held += len(found)
        if held == size:
            yield piece
            piece, held, made = [], 0, made + 1
            if made == MOST_PIECES:
                return
    if piece and not made:
        yield piece


def distinct(piece: Sequence[Sequence[str]], n: int) -> float:
    """Return the share of distinct n-grams among all n-grams of a piece; NaN if the piece has no n-grams. An n-gram
    never spans two texts.
    """
    seen: set[tuple[str, ...]] = set()
    total = 0
    for said in piece:
        grams = list(zip(*(said[k:] for k in range(n)), strict=False))
        seen.update(grams)
        total += len(grams)
    return len(seen) / total if total else float("nan")


def banned_in(text: str) -> list[str]:
    """Return the names of the phrases to avoid in a text; a name is repeated for each occurrence of its phrase."""
    low = text.lower()
    return [name for name, pattern in BANNED.items() for _ in pattern.finditer(low)]


@cache
def _nouns() -> re.Pattern[str]:
    """Return a pattern of the nouns of all languages, singular and plural, the longest first."""
    found = [language(code) for code in LANGUAGES]
    nouns = {
        noun.text.lower()
        for one in found
        for noun in (*(noun for _, noun in one.nouns_of_all_rooms), *one.rooms.values())
    }
    ordered = sorted(nouns, key=lambda noun: (-len(noun), noun))
    return re.compile(r"\b(?:" + "|".join(map(re.escape, ordered)) + r")(?:e?s)?\b")


LONG_SENTENCE: Final = 25
"""Number of words above which a sentence counts as long."""
COMMON: Final = 10
"""Number of most frequent sentences shown, with nouns masked."""


@dataclass(frozen=True)
class Lengths:
    """Length statistics in words: mean, median and maximum per text; mean per sentence, and the share of long
    sentences.
    """

    texts: int
    mean: float
    median: float
    most: int
    sentence: float
    long_sentences: float


@dataclass(frozen=True)
class LanguageReport:
    """The measures of a set of texts.

    lengths : over all texts under "all", and by category if known
    variety : each measure's mean over pieces of `piece` words (over all words if there are fewer)
    templates : share of distinct sentences after masking nouns; common : the most frequent of them, with shares
    compass, egocentric : shares of texts with compass or egocentric direction words
    banned : number of occurrences of each phrase to avoid; banned_texts : share of texts with at least one
    lint : for texts whose program is known: number of texts, of texts that do not parse back to their program, and of
        findings of the binding lint; None if no program is known
    asked : shares over texts whose program is known, by what they say; see `_asked`; None if no program is known
    """

    lengths: dict[str, Lengths]
    piece: int
    variety: dict[str, float]
    templates: float
    common: list[tuple[str, float]]
    compass: float
    egocentric: float
    banned: dict[str, int]
    banned_texts: float
    lint: dict[str, int] | None
    asked: dict[str, float] | None

    def document(self) -> dict[str, Any]:
        """Return the report as a JSON document."""
        return {
            "lengths": {name: vars(found) for name, found in self.lengths.items()},
            "piece_words": self.piece,
            "variety": self.variety,
            "masked_sentences": self.templates,
            "common_sentences": [{"sentence": said, "share": share} for said, share in self.common],
            "compass": self.compass,
            "egocentric": self.egocentric,
            "banned": self.banned,
            "banned_texts": self.banned_texts,
            "lint": self.lint,
            "asked": self.asked,
        }


def language_report(texts: Iterable[InstructionText]) -> LanguageReport:
    """Measure a set of texts; their order does not matter.

    Raises
    ------
    FormatError : there are no texts
    """
    found = list(texts)
    if not found:
        raise FormatError("there are no texts", remedy="Export episodes first")
    said = [one.text for one in found]
    low = [text.lower() for text in said]
    parts: defaultdict[str, list[str]] = defaultdict(list)
    for one in found:
        if one.category is not None:
            parts[one.category].append(one.text)
    shapes = Counter(masked(sentence) for text in said for sentence in sentences(text))
    total = shapes.total()
    phrases = [banned_in(text) for text in said]
    taken = min(PIECE_WORDS, sum(len(words(text)) for text in said))
    return LanguageReport(
        lengths={"all": _lengths(said), **{c: _lengths(parts[c]) for c in CATEGORIES if c in parts}},
        piece=taken,
        variety=_variety(said),
        templates=len(shapes) / total if total else 0.0,
        common=[
            (sentence, count / total)
            for sentence, count in sorted(shapes.items(), key=lambda x: (-x[1], x[0]))[:COMMON]
        ],
        compass=_share(bool(COMPASS_WORDS.search(text)) for text in low),
        egocentric=_share(bool(EGOCENTRIC_WORDS.search(text)) for text in low),
        banned=dict(sorted(Counter(name for names in phrases for name in names).items(), key=lambda x: (-x[1], x[0]))),
        banned_texts=_share(map(bool, phrases)),
        lint=_lint([one for one in found if one.program is not None]),
        asked=_asked([one for one in found if one.program is not None]),
    )


def _lengths(texts: Sequence[str]) -> Lengths:
    counts = [len(words(text)) for text in texts]
    spoken = [len(words(sentence)) for text in texts for sentence in sentences(text)]
    return Lengths(
        texts=len(texts),
        mean=statistics.fmean(counts),
        median=float(statistics.median(counts)),
        most=max(counts),
        sentence=statistics.fmean(spoken) if spoken else 0.0,
        long_sentences=_share(count > LONG_SENTENCE for count in spoken),
    )


def _variety(texts: Sequence[str]) -> dict[str, float]:
    plain, hidden = list(pieces(texts)), list(pieces([masked(text) for text in texts]))
    if not plain:
        return {}
    found = {f"distinct-{n}": statistics.fmean(distinct(piece, n) for piece in plain) for n in (2, 3, 4)}
    found["type/token"] = statistics.fmean(distinct(piece, 1) for piece in plain)
    found["masked distinct-4"] = statistics.fmean(distinct(piece, 4) for piece in hidden)
    return found


def _share(flags: Iterable[bool]) -> float:
    counted = list(flags)
    return sum(counted) / len(counted) if counted else 0.0


def _lint(texts: Sequence[InstructionText]) -> dict[str, int] | None:
    """Return three counts: all `texts`, those that do not parse back to their program, and those with findings of the
    binding lint. Return None if there are no texts.
    """
    if not texts:
        return None
    unsound: dict[tuple[str, Category, Template], bool] = {}
    counts = Counter({"texts": len(texts), "misread": 0, "findings": 0})
    for one in texts:
        code = next((code for code in LANGUAGES if _is_said(one, code)), None)
        if code is None:
            counts["misread"] += 1
            continue
        category, template = template_of(one.text, code)
        key = (code, category, template)
        if key not in unsound:
            unsound[key] = any(findings(language(code), category, template))
        counts["findings"] += unsound[key]
    return dict(counts)


def _asked(texts: Sequence[InstructionText]) -> dict[str, float] | None:
    """Return shares: of texts over several rooms and, of those, with a lead; of orders to look ("find the lamp") in
    a room to which nothing has sent one; of relations between two things that are built in or too heavy to move; and of
    stops and conditions about what nobody would say (worth 0). Return None if there are no texts.
    """
    if not texts:
        return None
    several, led, looks, fixed, silly = [], [], [], [], []
    heavy = labels_with_role("fixed")
    for one in texts:
        program = one.program
        assert program is not None
        moves = [move for leaf in program.leaves for move in leaf.moves]
        rooms = {x.room.room_id for x in moves} | {x.room.room_id for x in program.conditions}
        several.append(len(rooms) > 1)
        if several[-1]:
            led.append(any(branch.lead is not None for branch in program.branches))
        code = next((code for code in LANGUAGES if _is_said(one, code)), None)
        if code is not None:
            stated = template_of(one.text, code)[1].stated
            looks += [several[-1] and program.last_leads[k] is None for k, form in stated.items() if form == "see"]
        silly += [worth(move.label, move.room.label).goto == 0.0 for move in moves]
        for condition in program.conditions:
            own, anchors = worth(condition.label, condition.room.label), condition.qualifier
            silly.append((own.relation if anchors else own.presence) == 0.0)
            if anchors:
                fixed.append(heavy >= {condition.label, *anchors.anchor_labels})
    names = ("several rooms", "with a lead", "looks from afar", "fixed beside fixed", "worth nothing")
    return {name: _share(flags) for name, flags in zip(names, (several, led, looks, fixed, silly), strict=True)}


def _is_said(one: InstructionText, code: str) -> bool:
    """Return whether the text of `one`, parsed in the language `code`, means exactly the program of `one`."""
    assert one.program is not None
    try:
        reading = parse(one.text, code)
    except InputError:
        return False
    return reading == reading_of(one.program, reading.heading)
