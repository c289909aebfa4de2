"""Stage ``visibility``: which objects of a scene can be seen from where an agent can stand."""

from __future__ import annotations

from dataclasses import dataclass

from condvln.episodes.steps import look_around
from condvln.episodes.visibility import visibility_table
from factory.stage import Stage, StageOutput
from factory.unit import Unit
from jobs.stages.inputs import Tables, scene_of, walkable_of
from schemas.canonical import JSON

__all__ = ["VisibilityStage"]


@dataclass
class VisibilityStage(Stage):
    """Rooms, objects, navmesh and surfaces → which objects can be seen. In a scene without a navmesh, the values are
    null.
    """

    eye_height: float
    island_radius: float
    max_climb: float
    name: str = "visibility"
    version: int = 2
    tables: tuple[str, ...] = ("visibility",)
    reads: tuple[str, ...] | None = ("scenes", "rooms", "objects", "navmeshes")
    reads_inputs: bool = True

    def parameters(self, unit: Unit) -> JSON:
        return {
            "places": {"eye_height": self.eye_height, "island_radius": self.island_radius},
            "agent": {"max_climb": self.max_climb},
        }

    def run(self, unit: Unit, upstream: Tables, shared: Tables) -> StageOutput:
        scene = scene_of(unit, upstream)
        walkable = walkable_of(unit, scene, upstream, self.max_climb)
        if walkable is None:
            return StageOutput(tables={"visibility": visibility_table(scene, None)})
        found = look_around(scene, walkable, eye_height=self.eye_height, island_radius=self.island_radius)
        return StageOutput(
            tables={"visibility": visibility_table(scene, found)},
            measures={"objects": float(len(found)), "unseen": float(sum(one.unseen for one in found))},
        )
