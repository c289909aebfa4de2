"""Pools on a floor made here: every cell gets what it asks for, or each candidate is counted under what it fails."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from itertools import accumulate, permutations
from typing import Any

import numpy as np
import pyarrow as pa
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import ValidationError

from condvln.episodes import pool as pool_module
from condvln.episodes.candidates import REASONS, Candidate, unplaced_programs
from condvln.episodes.identity import content_hash
from condvln.episodes.observability import Observer
from condvln.episodes.placing import Placement, Placer, Rejected
from condvln.episodes.pool import EpisodePool, allowed_share, fill_pool, most_leaves, over_share
from condvln.episodes.table import funnel_table, placements_table, rejections_table, with_text
from condvln.episodes.view import SceneView
from condvln.instructions.degeneracy import outcomes
from condvln.instructions.programs import composition, oddness, with_leads
from condvln.navigation.pathfinder import Pathfinder
from condvln.scene import Scene
from condvln.seeding import Draws, generator
from schemas.config import EpisodeConfig, InstructionCell, PlacesConfig, TextConfig
from schemas.program import (
    SHAPES,
    Anchor,
    Category,
    Condition,
    Leaf,
    ObjectRef,
    Program,
    Qualifier,
    RoomRef,
)
from schemas.tables import EPISODES
from tests.condvln.episodes.floors import apartment, box, grid_floor, inside, placer_of
from tests.condvln.episodes.listed_candidates import Listed

PLACES, RULES = PlacesConfig(), EpisodeConfig()
ZONE = RoomRef(room_id="zone", label="apartment")
OBJECTS = (box("sofa", 1, 1), box("sink", 9, 1), box("lamp", 9, 5), box("bed", 1, 5), box("table", 5, 3))
SCREEN = box("screen", 3, 3, half=0.4, top=2.4)
NAMES = [o.object_id for o in OBJECTS]


def simple(**axes: Any) -> InstructionCell:
    """A cell of the category with one condition."""
    return InstructionCell(category="simple", **axes)


@pytest.fixture(scope="module")
def flat() -> tuple[Scene, Pathfinder]:
    scene = apartment(*OBJECTS, SCREEN)
    return scene, grid_floor(10, 6, lambda x, z: any(inside(o, x, z) for o in scene.objects))


def asking(first: str, second: str, witness: str, truth: bool) -> Program:
    """Two stops, and a condition whose evidence is `witness`, or all of the floor."""
    condition = Condition(
        label=witness if truth else "piano", room=ZONE, truth=truth, witnesses=(witness,) if truth else ()
    )
    leaves = (Leaf(moves=(ObjectRef(object_id=name, label=name, room=ZONE),)) for name in (first, second))
    return Program(category="simple", conditions=(condition,), branches=SHAPES["simple"].branches, leaves=tuple(leaves))


def filled_from(
    candidates: Iterable[Candidate],
    placer: Placer,
    cells: tuple[InstructionCell, ...],
    label_cap: float = 1.0,
    names_compass: Callable[[Program], bool] = lambda _: False,
    observer: Observer | None = None,
    groups: int = 0,
    shares: tuple[Sequence[float], Sequence[float]] | None = None,
) -> EpisodePool:
    """The pool where all candidates of a cell come at once; `shares` are those wanted and drawn."""
    moves = None if shares is None else lambda _: shares
    return fill_pool(Listed(candidates), placer, cells, label_cap, names_compass, observer, groups, moves)


def filled(
    flat, candidates: list[Candidate], cells: tuple[InstructionCell, ...], label_cap: float = 1.0
) -> EpisodePool:
    scene, pathfinder = flat
    placer = placer_of(scene, pathfinder)
    observer = Observer(scene, SceneView(scene), pathfinder, PLACES, RULES, placer.obstacles)
    return filled_from(candidates, placer, cells, label_cap, lambda _: True, observer)


def drawn(*cells: InstructionCell) -> list[Candidate]:
    """Every program for every cell, of both truths in turn."""
    programs = [
        asking(first, second, witness, truth)
        for first, second, witness in permutations(NAMES[:4], 3)
        for truth in (True, False)
    ]
    return [Candidate(f"{cell.name} {k}", program, cell) for cell in cells for k, program in enumerate(programs)]


LEVELS = ("O0f", "O0", "O1", "O2")


def test_every_cell_gets_what_it_asks_for(flat) -> None:
    cells = tuple(simple(observability=level, count=6) for level in LEVELS)
    pool = filled(flat, drawn(*cells), cells)
    for cell in cells:
        found = [e for e in pool.episodes if e.candidate.cell == cell]
        assert found
        assert all(e.observation.fits(cell.observability) for e in found)
        golds = Counter(e.program.gold_leaf() for e in found)
        assert max(golds.values()) <= 3, "no leaf beyond its share of a cell"
        assert pool.placed[cell] == len(found) <= cell.count
    # What needs no turning of the head is a part of what is seen from the start.
    first_view = [e for e in pool.episodes if e.candidate.cell.observability == "O0f"]
    assert {e.observation.observability for e in first_view} == {"O0"}
    assert pool.rejections[cells[2], "observability_missed"]


def test_bounds_of_a_route_may_be_met_and_those_beyond_every_route_change_nothing(flat) -> None:
    scene, pathfinder = flat
    placer = placer_of(scene, pathfinder)
    one_stop = asking("sofa", "sink", "bed", truth=True)
    stops = [tuple(ObjectRef(object_id=n, label=n, room=ZONE) for n in names) for names in (("bed", "sink"), ("sofa",))]
    for program in (one_stop, one_stop.model_copy(update={"leaves": tuple(Leaf(moves=moves) for moves in stops)})):
        free = placer.place(program, "i", compass=False)
        wide = placer.place(program, "i", compass=False, lengths=(0.0, 1000.0))
        np.testing.assert_array_equal(wide.start, free.start)
        assert wide.yaw == free.yaw
        lengths = [leaf.route.length for leaf in free.leaves]
        tight = placer.place(program, "i", compass=False, lengths=(min(lengths), max(lengths)))
        found = [leaf.route.length for leaf in tight.leaves]
        assert min(lengths) <= min(found) <= max(found) <= max(lengths)
        with pytest.raises(Rejected) as caught:
            placer.place(program, "i", compass=False, lengths=(0.0, 0.5))
        assert caught.value.reason == "route_missed"


def test_every_candidate_is_an_episode_or_is_counted_once(flat) -> None:
    cells = (
        simple(observability="O0", count=5),
        simple(moves=1, count=4),
    )
    candidates = drawn(*cells)
    pool = filled(flat, candidates, cells, label_cap=0.3)
    rejections = rejections_table("flat", "episodes", pool.rejections, pool.examples).to_pylist()
    funnel = funnel_table("flat", cells, pool).to_pylist()
    assert [row["cell"] for row in funnel] == ["simple O0", "simple 1 move"]
    for cell, row in zip(cells, funnel, strict=True):
        rejected = sum(r["count"] for r in rejections if r["cell"] == row["cell"])
        placed = sum(e.candidate.cell == cell for e in pool.episodes)
        assert row["candidates"] == sum(c.cell == cell for c in candidates) == rejected + placed
        assert (row["rejected"], row["placed"], row["wanted"]) == (rejected, placed, cell.count)
    assert {r["reason"] for r in rejections} <= set(REASONS)
    rows = placements_table(flat[0], pool, "0" * 64).to_pylist()
    for row, episode in zip(rows, pool.episodes, strict=True):
        assert row["observability"] == episode.observation.observability
        (evidence,) = episode.observation.evidence
        expected = {"condition": 0, "observability": row["observability"], "in_view": row["evidence_in_view"]}
        assert row["evidence"] == [expected | {"degrees": evidence.degrees}]
        assert row["observability_approximate"] is True
        assert (row["composition"], row["oddness"]) == (composition(episode.program), oddness(episode.program))


def test_what_is_asked_of_one_cell_leaves_the_others_alone(flat) -> None:
    plain, seen = (
        simple(count=6),
        simple(observability="O0f", count=6),
    )
    alone = filled(flat, drawn(plain), (plain,))
    beside = filled(flat, drawn(plain) + drawn(seen), (plain, seen))
    kept = [e for e in beside.episodes if e.candidate.cell == plain]
    assert [e.instruction_id for e in kept] == [e.instruction_id for e in alone.episodes]
    for one, other in zip(kept, alone.episodes, strict=True):
        np.testing.assert_array_equal(one.placement.start, other.placement.start)
        assert one.placement.yaw == other.placement.yaw
        assert one.observation == other.observation
    for episode in beside.episodes:  # turned by quarters, so that a compass point stays one
        assert np.degrees(episode.placement.yaw) / 45 == pytest.approx(round(np.degrees(episode.placement.yaw) / 45))


def test_instructions_without_episodes_keep_to_cells_and_gold_balance() -> None:
    cells = (
        simple(observability="O1", count=5),
        simple(count=4),
    )
    candidates = drawn(*cells)
    chosen = [c for c in candidates if c.instruction_id in set(unplaced_programs(candidates))]
    assert Counter(c.cell for c in chosen) == {cells[0]: 5, cells[1]: 4}
    for cell in cells:
        golds = Counter(c.program.gold_leaf() for c in chosen if c.cell == cell)
        assert max(golds.values()) - min(golds.values()) <= 1


def quadruple(first: str, second: str, witness: str, name: str) -> list[Candidate]:
    """The four programs of a counterfactual group."""
    programs = [
        asking(one, two, witness, truth) for one, two in ((first, second), (second, first)) for truth in (True, False)
    ]
    return [Candidate(f"{name} {k}", program, None, name) for k, program in enumerate(programs)]


def test_a_counterfactual_group_shares_its_start_and_comes_whole(flat) -> None:
    cell = simple(count=8)
    groups = [
        member for k, names in enumerate(permutations(NAMES, 3)) for member in quadruple(*names, name=f"group {k}")
    ]
    scene, pathfinder = flat
    placer = placer_of(scene, pathfinder)
    observer = Observer(scene, SceneView(scene), pathfinder, PLACES, RULES)
    pool = filled_from([*drawn(cell), *groups], placer, (cell,), 0.5, lambda p: p.conditions[0].truth, observer, 3)
    members: dict[str, list] = {}
    for episode in pool.episodes:
        if episode.candidate.group_id is not None:
            members.setdefault(episode.candidate.group_id, []).append(episode)
    assert 2 <= len(members) <= 3
    for found in members.values():
        assert len(found) == 4
        base = found[0]
        for episode in found:
            np.testing.assert_array_equal(episode.placement.start, base.placement.start)
            assert (episode.placement.yaw, episode.placement.steps) == (base.placement.yaw, base.placement.steps)
            for leaf, placed in zip(episode.program.leaves, episode.placement.leaves, strict=True):
                assert placed.objects == tuple(move.object_id for move in leaf.moves)
            assert episode.observation is not None
        # One text of the group names its heading, so that the start of all is a compass point.
        assert np.degrees(base.placement.yaw) / 45 == pytest.approx(round(np.degrees(base.placement.yaw) / 45))
        assert Counter(e.program.gold_leaf() for e in found) == {0: 2, 1: 2}
    programs = [e.program for e in pool.episodes]
    assert len(set(programs)) == len(programs), "a program of a group is not placed again by itself"
    assert pool.rejections[cell, "program_placed"]
    (row,) = [row for row in funnel_table("flat", (cell,), pool, 3).to_pylist() if row["category"] is None]
    assert row["wanted"] == 12
    assert row["placed"] == 4 * len(members)
    assert row["candidates"] == row["rejected"] + row["placed"] <= len(groups), (
        "groups are drawn until there are enough"
    )


class Anywhere(Placer):
    """Places every program but those of these ids, which `reason` keeps from it."""

    def __init__(self, nowhere: Iterable[str] = (), reason: str = "path_enters_other_leaf") -> None:
        self.nowhere, self.reason = set(nowhere), reason

    def place(self, program: Program, instruction_id: str, **_: object) -> Placement:
        if instruction_id in self.nowhere:
            raise Rejected(self.reason)
        return Placement(np.zeros(3), 0.0, tuple(program.leaves), 1.0)


def shares(pool: EpisodePool) -> Counter[str]:
    return Counter(leaf.goal.label for e in pool.episodes for leaf in e.program.leaves)


def test_a_group_is_trimmed_away_whole() -> None:
    pairs = [("sofa", "sink"), ("sofa", "lamp"), ("sofa", "table"), ("bed", "lamp")]
    groups = [m for k, pair in enumerate(pairs) for m in quadruple(*pair, "w", name=f"group {k}")]
    pool = filled_from(groups, Anywhere(), (), 0.2, groups=8)
    # Of five labels each may have a quarter. Sofa has 12 of 32 leaves; without two of its groups it has 4 of 16.
    assert Counter(e.candidate.group_id for e in pool.episodes) == {"group 0": 4, "group 3": 4}
    assert pool.rejections == {(None, "label_over_cap"): 8}


def test_what_a_label_over_its_share_leaves_behind_is_filled_by_others() -> None:
    barren, cell = InstructionCell(category="nested", count=8), simple(count=8)
    things = [f"thing {k}" for k in range(30)]
    crowded = [asking("sofa", things[k], "w", k % 2 == 0) for k in range(4)]
    spare = [asking(things[10 + 2 * k], things[11 + 2 * k], "w", k % 2 == 0) for k in range(10)]
    candidates = [Candidate(f"{k}", program, cell) for k, program in enumerate([*crowded, *spare])]
    pool = filled_from(candidates, Anywhere({"4", "6"}), (barren, cell), 0.15)
    # Of all that is wanted sofa may have 6 leaves of 40; of the 16 that can be had, 3.
    assert [e.instruction_id for e in pool.episodes] == ["0", "1", "2", "5", "7", "8", "9", "10"]
    assert pool.rejections == {
        (cell, "label_over_cap"): 1,
        (cell, "path_enters_other_leaf"): 2,
        (cell, "quota_full"): 3,
    }


def test_a_scene_of_one_crowded_label_keeps_what_it_has() -> None:
    """Twelve groups are wanted and five can be had, all past the one sofa: nothing is gained by dropping them."""
    groups = [m for k in range(5) for m in quadruple("sofa", f"thing {k}", "w", f"group {k}")]
    pool = filled_from(groups, Anywhere(), (), 0.5, groups=12)
    assert len(pool.episodes) == 20
    assert not pool.rejections
    assert shares(pool)["sofa"] == 20


def test_numbers_of_moves_keep_their_shares_where_long_routes_find_no_place() -> None:
    """Three of four candidates have leaves of one move; among what is kept they are as many as asked."""
    cell = simple(count=10)
    things = [f"thing {k}" for k in range(80)]
    short = [asking(things[k], things[k + 1], "w", k % 4 == 0) for k in range(0, 60, 2)]
    long = [_with_waypoint(asking(things[k], things[k + 1], "w", k % 4 == 0), "w") for k in range(60, 80, 2)]
    candidates = [Candidate(f"{k}", program, cell) for k, program in enumerate([*short, *long])]

    def moves(candidates: list[Candidate], shares: tuple[float, ...]) -> Counter[int]:
        pool = filled_from(candidates, Anywhere(), (cell,), shares=(shares, shares))
        assert len(pool.episodes) == 10
        assert set(pool.rejections) <= {(cell, "quota_full"), (cell, "gold_leaf_full")}
        return Counter(len(leaf.moves) for e in pool.episodes for leaf in e.program.leaves)

    assert moves(candidates, (0.4, 0.6, 0.0)) == {1: 8, 2: 12}
    assert moves(candidates, (0.6, 0.4, 0.0)) == {1: 12, 2: 8}
    # Where there are no others, the cell is filled with what there is.
    assert moves(candidates[: len(short)], (0.4, 0.6, 0.0)) == {1: 20}


def test_a_cell_makes_up_for_the_moves_of_the_groups_of_its_category() -> None:
    """A group's eight leaves have one move; with twenty leaves of the cell there are to be fourteen of each."""
    cell = simple(count=10)
    things = [f"thing {k}" for k in range(80)]
    short = [asking(things[k], things[k + 1], "w", k % 4 == 0) for k in range(0, 40, 2)]
    long = [_with_waypoint(asking(things[k], things[k + 1], "w", k % 4 == 0), "w") for k in range(40, 80, 2)]
    candidates = [Candidate(f"{k}", program, cell) for k, program in enumerate([*short, *long])]
    group = quadruple("sofa", "bed", "w", name="group")

    def moves(*candidates: Candidate) -> Counter[int]:
        pool = filled_from(candidates, Anywhere(), (cell,), groups=1, shares=((0.5, 0.5, 0.0),) * 2)
        return Counter(len(leaf.moves) for e in pool.episodes for leaf in e.program.leaves)

    assert moves(*candidates) == {1: 10, 2: 10}
    assert moves(*group, *candidates) == {1: 8 + 6, 2: 14}


