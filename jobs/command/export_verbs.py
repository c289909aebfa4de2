"""Verbs that write files for agents and loaders: exports, oracle twins (texts without conditions), composed scenes."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated

import typer

from jobs.command.answers import answer, console, leave
from jobs.command.options import (
    AsJson,
    ConfigPath,
    ExportPath,
    Graphs,
    NavmeshRoots,
    Overrides,
    SplitName,
)
from schemas.errors import UsageError

__all__ = ["compose", "export", "oracle"]


def export(
    config: Annotated[Path | None, typer.Argument(metavar="CONFIG", help="YAML configuration of the run")] = None,
    validate: Annotated[
        Path | None,
        typer.Option(
            "--validate",
            metavar="PATH",
            help="export nothing; lint the VLN-CE, ANSR-v1, RxR and R2R files below this path, from "
            "CondVLN or elsewhere",
        ),
    ] = None,
    navmesh_root: NavmeshRoots = None,
    connectivity: Graphs = None,
    allow_shrink: Annotated[
        bool,
        typer.Option("--allow-shrink", help="replace the export in place even if the new one has fewer episodes"),
    ] = False,
    overrides: Overrides = None,
    as_json: AsJson = False,
) -> None:
    """Write splits, ground truth and manifests from the snapshot; or lint such files (exit code 3 on errors)."""
    if validate is not None:
        from jobs.validate import validate_files

        found = validate_files(validate, navmesh_root or (), connectivity or ())
        if as_json:
            answer(found, as_json)
        else:
            sys.stdout.write(found.as_text())
        leave(found.exit_code)
        return
    if config is None:
        raise UsageError("a configuration or --validate must be given", remedy="Use condvln export CONFIG.")
    from jobs.configuration import load_config
    from jobs.export import run_export

    report = run_export(load_config(config, overrides or (), check_roots=False), allow_shrink=allow_shrink)
    answer(report, as_json)
    leave(report.exit_code)


def oracle(
    export: ExportPath,
    split: SplitName,
    file: Annotated[
        Path | None,
        typer.Option(
            "--file", help="VLN-CE, ANSR-v1 or RxR file of the split's episodes; by default the export's file in vlnce/"
        ),
    ] = None,
    out: Annotated[
        Path | None, typer.Option("--out", help="file to write; by default oracle/SPLIT/SPLIT.json.gz of the export")
    ] = None,
    seed: Annotated[int | None, typer.Option(help="seed of the wording; by default the export's own")] = None,
    scenes: Annotated[
        list[str] | None,
        typer.Option(
            "--scenes",
            metavar="FAMILY=DIR",
            help="in place of the gold branch, write the branch that looker picks when it sees the scenes in this "
            "dataset; may be repeated",
        ),
    ] = None,
    looker: Annotated[
        list[str] | None,
        typer.Option(
            "--looker", metavar="KEY=VALUE", help="set a key of looker, such as noise.missed=0.1; may be repeated"
        ),
    ] = None,
    navmesh_root: NavmeshRoots = None,
    as_json: AsJson = False,
) -> None:
    """Write the oracle-linear twin of a split: the same episodes, with the right branch as a plain instruction."""
    from jobs.looker import looker_picks
    from jobs.oracle import oracle_split

    picks = None
    if scenes or looker:
        picks = looker_picks(export, split, scenes or (), looker or (), navmesh_root or (), seed or 0)
        out = out or export / "looker" / split / f"{split}.json.gz"
    answer(oracle_split(export, split, file=file, out=out, seed=seed, picks=picks), as_json)


def compose(
    config: ConfigPath,
    scene: Annotated[
        str | None,
        typer.Argument(metavar="SCENE", help="scene id; FAMILY/ID if several sources have a scene of this id"),
    ] = None,
    out: Annotated[
        Path | None, typer.Argument(metavar="OUT.glb", help="file to write; the scene's navmesh is written beside it")
    ] = None,
    every: Annotated[
        Path | None,
        typer.Option(
            "--all",
            metavar="DIR",
            help="compose every scene of the export or, without an export, of the sources; DIR is the loader's "
            "data/scene_datasets, and a scene's path below it is the one that the scene's episodes name",
        ),
    ] = None,
    own_navmesh: Annotated[
        bool,
        typer.Option(
            "--own-navmesh",
            help="write the navmesh that the episodes were placed on: the dataset's own or, with --all, "
            "one that the export keeps",
        ),
    ] = False,
    overrides: Overrides = None,
    as_json: AsJson = False,
) -> None:
    """Write a scene's parts as one GLB with its navmesh, for loaders that open one file for each scene."""
    from jobs.configuration import load_config

    loaded = load_config(config, overrides or ())
    if every is not None and scene is None:
        from jobs.compose_all import compose_all

        report = compose_all(loaded, every, own_navmesh=own_navmesh, console=console(quiet=as_json))
    elif every is None and scene is not None and out is not None:
        from jobs.compose import compose as compose_scene

        report = compose_scene(loaded, scene, out, own_navmesh=own_navmesh)
    else:
        raise UsageError(
            "give either SCENE and OUT.glb, or --all DIR",
            remedy="Use condvln compose CONFIG SCENE OUT.glb, or condvln compose CONFIG --all DIR.",
        )
    answer(report, as_json)
    leave(report.exit_code)
