"""Write the lark grammar of a language, from the same data as its texts.

The grammar is LALR(1), so that a text has at most one parse by construction. It is also a plain context-free grammar,
so an Earley parser can check this without relying on LALR(1).
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Sequence
from itertools import pairwise, product
from typing import Final

from condvln.instructions.language import Language, Slot
from schemas.program import CATEGORIES, anchors_of

__all__ = ["ANSWERS", "grammar_source", "rule_of"]

PUNCTUATION: Final = {",": "COMMA", ";": "SEMICOLON", ":": "COLON", ".": "STOP", "?": "QUESTION"}
ANSWERS: Final = ("yes_one", "yes_it", "yes_any", "no_one", "no_it", "no_any")
"""Rules of the phrases that answer a question; all but two show what kind of question it was."""

_RULES: Final = {"leaf": "moves", "again": "yes", "not_again": "no", "lacks": "no"}
"""Grammar rules of slots that have another name; an answer may be given in full."""

_ARTICLES: Final = (
    ("a", "indefinite"),
    ("lo", "pronoun"),
    ("cercano", "nearest"),
    ("ninguno", "none"),
    ("alguno", "some"),
    ("ningun", "no"),
)
"""Words of phrases that agree with a noun, and their lists of forms."""

_TOKEN: Final = re.compile(r"\(\d\)|[^\s,;:.?]+|[,;:.?]")
"""Pattern of the words, numbers in brackets and punctuation of a template."""


def grammar_source(words: Language) -> str:
    """Return the lark grammar of a language."""
    return _GrammarWriter(words).source()


class _GrammarWriter:
    """Writes the grammar of a language. Each phrase is one terminal, even if several slots use the same phrase, so that
    the lexer takes the longest match.
    """

    def __init__(self, words: Language) -> None:
        self.words = words
        self.terminals: dict[str, str] = {}

    def source(self) -> str:
        w, rules = self.words, []
        for name, phrases in w.slots.items():
            if name not in ("then", "second", "last", "there", "same_place", *ANSWERS) and phrases:
                rules.append(f"_{name}: {self._any(phrases)}")
        rules.append(f"_joint: {self._any([*w.slots['then'], *w.slots['second'], *w.slots['last']])}")
        there = " | there" if w.slots["there"] else ""
        if there:
            rules.append(f"there: {self._any(w.slots['there'])}")
        lying = "[_lying] " if w.lying else ""
        if lying:
            rules.append(f"_lying: {self._any([w.lying])}")
        rules += self._answers()
        rules += [f"{rule_of(predicate)}: {self._any(phrases)}" for predicate, phrases in w.predicates.items()]
        rules += [f"{rule_of(name)}: {self._any(words.values())}" for name, words in w.superlatives.items()]
        rules += [f"direction_{rule_of(name)}: {self._any([text])}" for name, text in w.directions.items()]
        rules += [f"{rule_of(bearing)}: {self._any(phrases)}" for bearing, phrases in w.bearings.items()]
        rules += [f"{rule_of(bearing)}_stop: {self._any(phrases)}" for bearing, phrases in w.bearing_stops.items()]
        compared = "_THE superlative _noun" if w.superlative_first else "_THE _noun superlative"
        one_anchor = " | ".join(rule_of(p) for p in w.predicates if anchors_of(p) == 1)
        rules += [
            "start: [_facing direction] [_scope room COMMA] body",
            "direction: (" + " | ".join(f"direction_{rule_of(d)}" for d in w.directions) + ") STOP",
            "moves: _go object (_joint object)*",
            "bare_moves: _to object (_joint object)* -> moves",
            f"object: _THE _noun [_where_of] | _THE _noun ({lying}qualifier [_where_anchor] | bearing_stop)",
            *([f"    | _THE _noun _where_of {lying}qualifier"] if w.room_first else []),
            f"    | {compared} [_where_of]",
            *(["    | compound"] if w.compounds[0] else []),
            "compound: _THE ROOM NOUN",
            "_where: _in room" + (" | here" if w.slots["same_place"] else ""),
            *([f"here: {self._any(w.slots['same_place'])}"] if w.slots["same_place"] else []),
            f"_where_anchor: _of_anchor room{there}",
            f"_where_of: _of room{there}",
            "room: _THE (ROOM | BOTH) [_with _THE _noun]",
            "    | _THAT (ROOM | BOTH) -> same_room",
            f"qualifier: ({one_anchor}) _THE _noun"
            f" | {rule_of('between')} _THE _noun {self._terminal(w.both)} _THE _noun",
            "bearing: " + " | ".join(rule_of(b) for b in w.bearings),
            "bearing_stop: " + " | ".join(f"{rule_of(b)}_stop" for b in w.bearing_stops),
            "superlative: " + " | ".join(rule_of(p) for p in w.superlatives),
            f"asserted: {self._either('exists')} _noun [qualifier] [_where] -> some",
            *(["    | _in room _exists _noun [qualifier] -> some"] if w.room_first else []),
            *(["    | room _has _noun [qualifier] -> some"] if w.slots["has"] else []),
            f"    | _THE _noun [_where_of] {self._either('is')} (qualifier | bearing) -> the",
            f"    | COMMA _in room COMMA _THE _noun {self._either('is')} (qualifier | bearing) -> the",
            *([f"    | compound {self._either('is')} (qualifier | bearing) -> the"] if w.compounds[0] else []),
            f"denied: {self._either('absent')} _noun [qualifier] [_where] -> some",
            *(["    | _in room _absent _noun [qualifier] -> some"] if w.room_first else []),
            *(["    | room _has_no _noun [qualifier] -> some"] if w.slots["has"] else []),
            "    | _THE _noun [_where_of] _is_not (qualifier | bearing) -> the",
            "    | COMMA _in room COMMA _THE _noun _is_not (qualifier | bearing) -> the",
            *(["    | compound _is_not (qualifier | bearing) -> the"] if w.compounds[0] else []),
            "neither: _neither_a _noun _nor_a _noun",
            "joined: asserted | (_there_also | _also_a) _noun [qualifier] [_where] -> some"
            + (" | _also _noun [qualifier] [_where] -> some" if w.slots["also"] else ""),
            *(["    | _in room (_there_also | _also_a) _noun [qualifier] -> some"] if w.room_first else []),
            "not_joined: denied" + (" | _nor _noun [qualifier] [_where] -> some" if w.slots["nor"] else ""),
            "question: _is_there _noun [qualifier] [_where] QUESTION -> some",
            "    | _asks_is _THE _noun [_where_of] (qualifier | bearing) QUESTION -> the",
            *(["    | _asks_is compound (qualifier | bearing) QUESTION -> the"] if w.compounds[0] else []),
            "see: _see asserted",
            "    | _look _noun [qualifier] [_where] -> some",
            "    | _look_at _THE _noun [_where_of] -> the",
            *(["    | _look_at compound -> the"] if w.compounds[0] else []),
            *(
                [] if w.room_first else ["    | _check room _for _noun [qualifier] -> some"]
            ),  # it is "see" with the room first
            "_noun: NOUN | BOTH",
            "is_it: _it_is (qualifier | bearing)",
            "is_it_not: _it_is_not (qualifier | bearing)",
            f"yes: {' | '.join(self._answering('yes'))} | is_it | asserted",
            f"no: {' | '.join(self._answering('no'))} | is_it_not | denied",
        ]
        bodies: dict[str, str] = {}
        for category in CATEGORIES:
            for k, template in enumerate(w.templates[category]):
                whole = " ".join(self._parts(template.pieces))
                # Templates that differ only in {yes A} and {again A} are parsed as one.
                for right in _split(whole):
                    bodies.setdefault(right, f"{category}_{k}")
        for name in dict.fromkeys(bodies.values()):
            rules.append(f"{name}: " + " | ".join(right for right, its in bodies.items() if its == name))
        rules.append("body: " + " | ".join(dict.fromkeys(bodies.values())))
        return "\n".join([*rules, *self._terminal_lines()]) + "\n"

    def _answers(self) -> list[str]:
        """Return the grammar rules of the answers "yes" and "no". Answers that fit every kind of question have a rule
        of their own.
        """
        slots, rules = self.words.slots, []
        for word in ("yes", "no"):
            one, it = slots[f"{word}_one"], slots[f"{word}_it"]
            kinds = {"one": set(one) - set(it), "it": set(it) - set(one), "any": set(one) & set(it)}
            rules += [f"{word}_{kind}: {self._any(sorted(those))}" for kind, those in kinds.items() if those]
        return rules

    def _answering(self, word: str) -> list[str]:
        """Return the names of the grammar rules for the answer `word`, which is "yes" or "no"."""
        return [rule.split(":")[0] for rule in self._answers() if rule.startswith(f"{word}_")]

    def _either(self, slot: str) -> str:
        """Return what the grammar accepts at `slot`: the slot's rule, or either of two rules if the slot has further
        phrases for use after a denial.
        """
        slots = self.words.slots
        return f"(_{slot} | _{slot}_again)" if set(slots[f"{slot}_again"]) - set(slots[slot]) else f"_{slot}"

    def _parts(self, pieces: Sequence[str | Slot]) -> Iterator[str]:
        """Yield the grammar of each piece of a template. The comma before "but no lamp" is left out by the renderer."""
        for piece, after in pairwise((*pieces, "")):
            part = self._part(piece)
            joined = isinstance(after, Slot) and after.form in ("joined", "not_joined")
            yield part.replace("COMMA ", "COMMA? ") if joined else part

    def _part(self, piece: str | Slot) -> str:
        if isinstance(piece, Slot):
            if piece.bare:
                return "bare_moves"
            return _RULES.get(piece.form, piece.form)
        return " ".join(PUNCTUATION.get(token) or self._terminal(token) for token in _TOKEN.findall(piece.lower()))

    def _any(self, texts: Iterable[str]) -> str:
        return " | ".join(dict.fromkeys(self._terminal(text.strip()) for text in texts))

    def _terminal(self, phrase: str) -> str:
        pattern = _pattern(self.words.expanded(phrase))
        for slot, kind in _ARTICLES:
            articles = sorted(set(self.words.articles.get(kind, {}).values()), key=lambda x: (-len(x), x))
            pattern = pattern.replace(rf"\{{{slot}\}}", f"(?:{'|'.join(articles)})")
        return self.terminals.setdefault(pattern, f"_PHRASE_{len(self.terminals)}")

    def _terminal_lines(self) -> list[str]:
        w = self.words
        nouns = {noun.text.lower() for _, noun in w.nouns_of_all_rooms}
        rooms = {noun.text.lower() for noun in w.rooms.values()}
        named = {
            "NOUN": _alternatives(nouns - rooms, rooms),
            "ROOM": _alternatives(rooms - nouns, nouns),
            "BOTH": _alternatives(nouns & rooms) if nouns & rooms else "(?!)x",
            "_THE": _alternatives(w.articles["definite"].values()),
            "_THAT": _alternatives(w.articles["that"].values()),
        }
        lines = [f"{name}: /{pattern}/" for pattern, name in self.terminals.items()]
        lines += [f"{name}: /{pattern}/" for name, pattern in named.items()]
        lines += [f'{name}: "{character}"' for character, name in PUNCTUATION.items()]
        return [*lines, "%ignore /\\s+/"]


def _split(right: str) -> Iterator[str]:
    """Yield a template's sequence of symbols, and the variants of this sequence in which some colons or semicolons end
    a sentence.
    """
    marks = ("SEMICOLON", "COLON")
    parts = right.split(" ")
    places = [k for k, part in enumerate(parts) if part in marks]
    for taken in product((False, True), repeat=len(places)):
        said = list(parts)
        for place, split in zip(places, taken, strict=True):
            said[place] = "STOP" if split else said[place]
        yield " ".join(said)


def rule_of(name: str) -> str:
    """Return the name of the grammar rule of a predicate or direction."""
    return name.replace(" ", "_").replace("-", "_")


def _pattern(phrase: str) -> str:
    escaped = r"\s+".join(re.escape(word) for word in phrase.split()).replace("/", r"\/")
    return rf"{escaped}(?![\w-])"


def _alternatives(texts: Iterable[str], others: Iterable[str] = ()) -> str:
    """Return a pattern that matches any of `texts`, except where a text is the beginning of one of `others`: "the
    television" is not matched in "the television room".
    """
    longest_first = sorted({text.lower() for text in texts}, key=lambda text: (-len(text), text))
    patterns = []
    for text in longest_first:
        rests = sorted(other.removeprefix(text) for other in others if other.startswith(f"{text} "))
        guard = f"(?!{'|'.join(_spaced(rest) for rest in rests)})" if rests else ""
        patterns.append(_spaced(text) + guard)
    return "(?:" + "|".join(patterns) + r")(?![\w-])"


def _spaced(text: str) -> str:
    """Return a pattern that matches the words of `text` with any white space between them."""
    return (r"\s+" if text.startswith(" ") else "") + r"\s+".join(re.escape(word) for word in text.split())
