"""How tests read the made scene dataset, and look at what came of it."""

from __future__ import annotations

import math
from typing import Any

from condvln.navigation.scene_navmesh import with_shipped_navmesh
from condvln.scene import Scene, SceneObject
from schemas.config import AgentConfig
from schemas.errors import InputError

HALF = math.sqrt(0.5)


def read(made: Any, scene: str = "flat", **options: Any) -> Scene:
    return made.source(**options).read(scene)


def on_navmesh(made: Any, scene: str = "flat", agent: AgentConfig | None = None, **options: Any) -> Scene:
    return with_shipped_navmesh(read(made, scene, **options), agent or AgentConfig())


def codes(scene: Scene) -> list[str]:
    return [w.code for w in scene.warnings]


def box(item: SceneObject) -> list[list[float]]:
    return item.aabb.tolist()


def faults(made: Any) -> dict[str, InputError | None]:
    return {h.scene_id: h.fault for h in made.source().handles()}
