"""Counts over texts: sentences, n-grams, direction words, phrases to avoid. Pure functions of strings.

A word is a lower-case run of letters, digits, apostrophes and hyphens. Variety measures depend on the amount of text,
so they are computed over pieces of equal length in words.
"""

from __future__ import annotations

import hashlib
import re
from collections.abc import Iterator, Mapping, Sequence
from functools import cache
from typing import Final

from condvln.instructions.language import LANGUAGES, language

__all__ = [
    "BANNED",
    "COMPASS_WORDS",
    "EGOCENTRIC_WORDS",
    "PIECE_WORDS",
    "banned_in",
    "distinct",
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

BANNED: Final[Mapping[str, re.Pattern[str]]] = {
    name: re.compile(pattern)
    for name, pattern in {
        "after a no: if that is so": r"\bif that(?:'s| is) (?:so|true|the case)\b",
        "or else, failing that": r"\b(?:or else|barring that|failing that|in (?:any|all|every) other cases?)\b",
        "when that is not the case": r"\bwhen that is not the case\b",
        "odd ifs": r"\b(?:provided|supposing|assuming|on condition that|in the event that|if it is true that)\b",
        "happens to, one can find": r"\b(?:happens? to|one can find|turns? out to have|you can(?:'t|not)? find)\b",
        "such a": r"\bsuch an?\b|\bthere (?:really is|is indeed)\b|\byou do find\b",
        "moreover, though": r"\b(?:moreover|furthermore|besides|in addition|at the same time|though)\b",
        "and yet, and if": r"\b(?:but on the other hand|and yet|and if)\b",
        "look further": r"\b(?:look further|(?:decide|proceed) as follows|make one more check|take one more look)\b",
        "situated, located": r"\b(?:situated|positioned|located)\b",
        "up above, lower down": r"\b(?:straight above|up above|(?:lower down|higher up)(?! than\b))\b",
        "holds, contains": r"\b(?:holds|contains|containing|which has|over in|that is in)\b",
        "last of all, start by": r"\b(?:last of all|come to a stop|start by going|go first to)\b",
        "all of this is about": r"\ball of this is about\b",
        "has got, at least one": r"\b(?:has got|hasn't got|at least one|does have)\b",
    }.items()
}
"""Regular expressions, by name, of phrases that test readers found hard; matched against lower-case text."""


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
