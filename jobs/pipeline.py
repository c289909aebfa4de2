"""Build the pipeline and its units from a configuration; connects the packages ``condvln``, ``factory`` and
``schemas``.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, Final

from condvln.export.rows import Row
from condvln.export.scene_table import NavmeshBytes
from condvln.export.selection import VERSION
from condvln.sources.registry import open_source
from condvln.sources.source import HashFile, Source
from factory.pipeline import Pipeline, TableSpec
from factory.snapshot import Snapshot
from factory.unit import InputFile, Unit
from factory.unit_list import UnitList
from jobs.costs import stage_costs
from jobs.stages import (
    CountStage,
    EpisodeStage,
    PriorsAggregate,
    RelationStage,
    SceneStage,
    TextStage,
    VisibilityStage,
)
from schemas.config import Config, SourceConfig
from schemas.config.constants import GROUP_SIZE
from schemas.errors import ConfigError
from schemas.tables import SORT_KEYS, TABLES

__all__ = [
    "build_pipeline",
    "built_navmeshes",
    "code_versions",
    "list_units",
    "open_configured",
    "scene_payload",
    "units_of",
]

BYTES_BASE: Final = 300 * 2**20
"""Memory of a worker before it reads a scene, bytes: interpreter, numpy, Arrow, compiled kernels."""

_STAGE_OF: Final[dict[str, str | tuple[str, ...]]] = {
    "scenes": "scene",
    "rooms": "scene",
    "objects": "scene",
    "relations": "relations",
    "visibility": "visibility",
    "instructions": "text",
    "episodes": "text",
    "rejections": "episodes",
    "funnel": "episodes",
}


def build_pipeline(config: Config) -> Pipeline:
    """Build the six stages under `config`, with the nine tables that they publish."""
    agent, preamble = config.agent, config.text.preamble
    return Pipeline(
        name="condvln",
        stages=(
            SceneStage(agent, config.limits),
            CountStage(config.thresholds, config.sampling.anchor_size),
            RelationStage(config.thresholds),
            VisibilityStage(config.places.eye_height, config.places.island_radius, agent.max_climb),
            EpisodeStage(
                config.thresholds,
                config.places,
                config.instructions,
                config.sampling,
                config.goals,
                config.episodes,
                agent.max_climb,
                preamble,
                config.seed,
            ),
            TextStage(config.text, config.instructions.wording, config.episodes.max_steps, config.seed),
        ),
        aggregates=(PriorsAggregate(config.thresholds, config.sampling, config.instructions.directions),),
        tables={name: TableSpec(TABLES[name], SORT_KEYS[name], _STAGE_OF[name]) for name in TABLES},
    )


def code_versions(config: Config) -> dict[str, int]:
    """Return the versions of the code that decide rows: of each stage, of the priors and what they sum, and of the
    choice of episodes.
    """
    pipeline = build_pipeline(config)
    stages = {stage.name: stage.version for stage in pipeline.stages if stage.name != CountStage.name}
    return stages | {one.name: one.version for one in pipeline.aggregates} | {"select": VERSION}


def open_configured(config: Config, source: SourceConfig, hash_file: HashFile) -> Source:
    """Open the reader of one configured source."""
    return open_source(
        source.family,
        source.root,
        scenes=source.scenes,
        exclude=source.exclude,
        regions=source.regions,
        houses=source.houses,
        navmesh=source.navmesh,
        hash_file=hash_file,
        limits=config.limits,
        absence=source.absence,
        connectivity=source.connectivity,
    )


def scene_payload(source: SourceConfig, scene_id: str) -> dict[str, Any]:
    """Return what the stages need to open a scene of a configured source; see `jobs.stages.inputs.source_of`."""
    return {
        "family": source.family,
        "root": str(source.root),
        "scene_id": scene_id,
        "regions": None if source.regions is None else str(source.regions),
        "houses": None if source.houses is None else str(source.houses),
        "navmesh": source.navmesh,
        "absence": source.absence,
        "connectivity": None if source.connectivity is None else str(source.connectivity),
    }


def list_units(config: Config, hash_file: HashFile) -> list[Unit]:
    """List all scenes of all sources as units, by id. One that can't be listed becomes a unit that holds the error."""
    return [*units_of(config, hash_file)]


def units_of(config: Config, hash_file: HashFile) -> UnitList:
    """Return what ``list_units`` does, on disk."""
    units = UnitList(_each_unit(config, hash_file))
    if units.twice is not None:
        raise ConfigError(
            f"scene {units.twice} comes from two sources",
            remedy="Keep one of them, or separate them with 'scenes' and 'exclude'.",
        )
    return units


def _each_unit(config: Config, hash_file: HashFile) -> Iterator[Unit]:
    wanted = config.instructions
    asked = sum(cell.count for cell in wanted.wanted) + GROUP_SIZE * wanted.counterfactual_groups
    for source in config.sources:
        for handle in open_configured(config, source, hash_file).each_handle():
            yield Unit(
                unit_id=f"{handle.family}/{handle.scene_id}",
                partition=handle.family,
                inputs=tuple(InputFile(i.path, i.size, i.sha256) for i in handle.inputs),
                payload=scene_payload(source, handle.scene_id),
                costs={} if handle.fault else stage_costs(handle.family, handle.counts, asked),
                memory=BYTES_BASE + 4 * sum(i.size for i in handle.inputs),
                fault=handle.fault,
            )


def built_navmeshes(config: Config, snapshot: Snapshot) -> NavmeshBytes:
    """Return a function that takes the source of a scene and the scene's row of the scenes table, and returns the
    navmesh built for the scene, or None if none was built.

    Asking for one raises ``CorruptShardError`` where the unit's file is missing or damaged: leaving its scene out would
    shrink an export silently.
    """
    pipeline = build_pipeline(config)

    def navmesh(source: str, row: Row) -> bytes | None:
        if not row["navmesh_built"]:
            return None
        kept = snapshot.unit_table(f"{source}/{row['scene_id']}", pipeline, "navmeshes")
        return kept["data"][0].as_py() if kept.num_rows else None

    return navmesh
