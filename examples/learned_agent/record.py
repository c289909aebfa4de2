"""Record what the text sensor sees along walks: ``python record.py --kind looking --out FILE EXPORT=DATASET …``."""

from __future__ import annotations

import argparse
import json
import math
import time
from pathlib import Path

import numpy as np
import torch
from network import frame_tensors
from seen import START, Memory, Text
from space import scan

import condvln as cv
from condvln.evaluation.scene_views import SceneViews
from condvln.navigation.follower import FORWARD, LEFT, RIGHT, Follower
from condvln.seeding import generator
from condvln.sensors import TextSensor
from condvln.trajectories.walks import LeftOut, Walked, direct_walk, looking_walk
from schemas.config import TrajectoryConfig

LONGEST = 220
"""Walks with more actions are left out, of both kinds."""


def with_mistakes(walked: Walked, episode, pathfinder, share: float, seed: int):
    """Return the actions of a walk and which of them to imitate, (n,) each; a share of walks gets one or two mistakes
    of a few random actions, each with the way back to where it began. Walks of both kinds get the same draws.
    """
    plain = walked.actions, np.ones(len(walked), bool)
    draws = generator(seed, "mistakes", str(episode.episode_id))
    if draws.uniform() >= share:
        return plain
    follower = Follower(pathfinder, stop_within=0.1, arrive_within=0.25)
    at = np.sort(draws.uniform(size=draws.integers(1, 3)) * (len(walked) - 1)).astype(int).tolist()
    taken: list[int] = []
    right: list[bool] = []
    begun = 0
    start, facing = np.array(episode.start_position), float(walked.headings[0])
    for step in at:
        taken += walked.actions[begun:step].tolist()
        right += [True] * (step - begun)
        odds = (0.2, 0.4, 0.4) if draws.uniform() < 0.5 else (0.7, 0.15, 0.15)
        mistake = draws.choice((FORWARD, LEFT, RIGHT), size=draws.integers(2, 7), p=odds).tolist()
        end = follower.walk(start, facing, [*taken, *mistake])
        back = follower.follow(end.positions[-1], float(end.headings[-1]), walked.positions[step])
        if not back.arrived:
            return plain
        way = [*mistake, *back.actions[:-1].tolist()]
        heading = float(follower.walk(start, facing, [*taken, *way]).headings[-1])
        off = math.remainder(float(walked.headings[step]) - heading, math.tau)
        way += [LEFT if off > 0 else RIGHT] * round(abs(off) / math.radians(15))
        taken, begun = [*taken, *way], step
        right += [k >= len(mistake) for k in range(len(way))]
    taken += walked.actions[begun:].tolist()
    right += [True] * (len(walked) - begun)
    last = follower.walk(start, facing, taken).positions[-1:]
    goals = np.array(next(one for one in episode.leaves if one.leaf == episode.gold_leaf).goals)
    if pathfinder.distance_table(last, goals).min() > 0.9 * episode.success_distance:
        return plain
    return np.array(taken, np.int8), np.array(right)


def frames_along(episode, walked: Walked, actions, pathfinder, view, text: Text):
    """Return the frames that an agent sees as it takes the actions."""
    sensor = TextSensor(view.scene, view.renderer)
    poses = Follower(pathfinder).walk(episode.start_position, float(walked.headings[0]), actions)
    places = poses.positions.astype(np.float64)
    memory, last, frames = Memory(text), START, []
    for step, action in enumerate(actions):
        place, heading = places[step], float(poses.headings[step])
        collided = last == FORWARD and float(np.linalg.norm(place - places[step - 1])) < 0.249
        scanned = scan(view.renderer, place, heading)
        frames.append(memory.see(sensor.observe(place, heading), scanned, place, heading, collided, last))
        last = int(action)
    return frames


def recorded(folder: Path, dataset: Path, kind: str, arguments, most: int | None):
    """Yield a record of each walk of a split; episodes that lack a walk of either kind are left out."""
    export, config = cv.open_export(folder, [dataset]), TrajectoryConfig()
    episodes = export.episodes(arguments.split)
    if most is not None and most < len(episodes):
        chosen = generator(arguments.seed, "episodes").permutation(len(episodes))[:most]
        episodes = [episodes[k] for k in sorted(chosen.tolist())]
    views = SceneViews({episodes[0].source: dataset})
    for episode in sorted(episodes, key=lambda one: one.scene_id):
        name = f"{episode.source}/{episode.scene_id}"
        view, pathfinder = views(name), export.pathfinder(episode)
        goal = view.scene.object_of[episode.program.leaves[episode.gold_leaf].goal.object_id].center
        walks = {
            "looking": looking_walk(episode, pathfinder, config),
            "direct": direct_walk(episode, pathfinder, config, goal),
        }
        if any(isinstance(one, LeftOut) or len(one) > LONGEST for one in walks.values()):
            continue
        walked, text = walks[kind], Text.of(episode.instruction_text)
        actions, right = with_mistakes(walked, episode, pathfinder, arguments.mistakes, arguments.seed)
        frames = frames_along(episode, walked, actions, pathfinder, view, text)
        yield {
            "text": episode.instruction_text,
            "episode": str(episode.episode_id),
            "actions": torch.tensor(actions.astype(np.int8)),
            "right": torch.tensor(right),
            **frame_tensors(frames),
        }


def main() -> None:
    """Record the walks of one kind of a split of one or several exports."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("exports", nargs="+", help="EXPORT=DATASET")
    parser.add_argument("--kind", choices=("looking", "direct"), required=True)
    parser.add_argument("--split", default="train")
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--most", type=int, help="number of episodes taken of each export")
    parser.add_argument("--mistakes", type=float, default=0.6, help="share of walks with mistakes")
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    began, walks = time.time(), []
    for pair in arguments.exports:
        folder, _, dataset = pair.partition("=")
        for one in recorded(Path(folder), Path(dataset), arguments.kind, arguments, arguments.most):
            walks.append(one)
            if len(walks) % 200 == 0:
                print(f"{len(walks)} walks, {time.time() - began:.0f} s", flush=True)
    arguments.out.parent.mkdir(parents=True, exist_ok=True)
    torch.save(walks, arguments.out)
    counts = torch.bincount(torch.cat([one["actions"] for one in walks]).long(), minlength=4).tolist()
    print(json.dumps({"walks": len(walks), "frames": sum(counts), "stop, forward, left, right": counts}))


if __name__ == "__main__":
    main()
