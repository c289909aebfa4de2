"""Hook of mkdocs: files outside ``docs/`` become pages, and links between files become links between pages.

The Markdown files are written to be read in the repository, with links that work there. This is the one place that
knows which page each file becomes. It imports nothing of mkdocs until a site is built, so that the tests of links are
cheap.
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[2]

PAGES = {
    "README.md": "index.md",
    "CONTRIBUTING.md": "contributing.md",
    "CHANGELOG.md": "changelog.md",
    "deploy/README.md": "deploy.md",
    "examples/learned_agent/README.md": "learned_agent.md",
}
"""Page of each Markdown file outside ``docs/``."""

SHOWN = (
    "examples/own_agent.py",
    "examples/ray_job.py",
    "configs/replicacad.yaml",
    "configs/all-families.yaml",
    "deploy/condvln.yaml",
)
"""Files that the page of examples shows in full."""

COPIED = ("examples/tutorial.ipynb",)
"""Files that are copied into the site."""

_LINK = re.compile(r"(?<=\]\()([^)\s]+)(?=\))")
_CODE = re.compile(r"^```.*?^```", re.MULTILINE | re.DOTALL)


def anchor(name: str) -> str:
    """Return the anchor of a heading, as Python-Markdown makes it."""
    return re.sub(r"[-\s]+", "-", re.sub(r"[^\w\s-]", "", name).strip().lower())


def page_of(path: str) -> str:
    """Return the page (and anchor) that shows a file or folder of the repository; paths are relative to its root.

    Raises
    ------
    KeyError : the site does not show it
    """
    if path in PAGES:
        return PAGES[path]
    if path in SHOWN:
        return f"examples.md#{anchor(path)}"
    if path in COPIED:
        return path
    if path == "examples":
        return "examples.md"
    if path == "deploy":
        return "deploy.md"
    if path == "docs/decisions":
        return "decisions/index.md"
    if path.startswith("docs/") and (ROOT / path).is_file():
        return path.removeprefix("docs/")
    raise KeyError(path)


def links(markdown: str) -> Iterator[str]:
    """Yield the targets of the links in a text, except those in blocks of code."""
    yield from _LINK.findall(_CODE.sub("", markdown))


def with_page_links(markdown: str, source: str, page: str) -> str:
    """Return the text of the file `source` with its links turned into links from `page`; other links stay as they
    are."""

    def moved(found: re.Match[str]) -> str:
        target, _, fragment = found.group().partition("#")
        if not target or ":" in target:
            return found.group()
        path = os.path.normpath(os.path.join(os.path.dirname(source), target))
        try:
            shown, _, inside = page_of(path).partition("#")
        except KeyError:
            return found.group()  # the strict build reports it
        fragment = fragment or inside
        return os.path.relpath(shown, os.path.dirname(page) or ".") + (f"#{fragment}" if fragment else "")

    return _LINK.sub(moved, markdown)


def decisions() -> list[tuple[str, str]]:
    """Return (title, page) of each decision record, in order."""
    found = []
    for path in sorted((ROOT / "docs" / "decisions").glob("[0-9]*.md")):
        heading = path.read_text(encoding="utf-8").partition("\n")[0]
        found.append((heading.removeprefix("# "), f"decisions/{path.name}"))
    return found


def examples_page() -> str:
    """Return the text of the page of examples."""
    parts = [
        "# Examples\n\nThe [tutorial](docs/tutorial.md) as a notebook: [tutorial.ipynb](examples/tutorial.ipynb). "
        "The files below are in the repository, and the tests run them.\n"
    ]
    for name in SHOWN:
        text = (ROOT / name).read_text(encoding="utf-8")
        parts.append(f"## {name}\n\n```{'python' if name.endswith('.py') else 'yaml'}\n{text}```\n")
    return "\n".join(parts)


def decisions_page() -> str:
    """Return the text of the list of decisions."""
    lines = [f"* [{title}](docs/{page})" for title, page in decisions()]
    return "# Decisions\n\nShort records of why things are as they are.\n\n" + "\n".join(lines) + "\n"


def generated() -> dict[str, tuple[str, str]]:
    """Return, by page, (file that its links are relative to, text) of the pages that are not files of ``docs/``."""
    found = {page: (name, (ROOT / name).read_text(encoding="utf-8")) for name, page in PAGES.items()}
    found["examples.md"] = ("README.md", examples_page())
    found["decisions/index.md"] = ("README.md", decisions_page())
    return found


# ---- called by mkdocs


def on_files(files: Any, config: Any) -> Any:
    """Add the pages that are made of files outside ``docs/``."""
    from mkdocs.structure.files import File

    for page, (_, text) in generated().items():
        files.append(File.generated(config, page, content=text))
    for name in COPIED:
        files.append(File.generated(config, name, content=(ROOT / name).read_bytes()))
    return files


def on_page_markdown(markdown: str, page: Any, config: Any, files: Any) -> str:
    """Turn links between files into links between pages."""
    uri = page.file.src_uri
    source = generated()[uri][0] if uri in {*PAGES.values(), "examples.md", "decisions/index.md"} else f"docs/{uri}"
    return with_page_links(markdown, source, uri)
