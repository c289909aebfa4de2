"""Real scenes: everything drawn is proven, reads back, and can't be guessed from its words."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from sklearn.feature_extraction import DictVectorizer
from sklearn.linear_model import LogisticRegression
from sklearn.model_selection import GroupKFold

from condvln.instructions import (
    LabelPriors,
    instruction_id,
    parse,
    reading_of,
    render,
)
from condvln.scene import Scene
from condvln.sources.registry import open_source
from condvln.verify.referents import Answer, SceneReferents
from condvln.verify.surfaces import Shapes
from condvln.verify.text_reader import read as read_by_listener
from schemas.program import CATEGORIES, SHAPES, Category, Program
from tests.condvln.instructions.conftest import T
from tests.condvln.instructions.made_sampler import made_sampler

FAMILIES = ("replicacad", "procthor", "ithor", "gibson")


def read(real_data: Path, family: str, count: int | None) -> list[Scene]:
    if not (real_data / family).is_dir():
        pytest.skip(f"no {family} in {real_data}")
    source = open_source(family, real_data / family)
    scenes = [source.read(handle.scene_id) for handle in list(source.handles())[-count if count else 0 :]]
    return [scene for scene in scenes if len(scene.objects) > 1]


@pytest.mark.parametrize("family", FAMILIES)
def test_programs_of_real_scenes_are_proven(real_data: Path, facts_maker, prove, family: str) -> None:
    # Most small buildings of Gibson have few things that surely are in one room only.
    scenes = read(real_data, family, 12 if family == "gibson" else 4)
    priors = LabelPriors.merged(LabelPriors.of_scene(scene, T, 0.3) for scene in scenes)
    wanted = dict.fromkeys(CATEGORIES, 1)
    drawn = 0
    for scene in scenes:
        facts = facts_maker(scene)
        sampler = made_sampler(scene, facts, priors.bits(scene, 0.05), per_category=wanted)
        for category in CATEGORIES:
            for program in sampler.candidates(category):
                prove(program, scene, facts)
                text = render(program, 0, instruction_id(family, scene.scene_id, program))
                assert parse(text) == reading_of(program)
                drawn += 1
    assert drawn >= 55


def test_automated_graphs_are_asked_about_what_is_there(real_data: Path, facts_maker, prove) -> None:
    """In their rooms a direction has one truth: only all directions together have both. (In Allensville nothing is left
    to ask once things of odd sizes, such as a book of a metre, are nameless; in Oyens little is, since its books are
    0.2 m thick.)
    """
    if not (real_data / "gibson").is_dir():
        pytest.skip(f"no gibson in {real_data}")
    scene = open_source("gibson", real_data / "gibson", absence="never").read("automated/Oyens")
    facts, bits = facts_maker(scene), LabelPriors.of_scene(scene, T, 0.3).bits(scene, 0.05)
    samplers = [made_sampler(scene, facts, bits, per_category={"simple": 12}, seed=seed) for seed in range(24)]
    programs = [program for sampler in samplers for program in sampler.candidates("simple")]
    # A room with few statements is asked another one less often where a stop is what was to be asked about: with one
    # seed there may be none.
    assert len(programs) >= 18
    assert len({program.conditions[0].truth for program in programs}) == 2
    for program in programs:
        prove(program, scene, facts)
        assert all(condition.definite for condition in program.conditions)


@pytest.mark.soak
def test_the_church_scan_is_asked_about_its_nave(real_data: Path, facts_maker) -> None:
    """Across the altar a nameless "object" has the size of the statue: people see two, and the scan names one. The
    verifier, by its own code, finds in each text what the program has.
    """
    if not (real_data / "mp3d").is_dir():
        pytest.skip(f"no mp3d in {real_data}")
    scene = open_source("mp3d", real_data / "mp3d").read("YmJkqBEsHnH")
    assert [room.label for room in scene.rooms] == ["nave", "chancel", "porch", "staircase"]
    facts, bits = facts_maker(scene), LabelPriors.of_scene(scene, T, 0.3).bits(scene, 0.05)
    sampler = made_sampler(scene, facts, bits, per_category={"simple": 20})
    drawn = list(sampler.candidates("simple"))
    assert len(drawn) >= 20
    # "The table in the nave is east of the pedestal": neither of the two is ever a stop, since nothing else is asked.
    assert {(c.room.label, c.label) for program in drawn for c in program.conditions} == {
        ("nave", "table"),
        ("nave", "pedestal"),
    }
    views = SceneReferents(scene, T, 0.3, Shapes(scene.root))
    for program in [*drawn, *(program for group in sampler.groups() for program in group)]:
        text = render(program, 0, "church")
        assert "the sculpture" not in re.sub(r"the sculpture (south|east)", "", text)
        reading = read_by_listener(text)
        (answer,) = [views.claim(phrase) for phrase in reading.conditions]
        assert isinstance(answer, Answer)
        assert (answer.truth,) == tuple(condition.truth for condition in program.conditions)
        found = {views.thing(stop).object_id for moves in reading.moves for stop in moves}
        assert found == {move.object_id for leaf in program.leaves for move in leaf.moves}


def cues(program: Program) -> dict[str, int]:
    """What an agent that can read but not see has to go by."""
    found = {}
    for k, c in enumerate(program.conditions):
        relation = (c.qualifier.predicate, " + ".join(c.qualifier.anchor_labels)) if c.qualifier else ("", "")
        found.update(
            {f"{k} {c.label}": 1, f"{k} {relation[0]}": 1, f"{k} {relation[1]}": 1, f"{k} {c.label} {relation}": 1}
        )
    return found | {f"{k} goal {leaf.goal.label}": 1 for k, leaf in enumerate(program.leaves)}


def guessed(drawn: Sequence[tuple[str, Program]]) -> float:
    """Share of gold leaves that a logistic regression over the cues gets right in scenes it has not seen."""
    x = DictVectorizer().fit_transform([cues(program) for _, program in drawn])
    y = np.array([program.gold_leaf() for _, program in drawn])
    right = []
    for train, test in GroupKFold(5).split(x, y, [scene for scene, _ in drawn]):
        model = LogisticRegression(C=0.1, max_iter=1000).fit(x[train], y[train])
        right.append(model.predict(x[test]) == y[test])
    return float(np.concatenate(right).mean())


@pytest.mark.soak
@pytest.mark.parametrize("family", ["replicacad", "procthor"])
def test_words_alone_do_not_tell_the_gold_leaf(real_data: Path, facts_maker, family: str) -> None:
    scenes = read(real_data, family, None)
    known = [facts_maker(scene) for scene in scenes]
    priors = LabelPriors.merged(LabelPriors.of_scene(scene, T, 0.3) for scene in scenes)

    bits = [priors.bits(scene, 0.05) for scene in scenes]

    def drawn(category: Category, informed: bool, seed: int) -> list[tuple[str, Program]]:
        found = []
        for scene, facts, own in zip(scenes, known, bits, strict=True):
            known_bits = own if informed else replace(own, counts={})
            sampler = made_sampler(scene, facts, known_bits, per_category={category: 5}, seed=seed)
            found += [(scene.scene_id, program) for program in sampler.candidates(category)]
        return found

    for category in CATEGORIES:
        # One seed alone is right in 0.53 to 0.565 of `simple`.
        right = np.mean([guessed(drawn(category, True, seed)) for seed in range(3)])
        assert right < 1 / SHAPES[category].leaves + 0.055
    if family == "replicacad":
        # Without the priors' counts the same guesser sees through rooms that repeat: the test has teeth.
        assert guessed(drawn("simple", False, 0)) > 0.5 + 0.1
