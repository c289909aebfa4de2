"""Whole scores against the plain definitions; the laws that hold on any input; every edge rule."""

from __future__ import annotations

import math
from dataclasses import asdict, replace
from itertools import pairwise
from pathlib import Path
from typing import Any, get_args

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from condvln.evaluation.agents import walk_to_leaf
from condvln.evaluation.evaluate import evaluate
from condvln.evaluation.goal_distances import Nearness
from condvln.evaluation.measures import DistanceMode
from condvln.evaluation.predictions import Prediction
from condvln.evaluation.score import LOOKING, Score, ScoreRules, score
from condvln.evaluation.split import Export
from condvln.evaluation.task import LookingTask, Task
from condvln.navigation.follower import VLN_CE, Follower
from condvln.navigation.pathfinder import Pathfinder
from schemas.errors import FormatError
from tests.condvln.evaluation import plain
from tests.condvln.evaluation.conftest import OpenPlain, task_with

OPEN = OpenPlain()
SHARES = (
    "success",
    "oracle_success",
    "spl",
    "spl_route",
    "ndtw",
    "sdtw",
    "cls",
    "bsa",
    "csr",
    "bsa_all",
    "csr_all",
)
"""Measures that are 1 for a perfect walk and 0 for none."""
coordinate = st.one_of(
    st.floats(-4, 4, allow_nan=False).map(lambda v: round(v, 3)), st.integers(-6, 6).map(lambda n: n / 2), st.just(60.0)
)
point = st.tuples(coordinate, st.sampled_from([0.0, 0.0, 0.3]), coordinate)


@st.composite
def cases(draw: st.DrawFn) -> dict[str, Any]:
    start = draw(st.tuples(st.integers(-2, 2).map(float), st.just(0.0), st.integers(-2, 2).map(float)))
    leaf = st.fixed_dictionaries(
        {
            "goals": st.lists(point, min_size=1, max_size=3),
            "subgoals": st.lists(point, max_size=3),
            "route_length": st.floats(0, 20),
        }
    )
    leaves = draw(st.lists(leaf, min_size=2, max_size=4))
    shared = draw(st.none() | point)
    for each in leaves if shared is not None else ():
        each["subgoals"] = [shared, *each["subgoals"]]
    dense = st.lists(point, min_size=1, max_size=6)
    return {
        "start": start,
        "path": [start, *draw(st.lists(point, max_size=10))],
        "stopped": draw(st.booleans()),
        "counts": draw(st.booleans()),
        "leaves": leaves,
        "gold": draw(st.integers(0, len(leaves) - 1)),
        "reference": draw(dense),
        "looking": draw(st.none() | st.tuples(dense, st.floats(0, 20))),
        "decided": draw(st.none() | st.lists(st.none() | st.integers(0, 4), min_size=3, max_size=3)),
        "tau": draw(st.sampled_from([0.5, 1.0, 3.0])),
        "max_steps": draw(st.integers(1, 12)),
        "mode": draw(st.sampled_from(get_args(DistanceMode))),
    }


def straight(a: plain.Point, b: plain.Point) -> float:
    return math.inf if (a[0] > 50) != (b[0] > 50) else plain.euclid(a, b)


def task_of(case: dict[str, Any]) -> Task:
    looking = case["looking"]
    return task_with(
        case["leaves"],
        case["gold"],
        start=case["start"],
        reference=case["reference"],
        tau=case["tau"],
        max_steps=case["max_steps"],
        looking=None if looking is None else LookingTask(np.array(looking[0], float), looking[1], ()),
    )


def decided_in(case: dict[str, Any], task: Task) -> list[int | None] | None:
    """Drawn poses at which the conditions of the gold route are decided."""
    return case["decided"] and case["decided"][: len(set(task.program.route()[0]))]


def judged(case: dict[str, Any], prune: bool = True) -> Score:
    task = task_of(case)
    decided = decided_in(case, task)
    prediction = Prediction("e", np.array(case["path"], float), case["stopped"], case["counts"])
    rules = ScoreRules(distance=case["mode"])
    sees = None if decided is None else lambda walked: decided
    return score(task, prediction, Nearness(OPEN, prune=prune), rules, sees=sees)


def check(case: dict[str, Any]) -> None:
    ours = asdict(judged(case))
    theirs = plain.judge(
        case["path"],
        case["stopped"],
        start=case["start"],
        leaves=case["leaves"],
        gold=case["gold"],
        reference=case["reference"],
        tau=case["tau"],
        max_steps=case["max_steps"] if case["counts"] else None,
        distance=straight,
        mode=case["mode"],
        program=task_of(case).program,
        looking=case["looking"],
        decided=decided_in(case, task_of(case)),
    )
    for name, value in theirs.items():
        assert ours[name] == pytest.approx(value, rel=1e-9, abs=1e-12, nan_ok=True), name
    assert asdict(judged(case, prune=False)) == pytest.approx(ours, nan_ok=True, abs=0, rel=0)


