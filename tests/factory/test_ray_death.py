"""Ray's node dies while units are under way: the driver ends, and the next run goes on."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest
import toys

from factory.run import run
from factory.store import LocalStore

HERE = Path(__file__).parent

pytestmark = [pytest.mark.ray, pytest.mark.soak]


@pytest.mark.parametrize("part", ["raylet", "gcs_server"])
def test_the_next_run_goes_on(part: str, tmp_path: Path) -> None:
    """Ray itself may end the driver, past every handler of Python; its exit code is not 0 then."""
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(HERE), str(HERE.parents[1])])}
    victim = subprocess.run(
        [sys.executable, str(HERE / "ray_victim.py"), str(tmp_path / "store"), part],
        env=environment,
        capture_output=True,
        text=True,
        timeout=400,
        check=False,
    )
    assert victim.returncode not in (0, None), victim.stderr
    # What was committed stays: the next run finds it, and publishes what a run without a fault does.
    units = [toys.unit(f"a/{n:02d}", seconds=0.3) for n in range(40)]
    store = LocalStore(tmp_path / "store", durable=False)
    after = run(toys.pipeline(), units, store)
    assert after.exit_code == 0
    assert after.stages["count"] == 0, "the first pass was over"
    assert after.stages["square"] <= 40 - 3
    other = LocalStore(tmp_path / "other", durable=False)
    plain = [toys.unit(f"a/{n:02d}") for n in range(40)]
    assert run(toys.pipeline(), plain, other).snapshot_id == after.snapshot_id
