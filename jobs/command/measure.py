"""Verbs that verify an export, walk agents on it and score predictions, and the verbs of ``condvln benchmark``."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated, Final, cast

import typer

from jobs.command.options import (
    EXIT_CODES,
    AsJson,
    Datasets,
    ExportPath,
    ForwardStep,
    Graphs,
    Inline,
    LookerKeys,
    Overrides,
    SplitName,
)
from jobs.report import answer, console
from schemas.errors import UsageError

__all__ = ["benchmarks", "bias", "evaluate", "language", "serve", "verify", "walk"]


def verify(
    target: Annotated[
        Path,
        typer.Argument(
            metavar="CONFIG|EXPORT",
            help="YAML configuration of the run, which proves its export against the store too; or an export",
        ),
    ],
    split: Annotated[str, typer.Argument(metavar="[SPLIT]", help="split of the trajectories' episodes")] = "train",
    export: Annotated[
        Path | None,
        typer.Option(metavar="DIR", help="folder of the export to verify; by default the configuration's export"),
    ] = None,
    without_store: Annotated[
        bool,
        typer.Option(
            "--without-store",
            help="leave the published snapshot out: not compared with, texts without an episode not proven",
        ),
    ] = False,
    trajectories: Annotated[
        Path | None,
        typer.Option(
            metavar="DIR",
            help="verify, instead of an export, a folder that condvln trajectories wrote: poses, images, texts",
        ),
    ] = None,
    lint: Annotated[
        bool,
        typer.Option(
            "--lint",
            help="prove nothing; lint the VLN-CE, ANSR-v1, RxR and R2R files of, or below, this path, from CondVLN or "
            "elsewhere",
        ),
    ] = False,
    connectivity: Graphs = None,
    workers: Annotated[
        int | None,
        typer.Option(
            min=1,
            help="number of Ray workers that prove an export's scenes, of some 0.6 GiB each; by default one for each "
            "core, at most 8, and fewer for a small export or little memory",
        ),
    ] = None,
    overrides: Overrides = None,
    as_json: AsJson = False,
) -> None:
    """Prove every published episode again from its text and the raw source files, and check that the export is
    complete.
    """
    from jobs.agents import datasets_of, folders_of
    from jobs.export_origin import config_of, data_of

    given = data_of(target, overrides) if target.is_dir() else overrides or ()
    if lint:
        from jobs.validate import validate_files

        found = validate_files(target, folders_of(given)[1], connectivity or ())
        if not as_json:
            sys.stdout.write(found.as_text())
            raise typer.Exit(found.exit_code)
        answer(found, as_json)
        return
    if trajectories is not None:
        from jobs.trajectory_units import find_split
        from jobs.verify_trajectories import verify_trajectories

        changed = [*given, *([f"export={export.resolve()}"] if export is not None else [])]
        proof = verify_trajectories(find_split(str(target), split, given, changed), trajectories)
        answer(proof, as_json)
        return
    from jobs.configuration import load_config
    from jobs.verify import verify_export

    if target.is_dir():
        loaded, without_store = config_of(target, datasets_of(given)), True
    else:
        loaded = load_config(target, given)
    folder = export or loaded.export
    if folder is None:
        raise UsageError("no export folder is named", place="export", remedy="Set export: FOLDER, or say --export DIR.")
    answer(verify_export(loaded, folder, without_store=without_store, workers=workers), as_json)


def walk(
    export: ExportPath,
    split: SplitName,
    agent: Annotated[
        str,
        typer.Option(
            help="perfect, looking, oracle, wrong-branch, random-leaf, coin-flip, always-then, always-else, nearest, "
            "stop-at-start; looker, which reads the text and sees the scene; or your own module:Class"
        ),
    ],
    out: Annotated[Path, typer.Option(help="file of predictions to write (VLN-CE's format)")],
    seed: Annotated[int, typer.Option(help="seed of agents that act at random")] = 0,
    objects: Annotated[
        Path | None,
        typer.Option(
            "--objects", metavar="CONFIG", help="configuration of the run whose published objects your own agent sees"
        ),
    ] = None,
    data: Datasets = None,
    looker: LookerKeys = None,
) -> None:
    """Walk an agent (a reference agent or your own) on the navmesh with VLN-CE's actions, and write its predictions."""
    from jobs.agents import folders_of
    from jobs.configuration import load_config
    from jobs.evaluate import walk_split
    from jobs.export_origin import data_of

    seen = load_config(objects, check_roots=False) if objects is not None else None
    scenes, roots = folders_of(data_of(export, data))
    answer(walk_split(export, split, agent, out, roots, seed, seen, scenes, looker or ()), False)


