"""Verbs that write files for agents and loaders: exports, oracle twins (texts without conditions), composed scenes,
training data.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Final

import typer

from jobs.command.options import AsJson, Inline, Overrides, RetryQuarantined
from jobs.report import answer, console
from schemas.errors import UsageError

__all__ = ["export", "trajectories"]


def export(
    target: Annotated[
        Path,
        typer.Argument(
            metavar="CONFIG|EXPORT", help="YAML configuration of the run; with --oracle, an export's folder"
        ),
    ],
    name: Annotated[
        str | None,
        typer.Argument(
            metavar="SPLIT|SCENE",
            help="split for --oracle; scene for --compose, FAMILY/ID if several sources have one of this id",
        ),
    ] = None,
    allow_shrink: Annotated[
        bool,
        typer.Option("--allow-shrink", help="replace the export in place even if the new one has fewer episodes"),
    ] = False,
    oracle: Annotated[
        bool,
        typer.Option(
            "--oracle",
            help="write the oracle-linear twin of a split: the same episodes, with the right branch as a plain "
            "instruction",
        ),
    ] = False,
    file: Annotated[
        Path | None,
        typer.Option(help="VLN-CE, ANSR-v1 or RxR file of the twin's episodes; by default the export's file in vlnce/"),
    ] = None,
    out: Annotated[
        Path | None, typer.Option(help="file of the twin; by default oracle/SPLIT/SPLIT.json.gz of the export")
    ] = None,
    seed: Annotated[int | None, typer.Option(help="seed of the twin's wording; by default the export's own")] = None,
    looker: Annotated[
        list[str] | None,
        typer.Option(
            metavar="KEY=VALUE",
            help="in place of the twin's gold branch, write the one that looker picks in the scenes of --data, with "
            "this key, such as noise.missed=0.1; may be repeated",
        ),
    ] = None,
    compose: Annotated[
        Path | None,
        typer.Option(
            "--compose",
            metavar="OUT",
            help="write every scene's parts as one GLB with its navmesh, for loaders that open one file a scene; "
            "OUT is the loader's data/scene_datasets, and a scene's path below it is the one that its episodes name. "
            "With SCENE, that scene alone, to the file OUT.glb",
        ),
    ] = None,
    own_navmesh: Annotated[
        bool,
        typer.Option(
            "--own-navmesh",
            help="beside composed scenes, write the navmesh that the episodes were placed on: the dataset's own or, "
            "for all scenes, one that the export keeps",
        ),
    ] = False,
    overrides: Overrides = None,
    as_json: AsJson = False,
) -> None:
    """Write splits, ground truth and manifests from the snapshot; or a split's oracle twin, or composed scenes."""
    from jobs.configuration import load_config

    if oracle and name is not None and compose is None:
        from jobs.agents import looker_picks
        from jobs.export_origin import data_of
        from jobs.oracle import oracle_split

        picks = None
        if overrides or looker:
            picks = looker_picks(target, name, data_of(target, overrides), looker or (), seed or 0)
            out = out or target / "looker" / name / f"{name}.json.gz"
        report = oracle_split(target, name, file=file, out=out, seed=seed, picks=picks)
    elif compose is not None and not oracle:
        from jobs.compose import compose as compose_scene
        from jobs.compose import compose_all

        loaded = load_config(target, overrides or ())
        if name is None:
            report = compose_all(loaded, compose, own_navmesh=own_navmesh, console=console(quiet=as_json))
        else:
            report = compose_scene(loaded, name, compose, own_navmesh=own_navmesh)
    elif name is None and not oracle:
        from jobs.export import run_export

        report = run_export(load_config(target, overrides or (), check_roots=False), allow_shrink=allow_shrink)
    else:
        raise UsageError(
            "this is neither an export, nor a twin, nor composed scenes",
            remedy="Use condvln export CONFIG, EXPORT SPLIT --oracle, or CONFIG [SCENE] --compose OUT.",
        )
    answer(report, as_json)


_OF_A_RECIPE: Final = {
    "split": "SPLIT",
    "layout": "--layout",
    "camera": "--camera",
    "sweep": "--sweep",
    "walks": "--walks",
    "keys": "--walk",
    "recipe_only": "--recipe-only",
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
    split: Annotated[str, typer.Argument(metavar="[SPLIT]", help="train, val_seen, val_unseen or test")] = "train",
    layout: Annotated[
        list[str] | None,
        typer.Option(
            "--layout",
            metavar="NAME",
            help="streamvln (the default), navila, janusvln, internvla-n1 (turns of 15°), snav, uninavid (turns of "
            "30°), lerobot (any); may be repeated where the turns are the same",
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
            "--walks",
            metavar="KIND",
            help="looking (default): sees the evidence of each condition before it acts on it; direct: the shortest "
            "walk, which teaches turns before the frames justify them; oracle; recovery; may be repeated",
        ),
    ] = None,
    keys: Annotated[
        list[str] | None,
        typer.Option(
            "--walk", metavar="KEY=VALUE", help="set a key of the walks, such as jpeg_quality=80; may be repeated"
        ),
    ] = None,
    workers: Annotated[
        int | None, typer.Option(min=1, help="number of Ray workers; by default as many as the work needs")
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
            help="make the walks and images of a recipe again from your own copy of its datasets (--data)",
        ),
    ] = None,
    retry_quarantined: RetryQuarantined = False,
    overrides: Overrides = None,
    as_json: AsJson = False,
) -> None:
    """Make training data from a split: walks, images and poses in the layouts that agents' loaders read."""
    from condvln.trajectories.cameras import sweep_of
    from jobs.export_origin import data_of
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
    given = tuple(data_of(Path(target), overrides) if target and Path(target).is_dir() else overrides or ())
    request = Request(
        target=target or "",
        out=out,
        split=split,
        layouts=tuple(dict.fromkeys(layout or ("streamvln",))),
        camera=camera,
        config=trajectory_config(walks or (), keys or ()),
        scenes=given,
        overrides=given,
        workers=workers,
        inline=inline,
        plan=plan,
        retry=retry_quarantined,
        licensed=licensed,
        recipe_only=recipe_only,
        recipe=from_recipe,
        sweep=sweep_of(sweep or ()),
    )
    answer(make_trajectories(request, console(quiet=as_json)), as_json)


def _is_given(context: typer.Context, name: str) -> bool:
    """Return whether the command line sets a parameter, to the default or to another value."""
    source = context.get_parameter_source(name)
    return source is not None and source.name == "COMMANDLINE"
