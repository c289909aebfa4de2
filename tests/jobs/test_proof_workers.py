"""A proof that is shared out over Ray workers says what one process says."""

from __future__ import annotations

import gzip
import shutil
from collections.abc import Iterator
from pathlib import Path

import pytest

from condvln.export.contents import CERTIFICATES
from factory.ray_executor import RayExecutor
from jobs.report import Report
from jobs.verify import verify_export
from schemas.config import Config


@pytest.fixture(scope="module")
def ray() -> Iterator[None]:
    """A Ray that all proofs here use."""
    with RayExecutor(workers=2) as executor:
        executor.start()
        yield


@pytest.fixture(scope="module")
def made(export: Path, made_run: tuple[Config, Report]) -> tuple[Config, Path]:
    return made_run[0], export


def both(config: Config, folder: Path, tmp_path: Path) -> list[tuple[Report, dict[str, bytes]]]:
    """Return the reports and certificates of one process, and of two workers."""
    found = []
    for workers in (1, 2):
        own = Path(shutil.copytree(folder, tmp_path / str(workers)))
        report = verify_export(config, own, workers=workers)
        kept = {path.name: path.read_bytes() for path in (own / CERTIFICATES).iterdir()}
        found.append((report, kept))
    return found


@pytest.mark.ray
@pytest.mark.usefixtures("ray")
def test_two_workers_write_the_same_certificates(made: tuple[Config, Path], tmp_path: Path) -> None:
    (one, its), (two, others) = both(*made, tmp_path)
    assert one.exit_code == two.exit_code == 0
    assert one.document == two.document
    assert its == others
    assert len(its) > 1


@pytest.mark.ray
@pytest.mark.usefixtures("ray")
def test_two_workers_find_the_same_faults(made: tuple[Config, Path], tmp_path: Path) -> None:
    """A text that says something else, an episode that is there twice, a record without a row."""
    config, whole = made
    folder = Path(shutil.copytree(whole, tmp_path / "folder"))
    manifest = max(folder.glob("manifest/*.jsonl"), key=lambda path: path.stat().st_size)
    lines = manifest.read_bytes().splitlines(keepends=True)
    lines[0] = lines[0].replace(b" is ", b" isn't ", 1).replace(b"there's a", b"there's no", 1)
    manifest.write_bytes(b"".join([*lines[:-1], lines[1]]))
    (one, its), (two, others) = both(config, folder, tmp_path)
    assert one.exit_code == two.exit_code == 3
    assert one.lines[:-1] == two.lines[:-1]  # the last one names the folder
    assert its == others


@pytest.mark.ray
@pytest.mark.usefixtures("ray")
def test_two_workers_refuse_the_same_export(made: tuple[Config, Path], tmp_path: Path) -> None:
    config, whole = made
    folder = Path(shutil.copytree(whole, tmp_path / "folder"))
    truths = max(folder.glob("vlnce/*/*_gt.json.gz"), key=lambda path: path.stat().st_size)
    truths.write_bytes(gzip.compress(gzip.decompress(truths.read_bytes())[:-9]))
    (one, _), (two, _) = both(config, folder, tmp_path)
    assert one.exit_code == two.exit_code == 3
    assert one.document["faults"] == two.document["faults"]
