"""A run over made scenes, its page in Chromium, and DuckDB over its tables. Only `make browser` runs these tests."""

from __future__ import annotations

import os
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import duckdb
import pytest

from condvln.manifest import manifest_lines, manifest_paths
from condvln.samples import make_samples
from jobs.evaluate import walk_split
from jobs.explore import Exploration, explore
from jobs.generate import run_generate
from jobs.verify import verify_export
from jobs.workspace import published
from schemas.config import Config, InstructionsConfig, SourceConfig, SplitsConfig

AGENTS = ("perfect", "nearest", "always-then")
VARIABLE = "CONDVLN_BROWSER"


@dataclass(frozen=True)
class Run:
    """A run over made scenes: what the page was made of."""

    config: Config
    split: str
    page: Path
    manifest: dict[str, dict[str, Any]]
    database: duckdb.DuckDBPyConnection

    def ask(self, sql: str) -> list[tuple[Any, ...]]:
        """Return the rows of a query over the published tables."""
        return self.database.execute(sql).fetchall()


@pytest.fixture(scope="session", autouse=True)
def in_make_browser() -> None:
    """Skip all tests of this folder elsewhere."""
    if not os.environ.get(VARIABLE):
        pytest.skip("make browser runs the tests of the page")


@pytest.fixture(scope="session")
def made(in_make_browser: None, tmp_path_factory: pytest.TempPathFactory) -> Run:
    """Three made apartments with all categories, exported, proven, and walked by three agents."""
    folder = tmp_path_factory.mktemp("explored")
    make_samples(folder / "replicacad", family="replicacad", scenes=2, seed=3)
    make_samples(folder / "procthor", family="procthor", scenes=1, seed=4)
    categories = ("simple", "nested", "chain", "nested_chain")
    config = Config(
        name="made",
        store=folder / "store",
        export=folder / "export",
        sources=tuple(SourceConfig(family=name, root=folder / name) for name in ("replicacad", "procthor")),
        instructions=InstructionsConfig(per_category=dict.fromkeys(categories, 5), counterfactual_groups=2),
        splits=SplitsConfig(fractions=(0.4, 0.3, 0.3)),
    )
    return explored(config, folder / "page", inline=True)


def explored(config: Config, page: Path, *, inline: bool) -> Run:
    """Generate, export, verify, walk and explore."""
    assert config.export is not None
    run_generate(config, inline=inline)
    verify_export(config, config.export)
    lines = [line.fields() for path in manifest_paths(config.export) for line in manifest_lines(path)]
    manifest = {str(fields["episode_id"]): fields for fields in lines}
    sizes = {path.stem: path.read_bytes().count(b"\n") for path in manifest_paths(config.export)}
    split = max(sizes, key=lambda name: sizes[name])
    roots = [source.root for source in config.sources]
    files = tuple(page.parent / f"{agent}.json" for agent in AGENTS)
    for agent, path in zip(AGENTS, files, strict=True):
        walk_split(config.export, split, agent, path, roots, 0)
    explore(Exploration(page, config.export, config, files, views=2))
    database = duckdb.connect()
    snapshot = published(config)
    for table in snapshot.manifest.tables:
        database.register(table, snapshot.table(table))
    return Run(config, split, page, manifest, database)


@pytest.fixture(scope="session")
def chromium(in_make_browser: None, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Any]:
    """A headless Chromium."""
    from tests.browser.driver import browser

    with browser(tmp_path_factory.mktemp("profile")) as driver:
        yield driver


@pytest.fixture
def page(chromium: Any, made: Run) -> Iterator[Any]:
    """The page of the run, opened afresh. At the end nothing may have failed, and nothing been asked for outside."""
    from tests.browser.driver import Page

    shown = Page(chromium, made.page)
    shown.size(1280)
    shown.dark(False)
    shown.open()
    yield shown
    shown.note()
    assert shown.messages == []
    assert shown.outside() == []
