"""Episodes as a gymnasium environment: its checker, its scores beside `evaluate`, and what no observation may tell."""

from __future__ import annotations

import json
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

from condvln.evaluation.agents import agent_named
from condvln.evaluation.environment import NavigationEnv
from condvln.evaluation.predictions import Prediction, read_predictions, write_predictions
from condvln.evaluation.score import score
from condvln.evaluation.split import Export
from condvln.navigation.follower import Follower
from schemas.config import CameraConfig, NoiseConfig
from schemas.errors import UsageError

SMALL = {
    "rgb": CameraConfig(width=24, height=18),
    "depth": CameraConfig(width=16, height=16),
    "instance": CameraConfig(width=16, height=16),
}


def environment(made: tuple[Export, Path], **options: Any) -> NavigationEnv:
    options = {"cameras": SMALL, "text": True, "sources": {"replicacad": made[1]}} | options
    return NavigationEnv(made[0], "train", **options)


def same(one: dict[str, Any], other: dict[str, Any]) -> bool:
    return one.keys() == other.keys() and all(np.array_equal(one[key], other[key]) for key in one)


def actions_of(env: NavigationEnv, prediction: Prediction) -> list[int]:
    """The actions that lead along a prediction's poses."""
    assert prediction.headings is not None
    turns = np.diff(prediction.headings)
    moved = np.linalg.norm(np.diff(prediction.positions, axis=0), axis=1) > 0
    found = []
    for k, (turn, step) in enumerate(zip(turns, moved, strict=True)):
        left = (turn + np.pi) % (2 * np.pi) - np.pi
        last = k == len(turns) - 1 and prediction.stopped
        found.append(0 if last else 1 if step or abs(left) < 1e-6 else 2 if left > 0 else 3)
    return found


def test_gymnasium_s_checker_passes(made: tuple[Export, Path]) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        warnings.filterwarnings("ignore", message=".*(gps|compass|Box).*")
        warnings.filterwarnings("ignore", message=".*not within.*registry.*|.*spec.*|.*passed to `check_env` without.*")
        check_env(environment(made, shuffle=True, render_mode="rgb_array"))


def test_equal_resets_give_equal_observations(made: tuple[Export, Path]) -> None:
    one, other = (environment(made, shuffle=True) for _ in range(2))
    for seed in (0, 7):
        first, second = one.reset(seed=seed), other.reset(seed=seed)
        assert same(first[0], second[0])
        assert first[1] == second[1]
        for action in (2, 1, 1, 3):
            assert same(one.step(np.int64(action))[0], other.step(np.int64(action))[0])
    # Any episode can be begun again, by its id or its hash.
    task = made[0].tasks("train")[-1]
    for name in (task.episode_id, *task.aliases):
        seen, info = one.reset(options={"episode_id": name})
        assert info["episode_id"] == task.episode_id
        assert seen["instruction"] == task.text
        np.testing.assert_allclose([*seen["gps"], *seen["compass"]], 0, atol=1e-6)


def test_all_episodes_come_in_turn(made: tuple[Export, Path]) -> None:
    env = environment(made, cameras=None, text=False)
    found = [env.reset(seed=4 if k == 0 else None)[1]["episode_id"] for k in range(2 * len(env.episode_ids))]
    assert tuple(found) == 2 * env.episode_ids
    mixed = environment(made, cameras=None, text=False, shuffle=True)
    drawn = [mixed.reset(seed=4 if k == 0 else None)[1]["episode_id"] for k in range(len(env.episode_ids))]
    assert sorted(drawn) == sorted(env.episode_ids)
    assert tuple(drawn) != env.episode_ids


@pytest.mark.parametrize("agent", ["oracle", "wrong-branch", "random-leaf"])
def test_scores_are_those_of_evaluate(made: tuple[Export, Path], tmp_path: Path, agent: str) -> None:
    """Every measure of every walk, to the last digit, by way of a file of predictions too."""
    export = made[0]
    env = environment(made, cameras=None, text=False)
    walked, scored = [], {}
    for task in export.tasks("train"):
        pathfinder = export.pathfinder(task)
        known = agent_named(agent)(task, pathfinder, 0)
        env.reset(options={"episode_id": task.episode_id})
        for action in actions_of(env, known):
            _, reward, terminated, truncated, info = env.step(np.int64(action))
        assert terminated == known.stopped
        assert terminated or truncated
        np.testing.assert_array_equal(env.prediction.positions, known.positions)
        walked.append(env.prediction)
        scored[task.episode_id] = info["score"]
        assert reward == info["score"]["success"]
        assert info["path_length"] == info["score"]["path_length"]
    write_predictions(tmp_path / "walked.json", walked)
    again = export.evaluate("train", list(read_predictions(tmp_path / "walked.json")))
    for number, name in enumerate(again.episode_ids):
        for measure, value in scored[name].items():
            expected = float("nan") if value is None else float(value)
            np.testing.assert_equal(again.scores[measure][number], expected, err_msg=f"{name} {measure}")
    mean = np.mean([values["success"] for values in scored.values()])
    assert mean == {"oracle": 1.0, "wrong-branch": 0.0}.get(agent, mean)


