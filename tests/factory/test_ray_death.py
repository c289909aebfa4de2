"""Ray's node dies while units are under way: the driver ends with an error of ours, and the next run goes on."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest
import toys

from factory import LocalStore, run
from factory.ray_guard import COMMITTED, Guard

HERE = Path(__file__).parent

pytestmark = pytest.mark.ray


@pytest.mark.parametrize(
    "part",
    [
        "ray::DashboardAgent",
        pytest.param("raylet", marks=pytest.mark.soak),
        pytest.param("gcs_server", marks=pytest.mark.soak),
    ],
)
def test_the_last_word_is_ours(part: str, tmp_path: Path) -> None:
    """Of the three, the agent's death is the hardest: Ray ends the driver within milliseconds."""
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
    last = victim.stderr.strip().splitlines()[-1]
    assert last.startswith("condvln: Ray died while units were under way"), victim.stderr[-2000:]
    assert COMMITTED in last
    assert "Run the same command again" in last
    assert "Traceback" not in victim.stderr
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


@pytest.mark.parametrize("way", ["goodbye", "exit", "raise", "killed"])
def test_the_guard_speaks_only_for_who_cannot(way: str, tmp_path: Path) -> None:
    (tmp_path / "raylet.out").write_text(
        "[2026-11-22 08:35:25,819 E 31432 31476] (raylet) agent_manager.cc:87: The raylet exited immediately "
        "because one Ray agent failed, agent_name = dashboard_agent.\nThe raylet fate shares with the agent.\n"
    )
    end = {
        "goodbye": "guard.end()",
        "exit": "raise SystemExit(3)",
        "raise": "raise ValueError",
        "killed": "import os; os._exit(1)",
    }[way]
    code = f"from factory.ray_guard import Guard; guard = Guard({str(tmp_path)!r}); guard.done(7); {end}"
    found = subprocess.run(
        [sys.executable, "-c", code], cwd=HERE.parents[1], capture_output=True, text=True, timeout=60, check=False
    )
    spoke = "Ray died" in found.stderr
    assert spoke == (way == "killed")
    if spoke:
        assert (
            "The raylet exited immediately because one Ray agent failed, agent_name = dashboard_agent." in found.stderr
        )
        assert f"7 units of this pass were done; {COMMITTED}" in found.stderr
        assert str(tmp_path) in found.stderr


def test_a_guard_that_cannot_start_costs_nothing(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(sys, "executable", str(tmp_path / "nothing"))
    guard = Guard("")
    guard.done(3)
    guard.end()