def test_a_cell_that_can_not_have_its_shares_comes_as_near_as_its_candidates_allow() -> None:
    """All programs with a leaf of two moves are placed, wherever they are in the order, and others fill the cell."""
    cell = simple(count=10)
    things = [f"thing {k}" for k in range(40)]
    short = [asking(things[k], things[k + 1], "w", k % 4 == 0) for k in range(0, 20, 2)]
    mixed = [_with_waypoint(asking(things[k], things[k + 1], "w", k % 4 == 0), "w", 1) for k in range(20, 32, 2)]
    for programs in ([*short, *mixed], [*mixed, *short]):
        candidates = [Candidate(f"{k}", program, cell) for k, program in enumerate(programs)]
        pool = filled_from(candidates, Anywhere(), (cell,), shares=((0.5, 0.5, 0.0),) * 2)
        assert Counter(len(leaf.moves) for e in pool.episodes for leaf in e.program.leaves) == {1: 14, 2: 6}


def _with_moves(category: Category, moves: Sequence[int], gold: int, name: str) -> Program:
    """A program whose leaves have these numbers of moves; all its objects are its own."""

    def thing(what: str) -> ObjectRef:
        return ObjectRef(object_id=f"{name} {what}", label=f"{name} {what}", room=ZONE)

    shape = SHAPES[category]
    truths = next(t for t, leaf in outcomes(category).items() if leaf == gold)
    conditions = (
        Condition(label=f"{name} {k}", room=ZONE, truth=truth, witnesses=(f"{name} {k}",) if truth else ())
        for k, truth in enumerate(truths)
    )
    leaves = (Leaf(moves=tuple(thing(f"{k}/{n}") for n in range(count))) for k, count in enumerate(moves))
    return Program(category=category, conditions=tuple(conditions), branches=shape.branches, leaves=tuple(leaves))


