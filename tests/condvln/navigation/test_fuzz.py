"""Hostile navmeshes: a damaged file is refused with our error or is read in full, and what is read can be queried.

Kernels check no index, so a file that parses must not be able to lead one astray. The soak run repeats all this with
numba's bounds checks compiled in.
"""

from __future__ import annotations

import os
import resource
import subprocess
import sys
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from condvln.navigation.follower import Follower
from condvln.navigation.navmesh_file import NavMeshFile, parse_navmesh
from condvln.navigation.pathfinder import Pathfinder
from condvln.navigation.polygon_tile import tile_of_polygons
from condvln.navigation.settings import NavMeshSettings
from condvln.navigation.tile import NavMeshTile
from schemas.errors import FormatError, InputError

SAMPLE, SOAK = 800, 4_000
MAX_GROWTH = 400 * 1024  # kilobytes of memory that a whole run may add
INSIDE = "CONDVLN_FUZZ_INSIDE"

NASTY_INTEGERS = np.array([0, 1, -1, 2, 127, 128, 255, 256, 65535, 65536, 2**31 - 1, -(2**31)], np.int64)
NASTY_FLOATS = np.array([0, -0.0, 1e-40, 1e-5, -1e5, 9e5, 1e6, -1e7, 3e38, np.inf, -np.inf, np.nan], np.float32)


def sound_file() -> NavMeshFile:
    """A floor of 36 squares with steps in it and two islands: every section of the format is filled."""
    grid = [[x, 0.15 * ((x * z) % 3), z] for z in range(7) for x in range(7)]
    squares = [[7 * z + x, 7 * z + x + 1, 7 * z + x + 8, 7 * z + x + 7] for z in range(6) for x in range(6) if x != 3]
    return NavMeshFile.of_tile(tile_of_polygons(grid, squares), NavMeshSettings())


def damaged(data: bytes, rng: np.random.Generator) -> bytes:
    """``data`` with one to six faults."""
    for _ in range(rng.integers(1, 7)):
        if len(data) < 8:
            return data
        at = int(rng.integers(0, len(data) - 4))
        aligned = at // 4 * 4
        kind = rng.integers(0, 9)
        if kind == 0:
            data = data[:at]
        elif kind == 1:
            data = data[:at] + bytes(rng.integers(0, 256, rng.integers(1, 40), np.uint8)) + data[at:]
        elif kind == 2:
            data = data[:at] + data[at + int(rng.integers(1, 40)) :]
        elif kind <= 4:
            number = np.int64(rng.choice(NASTY_INTEGERS)).astype(np.int32)
            data = data[:aligned] + number.tobytes() + data[aligned + 4 :]
        elif kind <= 6:
            data = data[:aligned] + np.float32(rng.choice(NASTY_FLOATS)).tobytes() + data[aligned + 4 :]
        else:
            data = data[:at] + bytes([rng.integers(0, 256)]) + data[at + 1 :]
    return data


def absurd(tile: NavMeshTile, rng: np.random.Generator) -> NavMeshTile:
    """A tile of the right form with no sense in it: any index that is allowed, anywhere."""
    polys, details, tris, nodes = tile.polys.copy(), tile.detail_meshes, tile.detail_tris.copy(), tile.bv_nodes.copy()
    count = len(polys)
    verts = (tile.verts + rng.normal(0, rng.choice([0, 0.1, 3, 1e4]), tile.verts.shape)).astype(np.float32)
    some = rng.random((count, 6)) < 0.3
    polys["verts"][some] = rng.integers(0, len(verts), some.sum())
    some = rng.random((count, 6)) < 0.3
    # no more neighbours than there are links
    polys["neis"][some] = np.where(polys["neis"][some] > 0, rng.integers(0, count + 1, some.sum()), 0)
    polys["flags"][rng.random(count) < 0.1] = 4
    limit = np.repeat(polys["vert_count"], details["tri_count"])
    some_tris = rng.random(len(tris)) < 0.3
    tris[some_tris, :3] = rng.integers(0, limit[some_tris][:, None], (some_tris.sum(), 3))
    tris[:, 3] = rng.integers(0, 256, len(tris))
    some_nodes = rng.random(len(nodes)) < 0.2
    nodes["i"][some_nodes] = rng.integers(-(2**31), count, some_nodes.sum())
    return tile.with_parts(verts=verts, polys=polys, detail_tris=tris, bv_nodes=nodes)


