"""The stages that read a scene: rooms and objects, relations, counts of statements and the priors that sum them,
and what can be seen.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Final

import pyarrow as pa

from condvln.episodes.steps import look_around
from condvln.episodes.visibility import visibility_table
from condvln.instructions import LabelPriors
from condvln.navigation.scene_navmesh import with_built_navmesh, with_shipped_navmesh
from condvln.navigation.sight import Recognition
from condvln.relations import relate_scene, relation_table, text_facts
from condvln.scene.meshes import shared_library
from condvln.scene.tables import scene_tables
from factory.stage import Aggregate, Stage, StageOutput, Unit
from jobs.stages.inputs import Tables, dump, navmeshes_table, scene_of, source_of, walkable_of
from schemas.canonical import JSON
from schemas.config import (
    AgentConfig,
    EpisodeConfig,
    LimitsConfig,
    PlacesConfig,
    SamplingConfig,
    Thresholds,
)

__all__ = ["CountStage", "PriorsAggregate", "RelationStage", "SceneStage", "VisibilityStage"]


@dataclass
class SceneStage(Stage):
    """Native files → scenes, rooms, objects, and a navmesh if the source ships none.

    A sound scene that can't yield is skipped, with its reason. One without navmesh, mesh or walls yields instructions
    and no episodes.
    """

    agent: AgentConfig
    limits: LimitsConfig
    name: str = "scene"
    version: int = 13
    tables: tuple[str, ...] = ("scenes", "rooms", "objects", "navmeshes")
    reads_inputs: bool = True

    def parameters(self, unit: Unit) -> JSON:
        # Which of a dataset's navmeshes is preferred decides even where all of them are inputs.
        keys: dict[str, JSON] = {"navmesh": navmesh} if (navmesh := unit.payload.get("navmesh")) else {}
        if unit.payload.get("absence") == "never":
            keys["absence"] = "never"
        sources: dict[str, JSON] = {"sources": keys} if keys else {}
        return {"agent": dump(self.agent), "limits": dump(self.limits)} | sources

    def run(self, unit: Unit, upstream: Tables, shared: Tables) -> StageOutput:
        source = source_of(unit, self.limits)
        scene = with_shipped_navmesh(source.read(str(unit.payload["scene_id"])), self.agent)
        built: bytes | None = None
        reason = ""
        skipped = len(scene.objects) < 2
        if skipped:
            reason = f"{'no' if not scene.objects else 'only one'} object: nothing to relate or to choose between"
        elif scene.navmesh is None:
            geometry = source.geometry(scene)
            if geometry is not None:
                scene, built = with_built_navmesh(scene, geometry, self.agent)
            if scene.navmesh is None:
                reason = "no navmesh, and neither mesh nor walls to build one from: instructions without episodes"
        tables = scene_tables(scene, status="skipped" if skipped else "ok", reason=reason or None)
        tables["navmeshes"] = navmeshes_table(scene.scene_id, built)
        return StageOutput(tables=tables, outcome="skipped" if skipped else "ok", reason=reason if skipped else "")


@dataclass
class RelationStage(Stage):
    """Rooms, objects and their meshes → relations."""

    thresholds: Thresholds
    name: str = "relations"
    version: int = 3
    tables: tuple[str, ...] = ("relations",)
    reads: tuple[str, ...] | None = ("scenes", "rooms", "objects")
    reads_inputs: bool = True

    @cached_property
    def _parameters(self) -> JSON:
        """What `parameters` returns: one object for all units, whose hash is cached."""
        return {"thresholds": dump(self.thresholds)}

    def parameters(self, unit: Unit) -> JSON:
        return self._parameters

    def run(self, unit: Unit, upstream: Tables, shared: Tables) -> StageOutput:
        scene = scene_of(unit, upstream)
        relations = relate_scene(scene, self.thresholds, shared_library(scene.root).world_mesh)
        facts = {room_id: text_facts(found, self.thresholds) for room_id, found in relations.items()}
        return StageOutput(tables={"relations": relation_table(scene, relations, self.thresholds, facts)})


COUNTING: Final = 21
"""Version of how statements are counted, in a scene and over all scenes."""


@dataclass
class CountStage(Stage):
    """Rooms and objects → for each type of room, how many rooms of the scene hold a label, and how often a statement
    (such as "a pillow near the bed") is true. Workers count; the driver only adds.
    """

    thresholds: Thresholds
    anchor_size: float
    usual_places: bool
    name: str = "counts"
    version: int = COUNTING
    tables: tuple[str, ...] = ("counts",)
    reads: tuple[str, ...] | None = ("rooms", "objects")

    @cached_property
    def _parameters(self) -> JSON:
        """What `parameters` returns: one object for all units, whose hash is cached."""
        sampling = {"anchor_size": self.anchor_size, "usual_places": self.usual_places}
        return {"thresholds": dump(self.thresholds), "sampling": sampling}

    def parameters(self, unit: Unit) -> JSON:
        return self._parameters

    def run(self, unit: Unit, upstream: Tables, shared: Tables) -> StageOutput:
        found = LabelPriors.of_tables(
            upstream["rooms"], upstream["objects"], self.thresholds, self.anchor_size, usual_places=self.usual_places
        )
        return StageOutput(tables={"counts": found.rows()})


@dataclass
class PriorsAggregate(Aggregate):
    """Sums of what is counted in each scene, over all scenes of all sources, and the weights of statements that these
    make even.
    """

    thresholds: Thresholds
    sampling: SamplingConfig
    directions: str
    places: PlacesConfig
    name: str = "priors"
    version: int = COUNTING + 2
    after: str = "counts"
    tables: tuple[str, ...] = ("counts",)

    def parameters(self) -> JSON:
        sampling = dump(self.sampling)
        read = {key: sampling[key] for key in ("anchor_size", "plausible_share", "presence_share", "predicates")}
        places = dump(self.places)
        return {
            "thresholds": dump(self.thresholds),
            "sampling": read,
            "instructions": {"directions": self.directions},
            "places": {key: places[key] for key in ("eye_height", "seen_degrees", "sight_range")},
        }

    def build(self, tables: Iterator[tuple[str, Tables]]) -> pa.Table:
        scenes = ((unit.partition("/")[0], LabelPriors.from_table(one["counts"])) for unit, one in tables)
        return LabelPriors.of_corpus(scenes, self.sampling, self.directions, self.places).table()


@dataclass
class VisibilityStage(Stage):
    """Rooms, objects, navmesh and surfaces → which objects can be seen. In a scene without a navmesh, the values are
    null.
    """

    places: PlacesConfig
    object_seen: float
    max_climb: float
    name: str = "visibility"
    version: int = 4
    tables: tuple[str, ...] = ("visibility",)
    reads: tuple[str, ...] | None = ("scenes", "rooms", "objects", "navmeshes")
    reads_inputs: bool = True

    def parameters(self, unit: Unit) -> JSON:
        places = dump(self.places)
        return {
            "places": {key: places[key] for key in ("eye_height", "island_radius", "seen_degrees", "sight_range")},
            "episodes": {"object_seen": self.object_seen},
            "agent": {"max_climb": self.max_climb},
        }

    def run(self, unit: Unit, upstream: Tables, shared: Tables) -> StageOutput:
        scene = scene_of(unit, upstream)
        walkable = walkable_of(unit, scene, upstream, self.max_climb)
        if walkable is None:
            return StageOutput(tables={"visibility": visibility_table(scene, None)})
        recognition = Recognition.of(self.places, EpisodeConfig(object_seen=self.object_seen))
        found = look_around(scene, walkable, self.places, recognition)
        return StageOutput(
            tables={"visibility": visibility_table(scene, found)},
            measures={"objects": float(len(found)), "unseen": float(sum(one.unseen for one in found))},
        )
