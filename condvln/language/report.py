"""The style report: length, variety and clarity of instruction texts."""

from __future__ import annotations

import statistics
from collections import Counter, defaultdict
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any, Final

from condvln.instructions import parse, reading_of
from condvln.instructions.binding import findings
from condvln.instructions.language import LANGUAGES, Template, language
from condvln.instructions.parsing import template_of
from condvln.language.measures import (
    COMPASS_WORDS,
    EGOCENTRIC_WORDS,
    PIECE_WORDS,
    banned_in,
    distinct,
    masked,
    pieces,
    sentences,
    words,
)
from condvln.language.texts import InstructionText
from schemas.errors import FormatError, InputError
from schemas.program import CATEGORIES, Category

__all__ = ["LONG_SENTENCE", "LanguageReport", "language_report"]

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


def _is_said(one: InstructionText, code: str) -> bool:
    """Return whether the text of `one`, parsed in the language `code`, means exactly the program of `one`."""
    assert one.program is not None
    try:
        reading = parse(one.text, code)
    except InputError:
        return False
    return reading == reading_of(one.program, reading.heading)