def serve(
    export: ExportPath,
    split: SplitName,
    data: Datasets = None,
    host: Annotated[str, typer.Option(help="address to listen on")] = "127.0.0.1",
    port: Annotated[int, typer.Option(min=1, max=65535, help="port to listen on")] = 8000,
    sessions: Annotated[int, typer.Option(min=1, help="sessions that may be open at once")] = 8,
) -> None:
    """Serve a split's episodes to language agents, as an OpenEnv environment (extra openenv)."""
    from jobs.agents import serve_split
    from jobs.export_origin import data_of

    serve_split(export, split, data_of(export, data), host, port, sessions)


def evaluate(
    export: ExportPath,
    split: SplitName,
    predictions: Annotated[
        list[Path],
        typer.Argument(metavar="P...", help="one file of predictions per agent; tables name the agent after the file"),
    ],
    distance: Annotated[
        str,
        typer.Option(
            help="how to judge subgoals: geodesic, euclidean as the paper's Open-Nav does, or euclidean-any-order as "
            "its VLN-Zero does"
        ),
    ] = "geodesic",
    radius: Annotated[
        list[float] | None, typer.Option(help="also report rates at this success distance, metres; may be repeated")
    ] = None,
    oracle_radius: Annotated[
        float | None,
        typer.Option(help="success distance of OSR in metres, if larger than that of SR (VLN-CE uses 3)"),
    ] = None,
    fast_dtw: Annotated[bool, typer.Option("--fast-dtw", help="compute nDTW by FastDTW, as VLN-CE does")] = False,
    assume_stop: Annotated[
        bool, typer.Option("--assume-stop", help="treat the last pose of a path without STOP as STOP")
    ] = False,
    forward_step: ForwardStep = None,
    duplicates: Annotated[
        str,
        typer.Option(
            help="refuse a file that has an episode twice, or keep-last, as after a run that was started again"
        ),
    ] = "refuse",
    allow_partial: Annotated[
        bool, typer.Option("--allow-partial", help="leave out an unfinished last entry, as a killed run writes it")
    ] = False,
    oracle: Annotated[
        list[Path] | None,
        typer.Option(
            "--oracle",
            help="file of predictions of the same agent on the oracle twin; give one for each file of "
            "predictions, in the same order",
        ),
    ] = None,
    connectivity: Graphs = None,
    data: Datasets = None,
    scores: Annotated[Path | None, typer.Option(help="file to write one JSON line per episode and agent to")] = None,
    csv: Annotated[
        Path | None, typer.Option("--csv", metavar="DIR", help="folder to write one CSV file per table to")
    ] = None,
    plots: Annotated[
        Path | None,
        typer.Option(
            "--plots", metavar="DIR", help="folder for plots of SR, BSA and CSR against depth and chain length"
        ),
    ] = None,
    html: Annotated[
        Path | None,
        typer.Option(
            "--html", metavar="DIR", help="folder to write the page of condvln explore to, with these agents' results"
        ),
    ] = None,
    strict: Annotated[
        bool,
        typer.Option(
            "--strict",
            help="exit with code 3 and print no tables if an episode has no prediction, a step that no single action "
            "can make, or a pose off the navmesh",
        ),
    ] = False,
    table: Annotated[
        list[str] | None, typer.Option("--table", metavar="NAME", help="print this table; may be repeated")
    ] = None,
    all_tables: Annotated[bool, typer.Option("--all", help="print every table, not only the main ones")] = False,
    latex: Annotated[bool, typer.Option("--latex", help="print LaTeX tables (booktabs)")] = False,
    markdown: Annotated[bool, typer.Option("--markdown", help="print Markdown tables")] = False,
    as_json: AsJson = False,
) -> None:
    """Score agents' predictions: SR, SPL, nDTW, BSA, CSR, the branch taken and whether it was justified, with
    confidence intervals.
    """
    from condvln.evaluation.measures import DistanceMode
    from condvln.evaluation.reading import Duplicates, ReadRules
    from condvln.evaluation.score import ScoreRules
    from condvln.evaluation.split import SplitOptions
    from condvln.manifest import manifest_paths
    from jobs.agents import evidence_seen, folders_of
    from jobs.evaluate import ALL_TABLES, Question, evaluate_predictions
    from jobs.export_origin import data_of

    if distance not in ("geodesic", "euclidean", "euclidean-any-order"):
        raise UsageError(
            f"--distance {distance!r} is not a distance", remedy="Say geodesic, euclidean or euclidean-any-order."
        )
    if html is not None and not manifest_paths(export):
        raise UsageError(
            "--html shows the episodes of an export",
            place=str(export),
            remedy="This folder has no manifests: leave it out.",
        )
    scenes, roots = folders_of(data_of(export, data))
    options = SplitOptions(
        ScoreRules(distance=cast(DistanceMode, distance), oracle_success_distance=oracle_radius, fast_dtw=fast_dtw),
        radii=tuple(radius or ()),
        navmesh_roots=tuple(roots),
        reading=ReadRules(assume_stop, cast(Duplicates, duplicates), allow_partial),
        forward=forward_step,
        connectivity=tuple(connectivity or ()),
        sees_of=evidence_seen(export, scenes, roots) if scenes else None,
    )
    tables = (ALL_TABLES,) if all_tables else tuple(table or ())
    asked = Question(export, split, tuple(predictions), tuple(oracle or ()), options, strict, tables)
    report = evaluate_predictions(asked)
    for target, write in ((scores, report.write_scores), (csv, report.write_csv), (plots, report.write_plots)):
        if target is not None:
            write(target)
    if html is not None:
        from jobs.explore import Exploration, asked_split, explore

        explore(Exploration(html, export, roots=options.navmesh_roots, scored=(asked_split(asked, report),)))
    if latex or markdown:
        for warning in report.warnings:
            console().print(f"warning: {warning}", markup=False, soft_wrap=True)
        sys.stdout.write(report.as_latex() if latex else report.as_markdown())
    else:
        answer(report, as_json)


