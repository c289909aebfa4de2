"""Candidate programs of a scene, and the priors over all scenes that they are drawn with."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass

import pyarrow as pa

<<<<<<< HEAD
from condvln.episodes.candidates import Candidate, candidates_table, draw_candidates
from condvln.episodes.goals import blocked_footprints, scene_goals
from condvln.episodes.graph_placing import viewpoint_stops
from condvln.episodes.placing import reachable_stops
from condvln.episodes.routes import GoalField
=======
from condvln.episodes.candidates import candidates_table
from condvln.episodes.steps import draw_programs
>>>>>>> d2cfd00 (The steps from a scene to its episodes are functions that the stages and World call)
from condvln.episodes.table import (
    rejections_table,
    stops_table,
)
from condvln.episodes.visibility import sightings_from_table
from condvln.instructions import (
    LabelPriors,
    PriorBits,
)
from condvln.navigation.graph_pathfinder import GraphPathfinder
from condvln.relations import RoomRelations, text_facts
from condvln.scene import Scene
from factory.stage import Aggregate, Stage, StageOutput
from factory.unit import Unit
<<<<<<< HEAD
from jobs.stages.inputs import Tables, dump, pathfinder_of, scene_of, source_of, view_of
=======
from jobs.stages.inputs import Tables, dump, scene_of, walkable_of
>>>>>>> d2cfd00 (The steps from a scene to its episodes are functions that the stages and World call)
from jobs.stages.text import TextStage
from schemas.canonical import JSON
from schemas.config import (
    GoalsConfig,
    InstructionCell,
    InstructionsConfig,
    PlacesConfig,
    SamplingConfig,
    Thresholds,
)

__all__ = ["PriorsAggregate", "ProgramStage"]


@dataclass
class PriorsAggregate(Aggregate):
    """Which labels are usual in which type of room, and how often a statement is true there, over all scenes of all
    sources."""

    thresholds: Thresholds
    anchor_size: float
    name: str = "priors"
    version: int = 3
    after: str = "scene"
    tables: tuple[str, ...] = ("rooms", "objects")

    def parameters(self) -> JSON:
        return {"thresholds": dump(self.thresholds), "sampling": {"anchor_size": self.anchor_size}}

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
    version: int = 10
    tables: tuple[str, ...] = ("stops", "candidates", "rejections")
    reads_inputs: bool = True
    reads: tuple[str, ...] | None = ("scenes", "rooms", "objects", "navmeshes", "relations", "visibility")
    needs: tuple[str, ...] = ("priors",)

    def parameters(self, unit: Unit) -> JSON:
        wording: dict[str, JSON] = {}
        if any(cell.words for cell in self.instructions.cells):
            # The number of words is decided by the wording, which is another stage's to change.
            wording = {"text": {"preamble": self.preamble}, "wording": TextStage.version}
        return wording | {
            "thresholds": dump(self.thresholds),
            "places": dump(self.places),
            "instructions": dump(self.instructions),
            "sampling": dump(self.sampling),
            "goals": dump(self.goals),
            "agent": {"max_climb": self.max_climb},
            "seed": self.seed,
        }

    def dependencies(self, unit: Unit, upstream: Tables, shared: Tables) -> JSON:
        return dict(self._bits(scene_of(unit, upstream), shared).document())

    def _bits(self, scene: Scene, shared: Tables) -> PriorBits:
        return LabelPriors.from_table(shared["priors"]).bits(scene, self.sampling.plausible_share)

    def run(self, unit: Unit, upstream: Tables, shared: Tables) -> StageOutput:
        scene = scene_of(unit, upstream)
        facts = {}
        for room in scene.rooms:
            arrays = scene.arrays(room.room_id)
            relations = RoomRelations.from_table(upstream["relations"], arrays, self.thresholds)
            facts[room.room_id] = text_facts(relations, self.thresholds)
<<<<<<< HEAD
        goals = {}
        # What knows where objects can be stood at; each next one fills what the one before left short.
        ways = [apart_by_centres(scene, self.places)]
        if scene.navmesh is not None:
            pathfinder = pathfinder_of(scene, upstream)
            obstacles = blocked_footprints(scene, pathfinder, self.max_climb)
            goals = scene_goals(scene, pathfinder, self.places, self.goals, obstacles, view_of(unit, scene))
            separation = self.places.leaf_separation(scene.single_room)
            ways = [reachable_stops(pathfinder, GoalField(pathfinder, goals), separation)]
        elif (graph := source_of(unit).connectivity(scene.scene_id)) is not None:
            # Where too few things have a viewpoint, there are instructions without episodes.
            ways.insert(0, viewpoint_stops(scene, GraphPathfinder.load(graph)))
        bits = self._bits(scene, shared)
        # Leaves are checked before the gold one is drawn among them, so that the check can't favour a truth.
        candidates: list[Candidate] = []
        rejections: Counter[tuple[InstructionCell | None, str]] = Counter()
        for stops in ways:
            sampler = ProgramSampler(
                scene,
                facts,
                bits,
                self.instructions,
                self.sampling,
                self.seed,
                stops=stops,
                preamble=self.preamble,
                sightings=sightings_from_table(upstream["visibility"]),
            )
            drawn = draw_candidates(sampler)
            candidates = _filled(candidates, drawn) if candidates else drawn
            rejections += sampler.rejections
        return StageOutput(
            tables={
                "stops": stops_table(scene.scene_id, goals),
                "candidates": candidates_table(scene.scene_id, candidates),
                "rejections": rejections_table(scene.scene_id, self.name, rejections),
=======
        drawn = draw_programs(
            scene,
            facts,
            self._bits(scene, shared),
            walkable_of(unit, scene, upstream, self.max_climb),
            sightings_from_table(upstream["visibility"]),
            instructions=self.instructions,
            sampling=self.sampling,
            places=self.places,
            goals=self.goals,
            preamble=self.preamble,
            seed=self.seed,
        )
        return StageOutput(
            tables={
                "stops": stops_table(scene.scene_id, drawn.goals),
                "candidates": candidates_table(scene.scene_id, drawn.candidates),
                "rejections": rejections_table(scene.scene_id, self.name, drawn.rejections),
>>>>>>> d2cfd00 (The steps from a scene to its episodes are functions that the stages and World call)
            },
            measures={"candidates": float(len(drawn.candidates))},
        )


def _filled(candidates: list[Candidate], others: list[Candidate]) -> list[Candidate]:
    """`candidates`, and of the `others` as many as their cells are short of what is asked.

    No more others than candidates, so that most of what is published has an episode.
    """
    there = {candidate.instruction_id for candidate in candidates}
    held = Counter(candidate.cell for candidate in candidates)
    added: list[Candidate] = []
    for other in others:
        if other.cell is None or other.instruction_id in there or held[other.cell] >= other.cell.count:
            continue
        held[other.cell] += 1
        added.append(other)
    return candidates + added[: len(candidates)]
