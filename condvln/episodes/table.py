"""Placed programs as table rows: PLACEMENTS before the text is known, EPISODES after."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import accumulate
from typing import Any, Final

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from condvln.episodes.candidates import Candidate, cell_name
from condvln.episodes.identity import content_hash, numeric_id
from condvln.episodes.observability import Observation
from condvln.episodes.placing import PlacedLeaf, heading_degrees, yaw_quaternion
from condvln.episodes.pool import EpisodePool
from condvln.scene import round_mm
from schemas.config import InstructionCell, StepBudget
from schemas.config.constants import GROUP_SIZE
from schemas.tables import EPISODES, FUNNEL, QUATERNION, REJECTIONS, VEC3

__all__ = [
    "PLACEMENTS",
    "TEXT_COLUMNS",
    "funnel_table",
    "placements_table",
    "rejections_table",
    "with_text",
]

TEXT_COLUMNS: Final = ("words", "max_steps", "instruction_text")
PLACEMENTS: Final = pa.schema([f for f in EPISODES if f.name not in TEXT_COLUMNS])
"""Schema of the episodes table without the columns that depend on the wording."""

_POINTS: Final = pa.list_(VEC3)


def placements_table(
    scene_id: str, pool: EpisodePool, compositions: Mapping[str, str], navmesh_sha256: str
) -> pa.Table:
    """Return the pool's episodes as PLACEMENTS rows. `compositions` has the composition of each instruction, by
    instruction id.
    """
    episodes = pool.episodes
    names = [content_hash(scene_id, e.instruction_id, e.placement.start, e.placement.yaw) for e in episodes]
    programs, placements = [e.program for e in episodes], [e.placement for e in episodes]
    golds = [program.gold_leaf() for program in programs]
    gold = [placement.leaves[k] for placement, k in zip(placements, golds, strict=True)]
    stated = [program.leaves[k] for program, k in zip(programs, golds, strict=True)]
    rotations = np.array([yaw_quaternion(placement.yaw) for placement in placements]).reshape(-1, 4)
    places = [leaf.walk.locations for leaf in gold]
    columns: dict[str, Any] = {
        "scene_id": [scene_id] * len(episodes),
        "episode_id": [numeric_id(name) for name in names],
        "episode_hash": names,
        "instruction_id": [e.instruction_id for e in episodes],
        "group_id": [e.candidate.group_id for e in episodes],
        "category": [program.category for program in programs],
        "composition": [compositions[e.instruction_id] for e in episodes],
        **_seen([e.observation for e in episodes]),
        "gold_leaf": golds,
        "n_leaves": [len(program.leaves) for program in programs],
        "gold_label": [leaf.goal.label for leaf in stated],
        "moves": [len(leaf.moves) for leaf in stated],
        "start_position": _points(_stacked([placement.start[None] for placement in placements])),
        "start_rotation": _structs(QUATERNION, [pa.array(values) for values in rotations.T]),
        "start_heading_degrees": [heading_degrees(placement.yaw) for placement in placements],
        "geodesic_distance": [leaf.geodesic_distance for leaf in gold],
        "route_length": [leaf.route.length for leaf in gold],
        "leaves": _lists(
            PLACEMENTS.field("leaves").type,
            [len(placement.leaves) for placement in placements],
            _leaves([placement.leaves for placement in placements]),
        ),
        "success_distance": [placement.success_distance for placement in placements],
        "ground_truth_steps": [placement.steps for placement in placements],
        "actions": _lists(
            PLACEMENTS.field("actions").type,
            [len(leaf.walk.actions) for leaf in gold],
            pa.array(np.concatenate([np.empty(0, np.int8), *(leaf.walk.actions for leaf in gold)])),
        ),
        "locations": _lists(_POINTS, list(map(len, places)), _points(round_mm(_stacked(places)))),
        "navmesh_sha256": [navmesh_sha256] * len(episodes),
    }
    arrays = [
        columns[f.name] if isinstance(columns[f.name], pa.Array) else pa.array(columns[f.name], f.type)
        for f in PLACEMENTS
    ]
    return pa.table(arrays, schema=PLACEMENTS)


def _seen(observations: Sequence[Observation | None]) -> dict[str, Any]:
    """Return the columns of what was observed, null where nothing was."""
    of = PLACEMENTS.field("evidence").type
    found = [one for seen in observations if seen is not None for one in seen.evidence]
    columns = (
        [one.condition for one in found],
        [one.observability for one in found],
        [one.in_view for one in found],
    )
    evidence = [pa.array(values, f.type) for values, f in zip(columns, of.value_type, strict=True)]
    return {
        "observability": [None if seen is None else seen.observability for seen in observations],
        "evidence_in_view": [None if seen is None else seen.in_view for seen in observations],
        "observability_approximate": [None if seen is None else seen.approximate for seen in observations],
        "evidence": _lists(
            of,
            [None if seen is None else len(seen.evidence) for seen in observations],
            _structs(of.value_type, evidence),
        ),
    }


def _leaves(placed: Sequence[Sequence[PlacedLeaf]]) -> pa.Array:
    """Return the leaves of several placements as structs, one after the other."""
    of = PLACEMENTS.field("leaves").type.value_type
    leaves = [leaf for own in placed for leaf in own]
    stop = of.field("subgoals").type.value_type
    names = [name for leaf in leaves for name in leaf.objects[:-1]]
    stops = _stacked([leaf.route.stops[:-1] for leaf in leaves])
    goals, paths = [leaf.goals for leaf in leaves], [leaf.route.path for leaf in leaves]
    subgoals = _structs(stop, [pa.array(names, pa.string()), _points(stops)])
    columns: dict[str, Any] = {
        "leaf": [k for own in placed for k in range(len(own))],
        "object_id": [leaf.objects[-1] for leaf in leaves],
        "goals": _lists(_POINTS, list(map(len, goals)), _points(_stacked(goals))),
        "subgoals": _lists(of.field("subgoals").type, [len(leaf.objects) - 1 for leaf in leaves], subgoals),
        "reference_path": _lists(_POINTS, list(map(len, paths)), _points(_stacked(paths))),
        "geodesic_distance": [leaf.geodesic_distance for leaf in leaves],
        "route_length": [leaf.route.length for leaf in leaves],
    }
    arrays = [
        columns[f.name] if isinstance(columns[f.name], pa.Array) else pa.array(columns[f.name], f.type) for f in of
    ]
    return _structs(of, arrays)


def _stacked(parts: Sequence[NDArray[Any]]) -> NDArray[np.float64]:
    """Return points (n, 3) one after the other."""
    return np.concatenate([np.empty((0, 3)), *parts])


def _points(values: NDArray[np.float64]) -> pa.Array:
    """Return points (n, 3) as structs."""
    return _structs(VEC3, [pa.array(axis) for axis in values.T])


def _structs(kind: pa.DataType, arrays: Sequence[pa.Array]) -> pa.Array:
    return pa.StructArray.from_arrays(arrays, fields=list(kind))


def _lists(kind: pa.DataType, sizes: Sequence[int | None], values: pa.Array) -> pa.Array:
    """Return lists of these sizes that hold the values one after the other; None is a null without values."""
    ends = list(accumulate((size or 0 for size in sizes), initial=0))
    begins = [None if size is None else end for size, end in zip(sizes, ends, strict=False)]
    return pa.ListArray.from_arrays(pa.array([*begins, ends[-1]], pa.int32()), values, type=kind)


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
    examples: Mapping[tuple[InstructionCell | None, str], Candidate] | None = None,
) -> pa.Table:
    """Return the numbers of rejections, `counts`, as REJECTIONS rows. `examples` has one rejected candidate for each
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
            "example": examples[cell, reason].instruction_id if examples and (cell, reason) in examples else None,
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
