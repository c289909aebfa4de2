"""CPU seconds of this tree compared with those of an earlier commit, in one run: ``python -m benchmarks versus
COMMIT``.

Each round runs both trees one after the other, each in a process of its own: real scenes of a family from an empty
store to published tables, then export with the bias gate, then proof. Medians over the rounds are printed, and whether
the rows of every table are equal. CPU seconds (user and system, all threads) count, not the clock, so that a busy
machine disturbs little.

CONDVLN_BENCH_FAMILIES (``replicacad,procthor``), CONDVLN_BENCH_SCENES (10 of each, spread evenly), CONDVLN_BENCH_ROUNDS
(3) and CONDVLN_BENCH_CATEGORY (12 episodes a category) say how much is run.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
from collections import defaultdict
from collections.abc import Sequence
from pathlib import Path
from statistics import median
from typing import Any, Final

from rich.console import Console
from rich.table import Table

from benchmarks.costs import real_families

__all__ = ["main"]

TREE: Final = Path(__file__).resolve().parents[1]

# Runs in either tree, so it uses only what both have.
CHILD: Final = """
import json, os, resource, sys, time
from collections import defaultdict
from pathlib import Path
from rich.console import Console
from factory.executor import InlineExecutor
from factory.index import Index
try:
    from factory.store import LocalStore
except ImportError:  # it stood in a file of its own
    from factory.local_store import LocalStore
from factory.report import Progress
from factory.run import run
from factory.snapshot import Snapshot
from jobs.export import run_export
from jobs.pipeline import build_pipeline, list_units
from jobs.verify import verify_export
from jobs.workspace import file_hashes, hasher
from schemas.config import Config, InstructionsConfig, SourceConfig
from schemas.program import CATEGORIES
try:
    from schemas.config.run import SplitsConfig
except ModuleNotFoundError:  # schemas.config was one module
    from schemas.config import SplitsConfig
try:
    from condvln.compiled import warm_up
except ImportError:  # kernels are compiled where they are first used
    warm_up = None

family, root, folder, scenes, asked, proven = json.loads(sys.argv[1])
folder = Path(folder)

def config_of(**more):
    return Config(
        name="versus", store=folder / "store", export=folder / "export",
        sources=(SourceConfig(family=family, root=Path(root), **more),),
        instructions=InstructionsConfig(per_category=dict.fromkeys(CATEGORIES, asked)),
        splits=SplitsConfig(bias="warn"),
    )

