"""What must not change a build, and what must change it in a known way."""

from __future__ import annotations

import hashlib
import os
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from condvln.navigation.recast import build_navmesh
from condvln.navigation.settings import NavMeshSettings

# Cells that float32 holds exactly, so that a shift by whole cells rounds nothing.
BINARY = NavMeshSettings(cell_size=0.0625, cell_height=0.25, agent_max_climb=0.25)


def furnished(join, plate, box):
    """A room of 4.5 m x 3.5 m with a table, a wall with a door and a step; no face on a cell's border."""
    return join(
        plate(0, 0, 4.5, 3.5),
        box([1.03, 0.1, 1.03], [1.97, 0.79, 1.59]),
        box([2.53, 0, 0.03], [2.65, 2.6, 1.9]),
        box([2.53, 0, 2.84], [2.65, 2.6, 3.47]),
        box([3.53, 0.02, 0.53], [4.22, 0.2, 2.47]),
    )


@given(dx=st.integers(-4096, 4096), dy=st.integers(-512, 512), dz=st.integers(-4096, 4096))
def test_a_shift_by_whole_cells_shifts_the_mesh(join, plate, box, dx: int, dy: int, dz: int) -> None:
    vertices, faces = furnished(join, plate, box)
    vertices = np.round(vertices * 1024).astype(np.float32) / np.float32(1024)
    shift = np.array([dx, dy, dz], np.float32) * np.array([0.0625, 0.25, 0.0625], np.float32)
    here, there = (build_navmesh(points, faces, BINARY).tile for points in (vertices, vertices + shift))
    np.testing.assert_array_equal(here.verts + shift, there.verts)
    for part in ("polys", "detail_tris", "bv_nodes", "links"):
        np.testing.assert_array_equal(getattr(here, part), getattr(there, part))


@pytest.mark.costly
@given(seed=st.integers(0, 2**32 - 1))
def test_how_vertices_are_stored_does_not_matter(join, plate, box, seed: int) -> None:
    vertices, faces = furnished(join, plate, box)
    expected = build_navmesh(vertices, faces).to_bytes()
    assert (
        build_navmesh(vertices[faces].reshape(-1, 3), np.arange(3 * len(faces)).reshape(-1, 3)).to_bytes() == expected
    )
    order = np.random.default_rng(seed).permutation(len(vertices))
    assert build_navmesh(vertices[order], np.argsort(order)[faces]).to_bytes() == expected
    assert build_navmesh(vertices.astype(np.float64), faces.astype(np.uint64)).to_bytes() == expected


def test_inputs_are_left_alone(join, plate, box) -> None:
    vertices, faces = furnished(join, plate, box)
    vertices.flags.writeable = faces.flags.writeable = False
    assert build_navmesh(vertices, faces).to_bytes() == build_navmesh(vertices.copy(), faces.copy()).to_bytes()


@pytest.mark.parametrize("at", [[1.0, 0.0, 3.0], [3.0, 0.0, 3.0]])
def test_degenerate_triangles_on_the_floor_change_nothing(join, plate, box, at: list[float]) -> None:
    vertices, faces = furnished(join, plate, box)
    point = np.array([at, at, at, np.add(at, [0.5, 0, 0])], np.float32)
    degenerate = np.array([[0, 1, 2], [0, 1, 3], [3, 3, 3]], np.int32)
    more = join((vertices, faces), (point, degenerate))
    assert build_navmesh(*more).to_bytes() == build_navmesh(vertices, faces).to_bytes()


PROGRAM = """
import hashlib, sys
import numpy as np
from condvln.navigation.recast import build_navmesh
with np.load(sys.argv[1]) as mesh:
    print(hashlib.sha256(build_navmesh(mesh["vertices"], mesh["faces"]).to_bytes()).hexdigest())
"""


def test_processes_and_threads_agree(join, plate, box, tmp_path: Path) -> None:
    vertices, faces = furnished(join, plate, box)
    np.savez(tmp_path / "mesh.npz", vertices=vertices, faces=faces)
    expected = hashlib.sha256(build_navmesh(vertices, faces).to_bytes()).hexdigest()
    for seed in ("0", "1"):
        command = [sys.executable, "-c", PROGRAM, str(tmp_path / "mesh.npz")]
        environment = {**os.environ, "PYTHONHASHSEED": seed}
        printed = subprocess.run(command, env=environment, capture_output=True, text=True, check=True).stdout
        assert printed.strip() == expected
    with ThreadPoolExecutor(8) as pool:
        built = pool.map(lambda _: build_navmesh(vertices, faces).to_bytes(), range(32))
        assert {hashlib.sha256(data).hexdigest() for data in built} == {expected}