def language(
    target: Annotated[
        Path,
        typer.Argument(
            metavar="CONFIG|EXPORT|FILE",
            help="YAML configuration, folder of an export, or a file of R2R, VLN-CE, RxR or NavSpace",
        ),
    ],
    overrides: Overrides = None,
    as_json: AsJson = False,
) -> None:
    """Report the wording of texts: lengths, variety, directions, phrases to avoid, and ambiguous references."""
    from jobs.language import report_language

    answer(report_language(target, overrides or ()), as_json)


def bias(
    targets: Annotated[
        list[Path],
        typer.Argument(metavar="EXPORT|FILE...", help="folder of an export, or files of R2R, VLN-CE, RxR or NavSpace"),
    ],
    as_json: AsJson = False,
) -> None:
    """Test whether guessers that see no scene find the right branch above chance; exit code 3 if one does."""
    from jobs.bias import report_bias

    answer(report_bias(targets), as_json)


benchmarks = typer.Typer(help="Pack, unpack, prove and score a benchmark.", no_args_is_help=True, rich_markup_mode=None)

OwnScenes = Annotated[
    list[str] | None,
    typer.Option(
        "--data",
        metavar="FAMILY=DIR",
        help="your copy of a dataset, in any layout; may be repeated, for one family too",
    ),
]
_DATA: Final = "--data procthor=/data/houses --data replicacad=/data/replica_cad"


