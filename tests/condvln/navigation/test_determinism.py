"""Answers are the same in every thread and in every process, whatever its hash seed."""

from __future__ import annotations

import hashlib
import os
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest

from condvln.navigation.follower import Follower
from condvln.navigation.navmesh_file import write_navmesh
from condvln.navigation.pathfinder import Pathfinder
from condvln.navigation.settings import NavMeshSettings
from condvln.samples import make_layout
from tests.condvln.voxelised import voxelised

PROGRAM = """
import sys
sys.path.insert(0, sys.argv[2])
from test_determinism import digest
from condvln.navigation.pathfinder import Pathfinder
print(digest(Pathfinder.load(sys.argv[1]), int(sys.argv[3])))
"""


@pytest.fixture(scope="module")
def navmesh(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A made apartment with islands on its furniture, as a file."""
    path = tmp_path_factory.mktemp("navmesh") / "made.navmesh"
    write_navmesh(path, voxelised(make_layout(4, 5), NavMeshSettings(include_static_objects=True)))
    return path


def digest(pathfinder: Pathfinder, seed: int) -> str:
    """One hash over the bytes of all kinds of answers, to questions drawn from `seed`."""
    rng = np.random.default_rng(seed)
    low, high = pathfinder.bounds
    # On the floor, off it, above it.
    starts = np.concatenate([pathfinder.get_random_navigable_points(40, seed), rng.uniform(low - 1, high + 1, (20, 3))])
    ends = rng.permutation(starts)
    paths = pathfinder.find_paths(starts, ends)
    single = [pathfinder.find_path(a, b) for a, b in zip(starts, ends, strict=True)]
    multi = [pathfinder.find_multi_goal_path(point, ends[:7]) for point in starts[:10]]
    answers = [
        starts,
        pathfinder.snap_points(starts),
        pathfinder.get_islands(starts),
        pathfinder.are_navigable(starts),
        pathfinder.geodesic_distances(starts, ends),
        pathfinder.distance_table(starts[:20], ends[:20]),
        pathfinder.try_steps(starts, starts + np.float32(0.2)),
        pathfinder.try_steps(starts, starts + np.float32(0.2), sliding=False),
        np.array([pathfinder.distance_to_closest_obstacle(point) for point in starts[:40]]),
        pathfinder.get_topdown_view(0.1, float(low[1]) + 0.2),
        *(path.points for path in [*paths, *single, *multi]),
        np.array([path.geodesic_distance for path in [*paths, *single, *multi]]),
    ]
    reached = [pair for pair, path in zip(zip(starts, ends, strict=True), single, strict=True) if path.found][:5]
    follower = Follower(pathfinder)
    answers += [np.array(follower.follow(a, 0.0, b).actions) for a, b in reached]
    assert len(reached) == 5
    found = hashlib.sha256()
    for answer in answers:
        found.update(f"{answer.dtype} {answer.shape} ".encode() + np.ascontiguousarray(answer).tobytes())
    return found.hexdigest()


def test_processes_agree(navmesh: Path) -> None:
    expected = digest(Pathfinder.load(navmesh), 1)
    assert digest(Pathfinder.load(navmesh), 2) != expected
    for hash_seed in ("0", "77"):
        command = [sys.executable, "-c", PROGRAM, str(navmesh), str(Path(__file__).parent), "1"]
        environment = {**os.environ, "PYTHONHASHSEED": hash_seed}
        printed = subprocess.run(command, env=environment, capture_output=True, text=True, check=True).stdout
        assert printed.strip() == expected


def test_threads_share_one_pathfinder(navmesh: Path) -> None:
    """Different questions at one time: scratch memory that two threads shared would mix them up."""
    alone = [digest(Pathfinder.load(navmesh), seed) for seed in range(4)]
    shared = Pathfinder.load(navmesh)
    with ThreadPoolExecutor(4) as threads:
        together = list(threads.map(lambda k: digest(shared, k % 4), range(16)))
    assert together == alone * 4