@pytest.mark.costly
@given(cases())
@settings(max_examples=250)
def test_equal_the_plain_definitions(case: dict[str, Any]) -> None:
    check(case)


@pytest.mark.costly
@given(cases())
@settings(max_examples=200)
def test_laws_on_any_input(case: dict[str, Any]) -> None:
    found = judged(case)
    assert found.csr_all <= found.success
    assert found.spl <= found.success
    assert found.spl_route <= found.success
    assert found.oracle_success >= found.success
    assert found.bsa_all >= found.csr_all
    assert math.isnan(found.bsa) == math.isnan(found.csr)
    assert math.isnan(found.bsa) or found.bsa >= found.csr
    assert found.leaf_correct + found.wrong_branch + found.no_commit == 1
    assert 0 <= found.sdtw <= found.ndtw <= 1
    assert math.isnan(found.justified) or found.justified <= found.success
    assert math.isnan(found.spl_look) or found.spl_look <= found.success
    assert found.success <= 1 - found.unreachable
    assert all(math.isfinite(v) for n, v in asdict(found).items() if n not in NAN_ALLOWED)


NAN_ALLOWED = {"path_length", "bsa", "csr", "steps", "collisions", "divergence", "justified", *LOOKING}


# -- worked episodes ---------------------------------------------------------------------------------------------------

TWO = [
    {"goals": [[3, 0, 0]], "subgoals": [[1, 0, 0], [2, 0, 0]], "route_length": 3.0},
    {"goals": [[0, 0, 3]], "route_length": 3.0},
]


def walk(*points: Any, stopped: bool = True, counts: bool = True) -> Prediction:
    return Prediction("e", np.array(points, float).reshape(-1, 3), stopped, counts)


def scored(prediction: Prediction | None, rules: ScoreRules | None = None, **changes: Any) -> Score:
    task = task_with(changes.pop("leaves", TWO), changes.pop("gold", 0), **changes)
    return score(task, prediction, Nearness(OPEN), rules or ScoreRules())


@pytest.mark.parametrize(("pose", "justified"), [(0, 1), (3, 1), (4, 0), (None, 0)])
def test_a_decision_is_justified_before_the_walk_comes_near_what_only_its_branch_has(
    pose: int | None, justified: int
) -> None:
    """Both leaves have the stop at x = 1, so being there says nothing. The walk is first within 1 m of the goal at the
    fifth pose, x = 4.01.
    """
    leaves = [{"goals": [[5, 0, 0]], "subgoals": [[1, 0, 0]]}, {"goals": [[0, 0, 5]], "subgoals": [[1, 0, 0]]}]
    path = walk(*[[x, 0, 0] for x in (0, 1, 2, 4, 4.01, 5)])
    task = task_with(leaves)
    assert score(task, path, Nearness(OPEN), sees=lambda walked: [pose]).justified == justified
    lost = score(task, walk([0, 0, 0], [0, 0, 5]), Nearness(OPEN), sees=lambda walked: [0])
    assert (lost.success, lost.justified) == (0, 0)


def test_a_nested_condition_may_be_decided_after_the_outer_ones_branch_is_entered() -> None:
    """The stop at x = 2 is below the first condition only; the goals tell the second condition's answers apart."""
    inner = [{"goals": [[5, 0, z]], "subgoals": [[2, 0, 0]]} for z in (0, 5)]
    task = task_with([*inner, {"goals": [[-5, 0, 0]]}], 0)
    path = walk(*[[x, 0, 0] for x in range(6)])
    for decided, justified in (([0, 3], 1), ([1, 3], 1), ([2, 3], 0), ([0, 5], 0)):
        assert score(task, path, Nearness(OPEN), sees=lambda walked, at=decided: at).justified == justified


def test_the_authors_ball_is_closed_and_ours_open() -> None:
    path = walk([0, 0, 0], [3, 0, 0])
    leaves = [{"goals": [[3, 0, 0]], "subgoals": [[1, 0, 0]]}, TWO[1]]
    assert scored(path, leaves=leaves).bsa == 0  # the start is exactly 1 m from the subgoal
    assert scored(path, ScoreRules(distance="euclidean"), leaves=leaves).bsa == 1