@pytest.mark.parametrize(
    ("category", "asked", "drawn"),
    [
        ("simple", (0.4, 0.4, 0.2), (0.28, 0.42, 0.3)),
        ("nested", (0.4, 0.4, 0.2), (0.28, 0.42, 0.3)),
        ("chain", (0.4, 0.4, 0.2), (0.5, 0.35, 0.15)),
        ("deep_nested", (0.6, 0.4), (0.5, 0.5)),
    ],
)
def test_over_many_scenes_leaves_have_the_asked_shares_whatever_is_drawn(
    category: Category, asked: tuple[float, ...], drawn: tuple[float, ...]
) -> None:
    """Candidates are taken for the moves of their leaves, so that what is left at the end still fits."""
    cell = InstructionCell(category=category, count=12)
    leaves, sums, total = SHAPES[category].leaves, tuple(accumulate(drawn)), Counter[int]()
    for scene in range(60):
        draws = Draws(generator(0, category, scene))
        candidates = []
        for k in range(60):
            moves = [1 + draws.cumulative(sums) for _ in range(leaves)]
            candidates.append(Candidate(f"{k}", _with_moves(category, moves, k % leaves, f"{k}"), cell))
        pool = filled_from(candidates, Anywhere(), (cell,), shares=(asked, drawn))
        held = Counter(len(leaf.moves) for e in pool.episodes for leaf in e.program.leaves)
        assert held.total() == 12 * leaves
        assert all(abs(held[n] - share * held.total()) < 3 for n, share in enumerate(asked, 1))
        total += held
    assert [total[n] / total.total() for n in range(1, len(asked) + 1)] == pytest.approx(asked, abs=0.015)


