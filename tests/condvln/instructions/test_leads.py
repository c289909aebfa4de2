"""Leads: "Go to the kitchen. If there's a kettle, …"."""

from __future__ import annotations

from collections import Counter

import numpy as np
import pytest

from condvln.instructions import LabelPriors, parse, program_key, reading_of, render
from condvln.instructions.language import LANGUAGES, language
from condvln.instructions.programs import oracle_linear, with_leads
from condvln.instructions.sampling import counterfactual_group
from condvln.labels import vocabulary
from condvln.seeding import Draws
from condvln.verify.text_reader import read
from schemas.config import InstructionCell, Thresholds, WordingConfig
from schemas.program import SHAPES, Condition, Leaf, ObjectRef, Program
from tests.condvln.instructions.hand_written import KITCHEN, LIVING, nested_chain
from tests.condvln.instructions.made_sampler import made_sampler

KETTLE = Condition(label="kettle", room=KITCHEN, truth=False)
PLANT = Condition(label="plant", room=LIVING, truth=True, witnesses=("p",))
RUG = Condition(label="rug", room=KITCHEN, truth=False)
SINK, SOFA, LAMP, STOVE = (
    ObjectRef(object_id=label, label=label, room=room)
    for label, room in (("sink", KITCHEN), ("sofa", LIVING), ("lamp", LIVING), ("stove", KITCHEN))
)


def simple(condition: Condition, *stops: ObjectRef) -> Program:
    leaves = tuple(Leaf(moves=(stop,)) for stop in stops)
    return Program(category="simple", conditions=(condition,), branches=SHAPES["simple"].branches, leaves=leaves)


def test_a_lead_goes_to_each_other_room() -> None:
    program = with_leads(nested_chain((KETTLE, PLANT, RUG), [(SOFA,), (LAMP,), (SINK,), (STOVE,)]))
    assert [branch.lead for branch in program.branches] == [KITCHEN, LIVING, None]
    assert [program.leads(leaf) for leaf in range(4)] == [(KITCHEN, LIVING)] * 2 + [(KITCHEN,)] * 2
    assert program.stops(0) == ("k", "l", "sofa")
    assert program.last_leads == (KITCHEN, LIVING, KITCHEN)
    assert oracle_linear(program, 1) == (KITCHEN, LIVING, LAMP)


def test_programs_without_leads_keep_their_ids() -> None:
    bare = simple(KETTLE, SINK, SOFA)
    assert program_key(bare) != program_key(with_leads(bare))
    assert '"lead"' not in bare.model_dump_json(exclude_none=True)


@pytest.mark.parametrize("name", [str(k) for k in range(8)])
def test_its_condition_does_not_name_the_room(name: str) -> None:
    text = render(with_leads(simple(KETTLE, SINK, SOFA)), 0, name)
    first = text.partition("kettle")[0]
    assert "kitchen" in first
    assert " in the kitchen" not in text.partition("kettle")[2].partition(",")[0]
    assert [parse(text).leads[0].label, read(text).leads[0].label] == ["kitchen", "kitchen"]


def test_with_one_room_all_that_is_named_is_there() -> None:
    program = with_leads(simple(KETTLE, SINK, STOVE))
    for code in LANGUAGES:
        text = render(program, 0, "any", code)
        assert text.count("kitchen" if code == "en" else "cocina") == 1
        assert parse(text, code) == reading_of(program)


def test_every_voice_has_words_for_every_lead() -> None:
    for code in LANGUAGES:
        for templates in language(code).templates.values():
            several = [one for one in templates if one.allows([True] * len(one.stated)) and not one.is_choosy]
            assert several


@pytest.mark.parametrize("length", ["any", "short"])
@pytest.mark.parametrize("code", LANGUAGES)
def test_short_and_long_texts_read_back(sampled, code: str, length: str) -> None:
    wording = WordingConfig.model_validate({"language": code, "length": length})
    for scene, _, _, programs in sampled:
        for k, program in enumerate(programs[::3] if len(scene.rooms) > 1 else ()):
            led = with_leads(program)
            text = render(led, 0, str(k), wording)
            assert parse(text, code) == reading_of(led), text
            found = Counter(lead and (lead.label, lead.anchor) for lead in read(text, code).leads)
            leads = [branch.lead for branch in led.branches]
            assert found == Counter(lead and (lead.label, lead.anchor_label) for lead in leads), text


def test_groups_keep_their_leads(sampled) -> None:
    made = 0
    for scene, _, sampler, programs in sampled:
        draws = Draws(np.random.default_rng(0))
        for program in programs[::5] if len(scene.rooms) > 1 else ():
            group = counterfactual_group(with_leads(program), sampler.condition_sampler, draws, vocabulary)
            for member in group or ():
                assert [member.led_branches(k) for k in range(len(member.leaves))] == [
                    group[0].led_branches(k) for k in range(len(member.leaves))
                ]
                golds = {one.led_branches(one.gold_leaf()) for one in group}
                assert len(golds) == 1, "exchanged leaves keep where their leads end"
                assert member.branches == group[0].branches
                assert {member.stops(leaf) for leaf in range(len(member.leaves))} == {
                    group[0].stops(leaf) for leaf in range(len(member.leaves))
                }
            made += group is not None
    assert made


def test_leads_are_drawn_as_a_cell_asks(make_scene, facts_maker) -> None:
    scene = make_scene(1)
    bits = LabelPriors.of_scene(scene, Thresholds(), 0.3).bits(scene, 0.05)
    sampler = made_sampler(scene, facts_maker(scene), bits, leads=0.25)
    asked = [InstructionCell(category="simple", count=4, leads=leads) for leads in (None, "with", "without")]
    assert [sampler.leads_of(cell) for cell in asked] == ([0.25, 1.0, 0.0] if len(scene.rooms) > 1 else [0.0] * 3)
    assert [cell.name for cell in asked] == ["simple", "simple with leads", "simple without leads"]
