"""The ``condvln`` command: its verbs, in the order in which its help lists them. Each verb calls a module of ``jobs``.

Starting is quick because a verb imports what it needs only when it is called.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from importlib.metadata import version
from typing import Annotated, Any, Final

import typer
from rich.console import Console
from typer.core import TyperGroup

from jobs.command import build, measure, publish, read
from jobs.command.options import EXIT_CODES
from schemas.errors import CondVLNError, UsageError
from schemas.standard_files import open_standard_files

__all__ = ["app", "main"]

EXPORT: Final = "out/replicacad/export val_unseen"
VERBS: Final[dict[str, dict[Callable[..., None], str]]] = {
    "Start": {build.demo: "--out out/demo"},
    "Build": {
        read.sources: "configs/replicacad.yaml",
        build.plan: "configs/replicacad.yaml --all",
        build.generate: "configs/replicacad.yaml --data replicacad=/data/replica_cad",
        read.status: "configs/replicacad.yaml",
        build.submit: "configs/replicacad.yaml generate --address http://head:8265",
    },
    "Look": {
        read.query: 'configs/replicacad.yaml "SELECT source, count(*) FROM episodes GROUP BY ALL"',
        read.show: "out/replicacad/export --sample 6",
        read.explore: "configs/replicacad.yaml --out out/page",
        read.render: "configs/replicacad.yaml v3_sc0_staging_00 sheet.png",
    },
    "Publish": {
        publish.export: "configs/replicacad.yaml",
        publish.trajectories: "configs/replicacad.yaml train --out out/training --layout navila",
    },
    "Check": {
        measure.verify: "configs/replicacad.yaml",
        measure.bias: "out/replicacad/export",
        measure.language: "out/replicacad/export",
    },
    "Agents": {
        measure.walk: f"{EXPORT} --agent nearest --out nearest.json",
        measure.serve: f"{EXPORT} --data replicacad=/data/replica_cad",
        measure.evaluate: f"{EXPORT} nearest.json",
    },
}
"""The verbs in groups, as the command's help lists them, each with the arguments of its example."""

REPLACED: Final = {
    "rebuild": "generate CONFIG --if-changed",
    "samples": "demo --family FAMILY --out DIR",
    "oracle": "export EXPORT SPLIT --oracle",
    "compose": "export CONFIG [SCENE] --compose OUT",
}
"""Verbs of older releases, with the command line that does the same."""

SETTINGS: Final[dict[Callable[..., None], dict[str, Any]]] = {
    build.submit: {"context_settings": {"ignore_unknown_options": True}},
    read.query: {"cls": read.SqlCommand},
}
WITH_EXIT_CODES: Final = {
    build.demo,
    build.generate,
    read.status,
    publish.export,
    publish.trajectories,
    measure.verify,
    measure.bias,
}


class Groups(TyperGroup):
    """The command, whose help lists its verbs in groups, each with the first sentence of its help."""

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:
        """Find the verb. Options of older releases are read by their new name; of older verbs, the new one is said."""
        if args[0] in REPLACED:
            raise UsageError(f"{args[0]} has another name now", remedy=f"Use condvln {REPLACED[args[0]]}.")
        if args[0] != "demo":
            args = [re.sub(r"^--(scenes|navmesh-root)(?==|$)", "--data", word) for word in args]
        return super().resolve_command(ctx, args)

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        """Write the verbs, group by group; those with verbs of their own come last."""
        groups = {name: [verb.__name__ for verb in verbs] for name, verbs in VERBS.items()}
        listed = {name for names in groups.values() for name in names}
        groups["Tools"] = [name for name in self.commands if name not in listed]
        for group, names in groups.items():
            rows = [(name, re.split(r"\.\s|\.$", str(self.commands[name].help))[0]) for name in names]
            with formatter.section(group):
                formatter.write_dl(rows)


app = typer.Typer(
    name="condvln",
    cls=Groups,
    help="Generate, prove, publish and evaluate conditional navigation instructions from indoor scenes.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
    epilog=f"{EXIT_CODES}\n\nBegin with condvln demo. The help of each verb ends with an example.",
)


def _print_version(asked: bool) -> None:
    if asked:
        typer.echo(f"condvln {version('condvln')}")
        raise typer.Exit


@app.callback()
def _options(
    asked: Annotated[
        bool, typer.Option("--version", callback=_print_version, is_eager=True, help="print the version and exit")
    ] = False,
) -> None:
    pass


for _verb, _example in (one for verbs in VERBS.values() for one in verbs.items()):
    _codes = f"{EXIT_CODES}\n\n" if _verb in WITH_EXIT_CODES else ""
    app.command(epilog=f"{_codes}Example: condvln {_verb.__name__} {_example}", **SETTINGS.get(_verb, {}))(_verb)
app.add_typer(measure.benchmarks, name="benchmark")
app.add_typer(read.navmeshes, name="navmesh")

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
