"""A small made dataset, generated once a session; tests copy what they change."""

from __future__ import annotations

import json
import secrets
import shutil
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path

import pytest
from rich.console import Console

from condvln.samples import make_samples
from factory.store import open_store
from jobs.export import run_export
from jobs.generate import run_generate
from jobs.report import Report
from jobs.workspace import CACHE_VARIABLE
from schemas.config import Config, InstructionsConfig, SourceConfig, SplitsConfig
from schemas.program import CATEGORIES
from tests.once import made_once

SCENES = 2


def configuration(folder: Path, root: Path, **changes: object) -> Config:
    """Two episodes of two categories a scene over the dataset `root`, everything else below `folder`."""
    return Config(
        name="made",
        store=folder / "store",
        sources=(SourceConfig(family="replicacad", root=root),),
        instructions=InstructionsConfig(per_category={"simple": 2, "nested": 2}),
    ).model_copy(update=changes)


def made_config(
    folder: Path, family: str, scenes: int, seed: int = 3, *, episodes: int | dict[str, int], **changes: object
) -> Config:
    """A configuration over made scenes of a family in ``data``; its store and its export are below `folder` too.

    episodes : of each category in each scene, or by category
    """
    make_samples(folder / "data", family=family, scenes=scenes, seed=seed)
    wanted = episodes if isinstance(episodes, dict) else dict.fromkeys(CATEGORIES, episodes)
    return Config(
        name=family,
        store=folder / "store",
        export=folder / "export",
        sources=(SourceConfig(family=family, root=folder / "data"),),  # type: ignore[arg-type]
        instructions=InstructionsConfig(per_category=wanted),
    ).model_copy(update=changes)


def remove(folder: Path, *patterns: str) -> None:
    """Remove the files below a folder that have one of these names."""
    for pattern in patterns:
        for path in folder.rglob(pattern):
            path.unlink()


def made_scans(folder: Path, *, meshes: bool) -> Config:
    """The configuration of a run over three made scans of Matterport3D, after it; without meshes, viewpoints alone."""
    config = made_config(folder, "mp3d", 3, 5, episodes=12, splits=SplitsConfig(fractions=(0.0, 0.0, 1.0)))
    if not meshes:
        remove(folder / "data", "*.glb", "*.navmesh")
    assert run_generate(config, inline=True, console=Console(quiet=True)).exit_code == 0
    return config


@pytest.fixture(scope="session")
def scans_alone(tmp_path_factory: pytest.TempPathFactory) -> Config:
    """A run over scans of which only the annotation and the viewpoints are there; read only."""
    return made_once(tmp_path_factory, "scans alone", partial(made_scans, meshes=False))


@pytest.fixture(scope="session")
def made_dataset(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two made apartments in ReplicaCAD's format; read only."""

    def make(folder: Path) -> Path:
        make_samples(folder, family="replicacad", scenes=SCENES, seed=3)
        return folder

    return made_once(tmp_path_factory, "dataset", make)


@pytest.fixture(scope="session")
def made_run(made_dataset: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[Config, Report]:
    """The configuration and report of a clean run over the made dataset; read only."""

    def make(folder: Path) -> tuple[Config, Report]:
        config = configuration(folder, made_dataset)
        return config, run_generate(config, inline=True)

    return made_once(tmp_path_factory, "run", make)


@pytest.fixture(scope="module")
def export(made_run: tuple[Config, Report], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """An export of the made dataset, one a module."""

    def make(folder: Path) -> Path:
        run_export(made_run[0].model_copy(update={"export": folder / "export"}))
        return folder

    made, own = made_once(tmp_path_factory, "export", make), tmp_path_factory.mktemp("exported")
    return Path(shutil.copytree(made, own, dirs_exist_ok=True), "export")


@pytest.fixture(scope="module")
def split(export: Path) -> str:
    """The split with most episodes."""
    counts: dict[str, int] = json.loads((export / "export.json").read_text())["episodes"]
    return max(counts, key=lambda name: counts[name])


@pytest.fixture
def dataset(made_dataset: Path, tmp_path: Path) -> Path:
    """A copy of the made dataset to break."""
    return Path(shutil.copytree(made_dataset, tmp_path / "dataset"))


@pytest.fixture
def configured(tmp_path: Path) -> Callable[..., Config]:
    """A configuration over a dataset with a store of the test's own."""

    def make(root: Path, **changes: object) -> Config:
        return configuration(tmp_path, root, **changes)

    return make


@pytest.fixture(scope="session")
def made_away(
    made_run: tuple[Config, Report], s3_server: str, tmp_path_factory: pytest.TempPathFactory
) -> Iterator[Config]:
    """The same run, its store copied to an object store; read only."""
    config, _ = made_run
    address = f"s3://bucket/{secrets.token_hex(6)}?endpoint={s3_server}"
    here, away = open_store(str(config.store)), open_store(address)
    for kind in ("refs", "snapshots", "indexes", "pins", "aggregates", "runs", "units"):
        for entry in here.list(kind):
            away.write(entry.path, here.read(entry.path))
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv(CACHE_VARIABLE, str(tmp_path_factory.mktemp("cache")))
        yield config.model_copy(update={"store": address})
