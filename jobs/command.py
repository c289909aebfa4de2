"""The ``condvln`` command: one verb a function, each a thin door to its module."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Annotated, Any, Final

import typer
from rich.console import Console

from schemas.errors import CondVLNError, UsageError

__all__ = ["app", "main"]

app = typer.Typer(
    name="condvln",
    help="Conditional navigation instructions from indoor scenes: made, proven, published, measured.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
)

ConfigPath = Annotated[Path, typer.Argument(metavar="CONFIG", help="YAML configuration of the run")]
Overrides = Annotated[
    list[str] | None, typer.Option("--set", metavar="A.B=C", help="override one key; may be repeated")
]
TargetName = Annotated[
    str, typer.Argument(metavar="CONFIG|STORE", help="YAML configuration, or a store: its folder or s3://…")
]
RefName = Annotated[str | None, typer.Option("--ref", metavar="NAME", help="published under another name")]
AsJson = Annotated[bool, typer.Option("--json", help="print one JSON document instead of text")]

EXIT_CODES: Final = (
    "Exit codes: 0 done, 1 usage, 3 done with quarantined scenes or failed proofs, 4 over the failure budget."
)


@app.command(epilog=EXIT_CODES)
def demo(
    out: Annotated[Path, typer.Option(help="folder to write to")] = Path("out/demo"),
    scenes: Annotated[int, typer.Option(help="made apartments, over all formats")] = 12,
    seed: Annotated[int, typer.Option(help="seed of everything")] = 0,
    workers: Annotated[int | None, typer.Option(help="Ray workers; 0 runs inline")] = None,
) -> None:
    """Made scenes of four datasets' formats: generated, exported, proven, walked, measured; minutes on two cores."""
    from jobs.demo import run_demo

    _exit(run_demo(out, scenes=scenes, seed=seed, workers=workers, console=_console()))


@app.command()
def samples(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="folder to write the dataset to")],
    family: Annotated[str, typer.Option(help="native format of the scenes")] = "replicacad",
    scenes: Annotated[int, typer.Option(min=1, help="how many")] = 12,
    seed: Annotated[int, typer.Option(help="scene k of a seed is the same however many are made")] = 0,
) -> None:
    """Write whole made scenes in a family's native format."""
    from jobs.samples import write_samples

    write_samples(folder, family=family, scenes=scenes, seed=seed, console=_console())


@app.command()
def sources(
    config: ConfigPath,
    overrides: Overrides = None,
    limit: Annotated[
        int | None, typer.Option(min=1, help="read this many scenes of each source, spread evenly; all by default")
    ] = None,
    as_json: AsJson = False,
) -> None:
    """What is there, what is missing, and what will be skipped and why. Reads scenes, runs and builds nothing."""
    from jobs.configuration import load_config
    from jobs.sources import survey

    _show(survey(load_config(config, overrides or ()), limit=limit, console=_console(quiet=as_json)), as_json)


@app.command()
def plan(config: ConfigPath, overrides: Overrides = None, as_json: AsJson = False) -> None:
    """The difference between the published snapshot and the sources, with its cost. Runs nothing."""
    from jobs.configuration import load_config
    from jobs.plan import make_plan

    _show(make_plan(load_config(config, overrides or ())), as_json)


@app.command(epilog=EXIT_CODES)
def generate(
    config: ConfigPath,
    overrides: Overrides = None,
    inline: Annotated[bool, typer.Option("--inline", help="run in this process, without Ray")] = False,
    retry_quarantined: Annotated[
        bool, typer.Option("--retry-quarantined", help="try quarantined scenes again")
    ] = False,
    priors: Annotated[bool, typer.Option("--priors", help="renew the label priors")] = False,
    as_json: AsJson = False,
) -> None:
    """Run the plan and publish a snapshot; write the export where the configuration names one."""
    from jobs.configuration import load_config
    from jobs.generate import run_generate

    report = run_generate(
        load_config(config, overrides or ()),
        inline=inline,
        retry_quarantined=retry_quarantined,
        renew_priors=priors,
        console=_console(quiet=as_json),
    )
    _show(report, as_json)
    _exit(report.exit_code)


