"""Scenes in memory: rooms and objects as arrays, coordinate frames, boxes, meshes."""

from condvln.scene.scene import (
    MeshPart,
    NavmeshFile,
    OrientedBox,
    Room,
    RoomArrays,
    Scene,
    SceneObject,
    SceneWarning,
    round_mm,
)

__all__ = [
    "MeshPart",
    "NavmeshFile",
    "OrientedBox",
    "Room",
    "RoomArrays",
    "Scene",
    "SceneObject",
    "SceneWarning",
    "round_mm",
]
