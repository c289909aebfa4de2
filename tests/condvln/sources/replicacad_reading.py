"""How tests read the made scene dataset, and look at what came of it."""

from __future__ import annotations

import math
from typing import Any

from condvln.scene import Scene, SceneObject
from schemas.errors import InputError

HALF = math.sqrt(0.5)


def read(made: Any, scene: str = "flat", **options: Any) -> Scene:
    return made.source(**options).read(scene)


def codes(scene: Scene) -> list[str]:
    return [w.code for w in scene.warnings]


def box(item: SceneObject) -> list[list[float]]:
    assert item.aabb is not None
    return item.aabb.tolist()


def faults(made: Any) -> dict[str, InputError | None]:
    return {h.scene_id: h.fault for h in made.source().handles()}
