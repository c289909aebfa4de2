"""A disk that is full: one error that names the file, nothing half-written, and the next run succeeds."""

from __future__ import annotations

import resource
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from jobs.demo import write_samples
from jobs.navmesh import picture
from jobs.query import query_target
from jobs.report import Report
from jobs.show import show_episodes
from jobs.workspace import Target
from schemas.config import Config
from schemas.errors import StoreError, UsageError


@contextmanager
def files_of_at_most(size: int) -> Iterator[None]:
    """No file may grow beyond `size` bytes, as if the disk were full then."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


def pictures(config: Config, out: Path) -> object:
    return show_episodes(config, sample=1, picture=out)


def samples(_config: Config, out: Path) -> object:
    return write_samples(out, family="procthor", scenes=1, seed=0)


def rows(suffix: str) -> Callable[[Config, Path], object]:
    sql = "SELECT scene_id, object_id, label FROM objects"
    return lambda config, out: query_target(Target(config.store, config.name, config), sql, out=out / f"rows{suffix}")


def navmesh(config: Config, out: Path) -> object:
    file = min(config.sources[0].root.glob("navmeshes/*.navmesh"))
    return picture(file, out / "navmesh.png")


@pytest.mark.parametrize(
    "write", [pictures, samples, navmesh, rows(".parquet"), rows(".csv"), rows(".jsonl")], ids=lambda f: f.__qualname__
)
def test_what_does_not_fit_is_named_and_not_left_half_written(
    write: Callable[[Config, Path], object], made_run: tuple[Config, Report], tmp_path: Path
) -> None:
    config, _ = made_run
    out = tmp_path / "out"
    write(config, tmp_path / "whole")
    with files_of_at_most(500), pytest.raises(StoreError, match=r"can.t be written: .*File too large"):
        write(config, out)
    whole = {path.relative_to(tmp_path / "whole"): path.read_bytes() for path in files_below(tmp_path / "whole")}
    for path in files_below(out):
        assert path.read_bytes() == whole[path.relative_to(out)]
    write(config, out)
    assert {path.relative_to(out) for path in files_below(out)} == whole.keys()


def files_below(folder: Path) -> list[Path]:
    return [path for path in sorted(folder.rglob("*")) if path.is_file()]


def test_output_that_can_not_be_written_is_one_message(tmp_path: Path) -> None:
    words = ["demo", "--family", "replicacad", "--out", str(tmp_path), "--scenes", "1"]
    with open("/dev/full", "wb") as full:
        run = subprocess.run(
            [sys.executable, "-c", "from jobs.command import main; main()", *words],
            stdout=full,
            stderr=subprocess.PIPE,
            text=True,
            check=False,
        )
    assert run.returncode != 0
    assert "No space left on device" in run.stderr
    assert "Traceback" not in run.stderr


def test_a_format_that_pictures_do_not_have_is_refused(made_run: tuple[Config, Report], tmp_path: Path) -> None:
    file = min(made_run[0].sources[0].root.glob("navmeshes/*.navmesh"))
    with pytest.raises(UsageError, match=r"'\.xyz' is not a format of pictures"):
        picture(file, tmp_path / "navmesh.xyz")
