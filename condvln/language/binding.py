"""Lint for ambiguous answers: does a listener relate each answer word to the question that it is meant to answer?

A listener refers "if so", "if not", "if there is one", "if it isn't" to the latest question or supposition, "otherwise"
to the only "if" of the previous sentence, "neither" and "none of them" to all suppositions so far. A listener takes
"there is one" to be about an object that may not exist, and "it is" about an object that does exist. A template is
valid if these rules lead to its category's leaves in every case, so that its text is understood at first reading.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from itertools import product
from typing import Final

from condvln.instructions.language import Language, Slot, Template
from schemas.program import SHAPES, Category, route_through

__all__ = ["Finding", "findings"]

Context = tuple[tuple[int, bool], ...]
"""A listener's suppositions: (condition, truth) pairs that must all hold."""

_WORD: Final = re.compile(r"\(\d\)|[^\s,;:.?]+|[,;:.?]")


@dataclass(frozen=True, slots=True)
class Finding:
    """A wording that a listener may misunderstand."""

    template: str
    what: str


@dataclass
class _Listener:
    """Interprets a template from left to right as a listener does.

    asks : (context, condition, truth of the "if", or None for a question), in order
    supposed : the same for the last "if", also for one with an answer
    leading : the leaf that was said before its condition: "go to the lamp if …"
    """

    asks: list[tuple[Context, int, bool | None]] = field(default_factory=list)
    supposed: tuple[Context, int, bool] | None = None
    context: Context = ()
    listed: bool = False
    leaves: dict[int, list[Context]] = field(default_factory=dict)
    leading: int | None = None


def findings(words: Language, category: Category, template: Template) -> Iterator[Finding]:
    """Yield the ambiguities of a template. There are none if a listener always reaches the leaf that the template's
    category prescribes.
    """
    shape = SHAPES[category]
    text = written(template)
    try:
        leaves = _heard(words, template.pieces)
    except ValueError as doubt:
        yield Finding(text, str(doubt))
        return
    for truths in product((True, False), repeat=len(shape.branches)):
        _, reached = route_through(shape.branches, truths)
        heard = [leaf for leaf, contexts in leaves.items() if any(_holds(c, truths) for c in contexts)]
        if heard != [reached]:
            yield Finding(text, f"with conditions {truths} a listener goes to {heard}, not to leaf {reached}")


def written(template: Template) -> str:
    """Return a template with its slots in braces."""
    return "".join(p if isinstance(p, str) else f"{{{p.form} {p.index}}}" for p in template.pieces)


def _holds(context: Context, truths: Sequence[bool]) -> bool:
    return all(truths[condition] == truth for condition, truth in context)


def _heard(words: Language, pieces: Sequence[str | Slot]) -> dict[int, list[Context]]:
    """Return, by leaf, the contexts in which a listener goes to the leaf. Raises ValueError for a wording that no
    listener understands.
    """
    listener = _Listener()
    connectives = {
        tuple(_WORD.findall(phrase)): name for name, phrases in words.connectives.items() for phrase in phrases
    }
    agreeing = {*words.connectives["so"]} & {*words.slots["yes_one"], *words.slots["yes_it"]}
    supposing = False  # after "if", before its claim or answer
    sentence_ifs = previous_ifs = 0
    sentence: Context = ()
    for piece in pieces:
        if isinstance(piece, Slot):
            _hear_slot(listener, piece, supposing, agreeing=bool(agreeing))
            sentence_ifs += supposing
            supposing = False
            if piece.form == "see":
                sentence = listener.context
            continue
        for name in _names(piece.lower(), connectives):
            if name in (".", "?"):
                if name == ".":
                    listener.context, sentence = (), ()
                    previous_ifs, sentence_ifs = sentence_ifs, 0
            elif name in (";", ":"):
                listener.context = sentence if name == ";" or sentence else listener.context
            elif name == "if":
                supposing = True
            elif name in ("so", "not"):
                context, condition, truth = _latest(listener)
                if name == "so" and truth is False:
                    raise ValueError(f'"so" after a denial of condition {condition} agrees with the denial')
                listener.supposed = (context, condition, name == "so")
                listener.context = (*context, (condition, name == "so"))
                sentence_ifs += 1
                supposing = False
            elif name == "otherwise":
                if listener.supposed is None or previous_ifs != 1:
                    raise ValueError('"otherwise" follows a sentence that does not have exactly one "if"')
                context, condition, truth = listener.supposed
                listener.context = (*context, (condition, not truth))
                sentence_ifs = 0
            elif name in ("neither", "none"):
                asks = listener.asks
                if any(truth is None for _, _, truth in asks) or (name == "neither" and len(asks) != 2):
                    raise ValueError(f'"{name}" can\'t refer to the {len(asks)} conditions before it')
                listener.context = tuple((condition, not truth) for _, condition, truth in asks)
                supposing = False
            elif name in ("but", "and"):
                supposing = True
            elif name == "list":
                listener.listed = True
    return listener.leaves


