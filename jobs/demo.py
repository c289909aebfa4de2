"""``condvln demo``: the whole job on made scenes, ending with instructions to read and where the files are."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Final

from rich.console import Console

from condvln.samples import make_samples
from jobs.generate import run_generate
from jobs.report import Report, Section
from jobs.show import show_episodes
from jobs.workspace import published
from schemas.config import Config, InstructionsConfig, RayConfig, SourceConfig
from schemas.program import CATEGORIES

__all__ = ["run_demo"]

SHOWN: Final = 5
"""Instructions printed at the end."""
PER_CATEGORY: Final = 10
"""Episodes a scene and category: enough to fill every category, few enough for two minutes."""


def run_demo(out: Path, *, scenes: int, seed: int, workers: int | None, console: Console) -> int:
    """Make scenes, generate, export, show. Returns the exit code.

    workers : Ray workers; 0 runs in this process; None is one a core
    """
    began = time.monotonic()
    out = out.resolve()
    console.print(f"making {scenes} apartments in {out / 'scenes'}", highlight=False)
    make_samples(out / "scenes", family="replicacad", scenes=scenes, seed=seed)
    config = Config(
        name="demo",
        seed=seed,
        store=out / "store",
        export=out / "export",
        sources=(SourceConfig(family="replicacad", root=out / "scenes"),),
        instructions=InstructionsConfig(per_category=dict.fromkeys(CATEGORIES, PER_CATEGORY)),
        ray=RayConfig(workers=workers or None),
    )
    report = run_generate(config, inline=workers == 0, console=console)
    shown = show_episodes(config, sample=SHOWN, picture=out / "pictures")
    snapshot = published(config)
    tables = [(name, table.rows) for name, table in sorted(snapshot.manifest.tables.items())]
    closing = Report(
        {},
        [
            "",
            f"tables    {out / 'store' / 'snapshots' / snapshot.snapshot_id}",
            f"episodes  {config.export}",
            f"pictures  {out / 'pictures'}",
            f"done in {time.monotonic() - began:.0f} s",
        ],
    )
    printed = Console()
    for part in (report, shown, Report({}, [], [Section("Tables", ("table", "rows"), [*tables])]), closing):
        printed.print(part)
    return report.exit_code