def _end(verb: str, *, codes: bool = True) -> str:
    return f"{EXIT_CODES}\n\n" * codes + f"Example: condvln benchmark {verb}"


@benchmarks.command("pack", epilog=_end("pack out/condvln-1/export --out condvln-1.tar.zst"))
def benchmark_pack(
    target: Annotated[
        Path,
        typer.Argument(
            metavar="EXPORT|CONFIG", help="folder of an export; or a configuration, to generate and export first"
        ),
    ],
    out: Annotated[Path, typer.Option(metavar="FILE", help="the pack to write, such as condvln-1.tar.zst")],
    name: Annotated[str, typer.Option(help="name of the benchmark")] = "condvln",
    version: Annotated[
        str, typer.Option(help="its version; results on one that ends in draft are not to be published")
    ] = "draft",
    overrides: Overrides = None,
    inline: Inline = False,
    as_json: AsJson = False,
) -> None:
    """Write an export as one small file, without the scenes. Equal exports give equal bytes."""
    from jobs.benchmark import pack_benchmark

    bar = console(quiet=as_json)
    done = pack_benchmark(target, out, overrides or (), name=name, version=version, inline=inline, console=bar)
    answer(done, as_json)


@benchmarks.command("unpack", epilog=_end(f"unpack condvln-1 --out condvln-1 {_DATA}"))
def benchmark_unpack(
    pack: Annotated[Path, typer.Argument(metavar="PACK", help="condvln-1, which is part of condvln, or a file")],
    out: Annotated[Path, typer.Option(metavar="DIR", help="folder of the export to write")],
    scenes: OwnScenes = None,
    as_json: AsJson = False,
) -> None:
    """Write the export of a pack, and find its scenes in your copies of the datasets by the content of files. Scenes
    that are missing or differ are named; the others can be used. Texts and scores of results need no scenes.
    """
    from jobs.benchmark import unpack_benchmark

    answer(unpack_benchmark(pack, out, scenes or ()), as_json)


@benchmarks.command("prove", epilog=_end(f"prove condvln-1 {_DATA}"))
def benchmark_prove(
    target: Annotated[Path, typer.Argument(metavar="PACK|DIR", help="the folder that unpack wrote, or a pack")],
    scenes: OwnScenes = None,
    workers: Annotated[
        int | None, typer.Option(min=1, help="number of Ray workers; by default as condvln verify has them")
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Prove every episode again from its text and your copies of the scenes, with this release's verifier."""
    from jobs.benchmark import prove_benchmark

    answer(prove_benchmark(target, scenes or (), workers=workers), as_json)


@benchmarks.command("score", epilog=_end("score condvln-1 val_unseen mine.json --out board.json", codes=False))
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
    references: Annotated[
        bool, typer.Option(help="also walk the reference agents: the oracle and the guessers")
    ] = True,
    data: Datasets = None,
    forward_step: ForwardStep = None,
    as_json: AsJson = False,
) -> None:
    """Rank agents by their predictions, with confidence intervals. For each agent, also give the significance of the
    difference from the agent ranked above it. A file with steps that no single action can make, or with poses off
    the navmesh, is refused.
    """
    from jobs.agents import folders_of
    from jobs.export_origin import data_of
    from jobs.leaderboard import score_benchmark

    scenes, roots = folders_of(data_of(export, data))
    found = score_benchmark(
        export,
        split,
        predictions or (),
        out=out,
        roots=roots,
        references=references,
        scenes=scenes,
        forward=forward_step,
    )
    answer(found, as_json)
