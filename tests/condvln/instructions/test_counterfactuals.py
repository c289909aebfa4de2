"""Groups of four in which neither always obeying one branch nor always preferring one object gets more than half."""

from __future__ import annotations

from collections import Counter

import numpy as np

from condvln.instructions.counterfactuals import counterfactual_group, group_id, swapped
from condvln.instructions.draws import Draws
from condvln.labels import vocabulary


def test_groups(sampled, prove) -> None:
    made = tried = 0
    for scene, facts, sampler, programs in sampled:
        draws = Draws(np.random.default_rng(0))
        for program in programs[::5]:
            tried += 1
            group = counterfactual_group(program, sampler.asker, draws, vocabulary)
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


def test_exchanging_twice_changes_nothing(sampled) -> None:
    for _, _, _, programs in sampled:
        for program in programs[::17]:
            assert swapped(swapped(program, 0, 1), 0, 1) == program
