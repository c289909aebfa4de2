"""The example of an agent that learns: walks are recorded, a network is trained, and it walks (``make agents``)."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from condvln.evaluation.split import Export

ROOT = Path(__file__).parents[3]
EXAMPLE = ROOT / "examples" / "learned_agent"


def run(*arguments: str, **variables: str) -> str:
    """Run Python in the top folder of the repository, as a user does, and return what it printed."""
    environment = {**os.environ, "PYTHONPATH": str(ROOT), **variables}
    done = subprocess.run(
        [sys.executable, *arguments], cwd=ROOT, env=environment, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def test_a_network_learns_and_walks(made: tuple[Export, Path], tmp_path: Path) -> None:
    """The loss falls, a stopped training goes on, and `condvln walk` writes a walk of each episode."""
    pytest.importorskip("torch", reason="torch is absent: make agents installs its CPU build")
    export, dataset = made
    walks, net = tmp_path / "walks.pt", tmp_path / "net"
    told = run(
        str(EXAMPLE / "record.py"), "--kind", "looking", "--out", str(walks), f"{export.folder}={dataset}"
    ).splitlines()[-1]
    assert json.loads(told)["walks"] > 5
    train = [str(EXAMPLE / "train.py"), str(walks), "--out", str(net), "--epochs"]
    run(*train, "30", "--until", "20")
    assert "goes on after epoch 20" in run(*train, "30")
    log = json.loads((net / "log.json").read_text())
    assert [row["epoch"] for row in log] == [*range(1, 31)]
    assert log[-1]["loss"] < 0.9 * log[0]["loss"]

    predictions = tmp_path / "learned.json"
    walk = "from jobs.command import main; main()"
    run(
        *("-c", walk, "walk", str(export.folder), "train", "--agent", "examples.learned_agent.agent:Agent"),
        *("--data", f"replicacad={dataset}", "--out", str(predictions)),
        LEARNED_AGENT=str(net / "checkpoint.pt"),
        LEARNED_AGENT_EYES=f"{export.folder}={dataset}",
    )
    walked = json.loads(predictions.read_text())
    assert set(walked) == {task.episode_id for task in export.tasks("train")}
    assert all(len(poses) > 1 for poses in walked.values())
