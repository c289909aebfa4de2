"""The grammar as data: coherent voices, nouns that can be told apart, and templates that a listener takes as meant."""

from __future__ import annotations

import re
from dataclasses import replace

import pytest

from condvln.instructions.language import LANGUAGES, Language, _template, language
from condvln.instructions.rendering import HEADINGS, heading_name, preamble, voice_of
from condvln.language.binding import findings
from schemas.errors import UsageError
from schemas.program import CATEGORIES, SHAPES, Category

BANNED = (
    "provided", "supposing", "assuming", "in the event", "on condition", "barring", "failing that", "such a",
    "moreover", "furthermore", "besides", "situated", "positioned", "located", "happen", "one can find", "turns out",
    "at least one", "look further", "as follows", "all of this", "to begin with", "or else", "if that is so",
    "if the answer",
)  # fmt: skip
"""What readers stumbled over: none of it may come back."""


@pytest.fixture(params=LANGUAGES)
def words(request: pytest.FixtureRequest) -> Language:
    return language(request.param)


def test_there_are_five_or_six_voices_and_each_says_every_category(words: Language) -> None:
    assert 5 <= len(words.voices) <= 6
    for voice in words.voices:
        for category in CATEGORIES:
            assert voice.templates[category], (voice.name, category)
    named = {name for templates in words.templates.values() for t in templates for name in t.voices}
    assert named == {voice.name for voice in words.voices}


def test_no_voice_mixes_contractions_with_full_forms() -> None:
    for voice in language("en").voices:
        said = " ".join(phrase for slot in ("exists", "absent") for phrase in voice.slots[slot])
        assert len(set(re.findall(r"there(?:'s| is)", said))) == 1, voice.name


def test_nothing_stilted_comes_back() -> None:
    words = language("en")
    phrases = [
        p for slots in (words.slots, words.predicates, words.connectives) for those in slots.values() for p in those
    ]
    pieces = [p for ts in words.templates.values() for t in ts for p in t.pieces if isinstance(p, str)]
    for text in [*phrases, *pieces]:
        assert not [banned for banned in BANNED if banned in text.lower()], text


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
        for phrase in phrases:
            for noun in words.nouns.values():
                said = phrase.format(a="", lo="", cercano="", ninguno="", alguno="", ningun="")
                text = f"{said} {words.definite(noun)}"
                assert words.expanded(words.contracted(text)) == words.expanded(text)


# -- what a listener takes the answers for -----------------------------------------------------------------------------


@pytest.mark.parametrize("category", CATEGORIES)
def test_a_listener_takes_every_template_as_it_is_meant(words: Language, category: Category) -> None:
    for template in words.templates[category]:
        assert list(findings(words, category, template)) == []


@pytest.mark.parametrize(
    ("category", "text", "what"),
    [
        # "If not" goes with B, the last thing asked.
        ("nested", "If {A}, {see B}: if {yes B}, {x}; if {no B}, {y}. If not, {z}.", "listener goes to"),
        ("nested", "If {A}, {see B}: if {yes B}, {x}; if {no B}, {y}. If {no A}, {z}.", "comes after condition 1"),
        ("nested", "If {A}, {see B}: if {yes B}, {x}; if {no B}, {y}. Otherwise, {z}.", "exactly one"),
        ("chain", "If {A}, {x}. If {B}, {y}. If neither fits, {z}.", "listener goes to"),  # both may hold
        ("simple", "If {-A}, {y}. If not, {x}.", "listener goes to"),
        ("simple", "{see A}. If {no A}, {x}. If {yes A}, {y}.", "listener goes to"),
        ("simple", "If {A}, {x}. Failing that, {y}.", "not one of the language's connectives"),
        ("simple", "{y} if {A}. If not, {x}.", "listener goes to"),
        ("nested_chain", "If {A}, {x}. If {neither A C}, {w}. If {B}, {y}. If {C}, {z}.", "before conditions 0 and 2"),
        (
            "long_chain",
            "If {A}, {x}. If not, but {B}, {y}. If neither fits, but {C}, {z}. If neither fits, {w}.",
            "3",
        ),
    ],
)
def test_the_lint_finds_what_a_listener_would_take_wrongly(category: Category, text: str, what: str) -> None:
    words = language("en")
    template = _template({"voices": "brief", "text": text}, category)
    (finding, *_) = findings(words, category, template)
    assert what in finding.what


def test_agreeing_with_a_denial_is_found() -> None:
    """ "Si la caja no está cerca, ve al banco. Si es así, …" agrees that it isn't; so does "if so"."""
    text = "Si {-A}, {y}. Si es así, {x}."
    (finding,) = findings(language("es"), "simple", _template({"voices": "brief", "text": text}, "simple"))
    assert "agrees with the denial" in finding.what
    said = _template({"voices": "brief", "text": "Si {-A}, {y}. Si {yes A}, {x}."}, "simple")
    assert not list(findings(language("es"), "simple", said)), "si hay alguna"
    words = language("es")
    agreeing = replace(words, slots={**words.slots, "yes_it": ("es así",)})
    (finding,) = findings(agreeing, "simple", said)
    assert "agrees with the denial" in finding.what
    so = _template({"voices": "brief", "text": "If {-A}, {y}. If so, {x}."}, "simple")
    (finding,) = findings(language("en"), "simple", so)
    assert "agrees with the denial" in finding.what
    plain = _template({"voices": "brief", "text": "If {-A}, {y}. If {yes A}, {x}."}, "simple")
    assert not list(findings(language("en"), "simple", plain))


def test_a_template_asks_everything_and_names_each_leaf() -> None:
    for text in ("If {A}, {x}.", "If {A}, {x}. If not, {x}.", "Go to {x}, or {y}."):
        with pytest.raises(AssertionError, match="ask each condition"):
            _template({"voices": "brief", "text": text}, "simple")
    with pytest.raises(AssertionError, match="unknown slot"):
        _template({"voices": "brief", "text": "If {Q}, {x}."}, "simple")
    assert all(SHAPES[c].leaves == 2 for c in ("simple",))


def test_headings_have_names_only_where_exact() -> None:
    for k, name in enumerate(HEADINGS):
        assert heading_name(45.0 * k) == heading_name(45.0 * k - 360.0) == heading_name(45.0 * k + 0.001) == name
    with pytest.raises(UsageError, match="is not a multiple of 45°"):
        heading_name(44.0)
    brief = next(voice for voice in language("en").voices if voice.name == "brief")
    assert preamble(45.0, brief) == "You're facing north-east."


def test_voices_are_drawn_by_their_weights() -> None:
    words = language("en")
    drawn = [voice_of(0, str(k)).name for k in range(4000)]
    whole = sum(voice.weight for voice in words.voices)
    for voice in words.voices:
        assert abs(drawn.count(voice.name) / 4000 - voice.weight / whole) < 0.04, voice.name
