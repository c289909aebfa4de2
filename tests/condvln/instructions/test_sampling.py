"""Programs drawn are true, unique in reference, silent about their answers: proven without the sampler's code."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from copy import copy
from dataclasses import replace
from itertools import product
from typing import Any, cast

import numpy as np
import pytest
from pydantic import ValidationError
from scipy.stats import binomtest, chisquare

from condvln.instructions import LabelPriors, ProgramSampler
from condvln.instructions.cell_drawing import Seen
from condvln.instructions.condition_sampler import ConditionSampler
from condvln.instructions.conditions import ConditionPool, RelationPool
from condvln.instructions.degeneracy import REASONS
from condvln.instructions.predicates import COMPASS, GROUP_OF, PREDICATE_GROUPS, PREDICATES
from condvln.instructions.programs import composition, instruction_id
from condvln.instructions.rendering import names_compass, render, with_preamble, word_count
from condvln.instructions.stops import Stops, Targets, preferences
from condvln.labels import vocabulary
from condvln.labels.lists import goes_with
from condvln.scene import Scene
from schemas.config import InstructionCell, InstructionsConfig, SamplingConfig, Thresholds
from schemas.config.instructions import PredicateWeights
from schemas.program import CATEGORIES, SHAPES, Anchor, Condition, ObjectRef, Program, Qualifier, RoomRef, anchors_of
from tests.condvln.instructions.conftest import HOUSE, facts_of, made_scene
from tests.condvln.instructions.made_sampler import made_sampler

ALPHA = 1e-4
"""False alarms that a statistical test with a fixed seed may have when it is first written."""


TWO_BEDROOMS = 26
"""Made houses in which at least thirty texts name a bedroom by a thing in it."""


def simple(**axes: Any) -> InstructionCell:
    """A cell of the category with one condition."""
    return InstructionCell(category="simple", **axes)


def test_every_program_is_proven(sampled, prove) -> None:
    for scene, facts, _, programs in sampled:
        assert len(programs) > 6 * 54, "nearly every wish is met"
        for program in programs:
            prove(program, scene, facts)


def test_programs_are_distinct(sampled) -> None:
    for _, _, _, programs in sampled:
        assert len(set(programs)) == len(programs)


def test_stops_lie_apart(sampled) -> None:
    for scene, _, _, programs in sampled:
        least = 1.5 if scene.single_room else 2.5
        where = {o.object_id: o.center[[0, 2]] for o in scene.objects}
        for program in programs:
            goals = [leaf.goal.object_id for leaf in program.leaves]
            pairs = [(a, b) for k, a in enumerate(goals) for b in goals[:k]]
            for leaf in program.leaves:
                ids = [m.object_id for m in leaf.moves]
                pairs += [(a, b) for k, a in enumerate(ids) for b in ids[:k]]
                pairs += [(a, g) for a in ids[:-1] for g in goals]
            assert all(np.linalg.norm(where[a] - where[b]) >= least for a, b in pairs)


def test_the_gold_leaf_is_even(sampled) -> None:
    for category in CATEGORIES:
        golds = Counter(p.gold_leaf() for _, _, _, programs in sampled for p in programs if p.category == category)
        n_leaves = {"simple": 2, "nested": 3, "chain": 3}.get(category, 4)
        assert chisquare([golds[k] for k in range(n_leaves)]).pvalue > ALPHA, category


def test_numbers_of_moves_of_programs_have_these_shares(sampled) -> None:
    """An apartment has room for every shape. A house of five rooms has not: some shapes of long routes
    are given up there, and none is added.
    """
    for scene, _, sampler, programs in sampled:
        for four in (False, True):
            shares = np.array(sampler.sampling.drawn_move_shares("nested_chain" if four else "simple"))
            own = [p for p in programs if (SHAPES[p.category].leaves == 4) == four]
            moves = Counter(len(leaf.moves) for p in own for leaf in p.leaves)
            if scene.single_room:
                assert len(own) == 60 * sum((SHAPES[c].leaves == 4) == four for c in CATEGORIES)
                fits_shares(moves, shares)
            else:
                ones = binomtest(moves[1], moves.total(), shares[0], alternative="less")
                assert ones.pvalue > ALPHA, (scene.scene_id, moves)


def fits_shares(counts: Counter[int], shares: Sequence[float]) -> None:
    """The numbers 1, 2, … were drawn with these shares, as far as their count can tell."""
    assert counts.keys() <= set(range(1, len(shares) + 1))
    found = [counts[k] for k in range(1, len(shares) + 1)]
    assert chisquare(found, counts.total() * np.array(shares)).pvalue > ALPHA, (found, shares)


def test_counterfactual_groups_have_the_asked_numbers_of_moves(sampled) -> None:
    """Placing takes the first that fit, so the shares that are drawn are those that are published. In an apartment no
    shape is given up.
    """
    moves: dict[bool, Counter[int]] = {True: Counter(), False: Counter()}
    for _, _, sampler, _ in (one for one in sampled if one[0].single_room):
        many = copy(sampler)
        many.wanted = sampler.wanted.model_copy(update={"counterfactual_groups": 10})
        for group in many.groups():
            moves[len(group[0].leaves) == 4].update(len(leaf.moves) for leaf in group[0].leaves)
    for four, category in ((False, "simple"), (True, "nested_chain")):
        assert moves[four].total() >= 200
        fits_shares(moves[four], sampled[0][2].sampling.move_shares(category))


def named_in(program: Program) -> list[tuple[str, str]]:
    """Room and label of everything that a text names, names of rooms included."""
    named = [(one.room, one.label) for one in program.named]
    named += [(one.room, label) for one in program.named if one.qualifier for label in one.qualifier.anchor_labels]
    named += [(one.room, one.room.anchor_label) for one in program.named if one.room.anchor_label]
    return [(room.room_id, label) for room, label in named]


def test_a_word_names_things_of_one_room_only(sampled) -> None:
    for _, _, _, programs in sampled:
        for program in programs:
            named = named_in(program)
            rooms = {
                word: {room for room, label in named if word in vocabulary.overlapping(label)} for _, word in named
            }
            assert max(map(len, rooms.values())) == 1


@pytest.fixture(scope="module")
def of_two_bedrooms() -> list[list[Program]]:
    """Programs of full houses with two bedrooms: a text that names both needs a thing to tell them apart."""
    found = []
    for seed in range(TWO_BEDROOMS):
        scene = made_scene(seed, HOUSE, 18)
        bits = LabelPriors.of_scene(scene, Thresholds(), 0.3).bits(scene, 0.05)
        sampler = made_sampler(scene, facts_of(scene), bits, per_category=dict.fromkeys(CATEGORIES, 3))
        found.append([p for category in CATEGORIES for p in sampler.candidates(category)])
    return found


def test_what_names_a_room_is_named_for_nothing_else(of_two_bedrooms) -> None:
    tagged = 0
    for programs in of_two_bedrooms:
        for program in programs:
            rooms = {one.room for one in program.named if one.room.anchor_label}
            tags = [vocabulary.overlapping(room.anchor_label or "") for room in rooms]
            said = [label for _, label in named_in(program)]
            assert all(sum(label in words for label in said) == tally(program, words) for words in tags)
            tagged += bool(tags)
    assert tagged >= 30, "this is tried often enough"


def tally(program: Program, words: frozenset[str]) -> int:
    """How many names of rooms in a program are among `words`."""
    return sum(one.room.anchor_label in words for one in program.named)


def test_at_most_one_room_is_named_by_a_thing_in_it(sampled, of_two_bedrooms) -> None:
    # A single one of many houses with two bedrooms may have nothing to ask elsewhere.
    for programs in [*(programs for *_, programs in sampled), [p for own in of_two_bedrooms for p in own]]:
        tags = Counter(len({one.room for one in p.named if one.room.anchor_label}) for p in programs)
        assert tags[0] >= 0.7 * len(programs)
        assert set(tags) <= {0, 1}


def test_conditions_are_asked_in_rooms_with_a_plain_name(sampled) -> None:
    """ "If, in the bedroom that has the desk, the lamp is near the bed, …" is hard to follow."""
    asked = Counter(
        condition.room.anchor_label is None
        for _, _, _, programs in sampled
        for program in programs
        if any(one.room.anchor_label is None for one in program.named)
        for condition in program.conditions
    )
    assert asked[False] <= 0.05 * asked.total()


def test_leaves_begin_with_different_stops_and_a_thing_has_one_name(sampled) -> None:
    for _, _, _, programs in sampled:
        for program in programs:
            firsts = Counter(leaf.moves[0].object_id for leaf in program.leaves)
            assert max(firsts.values()) <= (len(program.leaves) + 1) // 2
            stops = {move for leaf in program.leaves for move in leaf.moves}
            assert len(stops) == len({stop.object_id for stop in stops})


def test_conditions_off_the_gold_route_are_fair_coins(sampled) -> None:
    off = Counter(
        condition.truth
        for _, _, _, programs in sampled
        for p in programs
        for k, condition in enumerate(p.conditions)
        if k not in p.route()[0]
    )
    assert chisquare([off[True], off[False]]).pvalue > ALPHA


def test_kind_and_predicate_do_not_tell_the_truth(sampled) -> None:
    for position in ("simple", "nested", "chain"):
        # In these shapes the first condition is true for one leaf of n or for all but one.
        firsts = [p.conditions[0] for _, _, _, programs in sampled for p in programs if p.category == position]
        truth = np.mean([c.truth for c in firsts])
        for cue in ("presence", "near", "compass"):
            chosen = [c.truth for c in firsts if cue_of(c) == cue]
            if len(chosen) >= 30:
                expected = [truth * len(chosen), (1 - truth) * len(chosen)]
                assert chisquare([sum(chosen), len(chosen) - sum(chosen)], expected).pvalue > ALPHA, (position, cue)


def test_definite_questions_are_as_often_true_as_indefinite_ones(sampled) -> None:
    """Where there are several lamps, one of them is near the bed more often than the only one of a room is."""
    places = [(p.category, k, c) for _, _, _, programs in sampled for p in programs for k, c in enumerate(p.conditions)]
    truths: dict[tuple[str, int], list[bool]] = {}
    for category, k, condition in places:
        truths.setdefault((category, k), []).append(condition.truth)
    usual = {place: float(np.mean(found)) for place, found in truths.items()}
    for definite in (True, False):
        asked = [(c.truth, usual[category, k]) for category, k, c in places if c.qualifier and c.definite == definite]
        excess = sum(truth - expected for truth, expected in asked)
        deviation = np.sqrt(sum(expected * (1.0 - expected) for _, expected in asked))
        assert len(asked) > 300
        assert abs(excess) < 3.9 * deviation, (definite, excess / deviation)


def cue_of(condition: Condition) -> str:
    if condition.qualifier is None:
        return "presence"
    return "compass" if condition.qualifier.predicate.endswith(" of") else condition.qualifier.predicate


def test_no_label_is_the_target_too_often(sampled) -> None:
    for _, _, sampler, programs in sampled:
        for category in CATEGORIES:
            labels = Counter(leaf.goal.label for p in programs if p.category == category for leaf in p.leaves)
            # Goals that don't fit stay as they were drawn, under the same cap.
            assert max(labels.values()) <= 1.5 * sampler.label_cap * sum(labels.values()) + 1


def test_few_label_only_conditions_where_a_scene_is_one_room(sampled) -> None:
    false = [c for s, _, _, programs in sampled if s.single_room for p in programs for c in p.conditions if not c.truth]
    assert sum(c.kind == "presence" for c in false) <= 0.2 * len(false)


def test_compositions(sampled) -> None:
    for scene, _, _, programs in sampled:
        found = Counter(composition(p) for p in programs)
        if scene.single_room:
            assert set(found) == {"C0"}
        else:
            # Four leaves hardly ever fit into one small room; two do.
            small = Counter(composition(p) for p in programs if p.category == "simple")
            assert min(small[c] for c in ("C0", "C1", "C2")) >= 0.05 * sum(small.values())
            assert found["C1"] > found["C2"]
            # What is looked for in several places is looked for in few rooms.
            others = [p for p in programs if p.category not in ("chain", "long_chain")]
            assert sum(composition(p) == "C2" for p in others) >= 0.15 * len(others)


@pytest.mark.parametrize("composition_", ["C0", "C1", "C2"])
@pytest.mark.parametrize("moves", [1, 3])
def test_a_cell_can_be_asked_for(make_scene, facts_maker, composition_: str, moves: int) -> None:
    # Many boxes of few labels in a room can't all be told apart, and every label is in two rooms or more.
    scene = make_scene(0, objects=10 if (composition_, moves) == ("C0", 3) else 14, side=8.0)
    facts, bits = facts_maker(scene), LabelPriors.of_scene(scene, Thresholds(), 0.3).bits(scene, 0.05)
    cells = (InstructionCell(category="nested", composition=composition_, moves=moves, count=2),)
    sampler = made_sampler(scene, facts, bits, per_category={"nested": 90}, cells=cells, candidates=10)
    programs = list(sampler.candidates("nested"))
    assert {composition(p) for p in programs} == {composition_}
    assert {len(leaf.moves) for p in programs for leaf in p.leaves} == {moves}
    assert len(programs) >= 9, "a small room can't fulfil every wish"


def test_a_cell_that_cannot_be_had_says_why(make_scene, facts_maker) -> None:
    scene = make_scene(0, ("apartment",), 20)
    cell = InstructionCell(category="nested", composition="C2", count=1)
    bits = LabelPriors.of_scene(scene, Thresholds(), 0.3).bits(scene, 0.05)
    sampler = made_sampler(scene, facts_maker(scene), bits, cells=(cell,), candidates=5)
    assert list(sampler.candidates("nested")) == []
    assert set(sampler.rejections) == {(cell, "no_targets")}


@pytest.mark.parametrize("preamble", [True, False])
def test_a_cell_bounds_the_words_of_the_published_text(make_scene, facts_maker, preamble: bool) -> None:
    scene = make_scene(0, side=8.0)
    facts, bits = facts_maker(scene), LabelPriors.of_scene(scene, Thresholds(), 0.3).bits(scene, 0.05)

    def drawn(*cells: InstructionCell) -> tuple[ProgramSampler, list[Program]]:
        sampler = made_sampler(scene, facts, bits, cells=cells, candidates=10, preamble=preamble)
        return sampler, list(sampler.candidates("simple"))

    def texts(program: Program) -> list[str]:
        """As it is published from each heading."""
        text = render(program, 0, instruction_id(scene.family, scene.scene_id, program))
        opened = preamble and names_compass(program)
        name = instruction_id(scene.family, scene.scene_id, program)
        return [with_preamble(text, 45.0 * k, 0, name) for k in range(8)] if opened else [text]

    def words(program: Program) -> int:
        (count,) = {len(text.split()) for text in texts(program)}
        name = instruction_id(scene.family, scene.scene_id, program)
        assert word_count(program, 0, name, preamble=preamble) == count
        return count

    _, free = drawn(simple(count=4))
    assert len({len(texts(program)) for program in free}) == (2 if preamble else 1), "some name the heading, some don't"
    least, middle, most = (int(n) for n in np.percentile([words(p) for p in free], [0, 50, 100]))
    assert least < middle < most
    low, high = (
        simple(words=(least, middle), count=4),
        simple(words=(middle, most), count=4),
    )
    sampler, bounded = drawn(low, high)
    found = Counter(
        cell for cell, program in sampler.drawn("simple") if cell.words[0] <= words(program) <= cell.words[1]
    )
    assert found.total() == len(bounded)
    assert min(found[low], found[high]) >= 20
    one = simple(words=(middle, middle), count=4)
    assert {words(program) for program in drawn(one)[1]} == {middle}, "both bounds are allowed"
    none = simple(words=(1, least // 2), count=1)
    sampler, programs = drawn(none)
    assert programs == []
    assert sampler.rejections[none, "words_missed"] > 100


NOWHERE = np.zeros((0, 0), dtype=bool)


@pytest.mark.parametrize("group", PREDICATE_GROUPS)
def test_every_weight_of_a_predicate_decides(make_scene, facts_maker, group: str) -> None:
    """For conditions and for names of stops, also of predicates that no made scene has a use for."""
    weights = PredicateWeights(**{name: 0.7 * (name == group) for name in PREDICATE_GROUPS})
    own, sampling = PREDICATE_GROUPS[group], SamplingConfig(predicates=weights)
    pool = ConditionPool(None, dict.fromkeys(product(PREDICATES, (True, False)), cast("RelationPool", None)))
    asked = ConditionSampler({}, sampling, vocabulary, Targets((), NOWHERE, NOWHERE), single_room=False)._groups(pool)
    assert [(forms, weight) for forms, weight in asked if weight] == [(tuple(product(own, (True, False))), 0.7)]
    scene = make_scene(0)
    bits = LabelPriors.of_scene(scene, Thresholds(), 0.3).bits(scene, 0.05)
    sampler = made_sampler(scene, facts_maker(scene), bits, sampling=sampling)
    anchors = [Anchor(object_id=name, label=name) for name in ("sofa", "desk")]
    names = [
        ObjectRef(
            object_id="lamp",
            label="lamp",
            room=RoomRef(room_id="room", label="bedroom"),
            qualifier=Qualifier(predicate=predicate, anchors=tuple(anchors[: anchors_of(predicate)])),
        )
        for predicate in PREDICATES
    ]
    groups = [GROUP_OF[name.qualifier.predicate] for name in names]
    weights = preferences(groups, sampler.sampling)
    assert weights == [0.7 / len(own) if predicate in own else 0.0 for predicate in PREDICATES]


def test_reasons_are_named(sampled) -> None:
    counted = {reason for _, _, sampler, _ in sampled for _, reason in sampler.rejections}
    assert counted <= set(REASONS)
    assert counted


def draw(scene: Scene, facts, seed: int = 0, stops: Stops | None = None) -> dict[str, list[Program]]:
    bits = LabelPriors.of_scene(scene, Thresholds(), 0.3).bits(scene, 0.05)
    sampler = made_sampler(scene, facts, bits, per_category=dict.fromkeys(CATEGORIES, 1), seed=seed, stops=stops)
    return {c: list(sampler.candidates(c)) for c in CATEGORIES}


def test_programs_depend_on_the_seed_and_on_nothing_else(make_scene, facts_maker) -> None:
    scene = make_scene(3)
    facts = facts_maker(scene)
    first = draw(scene, facts)
    turned = replace(scene, objects=scene.objects[::-1], rooms=scene.rooms[::-1])
    assert draw(turned, dict(reversed(facts.items()))) == first
    assert draw(scene, facts, seed=1) != first
    # A category's programs don't depend on which others are drawn, or when.
    bits = LabelPriors.of_scene(scene, Thresholds(), 0.3).bits(scene, 0.05)
    alone = made_sampler(scene, facts, bits, per_category={"chain": 1})
    assert list(alone.candidates("chain")) == first["chain"]


def test_what_navigation_knows_is_kept_to(make_scene, facts_maker) -> None:
    scene = make_scene(5)
    names = sorted(o.object_id for o in scene.objects)[::2]
    apart = np.random.default_rng(0).random((len(names), len(names))) < 0.7
    apart &= apart.T
    np.fill_diagonal(apart, False)
    row = {name: k for k, name in enumerate(names)}
    programs = [p for ps in draw(scene, facts_maker(scene), stops=Stops(tuple(names), apart)).values() for p in ps]
    assert programs
    for program in programs:
        stops = [move.object_id for leaf in program.leaves for move in leaf.moves]
        goals = [leaf.goal.object_id for leaf in program.leaves]
        assert set(stops) <= set(names)
        assert all(apart[row[a], row[b]] for k, a in enumerate(goals) for b in goals[:k])


def test_a_scene_with_nothing_to_tell_apart_yields_nothing_and_says_so(make_scene, facts_maker) -> None:
    scene = make_scene(0, ("apartment",), 3)
    same = replace(scene, objects=tuple(replace(o, label="chair") for o in scene.objects))
    bits = LabelPriors.of_scene(same, Thresholds(), 0.3).bits(same, 0.05)
    sampler = made_sampler(same, facts_maker(same), bits)
    assert list(sampler.candidates("simple")) == []
    assert sampler.rejections == {(simple(count=20), "nothing_to_ask"): 1}


def test_two_cells_of_one_category_share_no_program(make_scene, facts_maker) -> None:
    scene = make_scene(0, side=8.0)
    bits = LabelPriors.of_scene(scene, Thresholds(), 0.3).bits(scene, 0.05)
    cells = (
        simple(composition="C1", moves=1, count=3),
        simple(composition="C1", moves=1, observability="O1", count=1),
        simple(count=2),
    )
    sampler = made_sampler(scene, facts_maker(scene), bits, cells=cells)
    drawn = list(sampler.drawn("simple"))
    assert len({program for _, program in drawn}) == len(drawn)
    counts = Counter(cell for cell, _ in drawn)
    assert list(counts) == list(cells)
    assert all(0 < counts[cell] <= sampler.sampling.candidates(cell) for cell in cells)


@pytest.mark.parametrize(
    "cells",
    [
        [{"category": "simple", "count": 0}],
        [{"category": "simple", "count": 1, "moves": 4}],
        [{"category": "long_chain", "count": 1, "moves": 3}],
        [{"category": "simple", "count": 1, "observability": "O3"}],
        [{"category": "simple", "count": 1, "moves": 2}, {"category": "simple", "count": 5, "moves": 2}],
    ],
)
def test_cells_that_cannot_be_meant_are_refused(cells) -> None:
    with pytest.raises(ValidationError):
        InstructionsConfig(cells=cells)


def test_a_drawing_has_the_golds_and_moves_that_it_is_aimed_at(sampled) -> None:
    """Placing draws what a cell lacks; aimed at the next time, the drawing forgets what it was aimed at before."""
    sampler = sampled[0][2]
    for category in ("simple", "nested"):
        (cell,) = sampler.wanted.cells_of(category)
        leaves = SHAPES[category].leaves
        drawing, found = sampler.drawing(cell, Seen()), []
        one, two = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0)
        for golds, moves in (([leaves - 1], two), ([0, 0, 1], one), ([1] * 7 + [0], one)):
            drawing.aim(golds, moves)
            programs = list(sampler.programs(cell, drawing, len(golds)))
            assert sorted(program.gold_leaf() for program in programs) == sorted(golds), "each of them once"
            asked = {moves.index(1.0) + 1}
            assert all({len(leaf.moves) for leaf in program.leaves} == asked for program in programs)
            found += programs
        drawing.aim([0] * 5, one)
        found += sampler.programs(cell, drawing, 2)
        drawing.aim([1] * 2, one)
        last = list(sampler.programs(cell, drawing, 2))
        assert [program.gold_leaf() for program in last] == [1, 1], "three golds were left"
        found += last
        assert len(set(found)) == len(found), "all distinct, whatever they are aimed at"


@pytest.mark.parametrize(("share", "most"), [(0.0, 0), (0.4, 1), (1.0, 2)])
def test_compass_words_are_in_few_phrases_of_some_programs(make_scene, facts_maker, share: float, most: int) -> None:
    phrases = set()
    for seed in range(2):
        scene = make_scene(seed)
        facts, bits = facts_maker(scene), LabelPriors.of_scene(scene, Thresholds(), 0.3).bits(scene, 0.05)
        sampling = SamplingConfig(compass_share=share, compass_phrases=max(most, 1))
        sampler = made_sampler(scene, facts, bits, sampling=sampling, per_category=dict.fromkeys(CATEGORIES, 8))
        for program in (program for category in CATEGORIES for program in sampler.candidates(category)):
            things = {move.object_id: move.qualifier for leaf in program.leaves for move in leaf.moves}
            used = [*things.values(), *(condition.qualifier for condition in program.conditions)]
            phrases.add(sum(one is not None and one.predicate in COMPASS for one in used))
    assert phrases == set(range(most + 1))


def _fits(program: Program) -> list[bool]:
    """Return for each leaf whether its goal goes with what decides about it."""
    found = []
    for branch in program.branches:
        condition = program.conditions[branch.condition]
        anchors = [anchor.object_id for anchor in condition.qualifier.anchors] if condition.qualifier else []
        for leaf, holds in ((-1 - branch.then, True), (-1 - branch.otherwise, False)):
            if leaf >= 0:
                goal = program.leaves[leaf].goal
                alike = goal.label in goes_with().get(condition.label, ())
                found.append(goal.object_id in anchors if holds and len(anchors) == 1 else alike)
    return found


def test_goals_fit_what_is_asked_and_change_nothing_of_what_is_asked(make_scene, facts_maker) -> None:
    fits: dict[float, list[bool]] = {0.0: [], 1.0: []}
    for seed in range(6):
        scene = make_scene(seed)
        facts, bits = facts_maker(scene), LabelPriors.of_scene(scene, Thresholds(), 0.3).bits(scene, 0.05)
        asked = {}
        for share in fits:
            sampling = SamplingConfig(
                purpose=share, search=0.0, compass_share=1.0, compass_phrases=8, usual_places=False
            )
            sampler = made_sampler(scene, facts, bits, sampling=sampling, per_category=dict.fromkeys(CATEGORIES, 2))
            programs = [program for category in CATEGORIES for program in sampler.candidates(category)]
            asked[share] = [program.conditions for program in programs]
            fits[share] += [fit for program in programs for fit in _fits(program)]
        assert asked[0.0] == asked[1.0], "what is asked, in which order and how often, does not depend on the goals"
    assert np.mean(fits[1.0]) > 1.5 * np.mean(fits[0.0])
