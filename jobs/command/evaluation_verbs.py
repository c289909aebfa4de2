"""Verbs that verify an export, walk agents on it and score predictions."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated, cast

import typer

from jobs.command.answers import answer, console, leave
from jobs.command.options import AsJson, ConfigPath, ExportPath, Graphs, NavmeshRoots, Overrides, SplitName
from schemas.errors import UsageError

__all__ = ["bias", "evaluate", "language", "serve", "verify", "walk"]


def verify(
    config: ConfigPath,
    export: Annotated[
        Path | None,
        typer.Option(
            "--export", metavar="DIR", help="folder of the export to verify; by default the configuration's export"
        ),
    ] = None,
    without_store: Annotated[
        bool, typer.Option("--without-store", help="do not compare with the published snapshot")
    ] = False,
    trajectories: Annotated[
        Path | None,
        typer.Option(
            "--trajectories",
            metavar="DIR",
            help="verify, instead of an export, a folder that condvln trajectories wrote: poses, images, texts",
        ),
    ] = None,
    split: Annotated[str, typer.Option(help="split of the trajectories' episodes")] = "train",
    workers: Annotated[
        int | None,
        typer.Option(
            min=1,
            help="number of processes that prove an export's scenes, of some 0.6 GiB each; by default one for each "
            "core, at most 8, and fewer for a small export or little memory",
        ),
    ] = None,
    overrides: Overrides = None,
    as_json: AsJson = False,
) -> None:
    """Prove every published episode again from its text and the raw source files, and check that the export is
    complete.
    """
    from jobs.configuration import load_config
    from jobs.verify import verify_export

    if trajectories is not None:
        from jobs.trajectory_units import find_target
        from jobs.verify_trajectories import verify_trajectories

        changed = [*(overrides or ()), *([f"export={export.resolve()}"] if export is not None else [])]
        proof = verify_trajectories(find_target(str(config), split, overrides=changed), trajectories)
        answer(proof, as_json)
        leave(proof.exit_code)
        return

    loaded = load_config(config, overrides or ())
    folder = export or loaded.export
    if folder is None:
        raise UsageError("no export folder is named", place="export", remedy="Set export: FOLDER, or say --export DIR.")
    report = verify_export(loaded, folder, without_store=without_store, workers=workers)
    answer(report, as_json)
    leave(report.exit_code)


def walk(
    export: ExportPath,
    split: SplitName,
    agent: Annotated[
        str,
        typer.Option(
            help="perfect, oracle, wrong-branch, random-leaf, coin-flip, always-then, always-else, nearest, "
            "stop-at-start; looker, which reads the text and sees the scene; or your own module:Class"
        ),
    ],
    out: Annotated[Path, typer.Option(help="file of predictions to write (VLN-CE's format)")],
    navmesh_root: NavmeshRoots = None,
    seed: Annotated[int, typer.Option(help="seed of agents that act at random")] = 0,
    objects: Annotated[
        Path | None,
        typer.Option(
            "--objects", metavar="CONFIG", help="configuration of the run whose published objects your own agent sees"
        ),
    ] = None,
    scenes: Annotated[
        list[str] | None,
        typer.Option("--scenes", metavar="FAMILY=DIR", help="dataset in which looker sees the scenes; may be repeated"),
    ] = None,
    looker: Annotated[
        list[str] | None,
        typer.Option(
            "--looker", metavar="KEY=VALUE", help="set a key of looker, such as noise.missed=0.1; may be repeated"
        ),
    ] = None,
) -> None:
    """Walk an agent (a reference agent or your own) on the navmesh with VLN-CE's actions, and write its predictions."""
    from jobs.configuration import load_config
    from jobs.evaluate import walk_split

    seen = load_config(objects, check_roots=False) if objects is not None else None
    found = walk_split(export, split, agent, out, navmesh_root or (), seed, seen, scenes or (), looker or ())
    answer(found, False)


def serve(
    export: ExportPath,
    split: SplitName,
    scenes: Annotated[
        list[str],
        typer.Option("--scenes", metavar="FAMILY=DIR", help="dataset in which agents see the scenes; may be repeated"),
    ],
    navmesh_root: NavmeshRoots = None,
    host: Annotated[str, typer.Option(help="address to listen on")] = "127.0.0.1",
    port: Annotated[int, typer.Option(min=1, max=65535, help="port to listen on")] = 8000,
    sessions: Annotated[int, typer.Option(min=1, help="sessions that may be open at once")] = 8,
) -> None:
    """Serve a split's episodes to language agents, as an OpenEnv environment (extra openenv)."""
    from jobs.serve import serve_split

    serve_split(export, split, scenes, navmesh_root or (), host, port, sessions)


def evaluate(
    export: ExportPath,
    split: SplitName,
    predictions: Annotated[
        list[Path],
        typer.Argument(metavar="P...", help="one file of predictions per agent; tables name the agent after the file"),
    ],
    navmesh_root: NavmeshRoots = None,
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
    assume_stop: Annotated[bool, typer.Option("--assume-stop", help="treat the last pose as STOP")] = False,
    oracle: Annotated[
        list[Path] | None,
        typer.Option(
            "--oracle",
            help="file of predictions of the same agent on the oracle twin; give one for each file of "
            "predictions, in the same order",
        ),
    ] = None,
    connectivity: Graphs = None,
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
        bool, typer.Option("--strict", help="exit with code 3 and print no tables if an episode has no prediction")
    ] = False,
    table: Annotated[
        list[str] | None, typer.Option("--table", metavar="NAME", help="print this table; may be repeated")
    ] = None,
    all_tables: Annotated[bool, typer.Option("--all", help="print every table, not only the main ones")] = False,
    latex: Annotated[bool, typer.Option("--latex", help="print LaTeX tables (booktabs)")] = False,
    markdown: Annotated[bool, typer.Option("--markdown", help="print Markdown tables")] = False,
    as_json: AsJson = False,
) -> None:
    """Score agents' predictions: SR, SPL, nDTW, BSA, CSR and the branch taken, with confidence intervals."""
    from condvln.evaluation.measures import DistanceMode
    from condvln.manifest import manifest_paths
    from jobs.evaluate import ALL_TABLES, Question, evaluate_predictions

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
    asked = Question(
        export,
        split,
        tuple(predictions),
        tuple(oracle or ()),
        roots=tuple(navmesh_root or ()),
        connectivity=tuple(connectivity or ()),
        distance=cast(DistanceMode, distance),
        radii=tuple(radius or ()),
        assume_stop=assume_stop,
        oracle_radius=oracle_radius,
        fast_dtw=fast_dtw,
        strict=strict,
        tables=(ALL_TABLES,) if all_tables else tuple(table or ()),
    )
    report = evaluate_predictions(asked)
    for target, write in ((scores, report.write_scores), (csv, report.write_csv), (plots, report.write_plots)):
        if target is not None:
            write(target)
    if html is not None:
        from jobs.explore import Exploration, explore
        from jobs.explore_agents import asked_split

        explore(Exploration(html, export, roots=asked.roots, scored=(asked_split(asked, report),)))
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
    from jobs.foreign_bias import report_bias

    report = report_bias(targets)
    answer(report, as_json)
    leave(report.exit_code)
