"""Navmesh queries: microseconds alone and in batches, compared with Detour in C++, and the cost of compiling.

Run as ``python -m benchmarks.navigation_queries``. The queries are those of the golden files where the real data is
there (CONDVLN_REAL_DATA, or ``shared/data`` beside the checkout), else random ones on a made floor.
"""

from __future__ import annotations

import gzip
import json
import os
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from condvln.navigation.follower import Follower
from condvln.navigation.pathfinder import Pathfinder
from condvln.navigation.polygon_tile import tile_of_polygons
from condvln.navigation.tile import Floats

CPP_MICROSECONDS = (9.0, 29.0)
"""Microseconds of one find_path by Detour in C++, least and most over similar navmeshes (measured on another
machine)."""

AIM = 1.5
"""Target: batched queries take at most this many times the C++ figure."""

SECONDS = 0.2
"""Least duration of each measurement, seconds."""

ROUNDS = 5
"""Number of measurements of each kind; the best counts, since other work on the machine only slows them down."""

SINGLES = 200
"""Number of single queries in a round."""

START = "from benchmarks.navigation_queries import made_queries, measure; measure(made_queries(count=4))"
"""Code that a fresh process runs so that every kind of query has run."""

FIRST_QUERY = "from condvln import Pathfinder; Pathfinder.load({path!r}).find_path([1, 0, 1], [5, 0, 5])"
INFO = "import sys; sys.argv = ['condvln', 'navmesh', 'info', {path!r}]; from jobs.command import main; main()"
"""Code whose time a user waits for: the first answer of the library, and of the command."""


@dataclass(frozen=True)
class Queries:
    """Pairs of points (n, 3) on one navmesh."""

    name: str
    pathfinder: Pathfinder
    starts: Floats
    ends: Floats


def golden_queries() -> Iterator[Queries]:
    """Return the path queries of each golden file, or of a made floor if there are none."""
    checkout = Path(__file__).resolve().parents[1]
    data = Path(os.environ.get("CONDVLN_REAL_DATA", checkout.parent / "shared" / "data"))
    files = sorted((data / "navmesh_golden" / "queries").glob("*.json.gz"))
    for file in files:
        with gzip.open(file) as opened:
            golden = json.load(opened)
        pathfinder = Pathfinder.load(data / golden["navmesh"])
        pairs = [(case["start"], case["end"]) for case in golden["find_path"]]
        starts, ends = (np.array([pair[side] for pair in pairs], np.float32) for side in (0, 1))
        yield Queries(golden["navmesh"].removesuffix(".navmesh"), pathfinder, starts, ends)
    if not files:
        yield made_queries()


def made_queries(side: int = 14, count: int = 200) -> Queries:
    """Return random pairs on a floor of squares that lacks every third one along a diagonal."""
    grid = [[x, 0.0, z] for z in range(side + 1) for x in range(side + 1)]
    cells = [(x, z) for z in range(side) for x in range(side) if (x + 2 * z) % 5]
    row = side + 1
    squares = [[row * z + x, row * z + x + 1, row * (z + 1) + x + 1, row * (z + 1) + x] for x, z in cells]
    pathfinder = Pathfinder.from_tile(tile_of_polygons(grid, squares))
    points = pathfinder.get_random_navigable_points(2 * count, 0)
    return Queries("made floor", pathfinder, points[:count], points[count:])


def microseconds(run: Callable[[], object], per_run: int) -> float:
    """Return the best processor time per query, where ``run`` makes ``per_run`` queries."""
    best = float("inf")
    for _ in range(ROUNDS):
        runs, begun = 0, time.process_time()
        while time.process_time() - begun < SECONDS / ROUNDS or not runs:
            run()
            runs += 1
        elapsed = time.process_time() - begun
        best = min(best, elapsed / (runs * per_run))
    return best * 1e6


