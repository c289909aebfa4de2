"""Manifest rows whose gold leaf is drawn fairly, or leaks as a test wants it to; and rows of sampled programs."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest

from condvln.instructions import ProgramSampler, instruction_id, render
from schemas.program import SHAPES, Category, leaf_truths

LABELS = ("lamp", "sofa", "bed", "stool", "sink", "desk", "plant", "towel", "mirror", "clock", "rug", "oven")
ROOMS = ("kitchen", "bedroom", "bathroom")

Leak = Callable[[dict[str, Any], np.random.Generator], None]


def fair_row(rng: np.random.Generator, category: Category, scene: str, number: int, gold: int) -> dict[str, Any]:
    """A row in which nothing tells the gold leaf."""
    shape = SHAPES[category]
    truths = rng.integers(2, size=len(shape.branches)).astype(bool)
    for k, truth in leaf_truths(category)[gold]:
        truths[k] = truth

    def named() -> dict[str, Any]:
        room = {"label": ROOMS[rng.integers(len(ROOMS))]}
        return {"label": LABELS[rng.integers(len(LABELS))], "room": room, "qualifier": None}

    conditions = [{**named(), "definite": False, "truth": bool(truth)} for truth in truths]
    leaves = [{"moves": [named() for _ in range(rng.integers(1, 4))]} for _ in range(shape.leaves)]
    asked = " and ".join(f"a {c['label']} in the {c['room']['label']}" for c in conditions)
    goals = ", ".join(leaf["moves"][-1]["label"] for leaf in leaves)
    return {
        "episode_hash": f"{scene}-{category}-{number}",
        "source": "made",
        "scene_id": scene,
        "category": category,
        "group_id": None,
        "instruction_text": f"If there is {asked}, go to the {goals}.",
        "program": {"conditions": conditions, "leaves": leaves},
        "leaves": [
            {"geodesic_distance": float(rng.uniform(2, 20)), "route_length": float(rng.uniform(20, 30))}
            for _ in range(shape.leaves)
        ],
        "gold_leaf": gold,
    }


@pytest.fixture(scope="session")
def made_rows() -> Callable[..., list[dict[str, Any]]]:
    """``made_rows(seed, scenes, each, categories, leak)``: rows of all scenes, `each` of every gold leaf."""

    def make(
        seed: int,
        scenes: int = 20,
        each: int = 4,
        categories: tuple[Category, ...] = ("simple", "chain"),
        leak: Leak | None = None,
    ) -> list[dict[str, Any]]:
        rng = np.random.default_rng(seed)
        rows = []
        for scene in range(scenes):
            for category in categories:
                for number in range(each * SHAPES[category].leaves):
                    gold = number % SHAPES[category].leaves
                    row = fair_row(rng, category, f"s{scene}", number, gold)
                    if leak is not None:
                        leak(row, rng)
                    rows.append(row)
        return rows

    return make


RowsOf = Callable[[ProgramSampler], Iterator[dict[str, Any]]]


@pytest.fixture(scope="session")
def rows_of() -> RowsOf:
    """Manifest rows, without places, of all that a sampler draws."""

    def made(sampler: ProgramSampler) -> Iterator[dict[str, Any]]:
        scene = sampler.scene
        for category in sampler.wanted.per_category:
            for k, program in enumerate(sampler.candidates(category)):
                yield {
                    "episode_hash": f"{scene.scene_id} {category} {k}",
                    "source": scene.family,
                    "scene_id": scene.scene_id,
                    "category": category,
                    "group_id": None,
                    "instruction_text": render(program, 0, instruction_id(scene.family, scene.scene_id, program)),
                    "program": program.model_dump(mode="json"),
                    "leaves": [{"geodesic_distance": 0.0, "route_length": 0.0}] * len(program.leaves),
                    "gold_leaf": program.gold_leaf(),
                }

    return made
