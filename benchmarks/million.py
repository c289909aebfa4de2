"""Cost of a million and of a thousand million episodes, scaled from measurements on some scenes of each family.

Each family's real scenes (CONDVLN_REAL_DATA, or ``shared/data`` beside the checkout; made apartments where there are
none, or where they have no navmesh) run inline from an empty store, kernels warm, in a process of their own. They are
then exported with the bias gate, and proven. All figures but the peak are divided by the number of episodes and
multiplied by a million: a scene costs the same whatever is beside it.

CONDVLN_BENCH_SCENES (12, spread evenly), CONDVLN_BENCH_CATEGORY (20 episodes a category) and CONDVLN_BENCH_FAMILIES
(all) say how much is run; CONDVLN_BENCH_PRICE is what a CPU costs an hour (0.04).
"""

from __future__ import annotations

import multiprocessing
import os
import resource
import tempfile
import time
from collections import defaultdict
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final, get_args

from rich.console import Console
from rich.table import Table

from benchmarks.costs import real_families
from condvln.samples import make_samples
from factory.executor import InlineExecutor
from factory.receipt import Receipt
from factory.report import Progress
from factory.run import run
from factory.store import LocalStore
from jobs.export import run_export
from jobs.pipeline import build_pipeline, list_units
from jobs.verify import verify_export
from jobs.workspace import file_hashes, hasher, published
from schemas.config import Config, Family, InstructionsConfig, SourceConfig
from schemas.config.run import SplitsConfig
from schemas.program import CATEGORIES

__all__ = ["Cost", "cost_of", "main"]

MILLION: Final = 1_000_000
CPUS: Final = (2, 64, 1024)


@dataclass
class Cost:
    """Measurements on the scenes of one family.

    stages : CPU seconds by stage
    generate, export, verify : CPU seconds; generating includes the stages
    units, snapshot, files : bytes of the kept stages, of the published tables, and of the export
    peak : bytes of memory that the process took at most
    """

    scenes: int
    episodes: int = 0
    exported: int = 0
    generate: float = 0.0
    export: float = 0.0
    verify: float = 0.0
    units: int = 0
    snapshot: int = 0
    files: int = 0
    peak: int = 0
    stages: dict[str, float] = field(default_factory=lambda: defaultdict(float))

    def parts(self) -> dict[str, float]:
        """Return CPU seconds an episode, by part. They add up to the whole."""
        made = {name: seconds / self.episodes for name, seconds in self.stages.items()}
        made["store, publish"] = self.generate / self.episodes - sum(made.values())
        return {**made, "export, gate": self.export / self.exported, "verify": self.verify / self.exported}


@dataclass
class _Listener(Progress):
    cost: Cost

    def unit(self, receipt: Receipt) -> None:
        for stage in receipt.stages:
            if stage.made:
                self.cost.stages[stage.stage] += stage.cpu_seconds


def _bytes_below(folder: Path) -> int:
    return sum(path.stat().st_size for path in folder.rglob("*") if path.is_file())


def _cpu(work: Callable[[], object]) -> float:
    began = time.process_time()
    work()
    return time.process_time() - began


