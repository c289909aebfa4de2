"""Texts that say left, right, ahead and behind: proven where they are right, refuted where one fault is in them."""

from __future__ import annotations

import io
import sys
from collections import Counter
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from pydantic import ValidationError
from rich.console import Console

from condvln.navigation.scene_navmesh import with_shipped_navmesh
from condvln.samples import make_samples
from condvln.sources.registry import open_source
from condvln.verify.certificate import Certificate, VerifierRules
from condvln.verify.files import ExportFiles, Row
from condvln.verify.proof import prove_scene
from condvln.verify.standpoint import BEARINGS, inside_outline
from condvln.verify.surfaces import Shapes
from jobs.generate import run_generate
from schemas.config import Config, InstructionsConfig, PredicateWeights, SamplingConfig, SourceConfig
from schemas.program import CATEGORIES

sys.path.insert(0, str(Path(__file__).parent))
from mutants_of_bearings import MUTATORS_OF_BEARINGS
from mutation import Files, World

MEANING = {
    "condition_truth",
    "condition_decided",
    "qualifier_needed",
    "qualifier_sufficient",
    "bearing_room",
    "gold_leaf",
    "referents",
    "witnesses",
    "referent_unique",
}
"""Facts that speak of what is meant: a turned start is found by these, not only by the walk that no longer fits."""


@pytest.fixture(scope="session")
def egocentric(tmp_path_factory: pytest.TempPathFactory) -> Config:
    """A made export with egocentric directions; read only."""
    folder = tmp_path_factory.mktemp("egocentric")
    for family, scenes in (("replicacad", 4), ("procthor", 1)):
        make_samples(folder / family, family=family, scenes=scenes, seed=0)
    config = Config(
        name="egocentric",
        store=folder / "store",
        export=folder / "export",
        sources=tuple(SourceConfig(family=name, root=folder / name) for name in ("replicacad", "procthor")),  # type: ignore[arg-type]
        instructions=InstructionsConfig(per_category=dict.fromkeys(CATEGORIES, 6), directions="egocentric"),
        sampling=SamplingConfig(predicates=PredicateWeights(bearing=5.0)),
    )
    run_generate(config, inline=True, console=Console(file=io.StringIO()))
    return config


def _bearings(row: Row) -> list[str]:
    program = row.manifest.program
    return [one.qualifier.predicate for one in program.named if one.is_bearing and one.qualifier is not None]


def _proven(config: Config, source: str, rows: list[Row]) -> list[Certificate]:
    assert config.export is not None
    (root,) = [one.root for one in config.sources if one.family == source]
    reader = open_source(source, root)
    scene = with_shipped_navmesh(reader.read(rows[0].manifest.scene_id), config.agent)
    certificates = [Certificate(row.manifest.episode_id, source, scene.scene_id, row.split) for row in rows]
    surfaces = partial(reader.geometry, scene)
    prove_scene(rows, certificates, scene, surfaces, config.export, VerifierRules.of(config), Shapes(scene.root))
    return certificates


@pytest.mark.soak
def test_every_bearing_is_proven_and_no_compass_word_is_said(egocentric: Config) -> None:
    said: Counter[str] = Counter()
    for run in ExportFiles(egocentric.export).runs():
        for row, certificate in zip(run.rows, _proven(egocentric, run.source, run.rows), strict=True):
            assert certificate.proven, [str(d) for d in certificate.disagreements]
            said.update(_bearings(row))
            assert "facing" not in row.manifest.instruction_text
            assert certificate.checked["directions"] == 1
    assert set(said) == set(BEARINGS)


@pytest.mark.soak
def test_faults_in_bearings_are_caught(egocentric: Config) -> None:
    rng = np.random.default_rng(0)
    tried: Counter[str] = Counter()
    survivors, by_the_way = [], []
    for run in ExportFiles(egocentric.export).runs():
        (root,) = [one.root for one in egocentric.sources if one.family == run.source]
        world = World(open_source(run.source, root).read(run.scene_id), {})
        made: list[tuple[str, Row]] = []
        for row in run.rows:
            for name, mutate in MUTATORS_OF_BEARINGS.items():
                files = Files.of(row)
                if row.manifest.group_id is None and mutate(files, rng, world):
                    tried[name] += 1
                    try:
                        made.append((name, files.row(row.split)))
                    except ValidationError:
                        continue
        if not made:
            continue
        for (name, row), certificate in zip(
            made, _proven(egocentric, run.source, [row for _, row in made]), strict=True
        ):
            facts = {disagreement.fact for disagreement in certificate.disagreements}
            if not facts:
                survivors.append((name, row.manifest.instruction_text))
            if not facts & MEANING:
                by_the_way.append((name, row.manifest.instruction_text))
    print(f"\n{tried.total()} mutants of bearings: {dict(tried)}")
    assert set(tried) == set(MUTATORS_OF_BEARINGS), "every kind of fault was tried"
    assert not survivors
    assert not by_the_way, "what is said is found to be wrong by what it means"


def test_a_point_is_in_an_outline_or_not() -> None:
    corner = [(0.0, 0.0), (4.0, 0.0), (4.0, 2.0), (2.0, 2.0), (2.0, 4.0), (0.0, 4.0)]
    for x, z, inside in ((1.0, 1.0, True), (3.0, 1.0, True), (3.0, 3.0, False), (1.0, 3.0, True), (-1.0, 1.0, False)):
        assert inside_outline(x, z, corner) == inside_outline(x, z, corner[::-1]) == inside
