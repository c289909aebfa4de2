"""The stages that make episodes: programs drawn and placed, then their words."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import pyarrow as pa
import pyarrow.compute as pc

from condvln.episodes.candidates import DRAWING, PLACING, unplaced_programs, unplaced_table
from condvln.episodes.pool import EpisodePool
from condvln.episodes.steps import ProgramSettings, Rejections, draw_programs, place_programs, published_texts
from condvln.episodes.table import (
    PLACEMENTS,
    funnel_table,
    placements_table,
    rejections_table,
    with_text,
)
from condvln.episodes.visibility import sightings_from_table
from condvln.instructions import PriorBits, instruction_table, instructions_with_text
from condvln.navigation.graph_pathfinder import GraphPathfinder
from condvln.relations import TextFacts
from condvln.scene import Scene
from factory.stage import Stage, StageOutput, Unit
from jobs.stages.inputs import (
    Tables,
    asked_of,
    bits_of,
    dump,
    facts_of,
    programs_of,
    scene_of,
    source_of,
    walkable_of,
)
from schemas.canonical import JSON
from schemas.config import (
    StepBudget,
    TextConfig,
    WordingConfig,
)
from schemas.program import Program

__all__ = ["EpisodeStage", "TextStage"]


@dataclass
class TextStage(Stage):
    """Placed programs → instructions and episodes with their text, as they are published."""

    text: TextConfig
    wording: WordingConfig
    max_steps: StepBudget
    seed: int
    name: str = "text"
    version: int = 34
    tables: tuple[str, ...] = ("instructions", "episodes")
    reads: tuple[str, ...] | None = ("programs", "placements", "unplaced", "rooms")

    @cached_property
    def _parameters(self) -> JSON:
        """What `parameters` returns: one object for all units, whose hash is cached."""
        return {
            "text": dump(self.text),
            "instructions": dump(self.wording),
            "episodes": {"max_steps": self.max_steps},
            "seed": self.seed,
        }

    def parameters(self, unit: Unit) -> JSON:
        return self._parameters

    def run(self, unit: Unit, upstream: Tables, shared: Tables) -> StageOutput:
        placements, table = upstream["placements"], upstream["programs"]
        wanted = [*placements["instruction_id"].chunks, *upstream["unplaced"]["instruction_id"].chunks]
        names = pa.chunked_array(wanted, pa.string())
        programs = programs_of(table, names)
        groups = dict(zip(*(placements[c].to_pylist() for c in ("instruction_id", "group_id")), strict=True))
        rows = placements.select(["episode_id", "instruction_id", "start_heading_degrees"]).to_pylist()
        bodies, texts = published_texts(programs, rows, self.text, self.wording, self.seed)
        published = table.filter(pc.is_in(table["instruction_id"], value_set=names))
        return StageOutput(
            tables={
                "instructions": instructions_with_text(published, bodies, groups),
                "episodes": with_text(placements, texts, self.max_steps, self.text.steps_per_word),
            }
        )


@dataclass
class EpisodeStage(Stage):
    """Relations, navmesh and surfaces → placed programs with their paths and observability, without text.

    Its table ``programs`` has the published programs, and an example of each reason for which one was not placed.
    """

    settings: ProgramSettings
    max_climb: float
    name: str = "episodes"
    version: int = 42
    tables: tuple[str, ...] = ("programs", "placements", "unplaced", "rejections", "funnel")
    reads_inputs: bool = True
    reads: tuple[str, ...] | None = ("scenes", "rooms", "objects", "navmeshes", "relations", "visibility")
    needs: tuple[str, ...] = ("priors",)

    @cached_property
    def _parameters(self) -> JSON:
        """What `parameters` returns: one object for all units, whose hash is cached."""
        own, wording = self.settings, dict[str, JSON]()
        wanted = asked_of(own.instructions)
        if any(cell.words for cell in own.instructions.cells):
            # The number of words is decided by the wording, which is another stage's to change.
            wording = {"wording": TextStage.version}
            wanted |= dump(own.instructions.wording)
        return wording | {
            "thresholds": dump(own.thresholds),
            "places": dump(own.places),
            "instructions": wanted,
            "sampling": dump(own.sampling),
            "goals": dump(own.goals),
            "episodes": dump(own.episodes),
            "agent": {"max_climb": self.max_climb},
            "text": {"preamble": own.preamble},
            "seed": own.seed,
        }

    def parameters(self, unit: Unit) -> JSON:
        return self._parameters

    def dependencies(self, unit: Unit, upstream: Tables, shared: Tables) -> JSON:
        return dict(self._bits(scene_of(unit, upstream), shared).document())

    def _bits(self, scene: Scene, shared: Tables) -> PriorBits:
        own = self.settings
        return bits_of(scene, shared["priors"], own.sampling, own.instructions.directions, own.places)

    def run(self, unit: Unit, upstream: Tables, shared: Tables) -> StageOutput:
        scene = scene_of(unit, upstream)
        facts, bits = facts_of(scene, upstream["relations"], self.settings.thresholds), self._bits(scene, shared)
        if scene.navmesh is None:
            return self._without_navmesh(unit, scene, facts, bits, upstream)
        walkable = walkable_of(unit, scene, upstream, self.max_climb)
        assert walkable is not None
        sightings = sightings_from_table(upstream["visibility"])
        placed = place_programs(scene, facts, bits, walkable, sightings, self.settings)
        programs = {episode.instruction_id: episode.program for episode in placed.pool.episodes}
        return self._output(scene, programs, placed.pool, placed.rejections)

    def _without_navmesh(
        self, unit: Unit, scene: Scene, facts: Mapping[str, TextFacts], bits: PriorBits, upstream: Tables
    ) -> StageOutput:
        """Return the output for a scene without a navmesh: as many instructions as wanted, and no episodes. Every
        candidate counts as not placed. A scan may have a viewpoint graph instead.
        """
        viewpoints = source_of(unit).connectivity(scene.scene_id)
        graph = None if viewpoints is None else GraphPathfinder.load(viewpoints)
        sightings = sightings_from_table(upstream["visibility"])
        drawn = draw_programs(scene, facts, bits, sightings, self.settings, graph)
        pool = EpisodePool()
        for candidate in drawn.candidates:
            pool.candidates[candidate.cell] += 1
            pool.reject(candidate.cell, "no_navmesh", candidate)
        wanted = set(unplaced_programs(drawn.candidates))
        programs = {one.instruction_id: one.program for one in drawn.candidates if one.instruction_id in wanted}
        return self._output(scene, programs, pool, drawn.rejections)

    def _output(
        self, scene: Scene, programs: Mapping[str, Program], pool: EpisodePool, failed: Rejections
    ) -> StageOutput:
        """Return the tables of a scene, whose published programs are `programs`, by id."""
        names, asked = sorted(programs), self.settings.instructions
        examples = {one.instruction_id: one.program for one in pool.examples.values()}
        kept = [(name, programs[name]) for name in names]
        kept += [(name, examples[name]) for name in sorted(examples.keys() - programs.keys())]
        table, sha256 = instruction_table(scene.scene_id, kept), None if scene.navmesh is None else scene.navmesh.sha256
        placements = PLACEMENTS.empty_table() if sha256 is None else placements_table(scene, pool, sha256)
        return StageOutput(
            tables={
                "programs": table,
                "placements": placements,
                "unplaced": unplaced_table(names if sha256 is None else ()),
                "rejections": pa.concat_tables(
                    [  # in the order of the published table, which then need not be sorted
                        rejections_table(scene.scene_id, PLACING, pool.rejections, pool.examples),
                        rejections_table(scene.scene_id, DRAWING, failed),
                    ]
                ),
                "funnel": funnel_table(scene.scene_id, asked.wanted, pool, asked.counterfactual_groups),
            },
            measures={
                "episodes": float(len(pool.episodes)),
                "candidates": float(sum(pool.candidates.values())),
            },
        )
