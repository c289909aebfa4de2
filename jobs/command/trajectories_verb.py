"""The verb that makes training data."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Final

import typer

from jobs.command.answers import answer, console, leave
from jobs.command.options import AsJson, Inline, NavmeshRoots, Overrides, RetryQuarantined
from schemas.errors import UsageError

__all__ = ["trajectories"]


_OF_A_RECIPE: Final = {
    "split": "--split",
    "layout": "--layout",
    "camera": "--camera",
    "sweep": "--sweep",
    "walks": "--walks",
    "keys": "--walk",
    "navmesh_root": "--navmesh-root",
    "recipe_only": "--recipe-only",
    "overrides": "--set",
}
"""Options that a recipe decides, by parameter."""


def trajectories(
    context: typer.Context,
    out: Annotated[Path, typer.Option("--out", metavar="DIR", help="folder to write, outside of the export")],
    target: Annotated[
        str | None,
        typer.Argument(
            metavar="CONFIG|EXPORT",
            help="YAML configuration of the run, or folder of an export; none with --from-recipe",
        ),
    ] = None,
    split: Annotated[str, typer.Option(help="train, val_seen, val_unseen or test")] = "train",
    layout: Annotated[
        list[str] | None,
        typer.Option(
            "--layout",
            metavar="NAME",
            help="streamvln (always written, since the others name or link its images), navila, uninavid, janusvln, "
            "internvla-n1, lerobot; may be repeated",
        ),
    ] = None,
    camera: Annotated[str, typer.Option(help="main camera: streamvln, snav or vlnce")] = "streamvln",
    sweep: Annotated[
        list[str] | None,
        typer.Option(
            "--sweep",
            metavar="KEY=VALUE,…",
            help="add variants of the main camera: height (metres), pitch (degrees down), hfov (degrees), size "
            "(WIDTHxHEIGHT), images (rgb, depth); may be repeated, and all combinations are made",
        ),
    ] = None,
    walks: Annotated[
        list[str] | None,
        typer.Option(
            "--walks", metavar="KIND", help="gold, oracle, recovery or exploration; may be repeated (default: gold)"
        ),
    ] = None,
    keys: Annotated[
        list[str] | None,
        typer.Option(
            "--walk", metavar="KEY=VALUE", help="set a key of the walks, such as jpeg_quality=80; may be repeated"
        ),
    ] = None,
    scenes: Annotated[
        list[str] | None,
        typer.Option(
            "--scenes", metavar="FAMILY=DIR", help="dataset of the EXPORT's scenes; may be repeated; not with CONFIG"
        ),
    ] = None,
    navmesh_root: NavmeshRoots = None,
    workers: Annotated[
        int | None, typer.Option(min=1, help="number of worker processes; by default as many as the work needs")
    ] = None,
    inline: Inline = False,
    plan: Annotated[bool, typer.Option("--plan", help="only print what would be made and what it would cost")] = False,
    licensed: Annotated[
        bool,
        typer.Option(
            "--licensed",
            help="you have accepted the terms of scans whose images must not be passed on (Matterport3D, HM3D, "
            "Gibson), and keep the images to yourself",
        ),
    ] = False,
    recipe_only: Annotated[
        bool,
        typer.Option(
            "--recipe-only",
            help="write what may be shared of any scan: walks, poses, cameras and hashes of images, without images",
        ),
    ] = False,
    from_recipe: Annotated[
        Path | None,
        typer.Option(
            "--from-recipe",
            metavar="DIR",
            help="make the walks and images of a recipe again from your own copy of its datasets (--scenes)",
        ),
    ] = None,
    retry_quarantined: RetryQuarantined = False,
    overrides: Overrides = None,
    as_json: AsJson = False,
) -> None:
    """Make training data from a split: walks, images and poses in the layouts that agents' loaders read."""
    from condvln.trajectories.cameras import sweep_of
    from jobs.trajectories import Request, make_trajectories, trajectory_config

    if (target is None) == (from_recipe is None):
        raise UsageError(
            "name either CONFIG|EXPORT or --from-recipe DIR", remedy="See condvln trajectories --help for examples."
        )
    decided = [option for name, option in _OF_A_RECIPE.items() if _is_given(context, name)]
    if from_recipe is not None and decided:
        raise UsageError(
            "split, layouts, cameras and walks are those of the recipe, with all images",
            place="--from-recipe",
            remedy=f"Leave out {', '.join(decided)}.",
        )
    request = Request(
        target=target or "",
        out=out,
        split=split,
        layouts=tuple(dict.fromkeys(layout or ("streamvln",))),
        camera=camera,
        config=trajectory_config(walks or (), keys or ()),
        scenes=tuple(scenes or ()),
        roots=tuple(navmesh_root or ()),
        overrides=tuple(overrides or ()),
        workers=workers,
        inline=inline,
        plan=plan,
        retry=retry_quarantined,
        licensed=licensed,
        recipe_only=recipe_only,
        recipe=from_recipe,
        sweep=sweep_of(sweep or ()),
    )
    report = make_trajectories(request, console(quiet=as_json))
    answer(report, as_json)
    leave(report.exit_code)


def _is_given(context: typer.Context, name: str) -> bool:
    """Return whether the command line sets a parameter, to the default or to another value."""
    source = context.get_parameter_source(name)
    return source is not None and source.name == "COMMANDLINE"
