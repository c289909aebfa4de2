"""The ``condvln`` command: its verbs, in the order in which its help lists them. Each verb calls a module of ``jobs``.

Starting is quick because a verb imports what it needs only when it is called.
"""

from __future__ import annotations

from typing import Final

import typer
from rich.console import Console

from jobs.command import (
    benchmark,
    build_verbs,
    evaluation_verbs,
    export_verbs,
    navmesh,
    query_verbs,
    submit_verb,
    trajectories_verb,
)
from jobs.command.options import EXIT_CODES
from schemas.errors import CondVLNError
from schemas.standard_files import open_standard_files

__all__ = ["app", "main"]

app = typer.Typer(
    name="condvln",
    help="Generate, prove, publish and evaluate conditional navigation instructions from indoor scenes.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
)

app.command(epilog=EXIT_CODES)(build_verbs.demo)
app.command()(build_verbs.samples)
app.command()(build_verbs.warm_up)
app.command()(query_verbs.sources)
app.command()(build_verbs.plan)
app.command(epilog=EXIT_CODES)(build_verbs.generate)
app.command(epilog=EXIT_CODES)(build_verbs.rebuild)
app.command(epilog=EXIT_CODES)(query_verbs.status)
app.command(
    epilog="The exit code is that of the verb; 130 after Ctrl-C, when the job goes on.",
    context_settings={"ignore_unknown_options": True},
)(submit_verb.submit)
app.command(epilog=EXIT_CODES)(export_verbs.export)
app.command()(export_verbs.oracle)
app.command(epilog=EXIT_CODES)(export_verbs.compose)
app.command(epilog=EXIT_CODES)(trajectories_verb.trajectories)
app.command()(query_verbs.query)
app.command()(query_verbs.show)
app.command()(query_verbs.explore)
app.command()(query_verbs.render)
app.command(epilog=EXIT_CODES)(evaluation_verbs.verify)
app.command()(evaluation_verbs.walk)
app.command()(evaluation_verbs.serve)
app.command()(evaluation_verbs.evaluate)
app.command()(evaluation_verbs.language)
app.command(epilog=EXIT_CODES)(evaluation_verbs.bias)
app.add_typer(benchmark.group, name="benchmark")
app.add_typer(navmesh.group, name="navmesh")

CLICK_USAGE: Final = 2
"""Exit code of the command-line library for wrong usage; CondVLN's is 1."""


def main() -> None:
    """Entry point. CondVLN's errors, and system errors that name a file, become one message and an exit code."""
    open_standard_files()
    try:
        app()
    except CondVLNError as error:
        Console(stderr=True, highlight=False, soft_wrap=True).print(f"condvln: {error}", markup=False)
        raise SystemExit(error.exit_code) from None
    except OSError as error:
        # A folder that can't be made, a file that may not be written, a full disk: whoever met it, the person can act.
        if error.errno is None:
            raise
        place = "" if error.filename is None else f"{error.filename}: "
        told = f"condvln: {place}{error.strerror}. Check the path, its permissions and the room on the disk."
        Console(stderr=True, highlight=False, soft_wrap=True).print(told, markup=False)
        raise SystemExit(1) from None
    except SystemExit as stop:
        raise SystemExit(1 if stop.code == CLICK_USAGE else stop.code) from None
