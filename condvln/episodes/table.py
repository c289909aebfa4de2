"""Placed programs as table rows: PLACEMENTS before the text is known, EPISODES after."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import Any, Final

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from condvln.episodes.candidates import cell_name
from condvln.episodes.identity import content_hash, numeric_id
from condvln.episodes.observability import Observation
from condvln.episodes.placing import PlacedLeaf, heading_degrees, yaw_quaternion
from condvln.episodes.pool import EpisodePool, PooledEpisode
from condvln.scene import round_mm
from schemas.config import InstructionCell, StepBudget
from schemas.config.constants import GROUP_SIZE
from schemas.tables import EPISODES, FUNNEL, REJECTIONS, VEC3

__all__ = [
    "PLACEMENTS",
    "STOPS",
    "TEXT_COLUMNS",
    "funnel_table",
    "goals_from_table",
    "placements_table",
    "rejections_table",
    "stops_table",
    "with_text",
]

TEXT_COLUMNS: Final = ("words", "max_steps", "instruction_text")
PLACEMENTS: Final = pa.schema([f for f in EPISODES if f.name not in TEXT_COLUMNS])
"""Schema of the episodes table without the columns that depend on the wording."""

STOPS: Final = pa.schema(
    [
        pa.field("scene_id", pa.string(), nullable=False),
        pa.field("object_id", pa.string(), nullable=False),
        pa.field("points", pa.list_(VEC3), nullable=False),
    ]
)
"""Schema of the goal points of every reachable object that text can name, nearest first; stored in the unit, not
published."""


def stops_table(scene_id: str, goals: Mapping[str, NDArray[np.float64]]) -> pa.Table:
    """Return goal points (k, 3) by object id as STOPS rows."""
    rows = [{"scene_id": scene_id, "object_id": name, "points": _points(points)} for name, points in goals.items()]
    return pa.Table.from_pylist(rows, schema=STOPS)


def goals_from_table(table: pa.Table) -> dict[str, NDArray[np.float64]]:
    """Return the goal points (k, 3) by object id from STOPS rows, in the table's order."""
    return {
        row["object_id"]: np.array([[p["x"], p["y"], p["z"]] for p in row["points"]], dtype=np.float64)
        for row in table.select(["object_id", "points"]).to_pylist()
    }


def placements_table(
    scene_id: str, pool: EpisodePool, compositions: Mapping[str, str], navmesh_sha256: str
) -> pa.Table:
    """Return the pool's episodes as PLACEMENTS rows. `compositions` has the composition of each instruction, by
    instruction id.
    """
    rows = [_row(scene_id, e, compositions[e.instruction_id], navmesh_sha256) for e in pool.episodes]
    return pa.Table.from_pylist(rows, schema=PLACEMENTS)


def _row(scene_id: str, pooled: PooledEpisode, composition: str, navmesh_sha256: str) -> dict[str, Any]:
    program, placement = pooled.program, pooled.placement
    gold = program.gold_leaf()
    leaf = placement.leaves[gold]
    name = content_hash(scene_id, pooled.instruction_id, placement.start, placement.yaw)
    return {
        "scene_id": scene_id,
        "episode_id": numeric_id(name),
        "episode_hash": name,
        "instruction_id": pooled.instruction_id,
        "group_id": pooled.candidate.group_id,
        "category": program.category,
        "composition": composition,
        **_seen(pooled.observation),
        "gold_leaf": gold,
        "n_leaves": len(program.leaves),
        "gold_label": program.leaves[gold].goal.label,
        "moves": len(program.leaves[gold].moves),
        "start_position": _point(placement.start),
        "start_rotation": dict(zip("xyzw", yaw_quaternion(placement.yaw), strict=True)),
        "start_heading_degrees": heading_degrees(placement.yaw),
        "geodesic_distance": leaf.geodesic_distance,
        "route_length": leaf.route.length,
        "leaves": [_leaf(k, placed) for k, placed in enumerate(placement.leaves)],
        "success_distance": placement.success_distance,
        "ground_truth_steps": placement.steps,
        "actions": leaf.walk.actions.tolist(),
        "locations": _points(round_mm(leaf.walk.locations)),
        "navmesh_sha256": navmesh_sha256,
    }