@app.command(epilog=EXIT_CODES)
def rebuild(
    config: ConfigPath,
    overrides: Overrides = None,
    if_changed: Annotated[
        bool, typer.Option("--if-changed", help="end at once when no file changed, by names, sizes and times")
    ] = False,
    priors: Annotated[bool, typer.Option("--priors", help="renew the label priors")] = False,
    retry_quarantined: Annotated[
        bool, typer.Option("--retry-quarantined", help="try quarantined scenes again")
    ] = False,
    verify: Annotated[
        bool, typer.Option("--verify", help="read every published file again and mend those that are damaged")
    ] = False,
    inline: Annotated[bool, typer.Option("--inline", help="run in this process, without Ray")] = False,
    as_json: AsJson = False,
) -> None:
    """The scheduled form of generate: plan, run what changed, publish, export, sweep. Nothing to do exits 0."""
    from jobs.configuration import load_config
    from jobs.rebuild import run_rebuild

    report = run_rebuild(
        load_config(config, overrides or ()),
        if_changed=if_changed,
        renew_priors=priors,
        retry_quarantined=retry_quarantined,
        verify=verify,
        inline=inline,
        console=_console(quiet=as_json),
    )
    _show(report, as_json)
    _exit(report.exit_code)


@app.command()
def status(
    target: TargetName,
    overrides: Overrides = None,
    ref: RefName = None,
    drift: Annotated[
        bool, typer.Option("--drift", help="measure how far the priors are from what is published; reads every scene")
    ] = False,
    sizes: Annotated[bool, typer.Option("--sizes", help="list every file and add up the bytes")] = False,
    as_json: AsJson = False,
) -> None:
    """Snapshots and refs, what is quarantined and why, the last runs, and the drift of the priors."""
    from jobs.status import target_status
    from jobs.target import find_target

    found = find_target(target, overrides or (), ref)
    _show(target_status(found, measure_drift=drift, sizes=sizes), as_json)


@app.command(
    epilog="The exit code is that of the verb; 130 after Ctrl-C, when the job goes on.",
    context_settings={"ignore_unknown_options": True},
)
def submit(
    config: ConfigPath,
    verb: Annotated[str, typer.Argument(metavar="VERB", help="plan, generate, rebuild, export, verify, …")],
    arguments: Annotated[
        list[str] | None, typer.Argument(metavar="ARGUMENTS...", help="further words of the verb's command line")
    ] = None,
    address: Annotated[
        str,
        typer.Option(metavar="URL", envvar="RAY_API_SERVER_ADDRESS", help="dashboard of the cluster, http://HOST:8265"),
    ] = "http://127.0.0.1:8265",
    overrides: Overrides = None,
    job: Annotated[
        str | None, typer.Option("--id", metavar="ID", help="submission id; a job of this id is followed, not doubled")
    ] = None,
    follow: Annotated[bool, typer.Option(help="follow the log until the job ends")] = True,
) -> None:
    """The same verb as a Ray Job on a cluster; follows its log."""
    from jobs.submit import run_submit

    words = arguments or ()
    report = run_submit(config, verb, words, address=address, overrides=overrides or (), job=job, follow=follow)
    _show(report, False)
    _exit(report.exit_code)


NavmeshRoots = Annotated[
    list[Path] | None,
    typer.Option("--navmesh-root", help="dataset folder with the navmeshes that the export does not ship"),
]
Graphs = Annotated[
    list[Path] | None,
    typer.Option("--connectivity", help="folder of <scan>_connectivity.json, for discrete R2R"),
]


