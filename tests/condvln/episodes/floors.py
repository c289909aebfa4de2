"""Floors, boxes and programs made by hand, for tests of placing and seeing."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from condvln.episodes.goals import blocked_footprints, scene_goals
from condvln.episodes.placing import Placer
from condvln.navigation.pathfinder import Pathfinder
from condvln.navigation.polygon_tile import tile_of_polygons
from condvln.navigation.sight import Recognition
from condvln.scene import Room, Scene, SceneObject
from condvln.scene.scene import SceneGeometry
from schemas.config import EpisodeConfig, GoalsConfig, PlacesConfig
from schemas.program import SHAPES, Condition, Leaf, ObjectRef, Program, RoomRef

CELL = 0.25
RULE = Recognition.of(PlacesConfig(), EpisodeConfig())


def placer_of(
    scene: Scene,
    pathfinder: Pathfinder,
    rules: EpisodeConfig | None = None,
    places: PlacesConfig | None = None,
    *,
    seed: int = 5,
    max_climb: float = 0.2,
) -> Placer:
    """A placer of a scene whose objects are stood at wherever they can be reached; other rules are the defaults."""
    places = places or PlacesConfig()
    obstacles = blocked_footprints(scene, pathfinder, max_climb)
    goals = scene_goals(scene, pathfinder, places, GoalsConfig(), obstacles)
    return Placer(scene, pathfinder, goals, places, rules or EpisodeConfig(), seed, max_climb=max_climb)


def grid_floor(width: float, depth: float, solid) -> Pathfinder:
    """A floor of 0.25 m squares at y = 0 without the squares whose middle is `solid`."""
    columns, rows = round(width / CELL), round(depth / CELL)
    corner = {}
    verts: list[tuple[float, float, float]] = []

    def index(i: int, j: int) -> int:
        if (i, j) not in corner:
            corner[i, j] = len(verts)
            verts.append((i * CELL, 0.0, j * CELL))
        return corner[i, j]

    polys = [
        [index(i, j), index(i + 1, j), index(i + 1, j + 1), index(i, j + 1)]
        for j in range(rows)
        for i in range(columns)
        if not solid((i + 0.5) * CELL, (j + 0.5) * CELL)
    ]
    return Pathfinder.from_tile(tile_of_polygons(np.array(verts, np.float32), polys))


def box(name: str, x: float, z: float, half: float = 0.3, bottom: float = 0.0, top: float = 1.0) -> SceneObject:
    """An object labelled with its own name."""
    aabb = np.array([[x - half, bottom, z - half], [x + half, top, z + half]])
    return SceneObject(name, "zone", name, name, aabb.mean(axis=0), aabb=aabb)


def apartment(*objects: SceneObject) -> Scene:
    """One room, the whole scene, without a polygon."""
    room = Room("zone", "apartment", "apartment", 0, 0.0, 2.5, None, "scene", True)
    return Scene("made", "flat", Path("."), (room,), objects)


def inside(item: SceneObject, x: float, z: float, grow: float = 0.0) -> bool:
    """Whether (x, z) lies in the object's footprint."""
    low, high = item.aabb[0] - grow, item.aabb[1] + grow
    return bool(low[0] < x < high[0] and low[2] < z < high[2])


def box_triangles(low, high) -> tuple[np.ndarray, np.ndarray]:
    """The twelve triangles of a box: vertices (8, 3) and faces (12, 3)."""
    corners = np.array([[(low, high)[i >> axis & 1][axis] for axis in range(3)] for i in range(8)], float)
    quads = [(0, 4, 6, 2), (1, 3, 7, 5), (0, 1, 5, 4), (2, 6, 7, 3), (0, 2, 3, 1), (4, 5, 7, 6)]
    return corners, np.array([t for a, b, c, d in quads for t in ((a, b, c), (a, c, d))])


def surfaces_of(parts: list[tuple[int, tuple[np.ndarray, np.ndarray]]], approximate: bool = False) -> SceneGeometry:
    """Several meshes, each with its owner, as the geometry of a scene."""
    starts = np.cumsum([0, *(len(vertices) for _, (vertices, _) in parts)])
    return SceneGeometry(
        np.concatenate([vertices for _, (vertices, _) in parts]),
        np.concatenate([faces + start for start, (_, (_, faces)) in zip(starts, parts, strict=False)]),
        np.repeat([owner for owner, _ in parts], [len(faces) for _, (_, faces) in parts]),
        approximate,
    )


def program(*leaves: tuple[str, ...]) -> Program:
    """A program that sends to these moves; all its conditions are true, so that leaf 0 is gold."""
    room = RoomRef(room_id="zone", label="apartment")
    category = {2: "simple", 3: "nested", 4: "deep_nested"}[len(leaves)]
    return Program(
        category=category,
        conditions=tuple(
            Condition(label=f"c{k}", room=room, truth=True, witnesses=("w",)) for k in range(len(leaves) - 1)
        ),
        branches=SHAPES[category].branches,
        leaves=tuple(Leaf(moves=tuple(ObjectRef(object_id=m, label=m, room=room) for m in moves)) for moves in leaves),
    )
