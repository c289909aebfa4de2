"""The verb that makes training data."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from jobs.command.answers import answer, console, leave
from jobs.command.options import AsJson, Inline, NavmeshRoots, Overrides, RetryQuarantined

__all__ = ["trajectories"]


def trajectories(
    target: Annotated[
        str, typer.Argument(metavar="CONFIG|EXPORT", help="YAML configuration of the run, or folder of an export")
    ],
    out: Annotated[Path, typer.Option("--out", metavar="DIR", help="folder to write, outside of the export")],
    split: Annotated[str, typer.Option(help="train, val_seen, val_unseen or test")] = "train",
    layout: Annotated[
        list[str] | None,
        typer.Option(
            "--layout",
            metavar="NAME",
            help="streamvln (always written, since the others name or link its images), navila, uninavid, janusvln, "
            "internvla-n1; may be repeated",
        ),
    ] = None,
    camera: Annotated[str, typer.Option(help="main camera: streamvln, snav or vlnce")] = "streamvln",
    walks: Annotated[
        list[str] | None,
        typer.Option("--walks", metavar="KIND", help="gold, oracle or recovery; may be repeated (default: gold)"),
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
        int | None, typer.Option(min=1, help="number of Ray workers; by default as many as the work needs")
    ] = None,
    inline: Inline = False,
    plan: Annotated[bool, typer.Option("--plan", help="only print what would be made and what it would cost")] = False,
    retry_quarantined: RetryQuarantined = False,
    overrides: Overrides = None,
    as_json: AsJson = False,
) -> None:
    """Make training data from a split: walks, images and poses in the layouts that agents' loaders read."""
    from jobs.trajectories import Request, make_trajectories, trajectory_config

    request = Request(
        target=target,
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
    )
    report = make_trajectories(request, console(quiet=as_json))
    answer(report, as_json)
    leave(report.exit_code)
