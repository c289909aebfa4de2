"""The documentation: links, navigation, API pages, the figure and every command line; in the soak, the strict build."""

from __future__ import annotations

import os
import pkgutil
import re
import shlex
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import yaml
from typer.main import get_command
from typer.testing import CliRunner

import condvln
from condvln.samples import make_samples
from jobs.command import app
from tests.site_parts import part

REPOSITORY = Path(__file__).resolve().parents[1]
FENCE = re.compile(r"^```(\w*)\n(.*?)^```", re.MULTILINE | re.DOTALL)
NOT_RUN = ("submit",)
"""Verbs that need a cluster; ``tests/jobs/test_submit.py`` has a job server."""


PAGES = part("pages")


def documents() -> list[str]:
    """Every Markdown file that becomes a page, relative to the repository."""
    docs = (path.relative_to(REPOSITORY).as_posix() for path in (REPOSITORY / "docs").rglob("*.md"))
    return sorted([*docs, *PAGES.PAGES])


def text_of(name: str) -> str:
    return (REPOSITORY / name).read_text(encoding="utf-8")


def anchors(markdown: str) -> set[str]:
    headings = re.findall(r"^#+ (.*)$", FENCE.sub("", markdown), re.MULTILINE)
    return {PAGES.anchor(re.sub(r"[`*]", "", heading)) for heading in headings}


@pytest.mark.parametrize("name", documents())
def test_links_lead_somewhere(name: str) -> None:
    """To a file that is there and is a page of the site, and to a heading that is in it."""
    for target in PAGES.links(text_of(name)):
        if re.match(r"https?:", target):
            continue
        path, _, fragment = target.partition("#")
        found = os.path.normpath(os.path.join(os.path.dirname(name), path)) if path else name
        assert (REPOSITORY / found).exists(), target
        assert PAGES.page_of(found)
        if fragment:
            assert fragment in anchors(text_of(found)), target


def test_the_navigation_names_every_page_once() -> None:
    config = yaml.safe_load(text_of("mkdocs.yml"))

    def leaves(node: Any) -> Iterator[str]:
        if isinstance(node, str):
            yield node
        else:
            for value in node if isinstance(node, list) else node.values():
                yield from leaves(value)

    named = [*leaves(config["nav"]), *(page for _, page in PAGES.decisions())]
    assert len(named) == len({*named})
    assert {*named} == {*PAGES.generated(), *(name.removeprefix("docs/") for name in documents() if "docs/" in name)}


def test_every_name_of_the_front_door_has_its_place_on_the_api_pages() -> None:
    pages = [text_of(name) for name in documents() if name.startswith("docs/api/")]
    named = re.findall(r"^::: condvln\.(\w+)$", "\n".join(pages), re.MULTILINE)
    assert sorted([*named, "CondVLNError"]) == condvln.__all__, "errors have one page, for the whole tree"
    assert {*re.findall(r"`(\w+)`", text_of("docs/api/index.md"))} >= {*condvln.__all__}


def test_every_name_of_the_api_pages_is_there() -> None:
    pages = [text_of(name) for name in documents() if name.startswith("docs/api/")]
    named = re.findall(r"^::: (\S+)$", "\n".join(pages), re.MULTILINE)
    assert len(named) > 20
    for name in named:
        assert pkgutil.resolve_name(name) is not None


def test_the_figure_is_that_of_the_pipeline() -> None:
    assert text_of("docs/pipeline.svg") == part("pipeline").figure(), "run python docs/site/pipeline.py"


# ---- command lines


def lines(name: str) -> Iterator[str]:
    """Lines of a page's blocks of commands, continued ones joined."""
    for language, block in FENCE.findall(text_of(name)):
        if language in ("", "console"):
            yield from re.sub(r"\\\n\s*", "", block).splitlines()


def commands(name: str) -> Iterator[list[str]]:
    """Words of each command line of a page, ``condvln`` itself left out."""
    for line in lines(name):
        found = re.match(r"(?:\S*/)?condvln\s+(.*)", line)
        if found:
            yield shlex.split(found.group(1), comments=True)


WITH_COMMANDS = [name for name in documents() if not name.startswith("docs/command") and [*commands(name)]]


@pytest.mark.parametrize("name", WITH_COMMANDS)
def test_every_command_line_is_understood(name: str) -> None:
    """Each verb, option and kind of value exists; nothing runs."""
    verbs = get_command(app).commands  # type: ignore[attr-defined]
    for words in commands(name):
        command, rest = verbs[words[0]], words[1:]
        if words[0] in ("navmesh", "benchmark"):
            command, rest = command.commands[rest[0]], rest[1:]
        assert command.make_context(words[0], rest).params is not None


