"""Sentences of a text: contractions, capitals, and the length at which a sentence is split."""

from __future__ import annotations

from typing import Final

from condvln.instructions.language import Language

__all__ = ["LONGEST_SENTENCE", "sentences"]

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
