"""Chains that look for one thing in several places."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from condvln.instructions import LabelPriors
from condvln.instructions.parsing import parse
from condvln.instructions.programs import oddness
from condvln.instructions.rendering import render
from condvln.relations import TextFacts
from condvln.scene import Room, Scene, SceneObject
from schemas.config import SamplingConfig, Thresholds
from schemas.program import Category, Program
from tests.condvln.instructions.made_sampler import made_sampler


def thing(name: str, x: float, z: float, low: float, high: float, half: float) -> SceneObject:
    box = np.array([[x - half, low, z - half], [x + half, high, z + half]])
    return SceneObject(name, "r", name, name, box.mean(axis=0), aabb=box)


def flat(where: str, *, near: bool = False, beside: bool = False) -> Scene:
    """A bedroom with four places, 4 m from one another, or 0.1 m if they are `near`; the book is on one of them.
    `beside`: the sofa is 0.1 m from the bed, and all else as without.
    """
    step, half = (0.7, 0.3) if near else (5.0, 0.6)
    places = {"desk": (0.0, 0.0), "bed": (step, 0.0), "coffee table": (0.0, step), "sofa": (step, step)}
    if beside:
        places["sofa"] = (step, 1.3)
    things = [thing(name, x, z, 0.0, 0.6, half) for name, (x, z) in places.items()]
    things += [thing("book", *places[where], 0.6, 0.65, 0.15), thing("floor lamp", 2 * step, 0.0, 0.0, 1.6, 0.2)]
    room = Room("r", "bedroom", "bedroom", 0, 0.0, 2.5, None, "dataset", True)
    return Scene(family="procthor", scene_id=where, root=Path("."), rooms=(room,), objects=tuple(things))


def drawn(
    scene: Scene, facts: Mapping[str, TextFacts], category: Category, search: float, most_odd: int | None = None
) -> list[Program]:
    homes = [
        replace(flat(where), scene_id=f"{where} {k}")
        for where in ("desk", "bed", "coffee table", "sofa")
        for k in range(6)
    ]
    corpus = LabelPriors.merged(LabelPriors.of_scene(home, Thresholds(), 0.3) for home in homes)
    sampling = SamplingConfig(search=search, most_odd=most_odd, candidates_per_episode=6, moves_drawn=(1.0, 0.0, 0.0))
    sampler = made_sampler(
        scene, facts, corpus.bits(scene, 0.05), sampling=sampling, per_category={category: 8}, label_cap=1.0
    )
    return list(sampler.candidates(category))


def places_of(program: Program) -> list[str]:
    """The place that each condition asks about."""
    return [one.qualifier.anchor_ids[0] if one.qualifier else "" for one in program.conditions]


def searches(program: Program) -> bool:
    return len({condition.label for condition in program.conditions[:2]}) == 1


@pytest.mark.parametrize("category", ["chain", "long_chain"])
def test_one_thing_is_looked_for_in_places_where_one_can_be_sent(facts_maker, category: Category) -> None:
    scene = flat("desk")
    programs = drawn(scene, facts_maker(scene), category, 1.0)
    found = [program for program in programs if searches(program)]
    assert len(found) == len(programs) > 10
    for program in found:
        places = places_of(program)
        assert {condition.label for condition in program.conditions} == {"book"}
        assert len(set(places)) == len(places), "each place is asked about once"
        truths = [condition.truth for condition in program.conditions]
        assert truths == [place == "desk" for place in places], "it is where it is"
    golds = Counter(program.gold_leaf() for program in found)
    assert len(golds) == len(found[0].leaves), "found at each place, and at none"
    sent = [
        program.leaves[k].goal.object_id == place for program in found for k, place in enumerate(places_of(program))
    ]
    assert np.mean(sent) > 0.5, "one goes to where it is"
    for program in found:
        text = render(program, 0, "name")
        assert len(parse(text, "en").conditions) == len(program.conditions)


def test_places_at_one_spot_are_not_looked_through(facts_maker) -> None:
    scene = flat("desk", near=True)
    assert not any(map(searches, drawn(scene, facts_maker(scene), "chain", 1.0)))


def test_no_two_places_at_one_spot_are_asked_about(facts_maker: Callable[[Scene], dict[str, TextFacts]]) -> None:
    scene = flat("desk", beside=True)
    asked = [frozenset(places_of(program)) for program in drawn(scene, facts_maker(scene), "chain", 1.0)]
    assert {"bed", "sofa"} <= frozenset.union(*asked)
    assert frozenset(("bed", "sofa")) not in asked
    assert len(asked) > 10


def test_none_is_looked_for_if_none_is_wanted(facts_maker) -> None:
    scene = flat("desk")
    assert not any(map(searches, drawn(scene, facts_maker(scene), "chain", 0.0)))


@pytest.mark.parametrize("most", [0, 3])
def test_odd_programs_are_left_out(facts_maker: Callable[[Scene], dict[str, TextFacts]], most: int) -> None:
    scene = flat("desk")
    odd = [oddness(program) for program in drawn(scene, facts_maker(scene), "simple", 0.0)]
    assert max(odd) > 3
    kept = [oddness(program) for program in drawn(scene, facts_maker(scene), "simple", 0.0, most)]
    assert max(kept) == most
