"""A first answer waits for numpy and numba, and for no library that it has no use for."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from condvln.navigation.navmesh_file import NavMeshFile, write_navmesh
from condvln.navigation.pathfinder import Pathfinder

HEAVY = {"matplotlib", "pandas", "pyarrow", "ray", "duckdb", "trimesh", "fcl", "networkx", "shapely"}
"""Each of them takes a tenth of a second or more to load."""

STARTS = {
    "a first query": "from condvln import Pathfinder; Pathfinder.load(path).find_path([1, 0, 1], [1, 0, 3])",
    "condvln navmesh info": "from pathlib import Path; from jobs.navmesh import info; info(Path(path))",
}


@pytest.mark.parametrize("start", sorted(STARTS))
def test_nothing_heavy_is_loaded(start: str, l_shape: Pathfinder, tmp_path: Path) -> None:
    path = tmp_path / "l.navmesh"
    write_navmesh(path, NavMeshFile.of_tile(l_shape.navmesh.tile, l_shape.settings))
    code = f"import sys; path = {str(path)!r}; {STARTS[start]}; print(*{{m.partition('.')[0] for m in sys.modules}})"
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    loaded = set(run.stdout.split())
    assert "numba" in loaded
    assert not loaded & HEAVY
