"""Groups of four in which neither always obeying one branch nor always preferring one object gets more than half."""

from __future__ import annotations

from collections import Counter

import numpy as np

from condvln.instructions import LabelPriors
from condvln.instructions.sampling import counterfactual_group, group_id, swapped
from condvln.labels import vocabulary
from condvln.seeding import Draws
from schemas.config import InstructionCell, Thresholds
from tests.condvln.instructions.made_sampler import made_sampler


def test_groups(sampled, prove) -> None:
    made = tried = 0
    for scene, facts, sampler, programs in sampled:
        draws = Draws(np.random.default_rng(0))
        for program in programs[::5]:
            tried += 1
            group = counterfactual_group(program, sampler.condition_sampler, draws, vocabulary)
            if group is None:
                continue
            made += 1
            base, flipped, exchanged, both = group
            assert base == program
            goals = [member.leaves[member.gold_leaf()].goal.object_id for member in group]
            assert goals[0] == goals[3] != goals[1] == goals[2]
            assert Counter(goals).most_common(1)[0][1] == 2, "no object is right in more than half"
            leaves = [member.gold_leaf() for member in group]
            assert leaves[0] == leaves[2] != leaves[1] == leaves[3]
            assert Counter(leaves).most_common(1)[0][1] == 2, "no branch is right in more than half"
            for member in group:
                prove(member, scene, facts)
                assert {m for leaf in member.leaves for m in leaf.moves} == {
                    m for leaf in program.leaves for m in leaf.moves
                }
            changed = [(a, b) for a, b in zip(base.conditions, flipped.conditions, strict=True) if a != b]
            ((old, new),) = changed
            assert old.truth != new.truth
            assert old.kind == new.kind
            assert old.room == new.room
            if old.qualifier is not None and new.qualifier is not None:
                assert old.qualifier.predicate == new.qualifier.predicate
            assert (exchanged.conditions, both.conditions) == (base.conditions, flipped.conditions)
            name = group_id(scene.family, scene.scene_id, group)
            assert name == group_id(scene.family, scene.scene_id, (both, exchanged, flipped, base))
            assert name != group_id(scene.family, "another", group)
    assert made > 0.8 * tried


def test_a_sampler_s_groups_take_the_categories_in_turn(make_scene, facts_maker, prove) -> None:
    scene = make_scene(1, objects=14, side=8.0)
    facts = facts_maker(scene)
    bits = LabelPriors.of_scene(scene, Thresholds(), 0.3).bits(scene, 0.05)
    wanted = {"simple": 3, "nested": 3, "chain": 3}
    asked = {"per_category": wanted, "counterfactual_groups": 3}

    def groups(**changes) -> list[tuple]:
        return list(made_sampler(scene, facts, bits, candidates=6, **asked, **changes).groups())

    found = groups()
    assert 12 <= len(found) <= 18
    assert {group[0].category for group in found[:3]} == set(wanted)
    programs = [program for group in found for program in group]
    assert len(set(programs)) == len(programs)
    for group in found:
        assert len({program.category for program in group}) == 1
        for program in group:
            prove(program, scene, facts)
    sampler = made_sampler(scene, facts, bits, candidates=6, **asked)
    before = [p for c in wanted for p in sampler.candidates(c)]
    assert list(sampler.groups()) == found, "whatever was drawn before"
    alone = made_sampler(scene, facts, bits, candidates=6, per_category=wanted, counterfactual_groups=0)
    assert [p for c in wanted for p in alone.candidates(c)] == before
    assert list(alone.groups()) == []
    in_cells = groups(cells=(InstructionCell(category="chain", composition="C1", moves=2, count=4),))
    assert {len(leaf.moves) for g in in_cells for p in g if p.category == "chain" for leaf in p.leaves} == {2}


def test_exchanging_twice_changes_nothing(sampled) -> None:
    for _, _, _, programs in sampled:
        for program in programs[::17]:
            assert swapped(swapped(program, 0, 1), 0, 1) == program
