"""Navmesh builds: seconds compared with Recast & Detour in C++, time by stage, and the cost of compiling.

Times are processor seconds of the one thread that builds, as the machine may be shared. Run as
``python -m benchmarks navmesh_build``. The meshes are those of the golden builds where the real data is there
(CONDVLN_REAL_DATA, or ``shared/data`` beside the checkout), and each result is compared with its golden file; else made
rooms.
"""

from __future__ import annotations

import os
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from condvln.navigation.navmesh_file import NavMeshFile, read_navmesh
from condvln.navigation.recast.builder import build_navmesh
from condvln.navigation.recast.config import RecastProfile
from condvln.navigation.settings import NavMeshSettings

CPP_SECONDS = (0.01, 0.08)
"""Seconds of one build by Recast & Detour in C++, least and most over the golden meshes (measured on another
machine)."""

AIM = 3.0
"""Target: a build takes at most this many times the C++ figure."""

ROUNDS = 5
"""Number of builds of each mesh; the fastest counts, since other work on the machine only slows them down."""

MADE_ROOMS = 8

_PILLAR = [[x, y, z] for y in (0, 2) for x, z in ((0.85, -0.05), (0.85, 0.05), (0.95, 0.05), (0.95, -0.05))]
PILLARED_ROOM = (
    np.array([[-1.5, 0, -1.5], [-1.5, 0, 1.5], [1.5, 0, 1.5], [1.5, 0, -1.5], *_PILLAR], np.float32),
    np.array([[0, 1, 2], [0, 2, 3], *([4 + k, 4 + (k + 1) % 4, 8 + (k + 1) % 4] for k in range(4))], np.int32),
)
"""A floor with a pillar that makes a hole in a region, so that every kernel of a build is called."""

START = (
    "import time; t = time.process_time();"
    "from benchmarks.navmesh_build import PILLARED_ROOM, build_navmesh; a = time.process_time();"
    "build_navmesh(*PILLARED_ROOM); print(a - t, time.process_time() - a)"
)
"""Code that a fresh process runs to be ready for any build; prints seconds of importing, and of compiling or
loading."""


@dataclass(frozen=True)
class Case:
    """A mesh to build; ``golden`` is the navmesh that Habitat built of it."""

    name: str
    vertices: npt.NDArray[np.float32]
    faces: npt.NDArray[np.int32]
    settings: NavMeshSettings
    golden: NavMeshFile | None = None


def cases() -> Iterator[Case]:
    """Return the golden meshes, or made ones."""
    data = os.environ.get("CONDVLN_REAL_DATA", Path(__file__).resolve().parents[2] / "shared" / "data")
    meshes = sorted((Path(data) / "navmesh_golden" / "build").glob("*.npz"))
    for file in meshes:
        if ".stages" not in file.name:
            golden = read_navmesh(file.with_suffix(".navmesh"))
            with np.load(file) as arrays:
                yield Case(file.stem, arrays["vertices"], arrays["faces"], golden.known_settings, golden)
    if not meshes:
        for seed in range(MADE_ROOMS):
            yield made_room(seed)


def made_room(seed: int) -> Case:
    """A floor of 12 m x 9 m with 60 boxes on it."""
    rng = np.random.default_rng(seed)
    corner = np.array([[i & 1, i >> 1 & 1, i >> 2 & 1] for i in range(8)])
    quads = [(0, 4, 6, 2), (1, 3, 7, 5), (0, 1, 5, 4), (2, 6, 7, 3), (0, 2, 3, 1), (4, 5, 7, 6)]
    triangles = np.array([t for a, b, c, d in quads for t in ((a, b, c), (a, c, d))])
    sizes = np.concatenate([[[12.0, 0.1, 9.0]], rng.uniform([0.2, 0.3, 0.2], [1.5, 2.0, 1.5], (60, 3))])
    places = np.concatenate([[[0.0, -0.1, 0.0]], rng.uniform([0, 0, 0], [10.5, 0, 7.5], (60, 3))])
    vertices = (places[:, None] + corner * sizes[:, None]).reshape(-1, 3).astype(np.float32)
    faces = (triangles + 8 * np.arange(61)[:, None, None]).reshape(-1, 3).astype(np.int32)
    return Case(f"made-{seed}", vertices, faces, NavMeshSettings())


def measure(case: Case) -> tuple[float, dict[str, float], str]:
    """Return the seconds of the fastest of ROUNDS builds, the fastest of each stage, and the result."""
    best, stages = np.inf, dict[str, float]()
    note = ""
    for _ in range(ROUNDS):
        marks: list[tuple[str, float]] = []
        built = build_navmesh(
            case.vertices,
            case.faces,
            case.settings,
            RecastProfile.HABITAT_0_3_4,
            report=lambda stage, marks=marks: marks.append((stage, time.process_time())),
        )
        end = time.process_time()
        best = min(best, end - marks[0][1])
        for (stage, begin), (_, after) in zip(marks, [*marks[1:], ("end", end)], strict=True):
            stages[stage] = min(stages.get(stage, np.inf), after - begin)
        note = f"{len(built.tile.polys)} polygons"
        if case.golden is not None:
            same = built.to_bytes() == case.golden.to_bytes()
            note += ", bytes equal Habitat's" if same else ", DIFFERS FROM HABITAT'S"
    return best, stages, note


def start_times() -> tuple[list[float], list[float]]:
    """Return (import, kernels) seconds of a fresh process, with an empty cache of kernels and with a full one."""
    with tempfile.TemporaryDirectory() as folder:
        environment = {**os.environ, "NUMBA_CACHE_DIR": folder}
        times = []
        for _ in range(3):
            run = subprocess.run(
                [sys.executable, "-c", START], env=environment, capture_output=True, text=True, check=True
            )
            times.append([float(word) for word in run.stdout.split()])
        return times[0], min(times[1:], key=sum)


def main() -> None:
    """Print the table."""
    cold, cached = start_times()
    print(f"start with an empty kernel cache: {cold[0]:.2f} s import + {cold[1]:.1f} s compiling")
    print(f"start from the cache:             {cached[0]:.2f} s import + {cached[1]:.2f} s loading (aim: below 1 s)")
    build_navmesh(*PILLARED_ROOM)
    print(f"\n{'mesh':8} {'faces':>7} {'seconds':>8}  built")
    seconds, spent = [], dict[str, float]()
    for case in cases():
        best, stages, note = measure(case)
        seconds.append(best)
        for stage, value in stages.items():
            spent[stage] = spent.get(stage, 0.0) + value
        print(f"{case.name:8} {len(case.faces):7} {best:8.4f}  {note}")
    low, high = CPP_SECONDS
    print(f"\nleast {min(seconds):.4f}, mean {np.mean(seconds):.4f}, most {max(seconds):.4f} s a build")
    print(f"C++ reference: {low:.2f} to {high:.2f} s (another machine)")
    print(f"ratio: least {min(seconds) / low:.2f}, most {max(seconds) / high:.2f} (aim: at most {AIM:g})")
    total = sum(spent.values())
    print("time by stage: " + ", ".join(f"{stage} {100 * value / total:.0f} %" for stage, value in spent.items()))
    print(f"peak memory: {resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024:.0f} MiB")


if __name__ == "__main__":
    main()
