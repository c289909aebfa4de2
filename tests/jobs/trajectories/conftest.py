"""Trajectories of a small made export, made once for all tests of this folder."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path

import pytest

from condvln.trajectories.cameras import PRESETS
from jobs.export import run_export
from jobs.report import Report
from jobs.trajectories import Request, make_trajectories
from schemas.config import Config
from tests.jobs.trajectories.made import FIFTEEN, THIRTY, TINY, WALKS, to


@pytest.fixture(scope="package", autouse=True)
def tiny() -> Iterator[None]:
    """A camera of few pixels, so that a walk costs milliseconds."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("condvln.trajectories.cameras.PRESETS", {**PRESETS, "tiny": TINY})
        yield


@pytest.fixture(scope="package")
def asked(made_run: tuple[Config, Report], tmp_path_factory: pytest.TempPathFactory) -> Request:
    """The request of the tests, over an export of the made dataset; the folder is to be replaced."""
    config, _ = made_run
    export = tmp_path_factory.mktemp("export")
    run_export(config.model_copy(update={"export": export}))
    counts: dict[str, int] = json.loads((export / "export.json").read_text())["episodes"]
    (source,) = config.sources
    return Request(
        target=str(export),
        out=Path("unset"),
        split=max(counts, key=lambda name: counts[name]),
        camera="tiny",
        config=WALKS,
        layouts=FIFTEEN,
        scenes=(f"replicacad={source.root}",),
        inline=True,
    )


@pytest.fixture(scope="package")
def made(asked: Request, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Trajectories of the whole split, in every layout whose turns are of 15°; read only."""
    out = tmp_path_factory.mktemp("trajectories") / "out"
    assert make_trajectories(to(asked, out)).exit_code == 0
    return out


@pytest.fixture(scope="package")
def wide(asked: Request, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Trajectories of the whole split, in every layout whose turns are of 30°; read only."""
    out = tmp_path_factory.mktemp("trajectories") / "wide"
    assert make_trajectories(to(asked, out, layouts=THIRTY)).exit_code == 0
    return out