def test_targets_and_scripts_that_pages_name_exist() -> None:
    targets = {*re.findall(r"^([a-z]+):", text_of("Makefile"), re.MULTILINE)}
    for name in documents():
        text = text_of(name)
        assert {*re.findall(r"`make ([a-z]+)", text)} <= targets, name
        for module in re.findall(r"python -m ((?:jobs|benchmarks|schemas)[\w.]*)", text):
            path = REPOSITORY / module.replace(".", "/")
            assert path.with_suffix(".py").is_file() or (path / "__main__.py").is_file(), module
        for benchmark in re.findall(r"python -m benchmarks (\w+)", text):
            assert (REPOSITORY / "benchmarks" / f"{benchmark}.py").is_file(), name
        for script in re.findall(r"python ((?:examples|docs)/[\w/]+\.py)", text):
            assert (REPOSITORY / script).is_file(), script


RUN_IN_ORDER = (
    "docs/own_dataset.md",
    "docs/own_agent.md",
    "README.md",
    "docs/cookbook.md",
    "docs/nightly.md",
    "docs/running.md",
    "docs/files.md",
)
"""Pages whose command lines run; later ones need what earlier ones made."""

PLACES = {
    "configs/replicacad.yaml": "configs/replicacad.yaml",
    "/data/replica_cad": "data/mine",
    "out/replicacad/export": "out/mine/export",
    "out/demo": "out/mine/demo",
    "CONFIG": "configs/replicacad.yaml",
    "STORE": "out/mine/store",
    "EXPORT": "out/mine/export",
    "ROOT": "data/mine",
}
"""What the pages name, and what is there when their command lines run."""


@pytest.fixture(scope="module")
def workplace(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with made scenes, an agent and a configuration, where the command lines of the pages run."""
    folder = tmp_path_factory.mktemp("workplace")
    make_samples(folder / "data" / "mine", family="replicacad", scenes=4, seed=3)
    (own,) = (block for kind, block in FENCE.findall(text_of("docs/own_dataset.md")) if kind == "yaml")
    smaller = "instructions: {per_category: {simple: 3, nested: 2}, counterfactual_groups: 1}\n"
    (folder / "mine.yaml").write_text(own + smaller)
    (folder / "configs").mkdir()
    moved = own.replace("out/", "../out/").replace("data/mine", "../data/mine")
    (folder / "configs" / "replicacad.yaml").write_text(moved + smaller)
    (agent,) = (block for kind, block in FENCE.findall(text_of("docs/own_agent.md")) if kind == "python")
    (folder / "ahead.py").write_text(agent)
    shutil.copy(next((folder / "data" / "mine" / "stages").glob("*.glb")), folder / "scene.glb")
    return folder


@pytest.mark.soak
def test_command_lines_of_the_guides_run(workplace: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """From data to scores, in the order of the pages, on made scenes."""
    monkeypatch.chdir(workplace)
    monkeypatch.syspath_prepend(str(workplace))
    split = ""
    ran = set()
    for name in RUN_IN_ORDER:
        for words in commands(name):
            words = [PLACES.get(word, word) for word in words]
            words = [re.sub("=(/data/replica_cad|ROOT)$", f"={workplace}/data/mine", word) for word in words]
            if words[0] in NOT_RUN or "SELECT …" in words:
                continue
            if not split and (workplace / "out/mine/export/manifest").is_dir():
                split = max(
                    (workplace / "out/mine/export/manifest").glob("*.jsonl"), key=lambda p: p.stat().st_size
                ).stem
            words = [split if word == "val_unseen" else word for word in words]
            if words[0] == "generate":
                words.append("--inline")
            result = CliRunner().invoke(app, words)
            assert result.exit_code == 0, (name, words, result.output)
            ran.add(words[0])
    assert ran >= {"sources", "plan", "generate", "verify", "show", "walk", "evaluate", "query", "export"}


# ---- the site itself

FETCHED = re.compile(r"<(?:script|link|img|iframe|source)\b[^>]*?(?:src|href)=\"?(?:https?:)?//[^\">\s]*")


@pytest.mark.soak
def test_the_site_builds_strictly_and_fetches_nothing(tmp_path: Path) -> None:
    words = [sys.executable, "-m", "mkdocs", "build", "--strict", "--site-dir", str(tmp_path / "site")]
    closed = dict.fromkeys(("http_proxy", "https_proxy", "HTTP_PROXY", "HTTPS_PROXY"), "http://127.0.0.1:9")
    environment = {**os.environ, **closed, "NO_MKDOCS_2_WARNING": "1"}
    built = subprocess.run(words, cwd=REPOSITORY, capture_output=True, text=True, check=False, env=environment)
    assert built.returncode == 0, built.stderr
    assert "WARNING" not in built.stderr
    pages = [*(tmp_path / "site").rglob("*.html")]
    assert len(pages) > 40
    for page in pages:
        text = page.read_text(encoding="utf-8")
        assert [found for found in FETCHED.findall(text) if "canonical" not in found] == [], page
    for sheet in (tmp_path / "site").rglob("*.css"):
        assert not re.search(r"url\(['\"]?(?:https?:)?//", sheet.read_text(encoding="utf-8")), sheet
    shown = (tmp_path / "site" / "api" / "evaluation.html").read_text(encoding="utf-8")
    assert "success distances of a sweep, metres" in shown, "parameters of the house's docstrings are shown"
