"""Made rows of the episodes, instructions and scenes tables: every category, every gold leaf, no geometry behind."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pyarrow as pa

from condvln.episodes.identity import numeric_id
from condvln.export.tables import BATCH_ROWS
from condvln.navigation.points import densify
from schemas.program import CATEGORIES, SHAPES, Category
from schemas.tables import EPISODES, INSTRUCTIONS, SCENES

ROOMS = ("kitchen", "bedroom", "bathroom", "office", "hallway")
LABELS = ("stool", "lamp", "sink", "bed", "sofa", "desk", "plant", "towel", "mirror", "clock", "rug", "oven")


@dataclass(frozen=True)
class MemoryTables:
    """The tables of a snapshot in memory, ``tables[source][name]``, in place of `FolderTables`."""

    id: str
    tables: Mapping[str, Mapping[str, pa.Table]]

    @property
    def sources(self) -> tuple[str, ...]:
        return tuple(sorted(self.tables))

    def batches(self, table: str, source: str, columns: Sequence[str] | None = None) -> Iterator[pa.RecordBatch]:
        found = self.tables[source][table]
        yield from (found if columns is None else found.select([*columns])).to_batches(max_chunksize=BATCH_ROWS)


def point(values: Any) -> dict[str, float]:
    return dict(zip("xyz", (round(float(v), 3) for v in values), strict=True))


def made_leaf(rng: np.random.Generator, leaf: int, start: np.ndarray, moves: int) -> dict[str, Any]:
    steps = np.stack([np.zeros(n := int(rng.integers(2, 8)))] * 3, axis=1)
    steps[:, 0], steps[:, 2] = rng.uniform(1.0, 2.5, n), rng.normal(0, 2.0, n)
    corners = np.vstack([start, start + np.cumsum(steps, axis=0)])
    subgoals = [{"object_id": f"via{leaf}{i}", "position": point(corners[i + 1])} for i in range(moves - 1)][:3]
    end, around = corners[-1], rng.normal(0, 0.2, (int(rng.integers(0, 7)), 3)) * [1, 0, 1]
    lengths = np.linalg.norm(np.diff(corners, axis=0), axis=1)
    return {
        "leaf": leaf,
        "object_id": f"object{leaf}",
        "goals": [point(end), *(point(end + offset) for offset in around)],
        "subgoals": subgoals,
        "reference_path": [point(corner) for corner in corners],
        "geodesic_distance": round(float(np.linalg.norm(corners[-1] - corners[0])), 6),
        "route_length": round(float(lengths.sum()), 6),
    }


def made_rows(
    rng: np.random.Generator, scene: str, number: int, category: Category, group: str | None = None
) -> tuple[dict[str, Any], dict[str, Any]]:
    """One row of the episodes table and its row of the instructions table."""
    shape = SHAPES[category]

    def room() -> dict[str, Any]:
        name = ROOMS[rng.integers(len(ROOMS))]
        return {"room_id": f"{scene}-{name}", "label": name, "anchor_id": None, "anchor_label": None}

    truths = [bool(rng.integers(2)) for _ in shape.branches]
    at = 0
    while at >= 0:
        branch = shape.branches[at]
        at = branch.then if truths[branch.condition] else branch.otherwise
    gold = -1 - at
    conditions = [
        {
            "label": LABELS[rng.integers(len(LABELS))],
            "room": room(),
            "qualifier": {"predicate": "near", "anchors": [{"object_id": "a", "label": "bed"}]}
            if rng.integers(2)
            else None,
            "truth": truth,
            "definite": False,
            "witnesses": ["w"] if truth else [],
        }
        for truth in truths
    ]
    moves = [int(rng.integers(1, 4)) for _ in range(shape.leaves)]
    leaves = [
        {
            "moves": [
                {
                    "object_id": f"via{leaf}{i}" if i < moves[leaf] - 1 else f"object{leaf}",
                    "label": LABELS[rng.integers(len(LABELS))],
                    "room": room(),
                    "qualifier": None,
                }
                for i in range(moves[leaf])
            ]
        }
        for leaf in range(shape.leaves)
    ]
    text = "If " + ", else if ".join(
        f"there's a {c['label']} in the {c['room']['label']}, go to the {leaves[i]['moves'][-1]['label']}"
        for i, c in enumerate(conditions)
    )
    text += f", otherwise walk to the {leaves[-1]['moves'][-1]['label']} number {number}."
    start = np.round(rng.normal(0, 5, 3) * [1, 0, 1], 3)
    placed = [made_leaf(rng, leaf, start, moves[leaf]) for leaf in range(shape.leaves)]
    walked = densify([list(corner.values()) for corner in placed[gold]["reference_path"]])
    heading = int(rng.integers(8)) * 45
    half = np.radians(-heading) / 2
    instruction_id = f"{scene}-i{number:06d}"
    episode = {
        "scene_id": scene,
        "episode_id": numeric_id(f"{scene}-e{number:06d}"),
        "episode_hash": f"{scene}-e{number:06d}",
        "instruction_id": instruction_id,
        "group_id": group,
        "category": category,
        "depth": shape.depth,
        "chain": shape.chain,
        "composition": ("C0", "C1", "C2")[rng.integers(3)],
        "oddness": number % 14,
        "observability": (level := ("O0", "O1", "O2", None)[rng.integers(4)]),
        "evidence_in_view": level and level == "O0",
        "observability_approximate": level and True,
        "evidence": level and [{"condition": 0, "observability": level, "in_view": level == "O0", "degrees": 5.0}],
        "gold_leaf": gold,
        "n_leaves": shape.leaves,
        "gold_label": leaves[gold]["moves"][-1]["label"],
        "moves": moves[gold],
        "leads": 0,
        "start_position": point(start),
        "start_rotation": {"x": 0.0, "y": float(np.sin(half)), "z": 0.0, "w": float(np.cos(half))},
        "start_heading_degrees": float(heading),
        "geodesic_distance": placed[gold]["geodesic_distance"],
        "route_length": placed[gold]["route_length"],
        "leaves": placed,
        "success_distance": 1.0,
        "ground_truth_steps": 60,
        "actions": [2, *[1] * (len(walked) - 1), 3, 0] if number % 2 else None,
        "locations": [point(place) for place in walked] if number % 2 else None,
        "looking_path": placed[gold]["reference_path"] if number % 2 else None,
        "looking_length": placed[gold]["route_length"] if number % 2 else None,
        "looking_actions": [2, *[1] * (len(walked) - 1), 3, 0] if number % 2 else None,
        "looking_decided": [1] if number % 2 else None,
        "looking_locations": [point(place) for place in walked] if number % 2 else None,
        "words": len(text.split()),
        "max_steps": 300,
        "instruction_text": text,
        "navmesh_sha256": "0" * 64,
    }
    instruction = {
        "scene_id": scene,
        "instruction_id": instruction_id,
        "group_id": group,
        "category": category,
        "depth": shape.depth,
        "chain": shape.chain,
        "composition": episode["composition"],
        "oddness": episode["oddness"],
        "n_conditions": len(conditions),
        "n_relational": sum(c["qualifier"] is not None for c in conditions),
        "n_leaves": shape.leaves,
        "gold_leaf": gold,
        "moves": moves[gold],
        "leads": 0,
        "conditions": conditions,
        "branches": [branch.model_dump() for branch in shape.branches],
        "leaves": leaves,
        "text": text,
        "words": episode["words"],
    }
    return episode, instruction


def made_scene(scene: str, **changes: Any) -> dict[str, Any]:
    """One row of the scenes table."""
    return {
        "scene_id": scene,
        "status": "ok",
        "reason": None,
        "n_rooms": 4,
        "n_objects": 40,
        "n_objects_without_extent": 0,
        "navmesh_path": f"navmeshes/{scene}.navmesh",
        "navmesh_sha256": "0" * 64,
        "navmesh_built": False,
        "navmesh_fits": True,
        "stage": [],
        "warnings": [],
        **changes,
    }


def made_snapshot(
    scenes: dict[str, list[str]] | None = None, per_category: int = 12, seed: int = 0, identity: str = "made"
) -> MemoryTables:
    """A whole snapshot; ``scenes`` by source. Every fourth pair of episodes of a scene is a counterfactual group."""
    scenes = scenes or {"replicacad": ["v3_sc0_staging_00", "v3_sc0_staging_01", "v3_sc1_staging_00", "apt_0"]}
    tables: dict[str, dict[str, pa.Table]] = {}
    for source, names in scenes.items():
        episodes, instructions = [], []
        for scene in sorted(names):
            digest = int.from_bytes(f"{source}/{scene}".encode(), "big")
            rng = np.random.default_rng([seed, digest % (1 << 60)])
            number = 0
            for category in CATEGORIES:
                for turn in range(per_category):
                    group = f"{scene}-g{category}{turn // 2}" if turn % 8 < 2 else None
                    episode, instruction = made_rows(rng, scene, number, category, group)
                    episodes.append(episode)
                    instructions.append(instruction)
                    number += 1
        tables[source] = {
            "episodes": pa.Table.from_pylist(episodes, EPISODES),
            "instructions": pa.Table.from_pylist(instructions, INSTRUCTIONS),
            "scenes": pa.Table.from_pylist([made_scene(scene) for scene in sorted(names)], SCENES),
        }
    return MemoryTables(identity, tables)
