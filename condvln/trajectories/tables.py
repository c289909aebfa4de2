"""Walks as rows of the tables ``trajectories``, ``steps`` and ``left_out``, and back."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from condvln.navigation.pathfinder import Pathfinder
from condvln.trajectories.walks import LeftOut, Walked
from schemas.evaluation import ManifestEpisode
from schemas.trajectory_tables import LEFT_OUT, STEPS, TRAJECTORIES

__all__ = ["WalkRows", "point_of", "vector"]


def vector(values: Iterable[float]) -> dict[str, float]:
    """Return a point (3,) as the tables store it: ``{x, y, z}``."""
    return dict(zip("xyz", map(float, values), strict=True))


def point_of(row: Mapping[str, float]) -> NDArray[np.float64]:
    """Return the point (3,) that the tables store as ``{x, y, z}``."""
    return np.array([row[axis] for axis in "xyz"], np.float64)


class WalkRows:
    """Collects the walks of one scene as rows."""

    def __init__(self, scene_id: str) -> None:
        self._scene_id = scene_id
        self._trajectories: list[dict[str, Any]] = []
        self._left_out: list[dict[str, Any]] = []
        self._steps: list[pa.Table] = []

    def add(
        self,
        episode: ManifestEpisode,
        walked: Walked,
        pathfinder: Pathfinder,
        text: str,
        repeats: NDArray[np.integer],
        frames_of: str | None = None,
    ) -> None:
        """Add a walk.

        repeats : (n,) how often each frame occurs in balanced layouts
        frames_of : the walk whose images this one has; its own by default
        """
        goals = np.array(next(one for one in episode.leaves if one.leaf == episode.gold_leaf).goals)
        row = {"scene_id": self._scene_id, "trajectory": walked.name, "episode_id": int(episode.episode_id)}
        row["kind"] = walked.kind
        self._trajectories.append(
            row
            | {
                "instruction_text": text,
                "frames_of": frames_of or walked.name,
                "n_frames": len(walked),
                "actions": walked.actions.tolist(),
                "executed": walked.executed.tolist(),
                "repeats": repeats.tolist(),
                "goals": [vector(goal) for goal in goals],
                "success_distance": float(episode.success_distance),
                "max_steps": episode.max_steps,
                "start_position": vector(walked.positions[0]),
                "start_rotation": dict(zip("xyzw", map(float, episode.start_rotation), strict=True)),
                "navmesh": episode.navmesh,
                "navmesh_sha256": episode.navmesh_sha256,
            }
        )
        if frames_of is not None:
            return
        distances = pathfinder.distance_table(walked.positions, goals).min(axis=1).astype(np.float64)
        count = len(walked)
        places = walked.positions.astype(np.float64)
        half = walked.headings / 2
        zeros = np.zeros(count)
        columns: dict[str, Any] = {name: [value] * count for name, value in row.items()}
        columns |= {
            "frame": np.arange(count, dtype=np.int32),
            "action": walked.actions,
            "executed": walked.executed,
            "position": pa.StructArray.from_arrays([*map(pa.array, places.T)], fields=[*STEPS.field("position").type]),
            "rotation": pa.StructArray.from_arrays(
                [pa.array(part) for part in (zeros, np.sin(half), zeros, np.cos(half))],
                fields=[*STEPS.field("rotation").type],
            ),
            "heading": walked.headings,
            "leaf": walked.leaf,
            "looks_for": pa.array(walked.looks_for, mask=walked.looks_for < 0),
            "distance_to_goal": distances,
        }
        self._steps.append(pa.table(columns, schema=STEPS))

    def leave_out(self, episode: ManifestEpisode, found: LeftOut) -> None:
        """Add a walk that could not be made."""
        self._left_out.append(
            {
                "scene_id": self._scene_id,
                "episode_id": int(episode.episode_id),
                "kind": found.kind,
                "number": found.number,
                "reason": found.reason,
            }
        )

    def tables(self) -> dict[str, pa.Table]:
        """Return the tables by name."""
        return {
            "trajectories": pa.Table.from_pylist(self._trajectories, schema=TRAJECTORIES),
            "steps": pa.concat_tables(self._steps) if self._steps else STEPS.empty_table(),
            "left_out": pa.Table.from_pylist(self._left_out, schema=LEFT_OUT),
        }
