"""What a task needs of code comes to a node by Ray's ``runtime_env``, also to a second raylet."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

SCRIPT = """
import sys
from pathlib import Path
import ray
from ray.cluster_utils import Cluster
sys.path.insert(0, sys.argv[1])
import shipped
from factory.run import run
from factory.store import LocalStore
from factory.ray_executor import RayExecutor

cluster = Cluster(initialize_head=True, head_node_args={"num_cpus": 0, "include_dashboard": False})
cluster.add_node(num_cpus=1)
init = {"runtime_env": {sys.argv[2]: sys.argv[1] if sys.argv[2] == "working_dir" else [sys.argv[1] + "/shipped"]}}
if sys.argv[2] == "nothing":
    init = {}
from schemas.errors import CondVLNError
try:
    with RayExecutor(address=cluster.address, init=init) as executor:
        report = run(shipped.pipeline(), shipped.units(), LocalStore(sys.argv[3]), executor=executor)
        print("exit", report.exit_code, report.snapshot_id)
except CondVLNError as error:
    print("error", error)
"""

STAGES = """
import toys

def pipeline():
    return toys.pipeline(Here())

def units():
    return toys.units(6)

class Here(toys.Count):
    pass
"""


@pytest.mark.ray
@pytest.mark.soak
@pytest.mark.parametrize("way", ["working_dir", "py_modules", "nothing"])
def test_a_second_raylet_gets_the_code_of_the_stages(way: str, tmp_path: Path) -> None:
    """The package is on no path that Ray's processes inherit: without ``runtime_env`` the run ends with a word."""
    (tmp_path / "code" / "shipped").mkdir(parents=True)
    (tmp_path / "code" / "shipped" / "__init__.py").write_text(STAGES)
    (tmp_path / "run").mkdir()
    done = subprocess.run(
        [sys.executable, "-c", SCRIPT, str(tmp_path / "code"), way, str(tmp_path / "store")],
        cwd=tmp_path / "run", capture_output=True, text=True, timeout=200, check=False, env=dict(os.environ),
    )  # fmt: skip
    last = done.stdout.strip().splitlines()[-1] if done.stdout.strip() else done.stderr[-2000:]
    if way == "nothing":
        assert last.startswith("error worker node ")
        assert "No module named 'shipped'" in last
        assert "ray.runtime_env" in last
    else:
        assert last.startswith("exit 0 "), done.stderr[-2000:]
