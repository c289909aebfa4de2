"""Stage ``episodes``: chooses starts, goal points and paths for programs, and finds what is visible on the way."""

from __future__ import annotations

from dataclasses import dataclass

from condvln.episodes.candidates import Candidate, unplaced_programs, unplaced_table
from condvln.episodes.pool import EpisodePool
from condvln.episodes.steps import place_programs
from condvln.episodes.table import (
    PLACEMENTS,
    funnel_table,
    goals_from_table,
    placements_table,
    rejections_table,
)
from condvln.episodes.visibility import sightings_from_table
from condvln.scene import Scene
from factory.stage import Stage, StageOutput
from factory.unit import Unit
from jobs.stages.inputs import Tables, asked_of, candidates_of, dump, scene_of, walkable_of
from schemas.canonical import JSON
from schemas.config import (
    EpisodeConfig,
    InstructionsConfig,
    PlacesConfig,
    SamplingConfig,
    Thresholds,
)

__all__ = ["EpisodeStage"]


@dataclass
class EpisodeStage(Stage):
    """Candidate programs, navmesh and surfaces → placed episodes with their observability, without text."""

    places: PlacesConfig
    instructions: InstructionsConfig
    sampling: SamplingConfig
    rules: EpisodeConfig
    thresholds: Thresholds
    max_climb: float
    preamble: bool
    seed: int
    name: str = "episodes"
    version: int = 20
    tables: tuple[str, ...] = ("placements", "unplaced", "rejections", "funnel")
    reads: tuple[str, ...] | None = ("scenes", "rooms", "objects", "navmeshes", "visibility", "stops", "candidates")
    reads_inputs: bool = True

    def parameters(self, unit: Unit) -> JSON:
        return {
            "places": dump(self.places),
            "instructions": asked_of(self.instructions),
            "sampling": self.sampling.model_dump(mode="json", include={"moves", "moves_four_leaves"}),
            "episodes": dump(self.rules),
            "thresholds": {key: value for key, value in dump(self.thresholds).items() if key.startswith("bearing_")},
            "agent": {"max_climb": self.max_climb},
            "text": {"preamble": self.preamble},
            "seed": self.seed,
        }

    def run(self, unit: Unit, upstream: Tables, shared: Tables) -> StageOutput:
        scene = scene_of(unit, upstream)
        wanted, groups = self.instructions.wanted, self.instructions.counterfactual_groups
        candidates = candidates_of(upstream["candidates"], wanted)
        if scene.navmesh is None:
            return self._without_navmesh(scene, candidates)
        walkable = walkable_of(unit, scene, upstream, self.max_climb)
        assert walkable is not None
        pool = place_programs(
            scene,
            candidates,
            goals_from_table(upstream["stops"]),
            walkable,
            sightings_from_table(upstream["visibility"]),
            instructions=self.instructions,
            sampling=self.sampling,
            places=self.places,
            rules=self.rules,
            thresholds=self.thresholds,
            preamble=self.preamble,
            seed=self.seed,
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
        """Return the output for a scene without a navmesh: as many instructions as wanted, and no episodes. Every
        candidate counts as not placed.
        """
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
