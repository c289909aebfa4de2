"""Verbs that read sources, stores, published tables and episodes."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from jobs.command.answers import answer, console, leave
from jobs.command.options import AsJson, ConfigPath, NavmeshRoots, Overrides, RefName, TargetName
from schemas.errors import UsageError

__all__ = ["explore", "query", "render", "show", "sources", "status"]


def sources(
    config: ConfigPath,
    overrides: Overrides = None,
    limit: Annotated[
        int | None, typer.Option(min=1, help="number of scenes to read from each source, spread evenly; all by default")
    ] = None,
    as_json: AsJson = False,
) -> None:
    """List what each source has, what it lacks, and which scenes will be skipped and why. Reads scenes, changes
    nothing.

    Exit code 1 if a source can't be used or lacks something that the configuration names.
    """
    from jobs.configuration import load_config
    from jobs.sources import survey

    report = survey(load_config(config, overrides or ()), limit=limit, console=console(quiet=as_json))
    answer(report, as_json)
    leave(report.exit_code)


def status(
    target: TargetName,
    overrides: Overrides = None,
    ref: RefName = None,
    drift: Annotated[
        bool,
        typer.Option("--drift", help="compare the pinned priors with priors counted now; reads every published scene"),
    ] = False,
    sizes: Annotated[bool, typer.Option("--sizes", help="list every file and add up the bytes")] = False,
    as_json: AsJson = False,
) -> None:
    """Show snapshots and refs, quarantined scenes with causes, the last runs, and the drift of the priors."""
    from jobs.status import target_status
    from jobs.target import find_target

    found = find_target(target, overrides or (), ref)
    report = target_status(found, measure_drift=drift, sizes=sizes)
    answer(report, as_json)
    leave(report.exit_code)


def query(
    target: TargetName,
    sql: Annotated[
        str | None,
        typer.Argument(
            metavar="SQL|NAME", help="an SQL query over the tables and views, or a query's name from --list"
        ),
    ] = None,
    overrides: Overrides = None,
    ref: RefName = None,
    listed: Annotated[bool, typer.Option("--list", help="list tables, views and named queries")] = False,
    out: Annotated[
        Path | None, typer.Option("--out", metavar="FILE", help="write the rows to .parquet, .csv or .jsonl")
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Query the published tables with DuckDB. In every table, the column ``source`` names the source of the row."""
    from jobs.query import list_queries, query_target
    from jobs.target import find_target

    found = find_target(target, overrides or (), ref)
    if not listed and sql is None:
        raise UsageError("no query is given", place="SQL", remedy="Give a query or the name of one; --list shows them.")
    answer(list_queries() if listed or sql is None else query_target(found, sql, out), as_json)


def show(
    target: Annotated[Path, typer.Argument(metavar="CONFIG|EXPORT", help="YAML configuration, or folder of an export")],
    episode: Annotated[
        str | None,
        typer.Argument(
            metavar="ID", help="episode id, or the beginning of one; with a configuration also an instruction id"
        ),
    ] = None,
    sample: Annotated[
        int | None, typer.Option(min=1, help="number of episodes to show, spread over categories and sources")
    ] = None,
    picture: Annotated[Path | None, typer.Option(help="folder to write a top-down picture of each episode to")] = None,
    navmesh_root: NavmeshRoots = None,
    overrides: Overrides = None,
    as_json: AsJson = False,
) -> None:
    """Show episodes: text, tree, truths, paths, and a top-down picture.

    If a source has no navmesh, and so instructions without episodes, these are shown.
    """
    if target.is_dir():
        from jobs.show_export import show_export

        if overrides:
            raise UsageError("an export has no keys to override", place="--set", remedy="Name its configuration.")
        report = show_export(target, episode=episode, sample=sample, picture=picture, roots=navmesh_root or ())
        answer(report, as_json)
        return
    from jobs.configuration import load_config
    from jobs.show import show_episodes

    if navmesh_root:
        raise UsageError(
            "not allowed with a configuration, which names its datasets",
            place="--navmesh-root",
            remedy="Name an export instead.",
        )
    loaded = load_config(target, overrides or (), check_roots=picture is not None)
    answer(show_episodes(loaded, episode=episode, sample=sample, picture=picture), as_json)


def explore(
    target: Annotated[Path, typer.Argument(metavar="CONFIG|EXPORT", help="YAML configuration, or folder of an export")],
    out: Annotated[
        Path, typer.Option(metavar="DIR", help="folder to write the page to; a page that is there is replaced")
    ],
    predictions: Annotated[
        list[Path] | None,
        typer.Option("--predictions", metavar="FILE", help="predictions or results of an agent; may be repeated"),
    ] = None,
    before: Annotated[
        str | None,
        typer.Option(
            "--before",
            metavar="EXPORT|SNAPSHOT",
            help="a former export to compare with; or, with a configuration, a former snapshot's id or a ref",
        ),
    ] = None,
    views: Annotated[
        int,
        typer.Option(
            min=0,
            help="number of episodes per scene to illustrate: pictures along the gold path, and the places from which "
            "the conditions' evidence is first seen; reads the sources' files",
        ),
    ] = 0,
    navmesh_root: NavmeshRoots = None,
    overrides: Overrides = None,
    as_json: AsJson = False,
) -> None:
    """Write a page that shows scenes, trees, evidence, paths, statistics and agents; open it in a browser.

    The page needs no server and no network. With a configuration it shows rooms, furniture and relations too; an export
    alone has navmeshes and no furniture.
    """
    from jobs.configuration import load_config
    from jobs.explore import Exploration, explore

    whole = target.is_dir()
    if whole and overrides:
        raise UsageError("an export has no keys to override", place="--set", remedy="Name its configuration.")
    config = None if whole else load_config(target, overrides or (), check_roots=False)
    export = target if config is None else config.export
    asked = Exploration(out, export, config, tuple(predictions or ()), tuple(navmesh_root or ()), before, views)
    answer(explore(asked), as_json)


def render(
    config: ConfigPath,
    name: Annotated[
        str,
        typer.Argument(
            metavar="SCENE|EPISODE", help="scene id (FAMILY/ID where several sources have it), or episode id"
        ),
    ],
    out: Annotated[
        Path, typer.Argument(metavar="OUT", help=".png for one sheet, .gif for a clip, else a folder of frames")
    ],
    camera: Annotated[
        str, typer.Option(metavar="PRESET", help="vlnce, streamvln, internvla-n1 or panorama")
    ] = "streamvln",
    position: Annotated[
        tuple[float, float, float] | None,
        typer.Option(metavar="X Y Z", help="where the agent stands in a scene, metres; by default a navigable point"),
    ] = None,
    heading: Annotated[
        float | None,
        typer.Option(
            metavar="DEGREES",
            help="where the camera looks, degrees clockwise from north; by default north, east, south and west",
        ),
    ] = None,
    overrides: Overrides = None,
    as_json: AsJson = False,
) -> None:
    """Draw a scene from a pose, or an episode along its gold path. No simulator is needed.

    A folder gets colours, depth in millimetres and instance numbers (index in the objects table plus 1) of each camera.
    """
    from jobs.configuration import load_config
    from jobs.render import render as render_scene

    loaded = load_config(config, overrides or ())
    answer(render_scene(loaded, name, out, camera=camera, position=position, heading=heading), as_json)
