"""Stages ``scene`` and ``relations``: tables of a scene from its native files, and relations of its objects."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

from condvln.navigation.scene_navmesh import with_built_navmesh, with_shipped_navmesh
from condvln.relations import relate_scene, relation_table, text_facts
from condvln.scene.meshes import shared_library
from condvln.scene.tables import scene_tables
from factory.stage import Stage, StageOutput
from factory.unit import Unit
from jobs.stages.inputs import Tables, dump, keep_facts, navmeshes_table, scene_of, source_of
from schemas.canonical import JSON
from schemas.config import (
    AgentConfig,
    LimitsConfig,
    Thresholds,
)

__all__ = ["RelationStage", "SceneStage"]


@dataclass
class SceneStage(Stage):
    """Native files → scenes, rooms, objects, and a navmesh if the source ships none.

    A sound scene that can't yield is skipped, with its reason. One without navmesh, mesh or walls yields instructions
    and no episodes.
    """

    agent: AgentConfig
    limits: LimitsConfig
    name: str = "scene"
    version: int = 11
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
        table = relation_table(scene, relations, self.thresholds, facts)
        keep_facts(scene, table, self.thresholds, facts)
        return StageOutput(tables={"relations": table})