def test_a_lead_is_reached_anywhere_in_its_room() -> None:
    room = [[4, -2], [8, -2], [8, 4], [4, 4]]
    leaves = [{"goals": [[9, 0, 0]], "subgoals": [[6, 0, 3], [9, 0, 0]], "outlines": [room, None]}, TWO[1]]
    through, past = walk([0, 0, 0], [4, 0, -1], [9, 0, 0]), walk([0, 0, 0], [3, 0, -1], [9, 0, 0])
    assert [scored(path, leaves=leaves).bsa_all for path in (through, past)] == [1, 0]
    pointed = [{**leaves[0], "outlines": [None, None]}, TWO[1]]
    assert scored(through, leaves=pointed).bsa_all == 0, "no room, no outline"
    assert scored(through, ScoreRules(distance="euclidean"), leaves=leaves).bsa_all == 0, "the authors know points"
    upstairs = [{**leaves[0], "subgoals": [[6, 2.5, 3], [9, 0, 0]]}, TWO[1]]
    assert scored(through, leaves=upstairs).bsa_all == 0, "a room on another storey"
    late = [{**leaves[0], "subgoals": [[9, 0, 0], [6, 0, 3]], "outlines": [None, room]}, TWO[1]]
    assert scored(through, leaves=late).bsa_all == 0.5, "in order"


def test_leads_without_an_outline_are_said_to_be_points() -> None:
    room = [[4, -2], [8, -2], [8, 4], [4, 4]]
    own = {"goals": [[9, 0, 0]], "subgoals": [[6, 0, 3]]}
    for leaf, said in ((own, 1), ({**own, "outlines": [room]}, 0)):
        task = task_with([leaf, TWO[1]])
        notes = evaluate([replace(task, axes={**task.axes, "leads": 1})], [], lambda task: OpenPlain()).notes
        assert ["does not outline" in note for note in notes] == [True] * said


def test_the_authors_forks_disagree_on_the_order_of_subgoals() -> None:
    open_nav, vln_zero = (ScoreRules(distance=mode) for mode in ("euclidean", "euclidean-any-order"))
    leaves = [{"goals": [[9, 0, 0]], "subgoals": [[6, 0, 0], [3, 0, 0]]}, TWO[1]]
    backwards = walk([0, 0, 0], [3, 0, 0], [6, 0, 0], [9, 0, 0])
    assert (scored(backwards, open_nav, leaves=leaves).bsa, scored(backwards, vln_zero, leaves=leaves).bsa) == (0.5, 1)
    close = [{"goals": [[9, 0, 0]], "subgoals": [[3, 0, 0], [3.5, 0, 0]]}, TWO[1]]
    one_pose = walk([0, 0, 0], [3.2, 0, 0], [9, 0, 0])
    assert (scored(one_pose, open_nav, leaves=close).bsa, scored(one_pose, vln_zero, leaves=close).bsa) == (0.5, 1)


@pytest.mark.parametrize("prediction", [None, walk()])
def test_missing_and_empty_are_failures(prediction: Prediction | None) -> None:
    found = scored(prediction)
    assert found.missing == 1
    assert found.navigation_error == 3.0
    for name in SHARES:
        assert getattr(found, name) == 0, name
    assert math.isnan(scored(prediction, gold=1).bsa)


def test_a_start_elsewhere_is_an_error() -> None:
    scored(walk([0.25, 0, 0]))
    with pytest.raises(FormatError, match=r"episode e.*0\.26 m from the episode's start"):
        scored(walk([0.26, 0, 0]))


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize("at", [0, 1])
def test_a_position_that_is_not_finite_is_an_error(at: int, value: float) -> None:
    path = np.zeros((2, 3))
    path[at, 2] = value
    with pytest.raises(FormatError, match="episode e: a position of the path is not finite"):
        scored(walk(*path))


def test_the_budget_cuts_the_path_and_its_stop() -> None:
    path = walk(*[[x / 4, 0, 0] for x in range(13)])
    assert scored(path, max_steps=12).success == 1
    bumped = replace(path, collided=np.arange(len(path.positions)) % 4 == 0)
    assert scored(bumped, max_steps=12).collisions == 4
    assert scored(bumped, max_steps=11).collisions == 3  # what lies beyond the budget did not happen
    cut = scored(path, max_steps=11)
    assert (cut.success, cut.over_budget, cut.stopped, cut.steps) == (0, 1, 0, 11)
    assert cut.path_length == pytest.approx(2.75)
    assert scored(path, ScoreRules(keep_budget=False), max_steps=11).success == 1
    free = replace(path, counts_actions=False)
    assert scored(free, max_steps=11).success == 1
    assert math.isnan(scored(free).steps)


def test_a_given_success_distance_replaces_the_episodes_own() -> None:
    path = walk([0, 0, 0], [1, 0, 0])
    assert scored(path).success == 0
    assert scored(path, ScoreRules(success_distance=3.0)).success == 1


