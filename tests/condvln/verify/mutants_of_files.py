"""Faults in one file by itself."""

from __future__ import annotations

import numpy as np
from mutation import Document, Files, World, mutator, pick


@mutator
def change_the_record(files: Files, rng: np.random.Generator, world: World) -> bool:
    name = pick(rng, ("start_position", "goals", "reference_path", "scene_id", "trajectory_id", "text", "info"))
    record = files.record
    if name == "start_position":
        record[name] = [record[name][0] + 0.01, *record[name][1:]]
    elif name == "goals":
        record[name] = record[name][::-1] if len(record[name]) > 1 else []
    elif name == "reference_path":
        record[name] = record[name][:-1]
    elif name == "text":
        record["instruction"]["instruction_text"] += " "
    elif name == "info":
        del record["info"][pick(rng, sorted(record["info"]))]
    else:
        record[name] = "elsewhere"
    return True


@mutator
def change_the_truth(files: Files, rng: np.random.Generator, world: World) -> bool:
    return _change(files.truth, rng)


@mutator
def change_the_looking_truth(files: Files, rng: np.random.Generator, world: World) -> bool:
    return files.looking_truth is not None and _change(files.looking_truth, rng)


@mutator
def put_the_direct_truth_for_the_looking_one(files: Files, rng: np.random.Generator, world: World) -> bool:
    files.looking_truth = files.truth
    return files.truth["actions"] != files.manifest["looking_actions"]


def _change(truth: Document, rng: np.random.Generator) -> bool:
    kind = int(rng.integers(4))
    if kind == 0:
        truth["forward_steps"] += 1
    elif kind == 1:
        place = truth["locations"][rng.integers(len(truth["locations"]))]
        place[int(rng.choice([0, 2]))] += 0.05
    elif kind == 2:
        truth["locations"] = truth["locations"][:-1]
    else:
        actions = truth.get("actions")
        if not actions:
            return False
        turns = [k for k, action in enumerate(actions) if action in (2, 3)]
        if not turns:
            return False
        k = pick(rng, turns)
        actions[k] = 5 - actions[k]
        if 1 not in actions[k:]:
            return False  # a turn on the goal leads nowhere else
    return True
