"""Verbs that build a dataset: demo, plan, generate and submit."""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import Annotated, Any

import typer

from jobs.command.options import AsJson, ConfigPath, Inline, Overrides, RenewPriors, RetryQuarantined
from jobs.report import answer, console
from schemas.errors import UsageError

__all__ = ["demo", "generate", "plan", "submit"]


def demo(
    out: Annotated[Path, typer.Option(help="folder to write to")] = Path("out/demo"),
    family: Annotated[
        str | None,
        typer.Option(
            help="only write scenes in this native format, and print the source entry for a configuration: boxes, "
            "gibson, hm3d, hssd, ithor, mp3d, procthor, replicacad, robothor or ai2thor-hab; the last is ProcTHOR in "
            "Habitat's format, with rooms from the JSON of its houses"
        ),
    ] = None,
    scenes: Annotated[int, typer.Option(min=1, help="number of synthetic apartments, over all formats")] = 12,
    seed: Annotated[int, typer.Option(help="seed of all random choices")] = 0,
    workers: Annotated[int, typer.Option(min=1, help="number of Ray workers; 1 = run in this process")] = 2,
    as_json: Annotated[bool, typer.Option("--json", help="with --family, print one JSON document")] = False,
) -> None:
    """Run everything on synthetic scenes in four formats: generate, export, verify, walk, evaluate. Takes minutes."""
    from jobs.demo import run_demo, write_samples

    if family is not None:
        answer(write_samples(out, family=family, scenes=scenes, seed=seed), as_json)
    else:
        raise typer.Exit(run_demo(out, scenes=scenes, seed=seed, workers=workers, console=console()))


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
    if_changed: Annotated[
        bool,
        typer.Option(
            "--if-changed",
            help="for schedulers: end at once if no input file changed, else also sweep the store; compares names, "
            "sizes and times, so other bytes under the same size and time need --verify",
        ),
    ] = False,
    verify: Annotated[
        bool,
        typer.Option(
            "--verify",
            help="hash every source file again, read every file that publishing depends on, and rebuild what differs",
        ),
    ] = False,
    inline: Inline = False,
    retry_quarantined: RetryQuarantined = False,
    priors: RenewPriors = False,
    as_json: AsJson = False,
) -> None:
    """Run the plan and publish a snapshot; write the export if the configuration names one."""
    from jobs.configuration import load_config

    loaded = load_config(config, overrides or ())
    how: dict[str, Any] = {
        "inline": inline,
        "retry_quarantined": retry_quarantined,
        "renew_priors": priors,
        "console": console(quiet=as_json),
    }
    if if_changed or verify:
        from jobs.rebuild import run_rebuild

        answer(run_rebuild(loaded, if_changed=if_changed, verify=verify, **how), as_json)
    else:
        from jobs.generate import run_generate

        answer(run_generate(loaded, **how), as_json)


def submit(
    context: typer.Context,
    config: ConfigPath,
    verb: Annotated[str, typer.Argument(metavar="VERB", help="plan, generate, export, verify, …")],
    arguments: Annotated[
        list[str] | None, typer.Argument(metavar="ARGUMENTS...", help="further arguments of the verb")
    ] = None,
    address: Annotated[
        str,
        typer.Option(metavar="URL", envvar="RAY_API_SERVER_ADDRESS", help="dashboard of the cluster, http://HOST:8265"),
    ] = "http://127.0.0.1:8265",
    overrides: Overrides = None,
    job: Annotated[
        str | None,
        typer.Option(
            "--id", metavar="ID", help="submission id; if a job of this id exists, it is followed and none is submitted"
        ),
    ] = None,
    follow: Annotated[bool, typer.Option(help="follow the log until the job ends")] = True,
) -> None:
    """Run a verb as a Ray Job on a cluster, and follow its log.

    The exit code is that of the verb; 130 after Ctrl-C, when the job goes on.
    """
    from jobs.submit import run_submit

    words = arguments or ()
    _check(context, verb, [str(config), *words])
    answer(run_submit(config, verb, words, address=address, overrides=overrides or (), job=job, follow=follow), False)


def _check(context: typer.Context, verb: str, words: list[str]) -> None:
    """Check the submitted verb's command line on this machine, so that its job does not fail only after waiting for a
    node.
    """
    from jobs.submit import VERBS

    if verb not in VERBS:
        raise UsageError(f"{verb!r} can't be submitted", remedy=f"These can: {', '.join(VERBS)}.")
    command = context.find_root().command.commands[verb]  # type: ignore[attr-defined]
    try:
        command.make_context(verb, words)
    except typer.Exit:
        raise UsageError(
            f"the help of {verb} is not submitted as a job", remedy=f"Run condvln {verb} --help."
        ) from None
    except Exception as error:
        # The library's own errors, whose class depends on its version (it brings its own copy of click, or not).
        told = getattr(error, "format_message", None)
        if told is None:
            raise
        raise UsageError(f"{verb} {shlex.join(words[1:])}: {told()}", remedy=f"See condvln {verb} --help.") from None
