"""The five stages of a scene, each a thin wrapping of the science for the factory.

scene → relations → programs → episodes → text. What a stage computes is decided in ``condvln``; here stands only what
it reads, what it is keyed on, and where its rows go. A change of what a stage makes for equal inputs must raise its
``version``; a golden test holds that.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Final

import pyarrow as pa
import pyarrow.compute as pc

from condvln.episodes.candidates import Candidate, candidates_from_table, candidates_table, draw_candidates
from condvln.episodes.goals import blocked_footprints, scene_goals
from condvln.episodes.observability import Observer
from condvln.episodes.placing import Placer, reachable_stops
from condvln.episodes.pool import EpisodePool, fill_pool
from condvln.episodes.routes import GoalField
from condvln.episodes.table import (
    PLACEMENTS,
    funnel_table,
    goals_from_table,
    placements_table,
    rejections_table,
    stops_table,
    with_text,
)
from condvln.episodes.unplaced import unplaced_programs, unplaced_table
from condvln.episodes.view import SceneView
from condvln.instructions import (
    LabelPriors,
    PriorBits,
    ProgramSampler,
    apart_by_centres,
    instruction_table,
    names_compass,
    programs_from_table,
    render,
    with_preamble,
)
from condvln.navigation.navmesh_file import parse_navmesh
from condvln.navigation.pathfinder import Pathfinder
from condvln.navigation.scene_navmesh import with_built_navmesh, with_shipped_navmesh
from condvln.relations import RoomRelations, relate_scene, relation_table, text_facts
from condvln.scene import Scene
from condvln.scene.limits import check_limits
from condvln.scene.meshes import MeshLibrary
from condvln.scene.tables import scene_from_tables, scene_tables
from condvln.sources.registry import open_source
from condvln.sources.source import Source
from factory.stage import Aggregate, Stage, StageOutput
from factory.unit import Unit
from schemas.canonical import JSON
from schemas.config import (
    AgentConfig,
    EpisodeConfig,
    GoalsConfig,
    InstructionsConfig,
    LimitsConfig,
    PlacesConfig,
    SamplingConfig,
    Section,
    TextConfig,
    Thresholds,
)

__all__ = ["EpisodeStage", "PriorsAggregate", "ProgramStage", "RelationStage", "SceneStage", "TextStage"]

Tables = Mapping[str, pa.Table]

NAVMESHES: Final = pa.schema([("scene_id", pa.string()), ("data", pa.large_binary())])
"""Built navmeshes, kept in the unit for later stages and for the export; not a published table."""


def _navmeshes_table(scene_id: str, data: bytes | None) -> pa.Table:
    rows = [] if data is None else [{"scene_id": scene_id, "data": data}]
    return pa.Table.from_pylist(rows, schema=NAVMESHES)


@lru_cache(maxsize=8)
def _source(family: str, root: str, regions: str | None, houses: str | None, navmesh: str | None) -> Source:
    """One reader a process and dataset: its shared files are read once."""
    side, house_folder = (None if path is None else Path(path) for path in (regions, houses))
    return open_source(family, Path(root), navmesh=navmesh, regions=side, houses=house_folder)


def _source_of(unit: Unit) -> Source:
    keys = ("regions", "houses", "navmesh")
    regions, houses, navmesh = (None if value is None else str(value) for value in map(unit.payload.get, keys))
    return _source(str(unit.payload["family"]), str(unit.payload["root"]), regions, houses, navmesh)


def _scene(unit: Unit, tables: Tables) -> Scene:
    return scene_from_tables(tables, Path(str(unit.payload["root"])), family=str(unit.payload["family"]))


def _pathfinder(scene: Scene, tables: Tables) -> Pathfinder:
    """Over the navmesh that the first stage chose or built."""
    assert scene.navmesh is not None
    if scene.navmesh.built:
        return Pathfinder(parse_navmesh(tables["navmeshes"]["data"][0].as_py(), scene.navmesh.path))
    return Pathfinder.load(scene.root / scene.navmesh.path)


def _view(unit: Unit, scene: Scene) -> SceneView:
    return SceneView(scene, _source_of(unit).geometry(scene))


def _dump(section: Section) -> JSON:
    document: JSON = section.model_dump(mode="json")
    return document


@dataclass
class SceneStage(Stage):
    """Native files → scenes, rooms, objects, and a navmesh where the source ships none.

    A sound scene that can't yield is skipped, with its reason. One without navmesh, mesh or walls yields instructions
    and no episodes.
    """

    agent: AgentConfig
    limits: LimitsConfig
    name: str = "scene"
    version: int = 4
    tables: tuple[str, ...] = ("scenes", "rooms", "objects", "navmeshes")
    reads_inputs: bool = True

    def parameters(self, unit: Unit) -> JSON:
        # Which of a dataset's navmeshes is preferred decides even where all of them are inputs.
        preferred: dict[str, JSON] = (
            {"sources": {"navmesh": navmesh}} if (navmesh := unit.payload.get("navmesh")) else {}
        )
        return {"agent": _dump(self.agent), "limits": _dump(self.limits)} | preferred

    def run(self, unit: Unit, upstream: Tables, shared: Tables) -> StageOutput:
        source = _source_of(unit)
        scene = with_shipped_navmesh(source.read(str(unit.payload["scene_id"])), self.agent)
        check_limits(scene, self.limits)
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
        tables["navmeshes"] = _navmeshes_table(scene.scene_id, built)
        return StageOutput(tables=tables, outcome="skipped" if skipped else "ok", reason=reason if skipped else "")


@dataclass
class RelationStage(Stage):
    """rooms, objects (and their meshes) → relations."""

    thresholds: Thresholds
    name: str = "relations"
    version: int = 2
    tables: tuple[str, ...] = ("relations",)
    reads: tuple[str, ...] | None = ("scenes", "rooms", "objects")
    reads_inputs: bool = True

    def parameters(self, unit: Unit) -> JSON:
        return {"thresholds": _dump(self.thresholds)}

    def run(self, unit: Unit, upstream: Tables, shared: Tables) -> StageOutput:
        scene = _scene(unit, upstream)
        relations = relate_scene(scene, self.thresholds, MeshLibrary(scene.root).world_mesh)
        return StageOutput(tables={"relations": relation_table(scene, relations, self.thresholds)})


@dataclass
class PriorsAggregate(Aggregate):
    """Which labels are usual in which type of room, and how often a statement is true there, over all scenes of all
    sources."""

    thresholds: Thresholds
    anchor_size: float
    name: str = "priors"
    version: int = 2
    after: str = "scene"
    tables: tuple[str, ...] = ("rooms", "objects")

    def parameters(self) -> JSON:
        return {"thresholds": _dump(self.thresholds), "sampling": {"anchor_size": self.anchor_size}}

    def build(self, tables: Iterator[tuple[str, Tables]]) -> pa.Table:
        parts = (LabelPriors.of_tables(t["rooms"], t["objects"], self.thresholds, self.anchor_size) for _, t in tables)
        return LabelPriors.merged(parts).table()


@dataclass
class ProgramStage(Stage):
    """relations + navmesh + surfaces → where objects are stood at, and candidate programs, in the order in which they
    will be tried."""

    thresholds: Thresholds
    places: PlacesConfig
    instructions: InstructionsConfig
    sampling: SamplingConfig
    goals: GoalsConfig
    max_climb: float
    preamble: bool
    seed: int
    name: str = "programs"
    version: int = 6
    tables: tuple[str, ...] = ("stops", "candidates", "rejections")
    reads_inputs: bool = True
    reads: tuple[str, ...] | None = ("scenes", "rooms", "objects", "navmeshes", "relations")
    needs: tuple[str, ...] = ("priors",)

    def parameters(self, unit: Unit) -> JSON:
        wording: dict[str, JSON] = {}
        if any(cell.words for cell in self.instructions.cells):
            # The number of words is decided by the wording, which is another stage's to change.
            wording = {"text": {"preamble": self.preamble}, "wording": TextStage.version}
        return wording | {
            "thresholds": _dump(self.thresholds),
            "places": _dump(self.places),
            "instructions": _dump(self.instructions),
            "sampling": _dump(self.sampling),
            "goals": _dump(self.goals),
            "agent": {"max_climb": self.max_climb},
            "seed": self.seed,
        }

    def dependencies(self, unit: Unit, upstream: Tables, shared: Tables) -> JSON:
        return dict(self._bits(_scene(unit, upstream), shared).document())

    def _bits(self, scene: Scene, shared: Tables) -> PriorBits:
        return LabelPriors.from_table(shared["priors"]).bits(scene, self.sampling.plausible_share)

    def run(self, unit: Unit, upstream: Tables, shared: Tables) -> StageOutput:
        scene = _scene(unit, upstream)
        facts = {}
        for room in scene.rooms:
            arrays = scene.arrays(room.room_id)
            relations = RoomRelations.from_table(upstream["relations"], arrays, self.thresholds)
            facts[room.room_id] = text_facts(relations, self.thresholds)
        goals = {}
        stops = apart_by_centres(scene, self.places)
        if scene.navmesh is not None:
            pathfinder = _pathfinder(scene, upstream)
            obstacles = blocked_footprints(scene, pathfinder, self.max_climb)
            goals = scene_goals(scene, pathfinder, self.places, self.goals, obstacles, _view(unit, scene))
            separation = self.places.leaf_separation(scene.single_room)
            stops = reachable_stops(pathfinder, GoalField(pathfinder, goals), separation)
        # Leaves are checked before the gold one is drawn among them, so that the check can't favour a truth.
        sampler = ProgramSampler(
            scene,
            facts,
            self._bits(scene, shared),
            self.instructions,
            self.sampling,
            self.seed,
            stops=stops,
            preamble=self.preamble,
        )
        candidates = draw_candidates(sampler)
        return StageOutput(
            tables={
                "stops": stops_table(scene.scene_id, goals),
                "candidates": candidates_table(scene.scene_id, candidates),
                "rejections": rejections_table(scene.scene_id, self.name, sampler.rejections),
            },
            measures={"candidates": float(len(candidates))},
        )


@dataclass
class EpisodeStage(Stage):
    """Candidate programs + navmesh + surfaces → placed episodes and what is seen on them, without their words."""

    places: PlacesConfig
    instructions: InstructionsConfig
    rules: EpisodeConfig
    max_climb: float
    preamble: bool
    seed: int
    name: str = "episodes"
    version: int = 7
    tables: tuple[str, ...] = ("placements", "unplaced", "rejections", "funnel")
    reads: tuple[str, ...] | None = ("scenes", "rooms", "objects", "navmeshes", "stops", "candidates")
    reads_inputs: bool = True

    def parameters(self, unit: Unit) -> JSON:
        return {
            "places": _dump(self.places),
            "instructions": _dump(self.instructions),
            "episodes": _dump(self.rules),
            "agent": {"max_climb": self.max_climb},
            "text": {"preamble": self.preamble},
            "seed": self.seed,
        }

    def run(self, unit: Unit, upstream: Tables, shared: Tables) -> StageOutput:
        scene = _scene(unit, upstream)
        wanted, groups = self.instructions.wanted, self.instructions.counterfactual_groups
        candidates = candidates_from_table(upstream["candidates"], wanted)
        if scene.navmesh is None:
            return self._without_navmesh(scene, candidates)
        placer = Placer(
            scene,
            _pathfinder(scene, upstream),
            goals_from_table(upstream["stops"]),
            self.places,
            self.rules,
            self.seed,
            max_climb=self.max_climb,
        )
        observer = Observer(scene, _view(unit, scene), placer.pathfinder, self.places, self.rules, placer.obstacles)
        pool = fill_pool(
            candidates,
            placer,
            wanted,
            self.instructions.label_cap,
            lambda program: self.preamble and names_compass(program),
            observer,
            groups,
        )
        compositions = dict(
            zip(*(upstream["candidates"][c].to_pylist() for c in ("instruction_id", "composition")), strict=True)
        )
        return StageOutput(
            tables={
                "placements": placements_table(scene.scene_id, pool, compositions, scene.navmesh.sha256),
                "unplaced": unplaced_table(()),
                "rejections": rejections_table(scene.scene_id, self.name, pool.rejections, pool.examples),
                "funnel": funnel_table(scene.scene_id, wanted, pool, groups),
            },
            measures={"episodes": float(len(pool.episodes)), "candidates": float(len(candidates))},
        )

    def _without_navmesh(self, scene: Scene, candidates: list[Candidate]) -> StageOutput:
        """Instructions as many as wanted; every candidate counts as one that could not be placed."""
        pool = EpisodePool()
        wanted, groups = self.instructions.wanted, self.instructions.counterfactual_groups
        for candidate in candidates:
            pool.candidates[candidate.cell] += 1
            pool.reject(candidate, "no_navmesh")
        return StageOutput(
            tables={
                "placements": PLACEMENTS.empty_table(),
                "unplaced": unplaced_table(unplaced_programs(candidates)),
                "rejections": rejections_table(scene.scene_id, self.name, pool.rejections, pool.examples),
                "funnel": funnel_table(scene.scene_id, wanted, pool, groups),
            },
            measures={"episodes": 0.0, "candidates": float(len(candidates))},
        )


@dataclass
class TextStage(Stage):
    """Placed programs → their words: instructions and episodes as they are published."""

    text: TextConfig
    max_steps: int
    seed: int
    name: str = "text"
    version: int = 4
    tables: tuple[str, ...] = ("instructions", "episodes")
    reads: tuple[str, ...] | None = ("candidates", "placements", "unplaced", "rooms")

    def parameters(self, unit: Unit) -> JSON:
        return {
            "text": _dump(self.text),
            "episodes": {"max_steps": self.max_steps},
            "seed": self.seed,
        }

    def run(self, unit: Unit, upstream: Tables, shared: Tables) -> StageOutput:
        placements = upstream["placements"]
        candidates = upstream["candidates"]
        wanted = [*placements["instruction_id"].chunks, *upstream["unplaced"]["instruction_id"].chunks]
        names = pa.chunked_array(wanted, pa.string())
        kept = candidates.filter(pc.is_in(candidates["instruction_id"], value_set=names))
        programs = dict(programs_from_table(kept))
        bodies = {k: render(program, self.seed, k) for k, program in programs.items()}
        groups = dict(zip(*(placements[c].to_pylist() for c in ("instruction_id", "group_id")), strict=True))
        texts = {}
        for row in placements.select(["episode_id", "instruction_id", "start_heading_degrees"]).to_pylist():
            name = row["instruction_id"]
            named = self.text.preamble and names_compass(programs[name])
            texts[row["episode_id"]] = (
                with_preamble(bodies[name], row["start_heading_degrees"], self.seed, name) if named else bodies[name]
            )
        return StageOutput(
            tables={
                "instructions": instruction_table(str(unit.payload["scene_id"]), programs.items(), bodies, groups),
                "episodes": with_text(placements, texts, self.max_steps, self.text.steps_per_word),
            }
        )
