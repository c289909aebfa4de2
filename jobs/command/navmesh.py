"""The verbs of ``condvln navmesh``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from jobs.command.answers import answer, console, leave
from jobs.command.options import EXIT_CODES, AsJson

__all__ = ["group"]


group = typer.Typer(help="Build, inspect, compare and draw navmeshes.", no_args_is_help=True, rich_markup_mode=None)

NavmeshPath = Annotated[Path, typer.Argument(metavar="FILE", help="a .navmesh file")]


@group.command("build")
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


@group.command("info")
def navmesh_info(file: NavmeshPath, as_json: AsJson = False) -> None:
    """Print settings, size and islands of a navmesh."""
    from jobs.navmesh import info

    answer(info(file), as_json)


@group.command("compare", epilog=EXIT_CODES)
def navmesh_compare(
    first: Annotated[Path, typer.Argument(metavar="A")],
    second: Annotated[Path, typer.Argument(metavar="B")],
    as_json: AsJson = False,
) -> None:
    """Name the first build stage at which two navmeshes differ (exit code 3)."""
    from jobs.navmesh import compare

    report = compare(first, second)
    answer(report, as_json)
    leave(report.exit_code)


@group.command("picture")
def navmesh_picture(file: NavmeshPath, out: Annotated[Path, typer.Argument(metavar="OUT.png")]) -> None:
    """Draw a navmesh from above, each island in its own colour."""
    from jobs.navmesh import picture

    answer(picture(file, out), False)