def _sent(name: str, goal: str, *, truth: bool) -> Candidate:
    """Asks whether the book is on the desk, and sends to `goal` if it is, else to the sofa."""
    desk = Qualifier(predicate="on", anchors=(Anchor(object_id="desk", label="desk"),))
    asked = Condition(label="book", room=ZONE, qualifier=desk, truth=truth, witnesses=("book",) if truth else ())
    then, otherwise = (
        Leaf(moves=(ObjectRef(object_id=label, label=label.rpartition(" ")[0], room=ZONE),))
        for label in (goal, f"sofa {name}")
    )
    branches = SHAPES["simple"].branches
    program = Program(category="simple", conditions=(asked,), branches=branches, leaves=(then, otherwise))
    return Candidate(name, program, InstructionCell(category="simple", count=4))


def test_the_least_odd_programs_are_placed_first_if_goals_shall_fit() -> None:
    goals = ["toilet", "bed", "dining table"] * 4
    listed = [
        replace(one, program=one.program.model_copy(update={"leaves": (*_at_desk(one)[:1], one.program.leaves[0])}))
        for one in (_sent(f"{k}", f"{goal} {k}", truth=bool(k // 3 % 2)) for k, goal in enumerate(goals))
    ]
    cell = listed[0].cell
    found = {}
    for purposeful in (False, True):
        pool = fill_pool(
            Listed(listed), Anywhere(), (cell,), 1.0, lambda _: False, None, 0, None, purposeful=purposeful
        )
        found[purposeful] = Counter(e.program.leaves[1].goal.label for e in pool.episodes)
    assert found[False]["toilet"] == 2, "in their order"
    assert found[True].total() == 4
    assert "toilet" not in found[True], "nobody looks for a book there"


def test_of_relations_to_whose_anchor_one_is_sent_as_many_are_true_as_false() -> None:
    cell = InstructionCell(category="simple", count=12)
    false = [_sent(f"{k}", f"desk {k}", truth=False) for k in range(12)]
    to_desk = [
        replace(one, cell=cell, program=one.program.model_copy(update={"leaves": _at_desk(one)})) for one in false
    ]
    pool = fill_pool(Listed(to_desk), Anywhere(), (cell,), 1.0, lambda _: False, None, 0, None, purposeful=True)
    assert len(pool.episodes) == 1
    assert pool.rejections == {(cell, "truth_full"): 11}
    free = fill_pool(Listed(to_desk), Anywhere(), (cell,), 1.0, lambda _: False, None, 0, None)
    assert len(free.episodes) == 6, "the gold leaf's share"


def _at_desk(one: Candidate) -> tuple[Leaf, ...]:
    return (Leaf(moves=(ObjectRef(object_id="desk", label="desk", room=ZONE),)), one.program.leaves[1])


class ToOrder:
    """Draws what is asked for: golds in turn, moves by the shares; `most` candidates at most."""

    labels, group_leaves = 1000, 0.0

    def __init__(self, category: Category, scene: int, most: int = 60) -> None:
        self._category, self._draws, self._left = category, Draws(generator(1, category, scene)), most
        self.drawn: list[Candidate] = []
        self.calls = 0

    def group(self) -> Sequence[Candidate]:
        return ()

    def leads_of(self, cell: InstructionCell) -> int:
        return 0

    def more(
        self, cell: InstructionCell, count: int, golds: Sequence[int], moves: Sequence[float] | None
    ) -> Sequence[Candidate]:
        assert moves is not None
        assert sum(moves) == pytest.approx(1.0)
        self.calls += 1
        sums, found = tuple(accumulate(moves)), []
        for k in range(min(count, self._left)):
            name = f"{len(self.drawn) + k}"
            routes = [1 + self._draws.cumulative(sums) for _ in range(SHAPES[self._category].leaves)]
            found.append(Candidate(name, _with_moves(self._category, routes, golds[k % len(golds)], name), cell))
        self._left -= len(found)
        self.drawn += found
        return found


class ShortRoutes(Anywhere):
    """Places every program without long routes, and every eighth of the others."""

    def place(self, program: Program, instruction_id: str, **_: object) -> Placement:
        if max(len(leaf.moves) for leaf in program.leaves) > 1 and int(instruction_id) % 8:
            raise Rejected("path_enters_other_leaf")
        return Placement(np.zeros(3), 0.0, tuple(program.leaves), 1.0)


@pytest.mark.parametrize("category", ["simple", "nested", "deep_nested"])
def test_candidates_are_drawn_as_they_are_wanted_with_the_moves_and_golds_that_a_cell_lacks(category: Category) -> None:
    cell, leaves = InstructionCell(category=category, count=12), SHAPES[category].leaves
    shares = (0.6, 0.4) if leaves == 4 else (0.4, 0.4, 0.2)
    total, drawn, calls = Counter[int](), 0, 0
    for scene in range(40):
        supply = ToOrder(category, scene, most=200)
        pool = fill_pool(supply, ShortRoutes(), (cell,), 1.0, lambda _: False, None, 0, lambda _: (shares, shares))
        assert Counter(e.program.gold_leaf() for e in pool.episodes) == dict.fromkeys(range(leaves), 12 // leaves)
        assert pool.candidates[cell] == len(supply.drawn) == 12 + sum(pool.rejections.values())
        calls += supply.calls
        total += Counter(len(leaf.moves) for e in pool.episodes for leaf in e.program.leaves)
        drawn += len(supply.drawn)
    assert calls > 40, "some cells lack what was drawn for them, and draw again"
    assert drawn < 12 * 12 * 40, "an eighth of the programs with a long route is placed"
    found = [total[n] / total.total() for n in range(1, len(shares) + 1)]
    assert found == pytest.approx(shares, abs=0.04)


class Led(ToOrder):
    """Draws with leads what is asked for with them."""

    def leads_of(self, cell: InstructionCell) -> int:
        return round(0.75 * cell.count)

    def more(self, *asked: Any, leads: bool = False) -> Sequence[Candidate]:
        found = super().more(*asked)
        led = [replace(one, program=with_leads(one.program)) for one in found] if leads else found
        self.drawn[len(self.drawn) - len(found) :] = led
        return led


@pytest.mark.parametrize(("lost", "led"), [((), 9), (range(1, 400, 2), 9), (range(7, 45), 7)])
def test_a_cell_has_its_leads_and_others_where_they_find_no_place(lost: Iterable[int], led: int) -> None:
    cell, supply = InstructionCell(category="simple", count=12), Led("simple", 0, most=400)
    placer = Anywhere([f"{k}" for k in lost])
    if led < 9:  # no more of them are to be had
        more, supply.more = (
            supply.more,
            lambda *asked, leads=False: () if leads and supply.calls else more(*asked, leads=leads),
        )
    pool = fill_pool(supply, placer, (cell,), 1.0, lambda _: False, None, 0, lambda _: 2 * ((1.0,),))
    found = sum(episode.program.branches[0].lead is not None for episode in pool.episodes)
    assert len(pool.episodes) == 12
    assert found == led


def test_a_cell_that_asks_for_leads_has_nothing_else() -> None:
    cell, supply = InstructionCell(category="simple", count=12, leads="with"), Led("simple", 0, most=400)
    more = supply.more
    supply.leads_of = lambda cell: cell.count
    supply.more = lambda *asked, leads=False: () if leads and len(supply.drawn) > 10 else more(*asked, leads=leads)
    lost = [f"{k}" for k in range(400) if k % 6]
    pool = fill_pool(supply, Anywhere(lost), (cell,), 1.0, lambda _: False, None, 0, lambda _: 2 * ((1.0,),))
    assert 0 < len(pool.episodes) < 12
    assert all(episode.program.branches[0].lead is not None for episode in pool.episodes)
    assert len(supply.drawn) == pool.candidates[cell], "none without leads was asked for"


def test_a_cell_that_can_not_be_filled_draws_all_that_there_is_and_no_more() -> None:
    cell, rest = InstructionCell(category="simple", count=12), InstructionCell(category="nested", count=1)
    supply = ToOrder("simple", 0, most=30)
    nowhere = [f"{k}" for k in range(30) if k % 5]
    pool = fill_pool(supply, Anywhere(nowhere), (cell, rest), 1.0, lambda _: False, None, 0, lambda _: 2 * ((1.0,),))
    assert len(supply.drawn) == pool.candidates[cell] == 30
    assert 0 < pool.placed[cell] <= 6
    assert not pool.rejections[cell, "quota_full"]
    assert pool.candidates[rest] == 0


def _with_waypoint(program: Program, name: str, leaves: int = 2) -> Program:
    """The same program with a waypoint before the goals of its first `leaves` leaves."""
    way = ObjectRef(object_id=name, label=name, room=ZONE)
    longer = tuple(leaf.model_copy(update={"moves": (way, *leaf.moves)}) for leaf in program.leaves[:leaves])
    return program.model_copy(update={"leaves": (*longer, *program.leaves[leaves:])})


few = st.integers(0, 5).map("abcdef".__getitem__)


@given(st.lists(st.lists(few, min_size=2, max_size=4, unique=True), max_size=24), st.sampled_from([0.15, 0.3, 0.5]))
def test_trimming_keeps_half_and_never_raises_the_largest_share(leaves: list[list[str]], cap: float) -> None:
    units = [[Counter(labels)] for labels in leaves]
    dropped = over_share(units, cap)
    assert len(set(dropped)) == len(dropped) <= len(units) / 2
    before = Counter(label for labels in leaves for label in labels)
    kept = [labels for k, labels in enumerate(leaves) if k not in dropped]
    after = Counter(label for labels in kept for label in labels)
    share = allowed_share(cap, len(before))
    if before and max(before.values()) <= most_leaves(share, before.total()):
        assert dropped == []
    for last in dropped[-1:]:
        most = max(after.values())
        lower = most / after.total() < max(before.values()) / before.total()
        assert lower or most <= most_leaves(share, after.total())
        one_more = after + Counter(leaves[last])
        assert max(one_more.values()) > most_leaves(share, one_more.total()), "none is dropped for nothing"


@given(
    st.lists(st.tuples(few, few, st.integers(0, 3), st.booleans(), st.booleans()), max_size=60),
    st.sampled_from([0.15, 0.3, 1.0]),
)
def test_a_short_cell_has_no_candidate_that_its_quota_turned_away(
    asked: list[tuple[str, str, int, bool, bool]], cap: float
) -> None:
    cells = (simple(count=5), simple(moves=1, count=8))
    candidates = [
        Candidate(f"{k}", asking(first, second, f"w{witness}", truth), cells[witness % 2])
        for k, (first, second, witness, truth, _) in enumerate(asked)
        if first != second
    ]
    nowhere = [f"{k}" for k, row in enumerate(asked) if row[4]]
    pool = filled_from(candidates, Anywhere(nowhere), cells, cap)
    assert sum(pool.candidates.values()) == len(candidates) == len(pool.episodes) + sum(pool.rejections.values())
    labels = {leaf.goal.label for c in candidates for leaf in c.program.leaves}
    assert bool(pool.episodes) == any(c.instruction_id not in nowhere for c in candidates)
    for cell in cells:
        golds = Counter(e.program.gold_leaf() for e in pool.episodes if e.candidate.cell == cell)
        quota = -(-cell.count // 2)
        assert pool.placed[cell] <= cell.count
        assert max(golds.values(), default=0) <= quota
        if pool.placed[cell] < cell.count:
            assert not pool.rejections[cell, "quota_full"]
            assert bool(pool.rejections[cell, "gold_leaf_full"]) <= (quota in golds.values())
    if cap == 1.0 or not labels:
        assert not any(reason == "label_over_cap" for _, reason in pool.rejections)


@pytest.mark.parametrize("bits", [0, 1])
def test_a_scene_rejects_the_larger_hash_with_its_group(flat, monkeypatch: pytest.MonkeyPatch, bits: int) -> None:
    scene, pathfinder = flat
    candidates = [*quadruple("sofa", "sink", "bed", "g"), *drawn(simple(count=4))]
    whole = filled_from(candidates, placer_of(scene, pathfinder), (simple(count=4),), groups=1)
    assert len(whole.episodes) > 4
    hashes = {
        e.instruction_id: content_hash("flat", e.instruction_id, e.placement.start, e.placement.yaw)
        for e in whole.episodes
    }
    monkeypatch.setattr(pool_module, "numeric_id", lambda name: int(name, 16) & ((1 << bits) - 1))
    kept = EpisodePool(list(whole.episodes), whole.candidates.copy(), whole.rejections.copy())
    kept.reject_collisions("flat")
    low = {name: int(h, 16) & ((1 << bits) - 1) for name, h in hashes.items()}
    first = {min((h, name) for name, h in hashes.items() if low[name] == number)[1] for number in set(low.values())}
    members = {e.instruction_id for e in whole.episodes if e.candidate.group_id == "g"}
    expected = first if members <= first else first - members
    assert {e.instruction_id for e in kept.episodes} == expected
    lost = sum(n for (_, reason), n in kept.rejections.items() if reason == "id_collision")
    assert lost == len(whole.episodes) - len(kept.episodes)
    for cell, count in kept.candidates.items():
        assert kept.placed[cell] + sum(n for (of, _), n in kept.rejections.items() if of == cell) == count


def test_a_group_has_one_step_budget_by_its_longest_text(flat) -> None:
    scene, pathfinder = flat
    placer = placer_of(scene, pathfinder)
    candidates = quadruple("sofa", "sink", "bed", "g")
    pool = filled_from(candidates, placer, (), groups=1)
    placements = placements_table(flat[0], pool, "0" * 64)
    names = placements["episode_id"].to_pylist()
    texts = {name: " ".join(["word"] * (12 + k)) for k, name in enumerate(names)}
    rows = with_text(placements, texts, "proportional", 10).to_pylist()
    assert [row["words"] for row in rows] == [12, 13, 14, 15]
    assert {row["max_steps"] for row in rows} == {max(150, 2 * rows[0]["ground_truth_steps"])}
    assert {row["group_id"] for row in rows} == {"g"}
    single = placements.set_column(
        placements.schema.get_field_index("group_id"), EPISODES.field("group_id"), pa.nulls(4, pa.string())
    )
    alone = with_text(single, texts, "proportional", 10).to_pylist()
    assert [row["max_steps"] for row in alone] == [
        max(10 * row["words"], 2 * row["ground_truth_steps"]) for row in alone
    ]
    assert {row["max_steps"] for row in with_text(placements, texts, 500, 10).to_pylist()} == {500}
    paper = EpisodeConfig(max_steps="proportional")
    assert (EpisodeConfig().max_steps, paper.step_ceiling, TextConfig().steps_per_word) == (500, 500, 20)
    with pytest.raises(ValidationError, match="500"):
        EpisodeConfig(max_steps=501)