@app.command(epilog=EXIT_CODES)
def export(
    config: Annotated[Path | None, typer.Argument(metavar="CONFIG", help="YAML configuration of the run")] = None,
    validate: Annotated[
        Path | None,
        typer.Option(
            "--validate", metavar="PATH", help="lint VLN-CE, ANSR-v1, RxR and R2R files instead, ours or a stranger's"
        ),
    ] = None,
    navmesh_root: NavmeshRoots = None,
    connectivity: Graphs = None,
    overrides: Overrides = None,
    as_json: AsJson = False,
) -> None:
    """Published snapshot → splits, ground truth and manifests; or a linter of such files (exit code 3 on errors)."""
    if validate is not None:
        from jobs.validate import validate_files

        found = validate_files(validate, navmesh_root or (), connectivity or ())
        if as_json:
            _show(found, as_json)
        else:
            sys.stdout.write(found.as_text())
        _exit(found.exit_code)
        return
    if config is None:
        raise UsageError("neither a configuration nor --validate", remedy="Say condvln export CONFIG.")
    from jobs.configuration import load_config
    from jobs.export import run_export

    report = run_export(load_config(config, overrides or (), check_roots=False))
    _show(report, as_json)
    _exit(report.exit_code)


@app.command()
def oracle(
    export: Annotated[Path, typer.Argument(metavar="EXPORT", help="folder of an export")],
    split: Annotated[str, typer.Argument(metavar="SPLIT", help="train, val_seen, val_unseen or test")],
    file: Annotated[
        Path | None,
        typer.Option("--file", help="VLN-CE, ANSR-v1 or RxR file of these episodes; by default the stock one"),
    ] = None,
    out: Annotated[
        Path | None, typer.Option("--out", help="by default oracle/SPLIT/SPLIT.json.gz of the export")
    ] = None,
    seed: Annotated[int | None, typer.Option(help="seed of the words; by default the export's own")] = None,
    as_json: AsJson = False,
) -> None:
    """The oracle-linear twin of a split: the right branch alone, all else as it is."""
    from jobs.oracle import oracle_split

    _show(oracle_split(export, split, file=file, out=out, seed=seed), as_json)


@app.command(epilog=EXIT_CODES)
def compose(
    config: ConfigPath,
    scene: Annotated[
        str | None, typer.Argument(metavar="SCENE", help="scene id; FAMILY/ID where several sources have it")
    ] = None,
    out: Annotated[
        Path | None, typer.Argument(metavar="OUT.glb", help="file to write; its navmesh goes beside it")
    ] = None,
    every: Annotated[
        Path | None,
        typer.Option(
            "--all",
            metavar="DIR",
            help="instead of one: every scene of the export (of the sources where none is), each at the path below DIR "
            "that its episodes name; DIR is the loader's data/scene_datasets",
        ),
    ] = None,
    own_navmesh: Annotated[
        bool,
        typer.Option(
            "--own-navmesh",
            help="write the navmesh of the episodes: the dataset's own; with --all also one that the export keeps",
        ),
    ] = False,
    overrides: Overrides = None,
    as_json: AsJson = False,
) -> None:
    """One GLB and its navmesh from a scene's parts, as loaders need that open a scene by a single file."""
    from jobs.configuration import load_config

    loaded = load_config(config, overrides or ())
    if every is not None and scene is None:
        from jobs.compose_all import compose_all

        report = compose_all(loaded, every, own_navmesh=own_navmesh, console=_console(quiet=as_json))
    elif every is None and scene is not None and out is not None:
        from jobs.compose import compose as compose_scene

        report = compose_scene(loaded, scene, out, own_navmesh=own_navmesh)
    else:
        raise UsageError(
            "either one scene is composed, or all are", remedy="Say compose CONFIG SCENE OUT.glb, or CONFIG --all DIR."
        )
    _show(report, as_json)
    _exit(report.exit_code)


@app.command()
def query(
    target: TargetName,
    sql: Annotated[
        str | None, typer.Argument(metavar="SQL|NAME", help="a query over the tables and views, or one by its name")
    ] = None,
    overrides: Overrides = None,
    ref: RefName = None,
    listed: Annotated[bool, typer.Option("--list", help="list tables, views and named queries")] = False,
    out: Annotated[
        Path | None, typer.Option("--out", metavar="FILE", help="write the rows to .parquet, .csv or .jsonl")
    ] = None,
    as_json: AsJson = False,
) -> None:
    """DuckDB over the published tables; each has a ``source`` column from its folder."""
    from jobs.query import list_queries, query_target
    from jobs.target import find_target

    found = find_target(target, overrides or (), ref)
    if not listed and sql is None:
        raise UsageError("nothing is asked", place="SQL", remedy="Give a query or the name of one; --list tells them.")
    _show(list_queries() if listed or sql is None else query_target(found, sql, out), as_json)


