"""Verbs that build a dataset: demo, samples, plan, generate and rebuild."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from jobs.command.answers import answer, console, leave
from jobs.command.options import AsJson, ConfigPath, Inline, Overrides, RenewPriors, RetryQuarantined

__all__ = ["demo", "generate", "plan", "rebuild", "samples", "warm_up"]


def demo(
    out: Annotated[Path, typer.Option(help="folder to write to")] = Path("out/demo"),
    scenes: Annotated[int, typer.Option(min=1, help="number of synthetic apartments, over all formats")] = 12,
    seed: Annotated[int, typer.Option(help="seed of all random choices")] = 0,
    workers: Annotated[
        int | None, typer.Option(min=0, help="number of worker processes; 0 = run in this process")
    ] = None,
) -> None:
    """Run everything on synthetic scenes in four formats: generate, export, verify, walk, evaluate. Takes minutes."""
    from jobs.demo import run_demo

    leave(run_demo(out, scenes=scenes, seed=seed, workers=workers, console=console()))


def samples(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="folder to write the dataset to")],
    family: Annotated[
        str,
        typer.Option(
            help="native format of the scenes: gibson, hm3d, hssd, ithor, mp3d, procthor, replicacad, robothor or "
            "ai2thor-hab; the last is ProcTHOR in Habitat's format, with rooms from the JSON of its houses"
        ),
    ] = "replicacad",
    scenes: Annotated[int, typer.Option(min=1, help="number of scenes")] = 12,
    seed: Annotated[int, typer.Option(help="seed; scene k of a seed is the same however many scenes are made")] = 0,
    as_json: AsJson = False,
) -> None:
    """Write synthetic scenes in a family's native format, and print the source entry for a configuration."""
    from jobs.samples import write_samples

    answer(write_samples(folder, family=family, scenes=scenes, seed=seed), as_json)


def plan(
    config: ConfigPath,
    overrides: Overrides = None,
    every_scene: Annotated[bool, typer.Option("--all", help="print a row for each scene")] = False,
    as_json: AsJson = False,
) -> None:
    """Show what differs between the published snapshot and the sources, and what a run would cost. Runs nothing."""
    from jobs.configuration import load_config
    from jobs.plan import make_plan

    answer(make_plan(load_config(config, overrides or ()), every_scene=every_scene), as_json)


def generate(
    config: ConfigPath,
    overrides: Overrides = None,
    inline: Inline = False,
    retry_quarantined: RetryQuarantined = False,
    priors: RenewPriors = False,
    as_json: AsJson = False,
) -> None:
    """Run the plan and publish a snapshot; write the export if the configuration names one."""
    from jobs.configuration import load_config
    from jobs.generate import run_generate

    report = run_generate(
        load_config(config, overrides or ()),
        inline=inline,
        retry_quarantined=retry_quarantined,
        renew_priors=priors,
        console=console(quiet=as_json),
    )
    answer(report, as_json)
    leave(report.exit_code)


def rebuild(
    config: ConfigPath,
    overrides: Overrides = None,
    if_changed: Annotated[
        bool, typer.Option("--if-changed", help="end at once if no input file changed; compares names, sizes and times")
    ] = False,
    priors: RenewPriors = False,
    retry_quarantined: RetryQuarantined = False,
    verify: Annotated[
        bool, typer.Option("--verify", help="read every file that publishing depends on, and rebuild damaged ones")
    ] = False,
    inline: Inline = False,
    as_json: AsJson = False,
) -> None:
    """Bring the snapshot up to date from a scheduler: plan, run what changed, publish, export, sweep."""
    from jobs.configuration import load_config
    from jobs.rebuild import run_rebuild

    report = run_rebuild(
        load_config(config, overrides or ()),
        if_changed=if_changed,
        renew_priors=priors,
        retry_quarantined=retry_quarantined,
        verify=verify,
        inline=inline,
        console=console(quiet=as_json),
    )
    answer(report, as_json)
    leave(report.exit_code)


def warm_up(as_json: AsJson = False) -> None:
    """Compile all kernels now, on all cores. Later starts of any checkout on this machine load them from a cache."""
    from jobs.warm_up import compile_kernels

    answer(compile_kernels(lambda line: console().print(line, highlight=False)), as_json)