def test_no_truth_is_in_an_observation(made: tuple[Export, Path]) -> None:
    """Two episodes of one start and one text, whose truths are others, look the same; and no field has another name."""
    export, _ = made
    env = environment(made)
    for task in export.tasks("train")[:6]:
        env.reset(options={"episode_id": task.episode_id})
        for action in (1, 2, 2, 1, 3):
            seen, _, _, _, info = env.step(np.int64(action))
            assert set(seen) == {"instruction", "text", "gps", "compass", *SMALL}
            assert seen in env.observation_space
            assert "score" not in info
            assert not {"gold_leaf", "committed_leaf", "leaf_correct", "leaves", "program"} & set(info)
            words = json.dumps({key: str(value) for key, value in seen.items() if key in ("instruction", "text")})
            assert task.episode_id not in words
            for move in (move for leaf in task.program.leaves for move in leaf.moves):
                assert move.object_id not in words
            json.dumps(info)


def test_leaves_are_named_after_stop_only(made: tuple[Export, Path]) -> None:
    env = environment(made, cameras=None, text=False)
    _, info = env.reset(seed=0)
    for _ in range(info["max_steps"]):
        _, reward, terminated, truncated, info = env.step(np.int64(2))
    assert (terminated, truncated, reward) == (False, True, 0.0)
    assert info["score"]["stopped"] == 0
    assert not {"committed_leaf", "leaf_correct", "wrong_branch", "no_commit", "divergence"} & set(info["score"])
    with pytest.raises(UsageError, match="the episode is over"):
        env.step(np.int64(1))
    env.reset(seed=0)
    _, _, terminated, _, info = env.step(np.int64(0))
    assert terminated
    assert "committed_leaf" in info["score"]


def test_gps_and_compass_are_in_the_frame_of_the_start(made: tuple[Export, Path]) -> None:
    """A step ahead is ahead whatever the first heading is; a turn to the left is positive."""
    env, straight = environment(made, cameras=None, text=False), 0
    for task in made[0].tasks("train"):
        env.reset(options={"episode_id": task.episode_id})
        seen, *_ = env.step(np.int64(1))
        x, _, z, w = task.start_rotation
        assert x == z == 0
        yaw = 2 * np.arctan2(task.start_rotation[1], w)
        ahead, right = np.array([-np.sin(yaw), 0, -np.cos(yaw)]), np.array([np.cos(yaw), 0, -np.sin(yaw)])
        asked = task.start + 0.25 * ahead
        there = made[0].pathfinder(task).try_step(task.start, asked)
        moved = there - task.start
        # Along a wall a step may slide sideways without a collision: it is then longer than it would be ahead.
        np.testing.assert_allclose(seen["gps"], [moved @ ahead, moved @ right], atol=2e-3)
        if np.abs(there - asked)[[0, 2]].max() < 1e-3:
            straight += 1
            np.testing.assert_allclose(seen["gps"], [0.25, 0], atol=2e-3)
        seen, *_ = env.step(np.int64(2))
        np.testing.assert_allclose(seen["compass"], [np.pi / 12], atol=1e-6)
    assert straight > 3


def test_noise_is_seeded_and_leaves_the_score_to_where_one_is(made: tuple[Export, Path]) -> None:
    noise = NoiseConfig(position=0.3, heading=10.0, step=0.3, turn=0.3, missed=0.5)
    runs = []
    for seed in (1, 1, 2):
        env = environment(made, noise=noise)
        seen, _ = env.reset(seed=seed)
        for action in (1, 2, 1, 1, 3, 1):
            seen, *_ = env.step(np.int64(action))
        runs.append((seen, env.prediction))
    assert same(runs[0][0], runs[1][0])
    assert not np.array_equal(runs[0][0]["gps"], runs[2][0]["gps"])
    assert not np.array_equal(runs[0][1].positions, runs[2][1].positions)
    task = made[0].tasks("train")[0]
    pathfinder = made[0].pathfinder(task)
    assert score(task, runs[0][1], pathfinder).path_length > 0
    for place in runs[0][1].positions:
        assert pathfinder.is_navigable(place, 0.5)
    exact = Follower(pathfinder).walk(task.start, 0.0, [1, 2]).positions
    assert len(exact) == 3


def test_what_is_asked_must_be_there(made: tuple[Export, Path]) -> None:
    env = environment(made, cameras=None, text=False)
    with pytest.raises(UsageError, match="no episode has begun"):
        env.step(np.int64(1))
    with pytest.raises(UsageError, match="has no episode 'x'"):
        env.reset(options={"episode_id": "x"})
    with pytest.raises(UsageError, match="unknown option 'id'"):
        env.reset(options={"id": "x"})
    env.reset()
    with pytest.raises(UsageError, match="not an action"):
        env.step(np.int64(4))
    with pytest.raises(UsageError, match="no camera preset"):
        environment(made, cameras="eagle")
    with pytest.raises(UsageError, match="no dataset was given for the family"):
        environment(made, sources={}).reset()
