"""Arrow schemas of the tables of ``condvln trajectories``; every column carries its description.

Coordinates are metres in Habitat's frame, as in ``schemas.tables``. Positions are not rounded: replayed actions give
them again bit for bit.
"""

from __future__ import annotations

from typing import Final

import pyarrow as pa

from schemas.tables import QUATERNION, VEC3

__all__ = ["TRAJECTORY_ABOUT", "TRAJECTORY_SORT_KEYS", "TRAJECTORY_TABLES"]


def _required(name: str, kind: pa.DataType, about: str) -> pa.Field:
    return pa.field(name, kind, nullable=False, metadata={"description": about})


def _optional(name: str, kind: pa.DataType, about: str) -> pa.Field:
    return pa.field(name, kind, metadata={"description": about})


_S: Final = pa.string()
_I: Final = pa.int32()
_F: Final = pa.float64()
_ACTIONS: Final = pa.list_(pa.int8())
_INTRINSICS: Final = pa.struct([pa.field(name, _F) for name in ("fx", "fy", "cx", "cy")])

_SCENE: Final = _required("scene_id", _S, "id of the scene within its source")
_NAME: Final = _required("trajectory", _S, "name of the walk; its images are in `images/<trajectory>/`")
_EPISODE: Final = _required("episode_id", pa.int64(), "id of the episode, as in the export")
_KIND: Final = _required("kind", _S, "`gold`, `oracle`, `recovery` or `exploration`")

TRAJECTORIES: Final = pa.schema(
    [
        _SCENE,
        _NAME,
        _EPISODE,
        _KIND,
        _required("instruction_text", _S, "the instruction of this walk"),
        _required("frames_of", _S, "name of the walk whose images this walk has; its own name, except for `oracle`"),
        _required("n_frames", _I, "number of frames; each is seen before its action"),
        _required("actions", _ACTIONS, "right action at each frame: 0 STOP, 1 forward 0.25 m, 2 left 15°, 3 right 15°"),
        _required("executed", _ACTIONS, "action that was taken at each frame; differs from `actions` in mistakes only"),
        _required("repeats", pa.list_(_I), "how often each frame occurs in balanced layouts; 0 in a mistake"),
        _required("goals", pa.list_(VEC3), "goal points of the gold leaf, metres"),
        _required("success_distance", _F, "distance from a goal point within which STOP succeeds, metres"),
        _required("max_steps", _I, "number of actions that the episode allows"),
        _required("start_position", VEC3, "position of the first frame, metres"),
        _required("start_rotation", QUATERNION, "rotation of the episode's start, quaternion [x, y, z, w]"),
        _required("navmesh", _S, "path of the navmesh, as the export or the source ships it"),
        _required("navmesh_sha256", _S, "SHA-256 of the navmesh file"),
    ]
)

STEPS: Final = pa.schema(
    [
        _SCENE,
        _NAME,
        _EPISODE,
        _KIND,
        _required("frame", _I, "number of the frame, from 0"),
        _required("action", pa.int8(), "right action at this frame"),
        _required("executed", pa.int8(), "action that was taken at this frame"),
        _required("position", VEC3, "position of the agent's feet, metres"),
        _required("rotation", QUATERNION, "rotation of the agent, quaternion [x, y, z, w]; identity faces north"),
        _required("heading", _F, "radians counter-clockwise from north, in [0, 2π)"),
        _required("leaf", _I, "leaf that the agent walks to; -1 before the decision of an `exploration` walk"),
        _optional("looks_for", _I, "index of the condition whose evidence an `exploration` walk looks for"),
        _required("distance_to_goal", _F, "geodesic distance to the nearest goal point of the gold leaf, metres"),
    ]
)
"""Poses of the walks without cameras; kept in the unit and not published."""

POSES: Final = pa.schema(
    [
        *STEPS,
        _required("camera", _S, "name of the camera: the folder of its images"),
        _required("image", _S, "path of the image below the folder of the trajectories"),
        _required("width", _I, "columns of the image"),
        _required("height", _I, "rows of the image"),
        _required("hfov", _F, "horizontal field of view, degrees"),
        _required("eye_height", _F, "height of the camera above the agent's feet, metres"),
        _required("look_down", _F, "angle by which the camera looks below the horizon, degrees"),
        _required("intrinsics", _INTRINSICS, "focal lengths and principal point, pixels; pixel centres are at .5"),
        _optional("goal", pa.list_(_I), "column and row of the farthest later place that a depth camera sees, if any"),
        _optional("goal_frame", _I, "number of frames until that place is reached"),
        _required("bytes", pa.int64(), "size of the image file"),
        _required("sha256", _S, "SHA-256 of the image file"),
    ]
)

LEFT_OUT: Final = pa.schema(
    [
        _SCENE,
        _EPISODE,
        _KIND,
        _required("number", _I, "number of the walk among those of its kind"),
        _required("reason", _S, "why there is no such walk"),
    ]
)

TRAJECTORY_TABLES: Final[dict[str, pa.Schema]] = {
    "trajectories": TRAJECTORIES,
    "poses": POSES,
    "left_out": LEFT_OUT,
}

TRAJECTORY_ABOUT: Final[dict[str, str]] = {
    "trajectories": "One row for each walk of `condvln trajectories`: its episode, instruction and actions.",
    "poses": "One row for each image of a walk: frame, actions, pose, camera and hash.",
    "left_out": "One row for each walk that could not be made, with the reason.",
}

TRAJECTORY_SORT_KEYS: Final[dict[str, tuple[str, ...]]] = {
    "trajectories": ("scene_id", "trajectory"),
    "poses": ("scene_id", "trajectory", "frame", "camera"),
    "left_out": ("scene_id", "episode_id", "kind", "number"),
}