@app.command()
def show(
    config: ConfigPath,
    episode: Annotated[str | None, typer.Argument(metavar="ID", help="episode id")] = None,
    sample: Annotated[int | None, typer.Option(min=1, help="show this many, spread over categories")] = None,
    picture: Annotated[Path | None, typer.Option(help="folder for a top-down picture of each")] = None,
    overrides: Overrides = None,
    as_json: AsJson = False,
) -> None:
    """Episodes: text, tree, truths, paths, and a top-down picture."""
    from jobs.configuration import load_config
    from jobs.show import show_episodes

    loaded = load_config(config, overrides or (), check_roots=picture is not None)
    _show(show_episodes(loaded, episode=episode, sample=sample, picture=picture), as_json)


ExportPath = Annotated[Path, typer.Argument(metavar="EXPORT", help="folder of an export")]
SplitName = Annotated[str, typer.Argument(metavar="SPLIT", help="train, val_seen, val_unseen or test")]


@app.command(epilog=EXIT_CODES)
def verify(
    config: ConfigPath,
    export: Annotated[
        Path | None, typer.Option("--export", metavar="DIR", help="export to prove; by default the configuration's")
    ] = None,
    overrides: Overrides = None,
    as_json: AsJson = False,
) -> None:
    """Independent proof of every published episode, from its text and the raw source files."""
    from jobs.configuration import load_config
    from jobs.verify import verify_export

    loaded = load_config(config, overrides or ())
    folder = export or loaded.export
    if folder is None:
        raise UsageError("no export folder is named", place="export", remedy="Set export: FOLDER, or say --export DIR.")
    report = verify_export(loaded, folder)
    _show(report, as_json)
    _exit(report.exit_code)


@app.command()
def walk(
    export: ExportPath,
    split: SplitName,
    agent: Annotated[
        str,
        typer.Option(
            help="perfect, oracle, wrong-branch, random-leaf, always-then, nearest, …, or your own module:Class"
        ),
    ],
    out: Annotated[Path, typer.Option(help="file of predictions to write (VLN-CE's format)")],
    navmesh_root: NavmeshRoots = None,
    seed: Annotated[int, typer.Option(help="seed of agents that draw")] = 0,
    objects: Annotated[
        Path | None, typer.Option("--objects", metavar="CONFIG", help="configuration whose objects your own agent sees")
    ] = None,
) -> None:
    """Predictions of an agent, a reference or your own, walked on the navmesh with VLN-CE's actions."""
    from jobs.configuration import load_config
    from jobs.evaluate import walk_split

    seen = load_config(objects, check_roots=False) if objects is not None else None
    _show(walk_split(export, split, agent, out, navmesh_root or (), seed, seen), False)


@app.command()
def evaluate(
    export: ExportPath,
    split: SplitName,
    predictions: Annotated[list[Path], typer.Argument(metavar="P...", help="a file an agent, named after it")],
    navmesh_root: NavmeshRoots = None,
    distance: Annotated[str, typer.Option(help="geodesic, or euclidean as the paper's authors measure")] = "geodesic",
    radius: Annotated[list[float] | None, typer.Option(help="success distance of a sweep; may be repeated")] = None,
    assume_stop: Annotated[bool, typer.Option("--assume-stop", help="take the last pose as STOP")] = False,
    oracle: Annotated[
        list[Path] | None,
        typer.Option("--oracle", help="predictions of the same agent on the oracle twin; once for each P, in order"),
    ] = None,
    connectivity: Graphs = None,
    scores: Annotated[Path | None, typer.Option(help="file for one JSON line an episode")] = None,
    csv: Annotated[Path | None, typer.Option("--csv", metavar="DIR", help="folder for one CSV file a table")] = None,
    plots: Annotated[
        Path | None, typer.Option("--plots", metavar="DIR", help="folder for SR, BSA and CSR against depth and chain")
    ] = None,
    latex: Annotated[bool, typer.Option("--latex", help="print LaTeX tables (booktabs)")] = False,
    markdown: Annotated[bool, typer.Option("--markdown", help="print Markdown tables")] = False,
    as_json: AsJson = False,
) -> None:
    """Metrics of agents' predictions: SR, SPL, nDTW, BSA, CSR, which branch was taken, and how sure it all is."""
    from jobs.evaluate import Question, evaluate_predictions

    if distance not in ("geodesic", "euclidean"):
        raise UsageError(f"--distance {distance!r}", remedy="Say geodesic or euclidean.")
    asked = Question(
        export,
        split,
        tuple(predictions),
        tuple(oracle or ()),
        roots=tuple(navmesh_root or ()),
        connectivity=tuple(connectivity or ()),
        euclidean=distance == "euclidean",
        radii=tuple(radius or ()),
        assume_stop=assume_stop,
    )
    report = evaluate_predictions(asked)
    for target, write in ((scores, report.write_scores), (csv, report.write_csv), (plots, report.write_plots)):
        if target is not None:
            write(target)
    if latex or markdown:
        sys.stdout.write(report.as_latex() if latex else report.as_markdown())
    else:
        _show(report, as_json)


