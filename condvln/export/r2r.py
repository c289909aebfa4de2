"""Discrete R2R over Matterport3D viewpoints: ``R2R_<split>.json`` in the format of Matterport3DSimulator's agents.

Start, subgoals and goal become the nearest viewpoints, joined by shortest paths in the connectivity graph. Headings are
radians clockwise from +y of the scan, which is −z in Habitat's frame.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from itertools import combinations
from typing import Any, Final

from condvln.export.rows import Row
from condvln.export.vlnce import gold
from condvln.navigation.graph_pathfinder import GraphPathfinder

__all__ = ["ERROR_MARGIN", "Graphs", "r2r_episode", "reason_against"]

ERROR_MARGIN: Final = 3.0
"""R2R's success distance in metres."""

Graphs = Mapping[str, GraphPathfinder]
"""Connectivity graph by scan."""


def r2r_episode(row: Row, graph: GraphPathfinder) -> dict[str, Any] | str:
    """Return the R2R item of an episode, or the reason why there is none."""
    leaf = gold(row)
    start = graph.viewpoint(row["start_position"])
    stops = [graph.viewpoint(subgoal["position"]) for subgoal in leaf["subgoals"]] + [graph.viewpoint(leaf["goals"][0])]
    ends = [graph.viewpoint(other["goals"][0]) for other in row["leaves"]]
    reason = reason_against(start, stops, ends) or _too_near(graph, str(start), [str(end) for end in ends])
    if reason is not None:
        return reason
    path = [str(start)]
    for stop in stops:
        part = graph.viewpoint_path(path[-1], str(stop))
        if not part:
            return "its viewpoints are not connected"
        path += part[1:]
    return {
        "distance": graph.path_length(path),
        "scan": row["scene_id"],
        "path_id": row["episode_id"],
        "path": path,
        "heading": math.radians(row["start_heading_degrees"]) % (2 * math.pi),
        "instructions": [row["instruction_text"]],
    }


def _too_near(graph: GraphPathfinder, start: str, ends: list[str]) -> str | None:
    """Return a reason if two leaves, or a leaf and the start, are too close to each other, else None. R2R's evaluator
    counts everything within 3 m as reached.
    """
    between = graph.viewpoint_distance
    if any(between(one, other) < ERROR_MARGIN for one, other in combinations(ends, 2)):
        return f"two leaves within {ERROR_MARGIN:g} m on the graph"
    if any(between(start, end) < ERROR_MARGIN for end in ends):
        return f"a leaf within {ERROR_MARGIN:g} m of the start on the graph"
    return None


def reason_against(start: str | None, stops: list[str | None], ends: list[str | None]) -> str | None:
    """Return why an episode can't be an R2R item on the graph; None if it can."""
    if start is None or None in stops or None in ends:
        return "a start or goal with no viewpoint in reach"
    if len(set(ends)) < len(ends):
        return "two leaves at one viewpoint"
    if start in ends:
        return "a leaf at the start's viewpoint"
    return None
