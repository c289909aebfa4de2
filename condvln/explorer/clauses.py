"""Which words of a text state which condition and which stop, found by parsing the text with its own grammar."""

from __future__ import annotations

from collections.abc import Iterator
from functools import cache
from typing import Any, Final

from lark import Lark, Tree
from lark.exceptions import LarkError

from condvln.instructions.language import Slot, language
from condvln.instructions.parsing import grammar_source
from schemas.program import Program

__all__ = ["clauses"]

LANGUAGES: Final = ("en", "es")
Clause = tuple[int, int, int, int]
"""Beginning and end in the text, index of the condition or −1, index of the leaf or −1."""


def clauses(text: str, program: Program) -> list[Clause]:
    """Return the clauses of a text from its first word to its last; an empty list if no grammar of ours can parse the
    text.

    A clause of a condition is a statement, a question or an answer; a clause of a leaf has all its stops.
    """
    for code in LANGUAGES:
        words = language(code)
        lowered = text.lower()
        # A position in the parsed text is one in the text itself only where neither changes its length.
        if len(lowered) != len(text) or words.expanded(lowered) != lowered:
            continue
        try:
            tree = _parser(code).parse(lowered)
        except LarkError:
            continue
        return sorted(_found(tree, program, code))
    return []


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