@pytest.fixture
def round_the_corner() -> dict[str, Any]:
    """Start (4, 2), goal (2, 4); the way round the reflex corner (2, 2) is 4 m, the straight line 2.83 m."""
    leaves = [{"goals": [[2.0, 0, 4.0]], "route_length": 4.0}, {"goals": [[0, 0, 0]]}]
    return {"leaves": leaves, "start": (4.0, 0, 2.0)}


def line(*corners: Any, step: float = 0.25) -> np.ndarray:
    """Points along straight lines between corners, so far apart or nearer."""
    pieces = [np.array(corners[:1], float)]
    for a, b in pairwise(np.array(corners, float)):
        count = math.ceil(float(np.linalg.norm(b - a)) / step)
        pieces.append(a + (b - a) * np.linspace(0, 1, count + 1)[1:, None])
    return np.concatenate(pieces)


START, CORNER, GOAL = [4, 0, 2], [2, 0, 2], [2, 0, 4]


@pytest.mark.parametrize(
    ("path", "length", "gaps", "off"),
    [
        (line(START, CORNER, GOAL), 4.0, 0, 0),
        (np.array([START, GOAL]), 4.0, 1, 0),
        (np.array([START, [3, 0, 2], CORNER, GOAL]), 4.0, 3, 0),
        (line(START, CORNER, GOAL, step=0.5), 4.0, 8, 0),
        (line(START, GOAL), None, None, 11),  # through the wall in steps of an action
        (np.array([START, [1e5, 0, 0], GOAL]), None, 2, 1),
        (np.array([START, [4, 9, 2], GOAL]), None, 2, 1),
        (np.concatenate([line(START, CORNER), [[2, 0.6, 2]], line(CORNER, GOAL)]), None, 2, 1),
    ],
)
def test_a_walk_with_gaps_is_as_long_as_the_way(
    l_shape: Pathfinder, round_the_corner: dict[str, Any], path: np.ndarray, length: float | None, gaps: Any, off: int
) -> None:
    found = score(task_with(**round_the_corner), Prediction("e", path, True, True), l_shape)
    assert found.success == 1
    if length is None:
        assert found.gaps > 0 if gaps is None else found.gaps == gaps
        assert math.isnan(found.path_length) or found.path_length > 4
        assert found.spl < 1
    else:
        assert (found.gaps, found.path_length) == (gaps, pytest.approx(length))
        assert found.spl == pytest.approx(1)
    assert found.off_navmesh == off


def test_a_longer_action_makes_longer_steps(l_shape: Pathfinder, round_the_corner: dict[str, Any]) -> None:
    strides = Prediction("e", line(START, CORNER, GOAL, step=1.0), True, True)
    task = task_with(**round_the_corner)
    assert score(task, strides, l_shape).gaps == 4
    assert score(task, strides, l_shape, ScoreRules(forward=1.0)).gaps == 0


@pytest.mark.parametrize("decimals", [2, 3, 8])
def test_walks_of_the_follower_have_no_gap(made: tuple[Export, Path], decimals: int) -> None:
    export, _ = made
    for task in export.tasks("train"):
        pathfinder = export.pathfinder(task)
        walks = [walk_to_leaf(task, pathfinder, leaf) for leaf in range(len(task.leaves))]
        actions = np.random.default_rng(0).choice([1, 1, 1, 2, 3], 300).tolist()
        stray = Follower(pathfinder, VLN_CE).walk(task.start, 0.3, actions)
        walks.append(Prediction(task.episode_id, stray.positions.astype(np.float64), True, True))
        for one in walks:
            found = score(task, replace(one, positions=one.positions.round(decimals)), pathfinder)
            assert (found.gaps, found.off_navmesh) == (0, 0)


def test_geodesics_go_around_corners(l_shape: Pathfinder) -> None:
    # From (4, 2) round the reflex corner (2, 2) to (2, 4): 4 m, though the straight line is 2.83 m.
    leaves = [{"goals": [[2.0, 0, 4.0]], "subgoals": [[2.0, 0, 3.9]]}, {"goals": [[0, 0, 0]]}]
    task = task_with(leaves, start=(4.0, 0, 2.0), tau=3.0)
    stay = score(task, walk([4, 0, 2]), Nearness(l_shape), ScoreRules())
    assert stay.navigation_error == pytest.approx(4.0, abs=1e-5)
    assert (stay.success, stay.oracle_success, stay.bsa) == (0, 0, 0)
    assert score(task, walk([4, 0, 2]), Nearness(l_shape), ScoreRules(distance="euclidean")).bsa == 1