navmesh = typer.Typer(help="The navigation engine by itself.", no_args_is_help=True, rich_markup_mode=None)
app.add_typer(navmesh, name="navmesh")

NavmeshPath = Annotated[Path, typer.Argument(metavar="FILE", help="a .navmesh file")]


@navmesh.command("build")
def navmesh_build(
    mesh: Annotated[Path, typer.Argument(metavar="MESH", help="GLB, PLY, OBJ …, in Habitat's frame")],
    out: Annotated[Path, typer.Argument(metavar="OUT", help="the .navmesh file to write")],
    settings: Annotated[
        list[str] | None, typer.Option("--set", metavar="NAME=VALUE", help="a NavMeshSettings field; may be repeated")
    ] = None,
    profile: Annotated[str, typer.Option(help="habitat>=0.3.4 or habitat<=0.3.3")] = "habitat>=0.3.4",
    as_json: AsJson = False,
) -> None:
    """Build the navmesh that Habitat would build, byte for byte."""
    from jobs.navmesh import build, settings_of

    _show(build(mesh, out, settings_of(settings or ()), profile, _console(quiet=as_json)), as_json)


@navmesh.command("info")
def navmesh_info(file: NavmeshPath, as_json: AsJson = False) -> None:
    """What stands in a navmesh: settings, size, islands."""
    from jobs.navmesh import info

    _show(info(file), as_json)


@navmesh.command("compare", epilog=EXIT_CODES)
def navmesh_compare(
    first: Annotated[Path, typer.Argument(metavar="A")],
    second: Annotated[Path, typer.Argument(metavar="B")],
    as_json: AsJson = False,
) -> None:
    """Name the first stage of the build at which two navmeshes part (exit code 3)."""
    from jobs.navmesh import compare

    report = compare(first, second)
    _show(report, as_json)
    _exit(report.exit_code)


@navmesh.command("picture")
def navmesh_picture(file: NavmeshPath, out: Annotated[Path, typer.Argument(metavar="OUT.png")]) -> None:
    """Draw a navmesh from above, each island in its own colour."""
    from jobs.navmesh import picture

    _show(picture(file, out), False)


def _console(quiet: bool = False) -> Console:
    return Console(stderr=True, quiet=quiet)


def _show(report: Any, as_json: bool) -> None:
    if as_json:
        sys.stdout.write(json.dumps(report.as_json(), ensure_ascii=False, sort_keys=True) + "\n")
    else:
        from jobs.report import terminal

        terminal().print(report)


def _exit(code: int) -> None:
    if code:
        raise typer.Exit(code)


CLICK_USAGE: Final = 2
"""Exit code of the command-line library for wrong usage; ours is 1."""


def main() -> None:
    """Entry point: errors of ours become one message and their exit code."""
    try:
        app()
    except CondVLNError as error:
        Console(stderr=True, highlight=False, soft_wrap=True).print(f"condvln: {error}", markup=False)
        raise SystemExit(error.exit_code) from None
    except SystemExit as stop:
        raise SystemExit(1 if stop.code == CLICK_USAGE else stop.code) from None
