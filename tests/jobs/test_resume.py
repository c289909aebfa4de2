"""A driver killed mid-run: what was committed stays, the rest is redone, and the snapshot is the same one."""

from __future__ import annotations

import subprocess
import sys
import time
from pathlib import Path

import duckdb
import pytest
import yaml

from condvln.samples import make_samples
from jobs.configuration import load_config
from jobs.generate import run_generate
from tests.ending import kill_driver

# Workers of Ray end what they have at hand after the driver is gone, so most scenes must still be waiting then.
SCENES = {"inline": 3, "ray": 12}


def written(folder: Path, root: Path, name: str) -> Path:
    path = folder / f"{name}.yaml"
    document = {
        "name": "made",
        "store": f"{name}-store",
        "sources": [{"family": "replicacad", "root": str(root)}],
        "instructions": {"per_category": {"simple": 2, "chain": 2}},
        "ray": {"workers": 2},
    }
    path.write_text(yaml.safe_dump(document))
    return path


def committed(folder: Path, name: str) -> int:
    return len(list((folder / f"{name}-store" / "units" / "text").glob("*/*/unit.json")))


@pytest.mark.parametrize(
    "way", [pytest.param("inline"), pytest.param("ray", marks=[pytest.mark.ray, pytest.mark.soak])]
)
def test_killed_driver(way: str, tmp_path: Path) -> None:
    scenes = SCENES[way]
    make_samples(tmp_path / "data", family="replicacad", scenes=scenes, seed=11)
    clean = run_generate(load_config(written(tmp_path, tmp_path / "data", "clean"), environment={}), inline=True)
    assert clean.exit_code == 0
    path = written(tmp_path, tmp_path / "data", "killed")
    command = [sys.executable, "-c", "from jobs.command import main; main()", "generate", str(path)]
    with subprocess.Popen(
        command + (["--inline"] if way == "inline" else []), stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
    ) as driver:
        deadline = time.monotonic() + 120
        while committed(tmp_path, "killed") < 1 and time.monotonic() < deadline:
            time.sleep(0.005)
        kill_driver(driver)
    before = committed(tmp_path, "killed")
    assert 1 <= before < scenes, "the kill came in time"
    assert not (tmp_path / "killed-store" / "refs").exists() or not list((tmp_path / "killed-store" / "refs").iterdir())
    # What is committed is there for any tool, although nothing is published.
    tables = tmp_path / "killed-store" / "units" / "**" / "relations.parquet"
    (row,) = duckdb.sql(f"SELECT count(*), count(DISTINCT scene_id) FROM '{tables}'").fetchall()
    assert row[0] > 0
    assert 1 <= row[1] <= scenes
    again = run_generate(load_config(path, environment={}), inline=True)
    assert again.exit_code == 0
    assert again.document["snapshot_id"] == clean.document["snapshot_id"]
    assert again.document["stages"]["text"] == scenes - before, "only what was not committed is redone"
    assert again.document["counts"]["reused"] >= before
