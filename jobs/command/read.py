"""Verbs that read sources, stores, published tables, episodes and navmeshes."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer
from typer.core import TyperCommand

from jobs.command.options import EXIT_CODES, AsJson, ConfigPath, Overrides, RefName, TargetName
from jobs.report import answer, console
from schemas.errors import UsageError

__all__ = ["SqlCommand", "explore", "navmeshes", "query", "render", "show", "sources", "status"]


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

    answer(survey(load_config(config, overrides or ()), limit=limit, console=console(quiet=as_json)), as_json)


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
    from jobs.workspace import find_target

    found = find_target(target, overrides or (), ref)
    answer(target_status(found, measure_drift=drift, sizes=sizes), as_json)


class SqlCommand(TyperCommand):
    """A command with an argument of SQL, which may begin with a comment (``-- …``) that looks like an option."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Parse the arguments, the SQL last."""
        options = {name for param in self.params for name in param.opts}
        sql = [
            arg
            for arg in args
            if arg.startswith("--") and len(arg.split()) > 1 and arg.partition("=")[0] not in options
        ]
        if sql and "--" not in args:
            args = [*(arg for arg in args if arg not in sql), "--", *sql]
        return super().parse_args(ctx, args)


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
    from jobs.workspace import find_target

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
    overrides: Overrides = None,
    as_json: AsJson = False,
) -> None:
    """Show episodes: text, tree, truths, paths, and a top-down picture.

    If a source has no navmesh, and so instructions without episodes, these are shown.
    """
    if target.is_dir():
        from jobs.agents import folders_of
        from jobs.export_origin import data_of
        from jobs.show import show_export

        roots = folders_of(data_of(target, overrides))[1]
        answer(show_export(target, episode=episode, sample=sample, picture=picture, roots=roots), as_json)
        return
    from jobs.configuration import load_config
    from jobs.show import show_episodes

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
    overrides: Overrides = None,
    as_json: AsJson = False,
) -> None:
    """Write a page that shows scenes, trees, evidence, paths, statistics and agents; open it in a browser.

    The page needs no server and no network. With a configuration it shows rooms, furniture and relations too; an export
    alone has navmeshes and no furniture.
    """
    from jobs.agents import folders_of
    from jobs.configuration import load_config
    from jobs.explore import Exploration, explore
    from jobs.export_origin import data_of

    whole = target.is_dir()
    roots = folders_of(data_of(target, overrides))[1] if whole else ()
    config = None if whole else load_config(target, overrides or (), check_roots=False)
    export = target if config is None else config.export
    asked = Exploration(out, export, config, tuple(predictions or ()), tuple(roots), before, views)
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
        typer.Option(metavar="X Y Z", help="position of the agent in a scene, metres; default: a navigable point"),
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


navmeshes = typer.Typer(help="Build, inspect, compare and draw navmeshes.", no_args_is_help=True, rich_markup_mode=None)

NavmeshPath = Annotated[Path, typer.Argument(metavar="FILE", help="a .navmesh file")]


@navmeshes.command("build")
def navmesh_build(
    mesh: Annotated[Path, typer.Argument(metavar="MESH", help="GLB, PLY, OBJ …, in Habitat's frame")],
    out: Annotated[Path, typer.Argument(metavar="OUT", help="the .navmesh file to write")],
    settings: Annotated[
        list[str] | None,
        typer.Option("--set", metavar="NAME=VALUE", help="set a field of NavMeshSettings; may be repeated"),
    ] = None,
    profile: Annotated[str, typer.Option(help="Recast version: habitat>=0.3.4 or habitat<=0.3.3")] = "habitat>=0.3.4",
    as_json: AsJson = False,
) -> None:
    """Build the navmesh that Habitat would build, byte for byte."""
    from jobs.navmesh import build, settings_of

    answer(build(mesh, out, settings_of(settings or ()), profile, console(quiet=as_json)), as_json)


@navmeshes.command("info")
def navmesh_info(file: NavmeshPath, as_json: AsJson = False) -> None:
    """Print settings, size and islands of a navmesh."""
    from jobs.navmesh import info

    answer(info(file), as_json)


@navmeshes.command("compare", epilog=EXIT_CODES)
def navmesh_compare(
    first: Annotated[Path, typer.Argument(metavar="A")],
    second: Annotated[Path, typer.Argument(metavar="B")],
    as_json: AsJson = False,
) -> None:
    """Name the first build stage at which two navmeshes differ (exit code 3)."""
    from jobs.navmesh import compare

    answer(compare(first, second), as_json)


@navmeshes.command("picture")
def navmesh_picture(file: NavmeshPath, out: Annotated[Path, typer.Argument(metavar="OUT.png")]) -> None:
    """Draw a navmesh from above, each island in its own colour."""
    from jobs.navmesh import picture

    answer(picture(file, out), False)
