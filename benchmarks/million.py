"""Cost of a million episodes (CPU seconds, memory, disk), scaled from measurements on some scenes of each family.

Each family's real scenes (CONDVLN_REAL_DATA, or ``shared/data`` beside the checkout; made apartments where there are
none) run inline from an empty store, kernels warm; CONDVLN_BENCH_SCENES bounds them (12, spread evenly). They are then
exported, walked by the perfect agent, evaluated and proven. All figures but the peak are divided by the number of
published episodes and multiplied by a million: a scene costs the same whatever is beside it.
"""

from __future__ import annotations

import os
import resource
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from rich.console import Console
from rich.table import Table

from benchmarks.costs import real_families
from condvln.compiled import warm_up
from condvln.samples import make_samples
from factory.machine import slowness
from jobs.export import run_export
from jobs.generate import run_generate
from jobs.pipeline import list_units
from jobs.verify import verify_export
from jobs.workspace import file_hashes, hasher, published
from schemas.config import Config, SourceConfig
from schemas.config.run import SplitsConfig

__all__ = ["Cost", "cost_of", "main"]

MILLION = 1_000_000


@dataclass(frozen=True)
class Cost:
    """Measurements on the scenes of one family.

    generate, export, verify : CPU seconds
    units, snapshot, files : bytes of the kept stages, of the published tables, and of the export
    """

    family: str
    scenes: int
    episodes: int
    exported: int
    generate: float
    export: float
    verify: float
    units: int
    snapshot: int
    files: int


def _bytes_below(folder: Path) -> int:
    return sum(path.stat().st_size for path in folder.rglob("*") if path.is_file())


def _cpu(work: Callable[[], object]) -> float:
    began = time.process_time()
    work()
    return time.process_time() - began


def cost_of(family: str, root: Path, folder: Path, scenes: int) -> Cost:
    """Run `scenes` scenes of a family, spread evenly, from an empty store in `folder` to verified episodes."""
    source = SourceConfig(family=family, root=root)
    # The gate judges whole datasets; a few scenes may fail it.
    config = Config(
        name=family,
        store=folder / "store",
        export=folder / "export",
        sources=(source,),
        splits=SplitsConfig(bias="off"),
    )
    names = sorted(unit.unit_id.partition("/")[2] for unit in list_units(config, hasher(file_hashes(config))))
    chosen = {names[at * len(names) // scenes] for at in range(scenes)} if len(names) > scenes else {*names}
    config = config.model_copy(update={"sources": (source.model_copy(update={"scenes": tuple(sorted(chosen))}),)})
    quiet = Console(quiet=True)
    made = config.model_copy(update={"export": None})
    generate = _cpu(lambda: run_generate(made, inline=True, console=quiet))
    export = _cpu(lambda: run_export(config))
    snapshot = published(config)
    episodes = snapshot.manifest.tables["episodes"].rows
    files = _bytes_below(folder / "export")
    exported = sum(sum(1 for _ in path.open("rb")) for path in (folder / "export" / "manifest").glob("*.jsonl"))
    verify = _cpu(lambda: verify_export(config, folder / "export")) if exported else 0.0
    units, tables = (_bytes_below(folder / "store" / name) for name in ("units", "snapshots"))
    return Cost(family, len(chosen), episodes, exported, generate, export, verify, units, tables, files)


def main() -> None:
    """Print a row for each family: the measurements, and what a million episodes would take."""
    console = Console(width=170)
    scenes = int(os.environ.get("CONDVLN_BENCH_SCENES", "12"))
    warm_up(lambda message: None)
    table = Table(
        title=f"a million episodes, scaled from these scenes (this machine: {slowness():.2f} × the reference's time)"
    )
    for column in (
        "family",
        "scenes",
        "episodes",
        "a scene",
        "generate, CPU h",
        "export, CPU h",
        "verify, CPU h",
        "units, GB",
        "tables, GB",
        "export, GB",
    ):
        table.add_column(column, justify="right")
    with tempfile.TemporaryDirectory() as name:
        families = real_families()
        if not families:
            make_samples(Path(name) / "made", family="replicacad", scenes=scenes, seed=1)
            families = {"replicacad": Path(name) / "made"}
        for family, root in families.items():
            cost = cost_of(family, root, Path(name) / family, scenes)
            if not cost.exported:
                table.add_row(family, str(cost.scenes), str(cost.episodes), *["none exported"], *[""] * 6)
                continue
            each, out = MILLION / cost.episodes, MILLION / cost.exported
            table.add_row(
                family,
                str(cost.scenes),
                str(cost.episodes),
                f"{cost.episodes / cost.scenes:.0f}",
                *(f"{value / 3600:.1f}" for value in (cost.generate * each, cost.export * out, cost.verify * out)),
                *(f"{value / 1e9:.1f}" for value in (cost.units * each, cost.snapshot * each, cost.files * out)),
            )
    console.print(table)
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20
    console.print(f"peak memory of this one process over all of it: {peak:.2f} GiB")


if __name__ == "__main__":
    main()
