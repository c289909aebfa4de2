"""The verbs of ``condvln benchmark``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from jobs.command.answers import answer, console, leave
from jobs.command.options import EXIT_CODES, AsJson, ExportPath, Inline, NavmeshRoots, Overrides, SplitName

__all__ = ["group"]


group = typer.Typer(
    help="Build, check and score a version of a benchmark.", no_args_is_help=True, rich_markup_mode=None
)

BenchmarkPath = Annotated[
    Path, typer.Argument(metavar="BENCHMARK", help="benchmark file, such as configs/benchmark-v1.yaml")
]

OwnScenes = Annotated[
    list[str] | None,
    typer.Option(
        "--scenes",
        metavar="FAMILY=DIR",
        help="your copy of a dataset; may be repeated. Families that are not named are left out; without this option, "
        "the run's configuration names the folders",
    ),
]


@group.command("build", epilog=EXIT_CODES)
def benchmark_build(
    benchmark: BenchmarkPath,
    scenes: OwnScenes = None,
    overrides: Overrides = None,
    inline: Inline = False,
    as_json: AsJson = False,
) -> None:
    """Generate and export the benchmark from your copies of the datasets, and write its record, benchmark.json."""
    from jobs.benchmark import build_benchmark

    out = console(quiet=as_json)
    report = build_benchmark(benchmark, overrides or (), scenes=scenes or (), inline=inline, console=out)
    answer(report, as_json)
    leave(report.exit_code)


@group.command("check", epilog=EXIT_CODES)
def benchmark_check(
    benchmark: BenchmarkPath,
    record: Annotated[
        Path,
        typer.Argument(metavar="RECORD", help="published benchmark.json, or the folder of the export that holds it"),
    ],
    scenes: OwnScenes = None,
    overrides: Overrides = None,
    inline: Inline = False,
    as_json: AsJson = False,
) -> None:
    """Check whether your copies of the datasets give the published snapshot; name scenes that differ (exit code 3)."""
    from jobs.benchmark import check_benchmark

    out = console(quiet=as_json)
    report = check_benchmark(benchmark, record, overrides or (), scenes=scenes or (), inline=inline, console=out)
    answer(report, as_json)
    leave(report.exit_code)


@group.command("score")
def benchmark_score(
    export: ExportPath,
    split: SplitName,
    predictions: Annotated[
        list[Path] | None,
        typer.Argument(
            metavar="[P...]", help="one file of predictions for each agent; the table names the agent after the file"
        ),
    ] = None,
    out: Annotated[Path | None, typer.Option("--out", help="file to write the leaderboard to, as JSON")] = None,
    navmesh_root: NavmeshRoots = None,
    references: Annotated[
        bool, typer.Option(help="also walk the reference agents: the oracle and the guessers")
    ] = True,
    scenes: Annotated[
        list[str] | None,
        typer.Option(
            "--scenes",
            metavar="FAMILY=DIR",
            help="dataset in which the agent looker sees the scenes; without this option, looker is left out",
        ),
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Rank agents by their predictions, with confidence intervals. For each agent, also give the significance of the
    difference from the agent ranked above it.
    """
    from jobs.leaderboard import score_benchmark

    roots = navmesh_root or ()
    found = score_benchmark(
        export, split, predictions or (), out=out, roots=roots, references=references, scenes=scenes or ()
    )
    answer(found, as_json)
