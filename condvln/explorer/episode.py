"""An episode as the page shows it. It is made from a manifest row, which may be read from a file or built from the
tables.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, Final

from condvln.episodes.placing import heading_degrees
from condvln.explorer.clauses import clauses
from condvln.explorer.evidence import SceneFacts
from schemas.program import Program

__all__ = ["UNPUBLISHED", "episode_document", "episode_labels"]

Row = Mapping[str, Any]
Document = dict[str, Any]
UNPUBLISHED: Final = "not exported"
"""Split of an episode that is in the snapshot and in no split of the export."""


def episode_document(
    row: Row, *, facts: SceneFacts | None = None, certificate: Row | None = None, parsed: bool = True
) -> Document:
    """Return an episode's document.

    Parameters
    ----------
    row : a row of a manifest, as `condvln.manifest.manifest_row` makes it or as JSON; points are lists or have x, y, z
    facts : relations of its scene; without them the page shows no measures
    certificate : its line of ``certificates/<split>.jsonl``
    parsed : whether the text's clauses are wanted; pictures have none, and building the parser takes seconds
    """
    program = Program.model_validate(row["program"])
    start = _point(row["start_position"])
    rotation = _point(row["start_rotation"])
    heading = heading_degrees(2.0 * math.atan2(rotation[1], rotation[3]) % (2.0 * math.pi))
    place = dict(zip("xyz", start, strict=True))
    return {
        "id": str(row["episode_id"]),
        "hash": row.get("episode_hash") or str(row["episode_id"]),
        "instruction": row["instruction_id"],
        "group": row["group_id"],
        "source": row["source"],
        "scene": row["scene_id"],
        "split": row["split"],
        "category": row["category"],
        "composition": row["composition"],
        "observability": row["observability"],
        "in_view": row["evidence_in_view"],
        "approximate": row["observability_approximate"],
        "evidence": [dict(one) for one in row["evidence"] or ()],
        "moves": row["moves"],
        "words": row["words"],
        "text": row["instruction_text"],
        "clauses": clauses(row["instruction_text"], program) if parsed else [],
        "program": program.model_dump(mode="json"),
        "route": list(program.route()[0]),
        "gold": row["gold_leaf"],
        "start": start,
        "heading": round(heading, 1),
        "leaves": [_leaf(leaf) for leaf in sorted(row["leaves"], key=lambda leaf: leaf["leaf"])],
        "success_distance": row["success_distance"],
        "max_steps": row["max_steps"],
        "geodesic_distance": row["geodesic_distance"],
        "route_length": row["route_length"],
        "navmesh": row["navmesh"],
        "snapshot": row["snapshot"],
        "facts": None if facts is None else [facts.of(condition, place, heading) for condition in program.conditions],
        "certificate": None if certificate is None else _certificate(certificate),
        "frames": [],
        "views": {},
    }


def episode_labels(row: Row) -> list[str]:
    """Return the sorted labels that an episode's program names: conditions, anchors and stops."""
    program = row["program"]
    named: set[str] = set()
    moves = [move for leaf in program["leaves"] for move in leaf["moves"]]
    for one in (*program["conditions"], *moves):
        named.add(one["label"])
        qualifier = one["qualifier"]
        if qualifier is not None:
            named |= {anchor["label"] for anchor in qualifier.get("anchors") or ()}
    return sorted(named)


def _leaf(leaf: Row) -> Document:
    return {
        "leaf": leaf["leaf"],
        "object": leaf["object_id"],
        "goals": [_point(goal) for goal in leaf["goals"]],
        "stops": [{"object": stop["object_id"], "at": _point(stop["position"])} for stop in leaf["subgoals"]],
        "path": [_point(corner) for corner in leaf["reference_path"]],
        "geodesic_distance": leaf["geodesic_distance"],
        "route_length": leaf["route_length"],
    }


def _certificate(line: Row) -> Document:
    checked = line.get("checked") or {}
    return {
        "proven": line.get("proven"),
        "facts": sum(checked.values()),
        "kinds": len(checked),
        "conditions": line.get("conditions") or [],
        "disagreements": line.get("disagreements") or [],
    }


def _point(value: Row | Sequence[float]) -> list[float]:
    if isinstance(value, Mapping):
        return [float(value[axis]) for axis in ("x", "y", "z", "w") if axis in value]
    return [float(number) for number in value]
