"""Which words of a text state which condition and which stop, found by parsing the text with its own grammar."""

from __future__ import annotations

import re
from collections.abc import Iterator
from functools import cache
from typing import Any, Final

from lark import Lark, Tree
from lark.exceptions import LarkError

from condvln.instructions.grammar_source import grammar_source
from condvln.instructions.language import Language, Slot, language
from schemas.program import Program

__all__ = ["clauses"]

LANGUAGES: Final = ("en", "es")
Span = tuple[int, int]
Clause = tuple[int, int, int, int]
"""Beginning and end in the text, index of the condition or −1, index of the leaf or −1."""


def clauses(text: str, program: Program) -> list[Clause]:
    """Return the clauses of a text from its first word to its last; an empty list if no grammar of ours can parse the
    text.

    A clause of a condition is a statement, a question or an answer; a clause of a leaf has all its stops.
    """
    for code in LANGUAGES:
        lowered = text.lower()
        if len(lowered) != len(text):  # a position in the lowered text would be another one in the text
            continue
        whole, places = _expanded(lowered, language(code))
        try:
            tree = _parser(code).parse(whole)
        except LarkError:
            continue
        return _apart(sorted(_found(tree, program, code)), places)
    return []


def _expanded(text: str, words: Language) -> tuple[str, list[Span]]:
    """Return the expanded text, as :meth:`Language.expanded` does, and for each character of the expanded text the span
    of `text` that the character stands for: one character, or a whole contraction ("del" is parsed as "de el").
    """
    apart = {together: one for one, together in words.contractions.items()}
    whole, places, done = "", [], 0
    for found in re.finditer(rf"\b({'|'.join(apart)})\b", text) if apart else ():
        whole += text[done : found.start()] + apart[found[0]]
        places += [(k, k + 1) for k in range(done, found.start())]
        places += [found.span()] * len(apart[found[0]])
        done = found.end()
    return whole + text[done:], places + [(k, k + 1) for k in range(done, len(text))]


def _apart(parsed: list[Clause], places: list[Span]) -> list[Clause]:
    """Convert clauses of the expanded text to clauses of the original text. `places` has the span in the original text
    of each character. A contraction that two clauses share belongs to the earlier clause.
    """
    found, done = [], 0
    for start, end, condition, leaf in parsed:
        begin, done = max(done, places[start][0]), places[end - 1][1]
        found.append((begin, done, condition, leaf))
    return found


@cache
def _parser(code: str) -> Lark:
    return Lark(grammar_source(language(code)), parser="lalr", propagate_positions=True)


def _found(tree: Tree[Any], program: Program, code: str) -> Iterator[Clause]:
    body = next(tree.find_data("body")).children[0]
    category, number = str(body.data).rsplit("_", 1)
    if category != program.category:
        return
    slots = [
        piece for piece in language(code).templates[program.category][int(number)].pieces if isinstance(piece, Slot)
    ]
    parts = [child for child in body.children if isinstance(child, Tree)]
    if len(slots) != len(parts):
        return
    for slot, part in zip(slots, parts, strict=True):
        if part.meta.empty:
            continue
        leaf = slot.form == "leaf"
        yield part.meta.start_pos, part.meta.end_pos, -1 if leaf else slot.index, slot.index if leaf else -1
