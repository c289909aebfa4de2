"""The verb that runs another verb as a job of a cluster."""

from __future__ import annotations

import shlex
from typing import Annotated

import typer

from jobs.command.answers import answer, leave
from jobs.command.options import ConfigPath, Overrides
from schemas.errors import UsageError

__all__ = ["submit"]


def submit(
    context: typer.Context,
    config: ConfigPath,
    verb: Annotated[str, typer.Argument(metavar="VERB", help="plan, generate, rebuild, export, verify, …")],
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
    """Run a verb as a Ray Job on a cluster, and follow its log."""
    from jobs.submit import run_submit

    words = arguments or ()
    _check(context, verb, [str(config), *words])
    report = run_submit(config, verb, words, address=address, overrides=overrides or (), job=job, follow=follow)
    answer(report, False)
    leave(report.exit_code)


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
