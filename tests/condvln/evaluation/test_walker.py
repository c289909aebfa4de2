"""The kinematic walker and the reference agents on small floors."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from condvln.evaluation.agents import AGENTS, agent_named, predict_all, walk_to_leaf
from condvln.evaluation.evaluate import evaluate
from condvln.evaluation.predictions import Prediction, read_predictions, write_predictions
from condvln.evaluation.task import Task
from condvln.evaluation.walker import Observation, SeenObject, heading_of, labels_in_view, walk
from condvln.navigation.follower import VLN_CE, Follower
from condvln.navigation.pathfinder import Pathfinder
from condvln.navigation.polygon_tile import tile_of_polygons
from schemas.errors import UsageError
from tests.condvln.evaluation.conftest import L_POLYGONS, L_VERTICES, task_with


class Script:
    """A policy that does what it was told, and remembers what it saw."""

    def __init__(self, actions: Sequence[int]) -> None:
        self.actions = list(actions)
        self.begun = 0
        self.seen: list[Observation] = []

    def begin(self, observation: Observation) -> None:
        self.begun += 1

    def act(self, observation: Observation) -> int:
        self.seen.append(observation)
        return self.actions[len(self.seen) - 1]


LEAVES = [
    {"goals": [[3.5, 0, 1.0]], "subgoals": [[2.5, 0, 1.5]], "route_length": 2.6, "geodesic_distance": 2.5},
    {"goals": [[1.0, 0, 3.5]], "route_length": 2.5, "geodesic_distance": 2.4},
]


def task(**changes: object) -> Task:
    values = {"start": (1.0, 0.0, 1.0), "tau": 0.5, **changes}
    return task_with(LEAVES, values.pop("gold", 0), **values)  # type: ignore[arg-type]


@given(st.lists(st.sampled_from([1, 1, 1, 2, 3]), min_size=1, max_size=60), st.integers(0, 23), st.booleans())
@example([1, 1, 1, 1, 3, 3, 3, 3, 3, 3, 1], 0, True)  # once 5e-17 m apart: one heading was counted up, one modulo 24
@settings(max_examples=60)
def test_a_walk_is_the_followers_replay(l_shape: Pathfinder, actions: list[int], turn: int, sliding: bool) -> None:
    half = math.radians(15 * turn) / 2
    rotation = (0.0, math.sin(half), 0.0, math.cos(half))
    here = task(start_rotation=rotation)
    found = walk(here, Script([*actions, 0]), l_shape, sliding=sliding)
    replay = Follower(l_shape, VLN_CE, sliding=sliding).walk(here.start, heading_of(rotation), [*actions, 0])
    np.testing.assert_array_equal(found.positions, replay.positions.astype(np.float64))
    np.testing.assert_array_equal(found.headings, replay.headings)
    assert found.stopped
    assert len(found.positions) == len(actions) + 2


def test_what_a_policy_is_told(l_shape: Pathfinder) -> None:
    policy = Script([1, 2, 1, 0])
    walk(task(), policy, l_shape)
    assert policy.begun == 1
    assert [o.step for o in policy.seen] == [0, 1, 2, 3]
    assert [round(math.degrees(o.heading)) for o in policy.seen] == [0, 0, 15, 15]
    assert policy.seen[1].position == pytest.approx([1, 0, 0.75])
    assert policy.seen[3].position == pytest.approx(
        [1 - 0.25 * math.sin(math.pi / 12), 0, 0.75 - 0.25 * math.cos(math.pi / 12)]
    )
    assert policy.seen[0].instruction == task().text
    assert not hasattr(policy.seen[0], "gold_leaf")


def test_walls_are_felt(l_shape: Pathfinder) -> None:
    policy = Script([1] * 5 + [0])
    found = walk(task(), policy, l_shape)
    assert [o.collided for o in policy.seen] == [False] * 5 + [True]
    assert found.collided.sum() == 1
    assert found.positions[-1] == pytest.approx([1, 0, 0], abs=1e-6)


def test_the_budget_ends_the_walk_without_stop(l_shape: Pathfinder) -> None:
    found = walk(task(max_steps=7), Script([2] * 20), l_shape)
    assert (len(found.positions), found.stopped) == (8, False)
    last = walk(task(max_steps=7), Script([2] * 6 + [0]), l_shape)
    assert (len(last.positions), last.stopped) == (8, True)


def test_an_answer_that_is_no_action_is_refused(l_shape: Pathfinder) -> None:
    with pytest.raises(UsageError, match=r"episode e: 7 is not an action"):
        walk(task(), Script([7]), l_shape)


@pytest.mark.parametrize("degrees", range(0, 360, 15))
def test_heading_of_a_rotation(degrees: int) -> None:
    half = math.radians(degrees) / 2
    for sign in (1, -1):
        rotation = [0.0, sign * math.sin(half), 0.0, sign * math.cos(half)]
        assert math.degrees(heading_of(rotation)) == pytest.approx(degrees, abs=1e-9)


def test_eyes_see_ahead_near_and_not_round_corners(l_shape: Pathfinder) -> None:
    objects = {
        "made/a": [
            SeenObject("lamp", (1.0, 0.5, 0.2)),
            SeenObject("bed", (1.0, 0.5, 3.0)),
            SeenObject("sofa", (3.9, 0.4, 1.9)),
            SeenObject("vase", (2.0, 0.4, 4.0)),
            SeenObject("lamp", (0.9, 0.5, 0.1)),
        ]
    }
    eyes = labels_in_view(objects, lambda task: l_shape)
    here = task()
    at = np.array([1.0, 0.0, 1.0])
    assert eyes(here, at, 0.0) == ("lamp",)
    assert eyes(here, at, math.pi) == ("bed", "vase")
    assert eyes(here, at, 3 * math.pi / 2) == ("sofa",)
    corner = np.array([4.0, 0.0, 2.0])  # the vase is 2.8 m off, but 4 m round the reflex corner
    assert eyes(here, corner, 3 * math.pi / 4) == ("bed",)
    assert labels_in_view({}, lambda task: l_shape)(here, at, 0.0) == ()
    policy = Script([0])
    walk(here, policy, l_shape, eyes=eyes)
    assert policy.seen[0].labels == ("lamp",)


# -- reference agents --------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def floor() -> Pathfinder:
    return Pathfinder.from_tile(tile_of_polygons(L_VERTICES, L_POLYGONS))


@pytest.fixture(scope="module")
def tasks(floor: Pathfinder) -> list[Task]:
    made = []
    for number in range(60):
        here = task(gold=number % 2, episode_id=f"e{number}")
        reference = Follower(floor).follow(here.start, 0.0, np.vstack([here.gold.subgoals, here.gold.goals[:1]]))
        made.append(task(gold=number % 2, episode_id=f"e{number}", reference=reference.locations))
    return made


def rates(name: str, tasks: list[Task], floor: Pathfinder) -> dict[str, float]:
    predictions = predict_all(AGENTS[name], tasks, lambda task: floor)
    found = evaluate(tasks, predictions, lambda task: floor, agent=name)
    return {key: float(np.nanmean(values)) for key, values in found.scores.items() if not np.isnan(values).all()}


@pytest.mark.parametrize(
    ("name", "success", "wrong"),
    [
        ("perfect", 1.0, 0.0),
        ("oracle", 1.0, 0.0),
        ("wrong-branch", 0.0, 1.0),
        ("always-then", 0.5, 0.5),
        ("always-else", 0.5, 0.5),
        ("nearest", 0.5, 0.5),
        ("stop-at-start", 0.0, 0.0),
    ],
)
def test_agents_do_what_their_names_say(
    name: str, success: float, wrong: float, tasks: list[Task], floor: Pathfinder
) -> None:
    found = rates(name, tasks, floor)
    assert found["success"] == success
    assert found["wrong_branch"] == wrong
    assert found["over_budget"] == 0
    assert found["missing"] == 0


@pytest.mark.parametrize("name", ["random-leaf", "coin-flip"])
def test_guessers_guess_and_repeat_themselves(name: str, tasks: list[Task], floor: Pathfinder) -> None:
    assert 0.3 < rates(name, tasks, floor)["success"] < 0.7
    assert rates(name, tasks, floor) == rates(name, tasks, floor)
    ends = [AGENTS[name](t, floor, 1).positions[-1].tolist() for t in tasks]
    assert ends == [AGENTS[name](t, floor, 1).positions[-1].tolist() for t in reversed(tasks)][::-1]
    assert ends != [AGENTS[name](t, floor, 2).positions[-1].tolist() for t in tasks]


def test_a_budget_too_small_leaves_the_walker_on_its_way(floor: Pathfinder) -> None:
    short = walk_to_leaf(task(max_steps=4), floor, 0)
    assert len(short.positions) <= 5
    assert not short.stopped


def test_no_such_agent() -> None:
    with pytest.raises(UsageError, match="Choose one of perfect, looking, oracle"):
        agent_named("clever")
    assert agent_named("oracle") is AGENTS["oracle"]


def test_predictions_go_through_their_file(tmp_path: Path, tasks: list[Task], floor: Pathfinder) -> None:
    path = tmp_path / "p.json.gz"
    made = [walk_to_leaf(t, floor, 0) for t in tasks]
    made.append(Prediction("empty", np.zeros((0, 3)), False, True))
    assert write_predictions(path, iter(made)) == len(made)
    back = list(read_predictions(path))
    assert [p.episode_id for p in back] == [p.episode_id for p in made]
    for ours, theirs in zip(made, back, strict=True):
        np.testing.assert_array_equal(ours.positions, theirs.positions)
        assert ours.stopped == theirs.stopped
