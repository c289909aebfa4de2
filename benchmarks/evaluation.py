"""Evaluation of 10,000 episodes of 500 steps, compared with a loop over fastdtw and with asking every distance."""

from __future__ import annotations

import sys
import tempfile
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
from fastdtw import fastdtw

from condvln.evaluation.evaluate import Evaluation, evaluate
from condvln.evaluation.goal_distances import Nearness
from condvln.evaluation.measures import ndtw, without_repeats
from condvln.evaluation.predictions import Prediction, read_predictions, write_predictions
from condvln.evaluation.score import ScoreRules, score
from condvln.evaluation.task import LeafTask, Task
from condvln.navigation.follower import Follower
from condvln.navigation.pathfinder import Pathfinder
from condvln.samples import make_samples
from schemas.program import SHAPES, Condition, Leaf, ObjectRef, Program, RoomRef

EPISODES = 10_000
STEPS = 500
SCENES = 4
UNPRUNED = 100
"""Number of episodes that are judged with every distance asked."""
LOOPED = 25
"""Number of episodes of the loop over fastdtw, whose time is scaled up."""


def main() -> None:
    """Print the figures of one run."""
    episodes = int(sys.argv[1]) if len(sys.argv) > 1 else EPISODES
    with tempfile.TemporaryDirectory() as folder:
        pathfinders = _floors(Path(folder))
        tasks = [_task(number, pathfinders) for number in range(episodes)]
        path = Path(folder) / "predictions.json"
        write_predictions(path, (_wander(task, pathfinders) for task in tasks))
        size = path.stat().st_size / 1e6
        _judge(tasks[:50], read_predictions(path), pathfinders, strict=False)
        began = time.perf_counter()
        steps = sum(len(prediction.positions) - 1 for prediction in read_predictions(path))
        reading = time.perf_counter() - began
        began = time.perf_counter()
        found = _judge(tasks, read_predictions(path), pathfinders)
        took = time.perf_counter() - began
        print(
            f"{episodes} episodes, {steps} steps, {size:.0f} MB of JSON: {took:.1f} s from file to scores (aim: 60 s)"
        )
        print(f"  reading took {reading:.1f} s; {1e3 * took / episodes:.2f} ms an episode, one process")
        print(f"  SR {found.scores['success'].mean():.3f}, nDTW {found.scores['ndtw'].mean():.3f}")
        some = [prediction for prediction, _ in zip(read_predictions(path), range(UNPRUNED), strict=False)]
    _compare_dtw(tasks, some)
    _compare_pruning(tasks, some, pathfinders)


def _judge(
    tasks: list[Task], predictions: Iterator[Prediction], pathfinders: list[Pathfinder], strict: bool = True
) -> Evaluation:
    wanted = predictions if strict else (p for p, _ in zip(predictions, tasks, strict=False))
    return evaluate(tasks, wanted, lambda task: pathfinders[int(task.navmesh)])


def _compare_dtw(tasks: list[Task], predictions: list[Prediction]) -> None:
    pairs = [(p.positions, task.reference) for p, task in zip(predictions, tasks, strict=False)]
    began = time.perf_counter()
    exact = [ndtw(path, reference) for path, reference in pairs]
    ours = (time.perf_counter() - began) / len(pairs)
    began = time.perf_counter()
    fast = [ndtw(path, reference, fast=True) for path, reference in pairs]
    ours_fast = (time.perf_counter() - began) / len(pairs)
    began = time.perf_counter()
    theirs = []
    for path, reference in pairs[:LOOPED]:
        total = fastdtw(without_repeats(path), reference, dist=lambda a, b: float(np.linalg.norm(a - b)))[0]
        theirs.append(float(np.exp(-total / (len(reference) * 3.0))))
    loop = (time.perf_counter() - began) / LOOPED
    off = max(abs(a - b) for a, b in zip(fast, theirs, strict=False))
    print(f"nDTW an episode: exact {1e6 * ours:.0f} µs, fastdtw-compatible {1e6 * ours_fast:.0f} µs")
    print(f"  Python loop over fastdtw {1e6 * loop:.0f} µs: {loop / ours:.0f} and {loop / ours_fast:.0f} times as long")
    print(f"  compatible mode off by {off:.1e}; approximation below the exact by {max(np.subtract(exact, fast)):.3f}")


def _compare_pruning(tasks: list[Task], predictions: list[Prediction], pathfinders: list[Pathfinder]) -> None:
    seconds, scores = {}, {}
    for prune in (True, False):
        began = time.perf_counter()
        scores[prune] = [
            score(task, prediction, Nearness(pathfinders[int(task.navmesh)], prune=prune), ScoreRules())
            for prediction, task in zip(predictions, tasks, strict=False)
        ]
        seconds[prune] = time.perf_counter() - began
    same = repr(scores[True]) == repr(scores[False])
    ratio = seconds[False] / seconds[True]
    print(f"distances asked only where they matter: {ratio:.1f} times as fast, numbers equal: {same}")


def _floors(folder: Path) -> list[Pathfinder]:
    make_samples(folder, family="replicacad", scenes=SCENES, seed=0)
    return [Pathfinder.load(path) for path in sorted(folder.glob("**/*.navmesh"))[:SCENES]]


def _task(number: int, pathfinders: list[Pathfinder]) -> Task:
    """Make a task with three leaves at random places of a floor; every second one passes a subgoal."""
    which = number % len(pathfinders)
    pathfinder = pathfinders[which]
    points = pathfinder.get_random_navigable_points(8, number).astype(np.float64)
    start, goals, subgoals = points[0], points[1:4], points[4 : 4 + number % 2]
    route = Follower(pathfinder, max_actions=STEPS).follow(start, 0.0, np.vstack([subgoals, goals[:1]]))
    room = RoomRef(room_id="r", label="kitchen")
    program = Program(
        category="nested",
        conditions=tuple(Condition(label="lamp", room=room, truth=True, witnesses=("w",)) for _ in range(2)),
        branches=SHAPES["nested"].branches,
        leaves=tuple(Leaf(moves=(ObjectRef(object_id=f"o{i}", label="sink", room=room),)) for i in range(3)),
    )
    leaves = tuple(
        LeafTask(goal[None], subgoals if i == 0 else np.zeros((0, 3)), 5.0, 5.0, np.vstack([start, goal]))
        for i, goal in enumerate(goals)
    )
    axes: dict[str, str | int | None] = {
        "source": "made", "scene": f"made/{which}", "category": "nested", "depth": 2, "chain": 1,
        "composition": "C0", "observability": None, "moves": 1,
    }  # fmt: skip
    return Task(
        f"e{number}", None, "", axes, program, 0, leaves, start, (0.0, 0.0, 0.0, 1.0),
        route.locations.astype(np.float64), 1.0, STEPS, str(which), "",
    )  # fmt: skip


def _wander(task: Task, pathfinders: list[Pathfinder]) -> Prediction:
    """Make a random walk of forward steps and turns that ends with STOP."""
    rng = np.random.default_rng(int(task.episode_id[1:]))
    actions = rng.choice([1, 1, 1, 2, 3], STEPS)
    actions[-1] = 0
    walk = Follower(pathfinders[int(task.navmesh)]).walk(task.start, 0.0, actions)
    made = Prediction(task.episode_id, walk.positions.astype(np.float64), True, True)
    return replace(made, headings=walk.headings)


if __name__ == "__main__":
    main()
