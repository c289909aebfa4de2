"""docs/agents/: each page's settings are those of the files of an export, and each test that it names is there."""

from __future__ import annotations

import ast
import re
from pathlib import Path
from typing import Any

import pytest
import yaml

AGENTS = [
    "internnav",
    "janusvln",
    "navid",
    "navila",
    "open-nav",
    "streamvln",
    "uni-navid",
    "vln-zero",
    "vlnce-baselines",
]
SETTING = re.compile(r"^\| `(configs/[^`]+)` \| `([^`]+)` \| `([^`]+)` \| .+ \|$", re.MULTILINE)
TEST = re.compile(r"^\* `(tests/[^`]+\.py)::(\w+)`$", re.MULTILINE)


def page(repository: Path, agent: str) -> str:
    return (repository / "docs" / "agents" / f"{agent}.md").read_text(encoding="utf-8")


def test_every_agent_has_a_page_and_the_overview_names_it(repository: Path) -> None:
    names = sorted(path.stem for path in (repository / "docs" / "agents").glob("*.md"))
    assert names == sorted([*AGENTS, "index"])
    linked = set(re.findall(r"\]\(([a-z-]+)\.md\)", page(repository, "index")))
    assert linked == set(AGENTS)


@pytest.mark.parametrize("agent", AGENTS)
def test_the_settings_of_a_page_are_those_of_the_export(repository: Path, exported: Path, agent: str) -> None:
    settings = SETTING.findall(page(repository, agent))
    assert settings
    assert len(settings) == sum(line.startswith("| `configs/") for line in page(repository, agent).splitlines())
    for file, key, value in settings:
        found: Any = yaml.safe_load((exported / file).read_text(encoding="utf-8"))
        for part in key.split("."):
            found = found[part]
        assert str(found) == value, (file, key)


@pytest.mark.parametrize("agent", AGENTS)
def test_the_tests_of_a_page_exist(repository: Path, agent: str) -> None:
    text = page(repository, agent)
    for heading in ("## What was tried", "## Tests"):
        assert heading in text
    assert "Stubs: " in text
    named = TEST.findall(text)
    assert named
    for file, test in named:
        tree = ast.parse((repository / file).read_text(encoding="utf-8"))
        assert test in {node.name for node in ast.walk(tree) if isinstance(node, ast.FunctionDef)}, test