def _hear_slot(listener: _Listener, slot: Slot, supposing: bool, agreeing: bool) -> None:
    """Update the listener's state with one slot of a template.

    agreeing : whether "yes" is said as "if so", which agrees with a denial too
    """
    if slot.form == "leaf" and not listener.context and not supposing and not listener.asks:
        listener.leading = slot.index
    elif slot.form == "leaf":
        listener.leaves.setdefault(slot.index, []).append(listener.context)
    elif slot.form in ("yes", "no"):
        context, condition, truth = _latest(listener)
        if agreeing and slot.form == "yes" and truth is False:
            raise ValueError(f"the answer agrees with the denial of condition {condition}")
        if condition != slot.index:
            raise ValueError(f"the answer about condition {slot.index} comes after condition {condition} was asked")
        listener.supposed = (context, condition, slot.form == "yes")
        listener.context = (*context, (condition, slot.form == "yes"))
    elif slot.form == "neither":
        asked = {condition for _, condition, _ in listener.asks}
        if not supposing or not asked >= {slot.index, slot.other}:
            raise ValueError(f'"neither" comes before conditions {slot.index} and {slot.other} were asked')
        listener.context = (*listener.context, (slot.index, False), (slot.other, False))
    elif slot.form in ("question", "see"):
        listener.asks.append((listener.context, slot.index, None))
    elif not supposing:
        raise ValueError('a claim without "if"')
    else:
        truth = slot.form in ("asserted", "joined")
        before = listener.context
        asked_in = [context for context, condition, _ in listener.asks if condition == slot.index]
        if asked_in and not before:
            before = asked_in[0]  # the earlier question applies to the same cases
        if listener.listed:
            before = (*before, *((condition, not held) for _, condition, held in listener.asks))
        listener.asks.append((before, slot.index, truth))
        listener.supposed = (before, slot.index, truth)
        listener.context = (*before, (slot.index, truth))
        if listener.leading is not None:
            listener.leaves.setdefault(listener.leading, []).append(listener.context)
            listener.leading = None


def _latest(listener: _Listener) -> tuple[Context, int, bool | None]:
    if not listener.asks:
        raise ValueError("an answer comes before any question")
    return listener.asks[-1]


def _names(text: str, connectives: dict[tuple[str, ...], str]) -> Iterator[str]:
    """Yield the names of the connectives and the punctuation in a piece of a template, in order. At each position the
    longest match counts.
    """
    tokens = _WORD.findall(text)
    longest = max(map(len, connectives))
    at = 0
    while at < len(tokens):
        for length in range(min(longest, len(tokens) - at), 0, -1):
            name = connectives.get(tuple(tokens[at : at + length]))
            if name is not None:
                yield name
                at += length
                break
        else:
            if tokens[at] not in ",;:.?":
                raise ValueError(f"the word {tokens[at]!r} is not one of the language's connectives")
            yield tokens[at]
            at += 1
