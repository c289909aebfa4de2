"""Faults in places, paths and numbers."""

from __future__ import annotations

from typing import Any

import numpy as np
from mutation import Files, World, mutator, pick

from condvln.verify.standpoint import heading_of, yaw_of


@mutator
def move_the_start(files: Files, rng: np.random.Generator, world: World) -> bool:
    axis = int(rng.choice([0, 2]))
    start = files.manifest["start_position"]
    start[axis] = files.record["start_position"][axis] = round(start[axis] + float(rng.choice([-2.0, 2.0])), 3)
    for leaf in files.manifest["leaves"]:
        leaf["reference_path"][0] = list(start)
    files.repeat_gold()
    return True


@mutator
def turn_the_start(files: Files, rng: np.random.Generator, world: World) -> bool:
    yaw = (yaw_of(files.manifest["start_rotation"]) or 0.0) + np.radians(float(rng.choice([45, 90, 180, 270])))
    turned = [0.0, float(np.sin(yaw / 2)), 0.0, float(np.cos(yaw / 2))]
    files.manifest["start_rotation"] = files.record["start_rotation"] = turned
    files.record["info"]["start_heading_degrees"] = heading_of(yaw)
    return True


@mutator
def lengthen(files: Files, rng: np.random.Generator, world: World) -> bool:
    leaf, name = pick(rng, files.manifest["leaves"]), pick(rng, ("geodesic_distance", "route_length"))
    leaf[name] += float(rng.choice([-1.0, 1.0])) * float(rng.uniform(0.005, 1.0))
    files.take_leaf(files.manifest["gold_leaf"])
    return True


@mutator
def bend_a_path(files: Files, rng: np.random.Generator, world: World) -> bool:
    path = pick(rng, files.manifest["leaves"])["reference_path"]
    corner = path[rng.integers(len(path))]
    corner[int(rng.choice([0, 2]))] += float(rng.choice([-0.01, 0.01, 0.5]))
    files.repeat_gold()
    return True


@mutator
def cut_a_path(files: Files, rng: np.random.Generator, world: World) -> bool:
    path = pick(rng, files.manifest["leaves"])["reference_path"]
    if len(path) < 3:
        return False
    del path[rng.integers(1, len(path))]
    files.repeat_gold()
    return True


@mutator
def another_success_distance(files: Files, rng: np.random.Generator, world: World) -> bool:
    files.manifest["success_distance"] = files.record["info"]["success_distance"] = 3.0
    files.repeat_gold()
    return True


@mutator
def come_back_to_a_room(files: Files, rng: np.random.Generator, world: World) -> bool:
    """The first two stops of a leaf change places, in the program and where they lie; the text says so."""
    for k, leaf in enumerate(files.manifest["program"]["leaves"]):
        rooms = [move["room"]["room_id"] for move in leaf["moves"]]
        if len(rooms) == 3 and rooms[0] != rooms[1] == rooms[2]:
            leaf["moves"][:2] = leaf["moves"][1::-1]
            subgoals = files.manifest["leaves"][k]["subgoals"]
            subgoals[:2] = subgoals[1::-1]
            files.word()
            files.take_leaf(files.manifest["gold_leaf"])
            return True
    return False


@mutator
def walk_a_detour(files: Files, rng: np.random.Generator, world: World) -> bool:
    """A leaf's way goes on past its distance's bound, as far as the numbers say."""
    leaf = pick(rng, files.manifest["leaves"])
    leaf["route_length"] = 2 * leaf["geodesic_distance"] + 4 + float(rng.uniform(0.01, 3.0))
    files.take_leaf(files.manifest["gold_leaf"])
    return True


@mutator
def another_budget(files: Files, rng: np.random.Generator, world: World) -> bool:
    files.manifest["max_steps"] -= int(rng.integers(1, 50))
    files.record["info"]["max_steps"] = files.manifest["max_steps"]
    return True


@mutator
def another_axis(files: Files, rng: np.random.Generator, world: World) -> bool:
    name = pick(rng, ("depth", "chain", "moves", "words", "composition"))
    if name == "composition":
        value: Any = pick(rng, {"C0", "C1", "C2"} - {files.manifest[name]})
    else:
        value = files.manifest[name] + 1
    files.manifest[name] = files.record["info"][name] = value
    return True


@mutator
def another_navmesh(files: Files, rng: np.random.Generator, world: World) -> bool:
    files.manifest["navmesh_sha256"] = files.record["info"]["navmesh_sha256"] = f"{rng.integers(1 << 60):064x}"
    return True
