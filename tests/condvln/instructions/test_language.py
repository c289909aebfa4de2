"""The grammar as data: enough phrasings, no word left half-inflected, and templates that can be read in one way only.

The templates are checked by a reader of their own, which knows nothing of how they were meant: an "otherwise" goes with
the latest test that has no alternative yet, a "yes" or "no" with the latest question asked.
"""

from __future__ import annotations

import re
from itertools import product

import pytest

from condvln.instructions.language import LANGUAGES, PHRASINGS, Language, Slot, language
from condvln.instructions.rendering import HEADINGS, heading_name, preamble
from schemas.errors import UsageError
from schemas.program import CATEGORIES, SHAPES, Category

Literals = tuple[tuple[int, bool], ...]


@pytest.fixture(params=LANGUAGES)
def words(request: pytest.FixtureRequest) -> Language:
    return language(request.param)


def test_every_slot_has_enough_phrasings(words: Language) -> None:
    for name, phrases in {**words.slots, **words.predicates}.items():
        assert len(set(phrases.texts)) >= PHRASINGS, name
    for category in CATEGORIES:
        assert len(set(words.templates[category])) >= PHRASINGS, category


def test_nouns_are_plain_and_distinct(words: Language) -> None:
    for nouns in (words.nouns, words.rooms):
        texts = [noun.text for noun in nouns.values()]
        assert len(set(texts)) == len(texts)
        for text in texts:
            assert re.fullmatch(r"[^\W\d_]+(?:[ '-][^\W\d_]+)*", text), text
    assert set(words.nouns) == set(language("en").nouns)
    assert set(words.rooms) == set(language("en").rooms)
    for noun in [*words.nouns.values(), *words.rooms.values()]:
        assert all(noun.kind in table for table in words.articles.values()), noun


def test_contractions_can_be_undone(words: Language) -> None:
    for phrases in [*words.slots.values(), *words.predicates.values()]:
        for phrase in phrases.texts:
            for noun in words.nouns.values():
                text = f"{phrase.format(a='', none='')} {words.definite(noun)}"
                assert words.expanded(words.contracted(text)) == words.expanded(text)


class _Reader:
    """Reads a template clause by clause and collects what must hold for each leaf to be gone to."""

    def __init__(self, template: tuple[str | Slot, ...]) -> None:
        self.guards = [p.literals for p in template if isinstance(p, Slot) and p.kind == "guard"]
        self.open: list[tuple[Literals, Literals]] = []
        self.question: tuple[Literals, int] | None = None
        self.reached: dict[int, Literals] = {}
        self.denials: dict[int, list[tuple[Literals, Literals]]] = {}
        sentences: list[list[list[Slot]]] = [[[]]]
        for piece in template:
            if isinstance(piece, Slot):
                sentences[-1][-1].append(piece)
            elif "." in piece:
                sentences.append([[]])
            elif ";" in piece or ":" in piece:
                sentences[-1].append([])
        for sentence in sentences:
            self.sentence([clause for clause in sentence if clause])

    def sentence(self, clauses: list[list[Slot]]) -> None:
        inside: Literals | None = None
        for clause in clauses:
            # What follows a colon is said under what stands before it.
            inside = self.clause(clause, inside)

    def clause(self, clause: list[Slot], inside: Literals | None) -> Literals | None:
        context: Literals = inside or ()
        opens = None
        for slot in clause:
            if slot.kind == "guard":
                self.open.append((context, slot.literals))
                context = context + slot.literals
            elif slot.kind == "else":
                context = self.otherwise()
            elif slot.kind == "check":
                self.question = (context, slot.literals[0][0])
                opens = ()
            elif slot.kind in ("yes", "no"):
                assert self.question is not None
                before, index = self.question
                context = (*before, (index, slot.kind == "yes"))
            elif slot.kind == "nest":
                opens = context
            elif slot.kind == "leaf":
                assert slot.leaf not in self.reached, "each leaf is named once"
                self.reached[slot.leaf] = context
        return opens if opens is not None else inside

    def otherwise(self) -> Literals:
        candidates = [k for k, (_, literals) in enumerate(self.open) if not self.denied_elsewhere(literals)]
        assert len(candidates) == 1, "an 'otherwise' must have one test to go with, and one only"
        context, literals = self.open.pop(candidates[0])
        assert len(literals) == 1
        return (*context, (literals[0][0], not literals[0][1]))

    def denied_elsewhere(self, literals: Literals) -> bool:
        """Whether the template says in words what is to be done where this test fails."""
        said = {literal for guard in self.guards for literal in guard}
        return any((index, not asserted) in said for index, asserted in literals)

    def leaf(self, truths: tuple[bool, ...]) -> list[int]:
        return [k for k, needed in self.reached.items() if all(truths[i] == asserted for i, asserted in needed)]


@pytest.mark.parametrize("category", CATEGORIES)
def test_templates_mean_their_category(words: Language, category: Category) -> None:
    branches = SHAPES[category].branches
    for template in words.templates[category]:
        reader = _Reader(template)
        for truths in product((True, False), repeat=len(branches)):
            at = 0
            while at >= 0:
                at = branches[at].then if truths[branches[at].condition] else branches[at].otherwise
            assert reader.leaf(truths) == [-1 - at], template


def test_the_reader_does_not_believe_everything() -> None:
    from condvln.instructions.language import _template

    dangling = _template("{if A}, {if B}, {x}; {else}, {y}; {else}, {z}.", "nested")
    with pytest.raises(AssertionError, match="one test"):
        _Reader(dangling)


def test_headings_have_names_only_where_exact() -> None:
    for k, name in enumerate(HEADINGS):
        assert heading_name(45.0 * k) == heading_name(45.0 * k - 360.0) == heading_name(45.0 * k + 0.001) == name
    with pytest.raises(UsageError, match="no name"):
        heading_name(44.0)
    assert preamble(45.0) == "You are facing north-east."
    assert len({preamble(0.0, k) for k in range(PHRASINGS)}) == PHRASINGS
