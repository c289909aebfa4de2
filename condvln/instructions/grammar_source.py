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
from condvln.own_tables import own_text
from schemas.program import CATEGORIES, anchors_of

__all__ = ["ANSWERS", "grammar_source", "rule_of"]

PUNCTUATION: Final = {",": "COMMA", ";": "SEMICOLON", ":": "COLON", ".": "STOP", "?": "QUESTION"}
ANSWERS: Final = ("yes_one", "yes_it", "yes_any", "no_one", "no_it", "no_any")
"""Rules of the phrases that answer a question; all but two show what kind of question it was."""

_ARTICLES: Final = (
    ("a", "indefinite"),
    ("lo", "pronoun"),
    ("cercano", "nearest"),
    ("ninguno", "none"),
    ("alguno", "some"),
    ("ningun", "no"),
)
"""Words of phrases that agree with a noun, and their lists of forms."""

_LINE: Final = re.compile(r"(?:([?!])(\w+):)?(.*)")
"""A line of ``rules.lark``: a condition and the name of what the language must have or lack, and the rule."""

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
        if w.slots["there"]:
            rules.append(f"there: {self._any(w.slots['there'])}")
        if w.lying:
            rules.append(f"_lying: {self._any([w.lying])}")
        rules.append(f"_and: {self._any(w.connectives['and'])}")
        rules += self._answers()
        rules += [f"{rule_of(predicate)}: {self._any(phrases)}" for predicate, phrases in w.predicates.items()]
        rules += [f"{rule_of(name)}: {self._any(words.values())}" for name, words in w.superlatives.items()]
        rules += [f"direction_{rule_of(name)}: {self._any([text])}" for name, text in w.directions.items()]
        rules += [f"{rule_of(bearing)}: {self._any(phrases)}" for bearing, phrases in w.bearings.items()]
        rules += [f"{rule_of(bearing)}_stop: {self._any(phrases)}" for bearing, phrases in w.bearing_stops.items()]
        rules += self._shared_rules()
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

    def _shared_rules(self) -> list[str]:
        """Return the rules of ``rules.lark`` as they are in this language."""
        w, slots = self.words, self.words.slots
        has: dict[str, object] = {"room_first": w.room_first, "compounds": w.compounds[0]}
        has |= {name: slots[name] for name in ("has", "same_place", "also", "nor", "there")}
        said = {
            "same_place": self._any(slots["same_place"]),
            "both": self._terminal(w.both),
            "directions": " | ".join(f"direction_{rule_of(name)}" for name in w.directions),
            "lying": "[_lying] " if w.lying else "",
            "compared": "_THE superlative _noun" if w.superlative_first else "_THE _noun superlative",
            "one_anchor": " | ".join(rule_of(name) for name in w.predicates if anchors_of(name) == 1),
            "bearings": " | ".join(rule_of(name) for name in w.bearings),
            "bearing_stops": " | ".join(f"{rule_of(name)}_stop" for name in w.bearing_stops),
            "superlatives": " | ".join(rule_of(name) for name in w.superlatives),
            **{slot: self._either(slot) for slot in ("exists", "absent", "is")},
            **{word: " | ".join(self._answering(word)) for word in ("yes", "no")},
        }
        text = own_text("condvln.instructions", "grammar/rules.lark")
        found = []
        for line in text.splitlines():
            kind, name, rule = _LINE.fullmatch(line).groups()  # type: ignore[union-attr]  # it matches any line
            if not line.startswith("//") and (not kind or bool(has[name]) == (kind == "?")):
                found.append(rule.format_map(said))
        return found

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
        return f"(_{slot} | _{slot}_again)" if set(slots.get(f"{slot}_again", ())) - set(slots[slot]) else f"_{slot}"

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
            return {"leaf": "moves", "see": "(see | led)"}.get(piece.form, piece.form)
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
