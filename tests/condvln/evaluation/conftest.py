"""Tasks and worlds for the tests of evaluation."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from condvln.evaluation.split import Export, open_export
from condvln.evaluation.task import LeafTask, Task
from condvln.navigation.pathfinder import Pathfinder
from condvln.navigation.polygon_tile import tile_of_polygons
from condvln.samples import make_samples
from condvln.sources.registry import open_source
from condvln.world import open_world
from schemas.config import InstructionsConfig
from schemas.program import SHAPES, Condition, Leaf, ObjectRef, Program, RoomRef
from tests.once import made_once

L_VERTICES = [[0, 0, 0], [4, 0, 0], [4, 0, 2], [2, 0, 2], [0, 0, 2], [2, 0, 4], [0, 0, 4]]
L_POLYGONS = [[0, 1, 2, 3, 4], [4, 3, 5, 6]]


class OpenPlain:
    """A world without walls: geodesic = straight line; beyond x = 50 m lies an island nobody reaches."""

    def snap_points(self, points: Any, island: int | None = None) -> np.ndarray:
        return np.asarray(points, dtype=np.float64).reshape(-1, 3)

    def try_steps(self, starts: Any, ends: Any) -> np.ndarray:
        return np.asarray(ends, dtype=np.float64).reshape(-1, 3)

    def geodesic_distances(self, starts: Any, ends: Any) -> np.ndarray:
        a, b = np.broadcast_arrays(np.asarray(starts, float).reshape(-1, 3), np.asarray(ends, float).reshape(-1, 3))
        lines = np.sqrt(np.square(a - b).sum(axis=1))
        return np.where((a[:, 0] > 50) != (b[:, 0] > 50), np.inf, lines)

    def geodesic_distance(self, start: Any, end: Any) -> float:
        return float(self.geodesic_distances(start, end).min())


@pytest.fixture(scope="session")
def plain() -> OpenPlain:
    return OpenPlain()


@pytest.fixture(scope="session")
def l_shape() -> Pathfinder:
    """Two rooms of an L, 12 m²; the reflex corner is at (2, 2)."""
    return Pathfinder.from_tile(tile_of_polygons(L_VERTICES, L_POLYGONS))


def program_of(category: str, gold: int = 0) -> Program:
    """A program of a category whose truths lead to leaf ``gold``."""
    shape = SHAPES[category]  # type: ignore[index]
    room = RoomRef(room_id="r", label="kitchen")
    for bits in range(2 ** len(shape.branches)):
        truths = [bool(bits >> i & 1) for i in range(len(shape.branches))]
        program = Program(
            category=category,  # type: ignore[arg-type]
            conditions=tuple(
                Condition(label=f"thing{i}", room=room, truth=truth, witnesses=("w",) if truth else ())
                for i, truth in enumerate(truths)
            ),
            branches=shape.branches,
            leaves=tuple(
                Leaf(moves=(ObjectRef(object_id=f"o{i}", label=f"goal{i}", room=room),)) for i in range(shape.leaves)
            ),
        )
        if program.gold_leaf() == gold:
            return program
    raise AssertionError(gold)


def task_with(
    leaves: list[dict[str, Any]],
    gold: int = 0,
    *,
    start: Any = (0.0, 0.0, 0.0),
    reference: Any = None,
    tau: float = 1.0,
    max_steps: int = 500,
    category: str | None = None,
    **changes: Any,
) -> Task:
    """A task of the given leaves (goals, subgoals, route_length)."""
    category = category or {2: "simple", 3: "nested", 4: "deep_nested"}[len(leaves)]
    tasks = tuple(
        LeafTask(
            np.array(leaf["goals"], float).reshape(-1, 3),
            np.array(leaf.get("subgoals", []), float).reshape(-1, 3),
            float(leaf.get("route_length", 1.0)),
            float(leaf.get("geodesic_distance", 1.0)),
            np.array([start, *leaf.get("subgoals", []), leaf["goals"][0]], float),
            (*(f"stop at {[*map(float, stop)]}" for stop in leaf.get("subgoals", [])), f"goal {number}"),
            tuple(None if room is None else np.array(room, float) for room in leaf.get("outlines", [])),
        )
        for number, leaf in enumerate(leaves)
    )
    axes = {
        "source": "made",
        "scene": "made/a",
        "category": category,
        "depth": SHAPES[category].depth,  # type: ignore[index]
        "chain": SHAPES[category].chain,  # type: ignore[index]
        "composition": "C0",
        "oddness": "00",
        "observability": None,
        "evidence_in_view": None,
        "observability_approximate": None,
        "evidence": None,
        "moves": 1 + len(leaves[gold].get("subgoals", [])),
        "leads": 0,
        "route": "00–05 m",
        "words": "000–039",
    }
    values = {
        "episode_id": "e",
        "group_id": None,
        "text": "If there's a lamp, go to the sink, otherwise to the bed.",
        "axes": axes,
        "program": program_of(category, gold),
        "gold_leaf": gold,
        "leaves": tasks,
        "start": np.array(start, float),
        "start_rotation": (0.0, 0.0, 0.0, 1.0),
        "reference": np.array([start, leaves[gold]["goals"][0]] if reference is None else reference, float),
        "success_distance": tau,
        "max_steps": max_steps,
        "navmesh": "a.navmesh",
        "navmesh_sha256": "0" * 64,
        **changes,
    }
    return Task(**values)


@pytest.fixture(scope="session")
def made(tmp_path_factory: pytest.TempPathFactory) -> tuple[Export, Path]:
    """An export of two made scenes with shipped navmeshes, and the folder of its dataset."""

    def make(root: Path) -> Path:
        make_samples(root / "replicacad", family="replicacad", scenes=2, seed=3)
        source = open_source("replicacad", root / "replicacad")
        wanted = InstructionsConfig(per_category={"simple": 4, "chain": 3, "nested": 3}, counterfactual_groups=0)
        rows = [row for name in source.scene_ids() for row in open_world(source, name).episodes(instructions=wanted)]
        assert len({row.scene_id for row in rows}) == 2
        (root / "export" / "manifest").mkdir(parents=True)
        text = "".join(row.model_dump_json() + "\n" for row in rows)
        (root / "export" / "manifest" / "train.jsonl").write_text(text, encoding="utf-8")
        return root

    root = made_once(tmp_path_factory, "environment", make)
    return open_export(root / "export", (root / "replicacad",)), root / "replicacad"
