"""Stages ``counts`` and ``programs``: what a scene adds to the priors, and candidate programs drawn with the priors of
all scenes.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Final

import pyarrow as pa

from condvln.collector import no_collection
from condvln.episodes.candidates import candidates_table
from condvln.episodes.steps import DrawnPrograms, draw_programs
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
from condvln.relations import RoomRelations, TextFacts, text_facts
from condvln.scene import Scene
from factory.stage import Aggregate, Stage, StageOutput
from factory.unit import Unit
from jobs.stages.inputs import Tables, asked_of, bits_of, dump, keep_candidates, scene_of, source_of, walkable_of
from jobs.stages.text import TextStage
from schemas.canonical import JSON
from schemas.config import (
    GoalsConfig,
    InstructionsConfig,
    PlacesConfig,
    SamplingConfig,
    Thresholds,
)

__all__ = ["CountStage", "PriorsAggregate", "ProgramStage"]


COUNTING: Final = 12
"""Version of how statements are counted, in a scene and over all scenes."""


@dataclass
class CountStage(Stage):
    """Rooms and objects → for each type of room, how many rooms of the scene hold a label, and how often a statement
    (such as "a pillow near the bed") is true. Workers count; the driver only adds.
    """

    thresholds: Thresholds
    anchor_size: float
    name: str = "counts"
    version: int = COUNTING
    tables: tuple[str, ...] = ("counts",)
    reads: tuple[str, ...] | None = ("rooms", "objects")

    def parameters(self, unit: Unit) -> JSON:
        return {"thresholds": dump(self.thresholds), "sampling": {"anchor_size": self.anchor_size}}

    def run(self, unit: Unit, upstream: Tables, shared: Tables) -> StageOutput:
        found = LabelPriors.of_tables(upstream["rooms"], upstream["objects"], self.thresholds, self.anchor_size)
        return StageOutput(tables={"counts": found.rows()})


@dataclass
class PriorsAggregate(Aggregate):
    """Sums of what is counted in each scene, over all scenes of all sources."""

    thresholds: Thresholds
    anchor_size: float
    name: str = "priors"
    version: int = COUNTING
    after: str = "counts"
    tables: tuple[str, ...] = ("counts",)

    def parameters(self) -> JSON:
        return {"thresholds": dump(self.thresholds), "sampling": {"anchor_size": self.anchor_size}}

    def build(self, tables: Iterator[tuple[str, Tables]]) -> pa.Table:
        return LabelPriors.merged(LabelPriors.from_table(one["counts"]) for _, one in tables).table()


@dataclass
class ProgramStage(Stage):
    """Relations, navmesh and surfaces → goal points of objects, and candidate programs in the order in which they will
    be tried.
    """

    thresholds: Thresholds
    places: PlacesConfig
    instructions: InstructionsConfig
    sampling: SamplingConfig
    goals: GoalsConfig
    max_climb: float
    preamble: bool
    seed: int
    name: str = "programs"
    version: int = 46
    tables: tuple[str, ...] = ("stops", "candidates", "rejections")
    reads_inputs: bool = True
    reads: tuple[str, ...] | None = ("scenes", "rooms", "objects", "navmeshes", "relations", "visibility")
    needs: tuple[str, ...] = ("priors",)

    def parameters(self, unit: Unit) -> JSON:
        wording: dict[str, JSON] = {}
        wanted = asked_of(self.instructions)
        if any(cell.words for cell in self.instructions.cells):
            # The number of words is decided by the wording, which is another stage's to change.
            wording = {"text": {"preamble": self.preamble}, "wording": TextStage.version}
            wanted |= dump(self.instructions.wording)
        return wording | {
            "thresholds": dump(self.thresholds),
            "places": dump(self.places),
            "instructions": wanted,
            "sampling": dump(self.sampling),
            "goals": dump(self.goals),
            "agent": {"max_climb": self.max_climb},
            "seed": self.seed,
        }

    def dependencies(self, unit: Unit, upstream: Tables, shared: Tables) -> JSON:
        return dict(self._bits(scene_of(unit, upstream), shared).document())

    def _bits(self, scene: Scene, shared: Tables) -> PriorBits:
        return bits_of(scene, shared["priors"], self.sampling, self.instructions.directions)

    def run(self, unit: Unit, upstream: Tables, shared: Tables) -> StageOutput:
        scene = scene_of(unit, upstream)
        facts = {}
        for room in scene.rooms:
            arrays = scene.arrays(room.room_id)
            relations = RoomRelations.from_table(upstream["relations"], arrays, self.thresholds)
            facts[room.room_id] = text_facts(relations, self.thresholds)
        with no_collection():  # programs are trees; collecting garbage among them takes a tenth of this stage
            drawn = self._drawn(unit, scene, facts, upstream, shared)
            candidates = candidates_table(scene.scene_id, drawn.candidates)
        keep_candidates(candidates, self.instructions.wanted, drawn.candidates)
        return StageOutput(
            tables={
                "stops": stops_table(scene.scene_id, drawn.goals),
                "candidates": candidates,
                "rejections": rejections_table(scene.scene_id, self.name, drawn.rejections),
            },
            measures={"candidates": float(len(drawn.candidates))},
        )

    def _drawn(
        self, unit: Unit, scene: Scene, facts: Mapping[str, TextFacts], upstream: Tables, shared: Tables
    ) -> DrawnPrograms:
        return draw_programs(
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
            graph=self._graph(unit, scene),
        )

    def _graph(self, unit: Unit, scene: Scene) -> GraphPathfinder | None:
        """Return a pathfinder over the viewpoint graph of a scan that has no navmesh; None if there is a navmesh, or no
        graph.
        """
        path = None if scene.navmesh is not None else source_of(unit).connectivity(scene.scene_id)
        return None if path is None else GraphPathfinder.load(path)
