"""Build the pipeline and its units from a configuration; connects the packages ``condvln``, ``factory`` and
``schemas``.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise
from typing import Any, Final

from condvln.episodes.steps import ProgramSettings
from condvln.export.selection import VERSION
from condvln.export.tables import NavmeshBytes, Row
from condvln.scene import Scene
from condvln.sources.registry import open_source
from condvln.sources.scene_source import Source
from condvln.sources.source import HashFile, hash_file
from factory.pipeline import Pipeline, TableSpec
from factory.snapshot import Snapshot
from factory.stage import InputFile, Unit
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
from jobs.workspace import file_hashes, hasher
from schemas.config import Config, SourceConfig
from schemas.config.constants import GROUP_SIZE
from schemas.errors import ConfigError, MissingFileError
from schemas.tables import SORT_KEYS, TABLES

__all__ = [
    "SceneReader",
    "build_pipeline",
    "built_navmeshes",
    "code_versions",
    "list_units",
    "listed_units",
    "open_configured",
    "scene_payload",
]

BYTES_BASE: Final = 300 * 2**20
"""Memory of a worker before it reads a scene, bytes: interpreter, numpy, Arrow, compiled kernels."""


def build_pipeline(config: Config) -> Pipeline:
    """Build the six stages under `config`, with the nine tables that they publish."""
    agent = config.agent
    programs = ProgramSettings(
        config.thresholds,
        config.places,
        config.instructions,
        config.sampling,
        config.goals,
        config.episodes,
        config.text.preamble,
        config.seed,
    )
    return Pipeline(
        name="condvln",
        stages=(
            SceneStage(agent, config.limits),
            CountStage(config.thresholds, config.sampling.anchor_size, config.sampling.usual_places),
            RelationStage(config.thresholds),
            VisibilityStage(config.places, config.episodes.object_seen, agent.max_climb),
            EpisodeStage(programs, agent.max_climb),
            TextStage(config.text, config.instructions.wording, config.episodes.max_steps, config.seed),
        ),
        aggregates=(
            PriorsAggregate(config.thresholds, config.sampling, config.instructions.directions, config.places),
        ),
        tables={name: TableSpec(TABLES[name], SORT_KEYS[name]) for name in TABLES},
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
    return open_source(**dict(source), hash_file=hash_file, limits=config.limits)


class SceneReader:
    """Reads single scenes of the configured sources, from the files that are on disk now."""

    def __init__(self, config: Config) -> None:
        self.sources: dict[str, list[Source]] = {}
        for source in config.sources:
            opened = open_configured(config, source, hash_file)
            self.sources.setdefault(source.family, []).append(opened)

    def read(self, family: str, scene_id: str) -> tuple[Source, Scene]:
        """Return a scene and the first source that has it.

        Raises
        ------
        MissingFileError : no source has it
        """
        missing = MissingFileError(
            "no source has this scene",
            where=f"{family}/{scene_id}",
            remedy="Use the configuration that the export was built with.",
        )
        for source in self.sources.get(family, ()):
            try:
                return source, source.read(scene_id)
            except MissingFileError as error:
                missing = error
        raise missing


def scene_payload(source: SourceConfig, scene_id: str) -> dict[str, Any]:
    """Return what the stages need to open a scene of a configured source; see `jobs.stages.inputs.source_of`."""
    return {"scene_id": scene_id, **source.model_dump(mode="json", exclude={"scenes", "exclude"})}


def list_units(config: Config, hash_file: HashFile) -> list[Unit]:
    """List all scenes of all sources as units, by id. One that can't be listed becomes a unit that holds the error.

    Raises ``ConfigError`` where a scene comes from two sources.
    """
    units = sorted(_each_unit(config, hash_file), key=lambda unit: unit.unit_id)
    for one, two in pairwise(units):
        if one.unit_id == two.unit_id:
            raise ConfigError(
                f"scene {one.unit_id} comes from two sources",
                remedy="Keep one of them, or separate them with 'scenes' and 'exclude'.",
            )
    return units


def listed_units(config: Config, *, verify: bool = False) -> list[Unit]:
    """List units as `list_units` does, with the cached hashes of files whose size and time are as they were.

    verify : hash every file again: one may have other bytes and the same size and time
    """
    hashes = file_hashes(config, trust=not verify)
    units = list_units(config, hasher(hashes))
    hashes.save()
    return units


def _each_unit(config: Config, hash_file: HashFile) -> Iterator[Unit]:
    known: dict[InputFile, InputFile] = {}  # scenes share most of their files
    wanted = config.instructions
    asked = sum(cell.count for cell in wanted.wanted) + GROUP_SIZE * wanted.counterfactual_groups
    for source in config.sources:
        for handle in open_configured(config, source, hash_file).each_handle():
            files = (InputFile(file.path, file.size, file.sha256) for file in handle.inputs)
            yield Unit(
                unit_id=f"{handle.family}/{handle.scene_id}",
                partition=handle.family,
                inputs=tuple(known.setdefault(file, file) for file in files),
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