def _seen(observation: Observation | None) -> dict[str, Any]:
    if observation is None:
        return dict.fromkeys(("observability", "evidence_in_view", "observability_approximate", "evidence"))
    return {
        "observability": observation.observability,
        "evidence_in_view": observation.in_view,
        "observability_approximate": observation.approximate,
        "evidence": [asdict(evidence) for evidence in observation.evidence],
    }


def _leaf(index: int, leaf: PlacedLeaf) -> dict[str, Any]:
    return {
        "leaf": index,
        "object_id": leaf.objects[-1],
        "goals": _points(leaf.goals),
        "subgoals": [
            {"object_id": name, "position": _point(point)}
            for name, point in zip(leaf.objects[:-1], leaf.route.stops[:-1], strict=True)
        ],
        "reference_path": _points(leaf.route.path),
        "geodesic_distance": leaf.geodesic_distance,
        "route_length": leaf.route.length,
    }


def _point(values: NDArray[np.float64]) -> dict[str, float]:
    x, y, z = values.tolist()
    return {"x": x, "y": y, "z": z}


def _points(values: NDArray[np.float64]) -> list[dict[str, float]]:
    return [{"x": x, "y": y, "z": z} for x, y, z in values.tolist()]


def with_text(placements: pa.Table, texts: Mapping[int, str], max_steps: StepBudget, steps_per_word: int) -> pa.Table:
    """Return EPISODES rows: each placement with its text (by episode id), word count and step budget.

    A proportional budget is max(`steps_per_word` × words, 2 × ground-truth actions), as in the paper. In a
    counterfactual group the words of the longest text count, so that all members have the same budget.
    """
    columns = ("episode_id", "group_id", "ground_truth_steps")
    rows = list(zip(*(placements[name].to_pylist() for name in columns), strict=True))
    said = [texts[episode_id] for episode_id, _, _ in rows]
    words = [len(text.split()) for text in said]
    longest: dict[str | int, int] = {}
    for (episode_id, group_id, _), count in zip(rows, words, strict=True):
        unit = group_id or episode_id
        longest[unit] = max(longest.get(unit, 0), count)
    budgets = [
        max(steps_per_word * longest[group_id or episode_id], 2 * steps) if max_steps == "proportional" else max_steps
        for episode_id, group_id, steps in rows
    ]
    new = dict(zip(TEXT_COLUMNS, (words, budgets, said), strict=True))
    return pa.table(
        [pa.array(new[f.name], f.type) if f.name in new else placements[f.name] for f in EPISODES], schema=EPISODES
    )


def rejections_table(
    scene_id: str,
    stage: str,
    counts: Mapping[tuple[InstructionCell | None, str], int],
    examples: Mapping[tuple[InstructionCell | None, str], str] | None = None,
) -> pa.Table:
    """Return the numbers of rejections, `counts`, as REJECTIONS rows. `examples` has one rejected program's id for each
    (cell, reason).
    """
    rows = [
        {
            "scene_id": scene_id,
            "stage": stage,
            "category": None if cell is None else cell.category,
            "cell": cell_name(cell),
            "reason": reason,
            "count": count,
            "example": (examples or {}).get((cell, reason)),
        }
        for (cell, reason), count in sorted(counts.items(), key=lambda item: (item[0][1], cell_name(item[0][0])))
    ]
    return pa.Table.from_pylist(rows, schema=REJECTIONS)


def funnel_table(scene_id: str, cells: Sequence[InstructionCell], pool: EpisodePool, groups: int = 0) -> pa.Table:
    """Return the numbers of wanted, drawn and placed episodes of each cell and of counterfactual groups, as FUNNEL
    rows.
    """
    placed = pool.placed
    wanted: list[tuple[InstructionCell | None, int]] = [(cell, cell.count) for cell in cells]
    if groups:
        wanted.append((None, groups * GROUP_SIZE))
    rows = [
        {
            "scene_id": scene_id,
            "category": None if cell is None else cell.category,
            "cell": cell_name(cell),
            "wanted": count,
            "candidates": pool.candidates[cell],
            "rejected": sum(n for (of, _), n in pool.rejections.items() if of == cell),
            "placed": placed[cell],
        }
        for cell, count in wanted
    ]
    return pa.Table.from_pylist(rows, schema=FUNNEL)