def cost_of(family: Family, root: Path, folder: Path, scenes: int, asked: int) -> Cost:
    """Run `scenes` scenes of a family, spread evenly, from an empty store in `folder` to verified episodes."""
    source = SourceConfig(family=family, root=root)
    # The gate judges whole datasets; a few scenes may fail it.
    config = Config(
        name=family,
        store=str(folder / "store"),
        export=folder / "export",
        sources=(source,),
        instructions=InstructionsConfig(per_category=dict.fromkeys(CATEGORIES, asked)),
        splits=SplitsConfig(bias="warn"),
    )
    units = list_units(config, hasher(file_hashes(config)))
    units = [units[at * len(units) // scenes] for at in range(scenes)] if len(units) > scenes else units
    chosen = tuple(sorted(unit.unit_id.partition("/")[2] for unit in units))
    config = config.model_copy(update={"sources": (source.model_copy(update={"scenes": chosen}),)})
    cost = Cost(len(units))
    pipeline, store, heard = build_pipeline(config), LocalStore(folder / "store"), _Listener(cost)
    cost.generate = _cpu(lambda: run(pipeline, units, store, family, InlineExecutor(), progress=heard))
    cost.episodes = published(config).manifest.tables["episodes"].rows
    if cost.episodes:
        cost.export = _cpu(lambda: run_export(config))
        cost.exported = sum(sum(1 for _ in path.open("rb")) for path in (folder / "export/manifest").glob("*.jsonl"))
        cost.verify = _cpu(lambda: verify_export(config, folder / "export"))
        cost.files = _bytes_below(folder / "export")
    cost.units, cost.snapshot = (_bytes_below(folder / "store" / name) for name in ("units", "snapshots"))
    cost.peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024
    return cost


def _measured(families: Sequence[Family], scenes: int, asked: int) -> dict[str, Cost]:
    """Return the costs by family, each of which is measured in a process of its own; "(made)" follows the name where
    its scenes are made ones.
    """
    found: dict[str, Cost] = {}
    real = real_families()
    with tempfile.TemporaryDirectory() as name:
        for family in families:
            for made in (False, True):
                root = Path(name) / f"{family}-made" if made else real.get(family)
                if root is None:
                    continue
                if made:
                    make_samples(root, family=family, scenes=scenes, seed=1)
                folder = Path(name) / f"{family}-{made}"
                with ProcessPoolExecutor(1, mp_context=multiprocessing.get_context("spawn")) as pool:
                    cost = pool.submit(cost_of, family, root, folder, scenes, asked).result()
                if cost.exported:
                    found[f"{family} (made)" if made else family] = cost
                    break
            else:
                raise SystemExit(f"{family}: no episodes, neither of real scenes nor of made ones")
    return found


def _print_parts(console: Console, costs: dict[str, Cost]) -> None:
    table = Table(title="CPU ms an episode")
    parts = list(dict.fromkeys(name for cost in costs.values() for name in cost.parts()))
    for column in ("family", "scenes", "episodes", *parts, "all", "peak, MiB"):
        table.add_column(column, justify="right")
    for family, cost in costs.items():
        each = cost.parts()
        table.add_row(
            family,
            str(cost.scenes),
            str(cost.episodes),
            *(f"{1e3 * each.get(name, 0.0):.2f}" for name in parts),
            f"{1e3 * sum(each.values()):.1f}",
            f"{cost.peak / 2**20:.0f}",
        )
    console.print(table)


def _print_scaled(console: Console, costs: dict[str, Cost], price: float) -> None:
    """Print what a million episodes take, and how long on some CPUs. A thousand million take a thousand times as much,
    since the driver's own part, which grows with the scenes, is far below a hundredth.
    """
    table = Table(
        title="a million episodes, scaled from these scenes; a thousand million take a thousand times as much"
    )
    columns = ("CPU h", *(f"h on {cpus} CPUs" for cpus in CPUS), f"at {price} a CPU hour")
    for column in ("family", *columns, "units, GB", "tables, GB", "export, GB"):
        table.add_column(column, justify="right")
    for family, cost in costs.items():
        hours = MILLION * sum(cost.parts().values()) / 3600
        made, out = MILLION / cost.episodes, MILLION / cost.exported
        table.add_row(
            family,
            f"{hours:.2f}",
            *(f"{hours / cpus:.3g}" for cpus in CPUS),
            f"{hours * price:.2f}",
            *(f"{value / 1e9:.1f}" for value in (cost.units * made, cost.snapshot * made, cost.files * out)),
        )
    console.print(table)


def main() -> None:
    """Print two tables with a row for each family: the measurements, and what a million episodes would take."""
    console = Console(width=190)
    scenes = int(os.environ.get("CONDVLN_BENCH_SCENES", "12"))
    asked = int(os.environ.get("CONDVLN_BENCH_CATEGORY", "20"))
    chosen = os.environ.get("CONDVLN_BENCH_FAMILIES", ",".join(get_args(Family))).split(",")
    costs = _measured([family for family in get_args(Family) if family in chosen], scenes, asked)
    _print_parts(console, costs)
    _print_scaled(console, costs, float(os.environ.get("CONDVLN_BENCH_PRICE", "0.04")))


if __name__ == "__main__":
    main()
