"""A made export of every category, and the pieces it is proven from; made once a session."""

from __future__ import annotations

import io
from dataclasses import dataclass
from pathlib import Path

import pytest
from rich.console import Console

from condvln.navigation.scene_navmesh import with_shipped_navmesh
from condvln.samples import make_samples
from condvln.scene import Scene
from condvln.scene.scene import SceneGeometry
from condvln.sources.registry import open_source
from condvln.verify.certificate import VerifierRules
from condvln.verify.files import ExportFiles, Row, SceneRun
from jobs.generate import run_generate
from schemas.config import Config, InstructionsConfig, SamplingConfig, SourceConfig
from schemas.program import CATEGORIES
from tests.once import made_once

SCENES = 4
PER_CATEGORY = 6


@dataclass(frozen=True)
class MadeExport:
    """An export, what it was made with, its scenes with their surfaces, and its rows by scene."""

    config: Config
    folder: Path
    scenes: dict[str, Scene]
    surfaces: dict[str, SceneGeometry | None]
    runs: tuple[SceneRun, ...]

    @property
    def rules(self) -> VerifierRules:
        return VerifierRules.of(self.config)

    @property
    def rows(self) -> list[Row]:
        return [row for run in self.runs for row in run.rows]


def _exported(folder: Path) -> Config:
    make_samples(folder / "scenes", family="replicacad", scenes=SCENES, seed=0)
    config = Config(
        name="made",
        store=folder / "store",
        export=folder / "export",
        sources=(SourceConfig(family="replicacad", root=folder / "scenes"),),
        instructions=InstructionsConfig(per_category=dict.fromkeys(CATEGORIES, PER_CATEGORY), counterfactual_groups=4),
        sampling=SamplingConfig(
            candidates_per_episode=PER_CATEGORY,
            presence_share=0.5,
            moves=(0.4, 0.4, 0.2),
            moves_drawn=(0.27, 0.39, 0.34),
        ),
    )
    run_generate(config, inline=True, console=Console(file=io.StringIO()))
    return config


@pytest.fixture(scope="session")
def made_export(tmp_path_factory: pytest.TempPathFactory) -> MadeExport:
    """Made apartments of several rooms, some episodes of each category; read only."""
    config = made_once(tmp_path_factory, "proven", _exported)
    folder = config.store.parent
    runs = tuple(ExportFiles(folder / "export").runs())
    source = open_source("replicacad", folder / "scenes")
    scenes = {run.scene_id: with_shipped_navmesh(source.read(run.scene_id), config.agent) for run in runs}
    surfaces = {name: source.geometry(scene) for name, scene in scenes.items()}
    return MadeExport(config, folder / "export", scenes, surfaces, runs)
