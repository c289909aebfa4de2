"""The keys of wording: what language, voices and length change, and what they leave alone."""

from __future__ import annotations

from typing import get_args

import pytest
from pydantic import ValidationError

from condvln.instructions import LabelPriors, instruction_id, parse, reading_of, render, voice_of
from condvln.instructions.language import LANGUAGES, language
from condvln.instructions.predicates import COMPASS
from condvln.verify.text_reader import read
from schemas.config import InstructionsConfig, Thresholds, VoiceName, WordingConfig
from schemas.program import BEARINGS, SHAPES, Condition, Leaf, ObjectRef, Program, Qualifier, RoomRef
from tests.condvln.instructions.made_sampler import made_sampler


@pytest.mark.parametrize("code", LANGUAGES)
def test_the_voices_that_may_be_named_are_those_of_the_grammar(code: str) -> None:
    assert tuple(voice.name for voice in language(code).voices) == get_args(VoiceName)


@pytest.mark.parametrize("code", LANGUAGES)
def test_texts_are_in_the_voices_that_are_allowed_alone(code: str) -> None:
    allowed = WordingConfig(language=code, voices=("brief", "formal"))
    drawn = [voice_of(0, str(k), allowed).name for k in range(3000)]
    assert set(drawn) == {"brief", "formal"}
    # By their weights, 2 : 3; five standard deviations.
    assert abs(drawn.count("formal") - 1200) < 5 * (3000 * 6 / 25) ** 0.5


def test_allowing_all_voices_says_what_allowing_none_in_particular_does() -> None:
    everything = WordingConfig(voices=tuple(reversed(get_args(VoiceName))))
    assert [voice_of(3, str(k), everything) for k in range(50)] == [voice_of(3, str(k)) for k in range(50)]


@pytest.mark.parametrize("code", LANGUAGES)
def test_short_texts_have_the_same_meaning_in_fewer_words(sampled, code: str) -> None:
    short = WordingConfig(language=code, length="short")
    any_words = short_words = 0
    for scene, _, _, programs in sampled:
        for program in programs[::3]:
            name = instruction_id(scene.family, scene.scene_id, program)
            text, shortest = render(program, 0, name, code), render(program, 0, name, short)
            assert parse(shortest, code) == reading_of(program)
            any_words, short_words = any_words + len(text.split()), short_words + len(shortest.split())
    assert short_words < any_words


def test_wording_is_refused_that_names_no_voice_or_one_twice() -> None:
    for voices in ((), ("brief", "brief"), ("loud",)):
        with pytest.raises(ValidationError):
            WordingConfig(voices=voices)  # type: ignore[arg-type]


def test_wording_is_the_part_of_the_instructions_that_decides_no_program() -> None:
    whole = InstructionsConfig(language="es", voices=("list",), length="short", directions="none")
    assert whole.wording == WordingConfig(language="es", voices=("list",), length="short")


def test_without_directions_no_program_uses_compass_words(make_scene, facts_maker, sampled) -> None:
    scene, facts, _, with_compass = sampled[2]
    bits = LabelPriors.of_scene(scene, Thresholds(), 0.3).bits(scene, 0.05)
    plain = made_sampler(scene, facts, bits, directions="none", per_category={"nested": 8, "chain": 8})
    programs = [p for c in ("nested", "chain") for p in plain.candidates(c)]

    def said(found):
        named = [*(c for p in found for c in p.conditions), *(m for p in found for x in p.leaves for m in x.moves)]
        return {one.qualifier.predicate for one in named if one.qualifier is not None}

    assert programs
    assert said(programs)
    assert said(programs).isdisjoint(COMPASS)
    assert not said(with_compass).isdisjoint(COMPASS)


@pytest.mark.parametrize("code", LANGUAGES)
def test_texts_with_bearings_are_read_back_by_both_readers(make_scene, facts_maker, sampled, code: str) -> None:
    said = []
    for scene, facts, _, _ in (sampled[0], sampled[2]):
        bits = LabelPriors.of_scene(scene, Thresholds(), 0.3).bits(scene, 0.05)
        wanted = {"simple": 5, "nested": 5, "nested_chain": 5}
        sampler = made_sampler(scene, facts, bits, directions="egocentric", per_category=wanted)
        for program in (p for c in wanted for p in sampler.candidates(c)):  # type: ignore[attr-defined]
            text = render(program, 0, instruction_id(scene.family, scene.scene_id, program), code)
            assert parse(text, code) == reading_of(program)
            reading = read(text, code)
            bearings = [one.qualifier.predicate for one in program.named if one.is_bearing]
            found = {p for p in (*reading.conditions, *(s for m in reading.moves for s in m)) if p.qualifier}
            assert {p.qualifier[0] for p in found} & set(BEARINGS) == set(bearings)
            assert len(bearings) <= 2
            assert all(p.room is None for m in reading.moves for p in m if p.qualifier and p.qualifier[0] in BEARINGS)
            assert (program.start_room is None) == (not bearings)
            said += bearings
    assert set(said) == set(BEARINGS)


def test_a_program_s_bearings_are_of_one_room_and_of_definite_things() -> None:
    def condition(room: str, definite: bool = True) -> Condition:
        where = RoomRef(room_id=room, label="kitchen")
        left = Qualifier(predicate="left")
        return Condition(label="sink", room=where, qualifier=left, definite=definite, truth=False)

    with pytest.raises(ValidationError, match="definite"):
        condition("a", definite=False)
    stops = [ObjectRef(object_id=n, label=n, room=RoomRef(room_id="a", label="kitchen")) for n in ("x", "y", "z")]
    leaves = tuple(Leaf(moves=(stop,)) for stop in stops)
    shape = SHAPES["chain"].branches
    Program(category="chain", conditions=(condition("a"), condition("a")), branches=shape, leaves=leaves)
    with pytest.raises(ValidationError, match="the room of the start"):
        Program(category="chain", conditions=(condition("a"), condition("b")), branches=shape, leaves=leaves)
