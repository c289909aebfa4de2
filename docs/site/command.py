"""Generate ``docs/command.md``, the command reference, from the commands' own help.

``python docs/site/command.py`` renews ``docs/command.md``.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Final

from typer.main import get_command
from typer.testing import CliRunner

from jobs.command import app

__all__ = ["FILE", "command_paths", "reference"]

FILE: Final = Path(__file__).resolve().parents[1] / "command.md"
WIDTH: Final = 100


def command_paths() -> list[tuple[str, ...]]:
    """Return every command as the tuple of words that calls it, and each command group before the commands in it."""
    root = get_command(app)
    return [(), *_below(root, ())]


def _below(command: object, path: tuple[str, ...]) -> Iterator[tuple[str, ...]]:
    for name, inner in getattr(command, "commands", {}).items():
        yield (*path, name)
        yield from _below(inner, (*path, name))


def reference() -> str:
    """Return the text of ``docs/command.md``."""
    runner = CliRunner()
    parts = ["# The command", "Written from the commands' own `--help`; renew it with `python docs/site/command.py`."]
    for path in command_paths():
        result = runner.invoke(
            app, [*path, "--help"], prog_name="condvln", terminal_width=WIDTH, env={"COLUMNS": str(WIDTH)}
        )
        text = "\n".join(line.rstrip() for line in result.output.strip().splitlines())
        parts.append(f"## {' '.join(('condvln', *path))}\n\n```\n{text}\n```")
    return "\n\n".join(parts) + "\n"


if __name__ == "__main__":
    FILE.write_text(reference(), encoding="utf-8")