def query_everything(pathfinder: Pathfinder, rng: np.random.Generator) -> None:
    """Each kind of query, on points in and around the mesh. What comes back must make sense."""
    low, high = pathfinder.bounds
    points = rng.uniform(low - 1, np.minimum(high, low + 50) + 1, (6, 3))
    points[0] = rng.choice(NASTY_FLOATS, 3)
    vertices = pathfinder.navmesh.tile.verts
    points[1:3] = vertices[rng.integers(0, len(vertices), 2)]
    table = pathfinder.distance_table(points, points)
    assert not np.isnan(table).any()
    assert (table >= 0).all()
    for path in pathfinder.find_paths(points[:3], points[3:]):
        assert path.found == (len(path.points) > 0)
        assert np.isfinite(path.points).all()
    islands = pathfinder.get_islands(points)
    both = pathfinder.snap_to_islands(points)
    np.testing.assert_array_equal(both[0], pathfinder.snap_points(points))
    np.testing.assert_array_equal(both[1], islands)
    assert ((islands >= -1) & (islands < pathfinder.num_islands)).all()
    snapped = pathfinder.snap_points(points)
    assert (np.isnan(snapped).any(axis=1) == (islands < 0)).all()
    for sliding in (True, False):
        pathfinder.try_steps(points[:3], points[:3] + 0.25, sliding)
        Follower(pathfinder, sliding=sliding, max_actions=60).follow(points[4], 0.3, points[5])
    assert pathfinder.distance_to_closest_obstacle(points[4]) >= 0
    with suppress(InputError):  # a mesh without floor, or of slivers, says so
        pathfinder.get_random_navigable_points(3, rng)
    assert pathfinder.navigable_area >= 0


def hostile_files(count: int, seed: int) -> Iterator[tuple[bytes, np.random.Generator]]:
    sound = sound_file()
    for number in range(count):
        rng = np.random.default_rng([seed, number])
        data = NavMeshFile.of_tile(absurd(sound.tile, rng), NavMeshSettings()).to_bytes() if number % 4 == 0 else None
        yield damaged(sound.to_bytes(), rng) if data is None else data, rng


def survive(count: int, seed: int) -> tuple[int, int]:
    """Read and query hostile files; how many were refused, how many read."""
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    refused = read = 0
    for data, rng in hostile_files(count, seed):
        try:
            navmesh = parse_navmesh(data)
        except FormatError:
            refused += 1
            continue
        assert navmesh.to_bytes() == data
        query_everything(Pathfinder(navmesh), rng)
        read += 1
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < MAX_GROWTH
    return refused, read


def test_hostile_files_are_refused_or_safe() -> None:
    refused, read = survive(SAMPLE, seed=1)
    assert refused > SAMPLE // 10  # both ways out were taken often
    assert read > SAMPLE // 10


@given(st.binary(max_size=400))
def test_random_bytes_are_refused(data: bytes) -> None:
    with pytest.raises(FormatError):
        parse_navmesh(data)


@given(st.binary(max_size=400))
def test_random_bytes_after_a_sound_beginning_are_refused(data: bytes) -> None:
    with pytest.raises(FormatError):
        parse_navmesh(sound_file().to_bytes()[:204] + data)


@pytest.mark.soak
@pytest.mark.skipif(INSIDE in os.environ, reason="the outer run does this")
def test_many_hostile_files_are_refused_or_safe() -> None:
    refused, read = survive(SOAK, seed=2)
    assert refused + read == SOAK


@pytest.mark.soak
@pytest.mark.skipif(INSIDE in os.environ, reason="this is that run")
def test_no_kernel_reads_out_of_bounds(tmp_path: Path) -> None:
    """The sample again, and the real and golden meshes' tests, with bounds checks in every kernel."""
    environment = os.environ | {"NUMBA_BOUNDSCHECK": "1", "NUMBA_CACHE_DIR": str(tmp_path), INSIDE: "1"}
    here = Path(__file__).parent
    files = [here / f"test_{name}.py" for name in ("fuzz", "golden_queries", "pathfinder", "follower")]
    command = [sys.executable, "-m", "pytest", "-q", "-x", "-m", "not soak", "-p", "no:cacheprovider", *map(str, files)]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout[-4000:]
