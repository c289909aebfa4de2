"""Faults in what an episode says is true, and where it goes."""

from __future__ import annotations

import numpy as np
from mutation import Files, World, mutator, pick


@mutator
def flip_truth(files: Files, rng: np.random.Generator, world: World) -> bool:
    condition = pick(rng, files.conditions)
    condition["truth"] = not condition["truth"]
    condition["witnesses"] = [world.scene.objects[0].object_id] if condition["truth"] else []
    files.follow_truths()
    return True


@mutator
def drop_a_witness(files: Files, rng: np.random.Generator, world: World) -> bool:
    several = [c for c in files.conditions if len(c["witnesses"]) > 1]
    if not several:
        return False
    pick(rng, several)["witnesses"].pop()
    return True


@mutator
def replace_a_witness(files: Files, rng: np.random.Generator, world: World) -> bool:
    true = [c for c in files.conditions if c["truth"]]
    if not true:
        return False
    condition = pick(rng, true)
    others = [o.object_id for o in world.scene.objects if o.object_id not in condition["witnesses"]]
    condition["witnesses"][0] = pick(rng, others)
    return True


@mutator
def swap_gold_leaf(files: Files, rng: np.random.Generator, world: World) -> bool:
    files.take_leaf(pick(rng, {*range(len(files.leaves))} - {files.manifest["gold_leaf"]}))
    return True


@mutator
def swap_leaves_of_program(files: Files, rng: np.random.Generator, world: World) -> bool:
    """Program, places and record agree on it; the text says otherwise."""
    one, other = rng.choice(len(files.leaves), 2, replace=False)
    for leaves in (files.leaves, files.manifest["leaves"]):
        leaves[one], leaves[other] = leaves[other], leaves[one]
    for k, leaf in enumerate(files.manifest["leaves"]):
        leaf["leaf"] = k
    files.follow_truths()
    return True


@mutator
def swap_leaves_as_said(files: Files, rng: np.random.Generator, world: World) -> bool:
    """Text and program agree on it; the places stay."""
    one, other = rng.choice(len(files.leaves), 2, replace=False)
    files.leaves[one], files.leaves[other] = files.leaves[other], files.leaves[one]
    files.word()
    return True


@mutator
def swap_places_of_leaves(files: Files, rng: np.random.Generator, world: World) -> bool:
    """Only the places of two leaves change with each other."""
    one, other = rng.choice(len(files.leaves), 2, replace=False)
    leaves = files.manifest["leaves"]
    leaves[one], leaves[other] = leaves[other], leaves[one]
    for k, leaf in enumerate(leaves):
        leaf["leaf"] = k
    files.follow_truths()
    return True


@mutator
def swap_conditions(files: Files, rng: np.random.Generator, world: World) -> bool:
    if len(files.conditions) < 2:
        return False
    one, other = rng.choice(len(files.conditions), 2, replace=False)
    files.conditions[one], files.conditions[other] = files.conditions[other], files.conditions[one]
    files.follow_truths()
    return True
