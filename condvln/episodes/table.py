"""Placed programs as table rows: PLACEMENTS before the text is known, EPISODES after."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Final

import pyarrow as pa
from numpy.typing import NDArray

from condvln.episodes.candidates import Candidate, cell_name
from condvln.episodes.identity import content_hash, numeric_id
from condvln.episodes.looking import LookingPath
from condvln.episodes.observability import Observation
from condvln.episodes.placing import PlacedLeaf, heading_degrees, yaw_quaternion
from condvln.episodes.pool import EpisodePool, PooledEpisode
from condvln.instructions.programs import composition, oddness
from condvln.scene import Room, Scene, round_mm
from schemas.base import Json as Row
from schemas.config import InstructionCell, StepBudget
from schemas.config.constants import GROUP_SIZE
from schemas.program import SHAPES
from schemas.tables import EPISODES, FUNNEL, REJECTIONS

__all__ = [
    "LOOKING_COLUMNS",
    "PLACEMENTS",
    "TEXT_COLUMNS",
    "funnel_table",
    "placements_table",
    "rejections_table",
    "with_text",
]

TEXT_COLUMNS: Final = ("depth", "chain", "words", "max_steps", "instruction_text")
LOOKING_COLUMNS: Final = (
    "looking_path", "looking_length", "looking_actions", "looking_decided", "looking_locations",
)  # fmt: skip
"""Columns of the looking path; null where there is none."""
PLACEMENTS: Final = pa.schema([f for f in EPISODES if f.name not in TEXT_COLUMNS])
"""Schema of the episodes table without the columns that `with_text` adds."""


def placements_table(scene: Scene, pool: EpisodePool, navmesh_sha256: str) -> pa.Table:
    """Return the pool's episodes in a scene as PLACEMENTS rows."""
    rows = [
        {
            "scene_id": scene.scene_id,
            "navmesh_sha256": navmesh_sha256,
            **_placement(scene, episode),
            **_seen(episode.observation),
            **_looking(episode.looking),
        }
        for episode in pool.episodes
    ]
    return pa.Table.from_pylist(rows, schema=PLACEMENTS)


def _placement(scene: Scene, episode: PooledEpisode) -> Row:
    """Return the columns that follow from the program and its placement."""
    program, placement = episode.program, episode.placement
    name = content_hash(scene.scene_id, episode.instruction_id, placement.start, placement.yaw)
    gold = program.gold_leaf()
    stated, placed = program.leaves[gold], placement.leaves[gold]
    return {
        "episode_id": numeric_id(name),
        "episode_hash": name,
        "instruction_id": episode.instruction_id,
        "group_id": episode.candidate.group_id,
        "category": program.category,
        "composition": composition(program),
        "oddness": oddness(program),
        "gold_leaf": gold,
        "n_leaves": len(program.leaves),
        "gold_label": stated.goal.label,
        "moves": len(stated.moves),
        "leads": len(program.leads(gold)),
        "start_position": _points(placement.start[None])[0],
        "start_rotation": dict(zip("xyzw", yaw_quaternion(placement.yaw), strict=True)),
        "start_heading_degrees": heading_degrees(placement.yaw),
        "geodesic_distance": placed.geodesic_distance,
        "route_length": placed.route.length,
        "leaves": [_leaf(k, leaf, scene) for k, leaf in enumerate(placement.leaves)],
        "success_distance": placement.success_distance,
        "ground_truth_steps": placement.steps,
        "actions": placed.walk.actions.tolist(),
        "locations": _points(round_mm(placed.walk.locations)),
    }


def _seen(observation: Observation | None) -> Row:
    """Return the columns of what was observed, null where nothing was."""
    if observation is None:
        return {}
    return {
        "observability": observation.observability,
        "evidence_in_view": observation.in_view,
        "observability_approximate": observation.approximate,
        "evidence": [one.model_dump() for one in observation.evidence],
    }


def _looking(found: LookingPath | None) -> Row:
    """Return the columns of the looking path, null without one."""
    if found is None:
        return {}
    walked = found.actions.tolist(), list(found.decided), _points(found.locations)
    values = _points(found.path), found.length, *walked
    return dict(zip(LOOKING_COLUMNS, values, strict=True))


def _leaf(number: int, leaf: PlacedLeaf, scene: Scene) -> Row:
    *stops, goal = leaf.objects
    places = _points(leaf.route.stops)
    return {
        "leaf": number,
        "object_id": goal,
        "goals": _points(leaf.goals),
        "subgoals": [
            {"object_id": k, "position": place, "outline": _outline(scene.room_of.get(k))}
            for k, place in zip(stops, places[:-1], strict=True)
        ],
        "reference_path": _points(leaf.route.path),
        "geodesic_distance": leaf.geodesic_distance,
        "route_length": leaf.route.length,
    }


def _outline(room: Room | None) -> list[dict[str, float]] | None:
    return None if room is None or room.polygon is None else [{"x": x, "z": z} for x, z in room.polygon.tolist()]


def _points(values: NDArray[Any]) -> list[dict[str, float]]:
    """Return points (n, 3) as rows."""
    return [{"x": x, "y": y, "z": z} for x, y, z in values.tolist()]


def with_text(placements: pa.Table, texts: Mapping[int, str], max_steps: StepBudget, steps_per_word: int) -> pa.Table:
    """Return EPISODES rows: each placement with its text (by episode id), word count, step budget and its tree's shape.

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
    shapes = [SHAPES[category] for category in placements["category"].to_pylist()]
    depths, chains = [shape.depth for shape in shapes], [shape.chain for shape in shapes]
    new = dict(zip(TEXT_COLUMNS, (depths, chains, words, budgets, said), strict=True))
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