def measure(queries: Queries) -> dict[str, float]:
    """Return the microseconds of each kind of query."""
    paths, starts, ends = queries.pathfinder, queries.starts, queries.ends
    count = len(starts)
    pairs = list(zip(starts[:SINGLES], ends[:SINGLES], strict=True))
    follower = Follower(paths)
    reachable = [pair for pair in pairs if np.isfinite(paths.geodesic_distance(*pair))][:20]
    return {
        "polygons": len(paths.navmesh.tile.polys),
        "single": microseconds(lambda: [paths.find_path(a, b) for a, b in pairs], len(pairs)),
        "batch": microseconds(lambda: paths.find_paths(starts, ends), count),
        "distances": microseconds(lambda: paths.geodesic_distances(starts, ends), count),
        "one by one": microseconds(lambda: [paths.geodesic_distance(starts[0], b) for b in ends], count),
        "one-to-many": microseconds(lambda: paths.geodesic_distances(starts[0], ends), count),
        "table": microseconds(lambda: paths.distance_table(starts[:40], ends[:40]), 1600),
        "snap": microseconds(lambda: paths.snap_points(starts), count),
        "step": microseconds(lambda: paths.try_steps(starts, starts + np.float32(0.2)), count),
        "sample": microseconds(lambda: paths.get_random_navigable_points(1000, 0), 1000),
        "follow": microseconds(lambda: [follower.follow(a, 0.0, b) for a, b in reachable], len(reachable)),
    }


def start_seconds(code: str, cache: str) -> tuple[float, float]:
    """Return (wall-clock seconds, CPU seconds) that a fresh Python takes for ``code``."""
    spent, begun = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
    environment = os.environ | {"NUMBA_CACHE_DIR": cache}
    quiet = subprocess.DEVNULL
    subprocess.run([sys.executable, "-c", code], check=True, env=environment, stdout=quiet, stderr=quiet)
    elapsed, now = time.perf_counter() - begun, resource.getrusage(resource.RUSAGE_CHILDREN)
    return elapsed, now.ru_utime + now.ru_stime - spent.ru_utime - spent.ru_stime


def main() -> None:
    """Print the tables."""
    rows = [(queries.name, measure(queries)) for queries in golden_queries()]
    names = list(rows[0][1])
    print("microseconds a query")
    print(f"{'navmesh':42}" + "".join(f"{name:>12}" for name in names))
    for navmesh, row in rows:
        print(f"{navmesh:42}" + "".join(f"{row[name]:12.1f}" for name in names))
    low, high = CPP_MICROSECONDS
    batched = [row["batch"] for _, row in rows]
    print(f"\nfind_path in batches: {min(batched):.1f} to {max(batched):.1f} µs; in C++: {low:.0f} to {high:.0f} µs")
    print(f"slowest against slowest: {max(batched) / high:.2f} times C++ (aim: at most {AIM})")
    saved = [1 - row["one-to-many"] / row["one by one"] for _, row in rows]
    print(f"one start, many ends: {100 * min(saved):.0f} to {100 * max(saved):.0f} % less than separate calls")
    with tempfile.TemporaryDirectory() as cache:
        cold = start_seconds(START, cache)
        warm = min(start_seconds(START, cache) for _ in range(3))
        bare = min(start_seconds("import numpy, numba", cache) for _ in range(3))
        made_queries().pathfinder.save(path := Path(cache) / "made.navmesh")
        first = min(start_seconds(FIRST_QUERY.format(path=str(path)), cache) for _ in range(3))
        told = min(start_seconds(INFO.format(path=str(path)), cache) for _ in range(3))
    print("\nstart of a process until every kernel has run once, seconds (on the clock; of processor time)")
    starts = {"compiling": cold, "from the cache": warm, "only numpy and numba": bare}
    starts |= {"a first query, cached": first, "navmesh info, cached": told}
    for name, (clock, processor) in starts.items():
        print(f"  {name:22}{clock:8.2f}{processor:8.2f}")
    print("  aim from the cache: below 1 s")


if __name__ == "__main__":
    main()