def cpu():
    own, children = (resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
    return own.ru_utime + own.ru_stime + children.ru_utime + children.ru_stime

def timed(work):
    began = cpu()
    return work(), cpu() - began

class Listener(Progress):
    spent = defaultdict(float)
    failed = 0
    def unit(self, receipt):
        self.failed += bool(getattr(receipt, "fault", None) or getattr(receipt, "error", None))
        for stage in receipt.stages:
            if stage.made:
                self.spent[stage.stage] += getattr(stage, "cpu_seconds", stage.seconds)

if warm_up:
    warm_up(lambda message: None)
config = config_of()
units = list_units(config, hasher(file_hashes(config)))
units = [units[at * len(units) // scenes] for at in range(scenes)] if len(units) > scenes else units
config = config_of(scenes=tuple(sorted(unit.unit_id.partition("/")[2] for unit in units)))
pipeline = build_pipeline(config)
if not warm_up:
    run(pipeline, units[:1], LocalStore(folder / "warm"), "versus", InlineExecutor())
store, listener = LocalStore(folder / "store"), Listener()
_, whole = timed(lambda: run(pipeline, units, store, "versus", InlineExecutor(), progress=listener))
peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
manifest = Snapshot.open(store, "versus").manifest
found = {
    "stages": dict(listener.spent), "generate": whole, "episodes": manifest.tables["episodes"].rows, "peak": peak,
    "failed": listener.failed, "tables": {
        name: [str(part.logical_hash) for _, part in sorted(table.partitions.items())]
        for name, table in manifest.tables.items()
    },
}
if proven:
    report, found["export"] = timed(lambda: run_export(config))
    found["gate"] = report.lines[-3:]
    lines = sum(sum(1 for _ in path.open("rb")) for path in (folder / "export" / "manifest").glob("*.jsonl"))
    found["exported"] = lines
    report, found["verify"] = timed(lambda: verify_export(config, folder / "export"))
    found["proof"] = report.lines[0]
print("FOUND " + json.dumps(found))
"""


def measured(tree: Path, arguments: Sequence[object]) -> dict[str, Any]:
    """Return the figures that the child process found in `tree`."""
    environment = {**os.environ, "PYTHONPATH": str(tree)}
    command = [
        sys.executable,
        "-c",
        CHILD,
        json.dumps([str(one) if isinstance(one, Path) else one for one in arguments]),
    ]
    done = subprocess.run(command, cwd=tree, env=environment, capture_output=True, text=True, check=False)
    lines = [line for line in done.stdout.splitlines() if line.startswith("FOUND ")]
    if done.returncode or not lines:
        raise SystemExit(f"the run in {tree} failed:\n{done.stderr[-3000:]}")
    found: dict[str, Any] = json.loads(lines[-1].removeprefix("FOUND "))
    return found


def _worktree(commit: str, folder: Path) -> Path:
    """Yield a work tree of that commit; `commit` itself if it is a folder."""
    if Path(commit).is_dir():
        return Path(commit).resolve()
    tree = folder / "tree"
    subprocess.run(["git", "-C", str(TREE), "worktree", "add", "--detach", "--quiet", str(tree), commit], check=True)
    return tree


def _figures(found: dict[str, Any]) -> dict[str, float]:
    """Return CPU milliseconds per episode."""
    made, exported = max(1, found["episodes"]), max(1, found.get("exported", 0))
    rows = {f"stage {name}": 1e3 * spent / made for name, spent in found["stages"].items()}
    rows["all stages"] = sum(rows.values())
    rows["generate (stages, store, publication)"] = 1e3 * found["generate"] / made
    for name in ("export", "verify"):
        if name in found:
            rows[name] = 1e3 * found[name] / exported
    return rows


def main(arguments: Sequence[str] = ()) -> None:
    """Print a table for each family."""
    given = list(arguments)
    if len(given) != 1:
        raise SystemExit("usage: python -m benchmarks versus COMMIT (or the folder of a tree)")
    console = Console(width=130)
    rounds = int(os.environ.get("CONDVLN_BENCH_ROUNDS", "3"))
    scenes = int(os.environ.get("CONDVLN_BENCH_SCENES", "10"))
    asked = int(os.environ.get("CONDVLN_BENCH_CATEGORY", "12"))
    wanted = os.environ.get("CONDVLN_BENCH_FAMILIES", "replicacad,procthor").split(",")
    roots = real_families()
    with tempfile.TemporaryDirectory() as name:
        before = _worktree(given[0], Path(name))
        try:
            for family in wanted:
                if family not in roots:
                    console.print(f"{family}: no real scenes here (set CONDVLN_REAL_DATA)")
                    continue
                runs: dict[str, list[dict[str, Any]]] = defaultdict(list)
                for turn in range(rounds):
                    for side, tree in (("before", before), ("now", TREE)):
                        folder = Path(name) / f"{family}-{side}-{turn}"
                        runs[side].append(measured(tree, [family, roots[family], folder, scenes, asked, True]))
                _print(console, family, runs)
        finally:
            if before.is_relative_to(name):
                subprocess.run(["git", "-C", str(TREE), "worktree", "remove", "--force", str(before)], check=False)


def _print(console: Console, family: str, runs: dict[str, list[dict[str, Any]]]) -> None:
    table = Table(title=f"{family}: CPU milliseconds an episode, median of {len(runs['now'])}")
    for column in ("", "before", "now", "before ÷ now"):
        table.add_column(column, justify="right")
    sides = {side: [_figures(found) for found in found_runs] for side, found_runs in runs.items()}
    for row in sides["before"][0]:
        old, new = (median(figures.get(row, 0.0) for figures in sides[side]) for side in ("before", "now"))
        table.add_row(row, f"{old:.2f}", f"{new:.2f}", f"{old / new:.2f}" if new else "")
    console.print(table)
    for side, found in ((side, found_runs[-1]) for side, found_runs in runs.items()):
        console.print(
            f"{side}: {found['episodes']} episodes, {found['exported']} exported; worker peak {found['peak']:.0f} MiB; "
            f"{found['proof']}"
        )
    old, new = (runs[side][-1]["tables"] for side in ("before", "now"))
    differ = sorted(name for name in old if old[name] != new.get(name))
    console.print(
        f"rows of all tables are equal: {not differ}" + (f"; different: {', '.join(differ)}" if differ else "")
    )


if __name__ == "__main__":
    main(sys.argv[1:])
