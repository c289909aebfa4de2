"""Generate the command reference, three pages, from the commands' own help.

``python docs/site/command.py`` renews ``docs/command.md`` and the pages beside it.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Final

from typer.main import get_command
from typer.testing import CliRunner

from jobs.command import app

__all__ = ["PAGES", "command_paths", "reference"]

_DOCS: Final = Path(__file__).resolve().parents[1]
PAGES: Final = {
    _DOCS / "command.md": ("Commands that make and show episodes", ""),
    _DOCS / "command_measure.md": ("Commands that publish, check and measure", "export"),
    _DOCS / "command_tools.md": ("Commands for benchmarks and navmeshes", "benchmark"),
}
"""Title of each page, and the first command on it."""
WIDTH: Final = 100


def command_paths() -> list[tuple[str, ...]]:
    """Return every command as the tuple of words that calls it, and each command group before the commands in it."""
    root = get_command(app)
    return [(), *_below(root, ())]


def _below(command: object, path: tuple[str, ...]) -> Iterator[tuple[str, ...]]:
    for name, inner in getattr(command, "commands", {}).items():
        yield (*path, name)
        yield from _below(inner, (*path, name))


def reference() -> dict[Path, str]:
    """Return the text of each page."""
    runner = CliRunner()
    first = {verb: page for page, (_, verb) in PAGES.items()}
    texts: dict[Path, list[str]] = {}
    for path in command_paths():
        page = first.get(" ".join(path))
        if page is not None:
            said = "Written from the commands' own `--help`; renew it with `python docs/site/command.py`."
            parts = texts.setdefault(page, [f"# {PAGES[page][0]}", said])
        result = runner.invoke(
            app, [*path, "--help"], prog_name="condvln", terminal_width=WIDTH, env={"COLUMNS": str(WIDTH)}
        )
        text = "\n".join(line.rstrip() for line in result.output.strip().splitlines())
        parts.append(f"## {' '.join(('condvln', *path))}\n\n```\n{text}\n```")
    return {page: "\n\n".join(parts) + "\n" for page, parts in texts.items()}


if __name__ == "__main__":
    for file, written in reference().items():
        file.write_text(written, encoding="utf-8")
