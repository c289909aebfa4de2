"""The view of agents equals `condvln evaluate` on the same predictions: tables, sweeps, and where two agents differ."""

from __future__ import annotations

import re
from collections import Counter
from functools import partial
from typing import Any

import pytest
from selenium.webdriver.support.ui import Select

from condvln.evaluation.render import as_document, as_markdown
from condvln.evaluation.split import SplitOptions
from jobs.agents import evidence_seen
from jobs.evaluate import EvaluationReport, Question, evaluate_predictions
from tests.browser.conftest import AGENTS, Run
from tests.browser.driver import Page
from tests.browser.test_page import cells, count


@pytest.fixture(scope="module")
def evaluated(made: Run) -> EvaluationReport:
    """What `condvln evaluate` computes from the predictions that the page shows."""
    assert made.config.export is not None
    files = tuple(made.page.parent / f"{agent}.json" for agent in AGENTS)
    roots = tuple(source.root for source in made.config.sources)
    datasets = [f"{source.family}={source.root}" for source in made.config.sources]
    options = SplitOptions(navmesh_roots=roots, sees_of=evidence_seen(made.config.export, datasets, roots))
    return evaluate_predictions(Question(made.config.export, made.split, files, options=options))


def written_cells(report: EvaluationReport) -> dict[str, list[list[str]]]:
    """Return the rows of each table as `condvln evaluate --markdown` prints them."""
    found: dict[str, list[list[str]]] = {}
    for table in report.tables:
        lines = as_markdown(table).splitlines()
        rows = [line.strip("| ").split(" | ") for line in lines if line.startswith("|")]
        found[table.name] = rows[2:]
    return found


def on_axis(zero: float, one: float, y: float) -> float:
    """Return the value that a chart shows at a height."""
    return (y - zero) / (one - zero)


def test_agents_tables_are_those_of_evaluate(page: Page, evaluated: EvaluationReport) -> None:
    report = evaluated
    wanted = written_cells(report)
    page.go("#/agents")
    page.run("for (const node of document.querySelectorAll('details')) node.open = true")
    for name, rows in wanted.items():
        assert cells(page, name) == ["|".join(row).replace(",", "") for row in rows], name
    assert {"main", "by_depth", "by_chain", "branches", "comparison"} <= wanted.keys()
    numbers = {table.name: as_document(table) for table in report.tables}
    script = """return [...document.querySelectorAll('figure')].map((figure) => ({
        title: figure.querySelector('figcaption').textContent, grid: [...figure.querySelectorAll('.grid')].map((line) =>
            Number(line.getAttribute('d').match(/M\\S+ (\\S+?)H/)[1])),
        points: [...figure.querySelectorAll('.point')].map((point) => ({
            title: point.querySelector('title').textContent,
            at: Number(point.dataset.y),
            line: point.querySelector('path:not(.bead)')?.getAttribute('d') }))}))"""
    charts = page.run(script)
    assert len(charts) == 6
    drawn = 0
    for k, chart in enumerate(charts):
        axis = ("depth", "chain")[k // 3]
        measure = ("success", "bsa_all", "csr_all")[k % 3]
        value = partial(on_axis, chart["grid"][0], chart["grid"][2])
        rows = {f"{row['agent']}, {axis} {row[axis]}": row[measure] for row in numbers[f"by_{axis}"]["rows"]}
        for point in chart["points"]:
            row = rows[point["title"].split(":")[0]]
            assert value(point["at"]) == pytest.approx(row["mean"], abs=1e-6)
            if point["line"] is not None:
                low, high = (float(y) for y in re.fullmatch(r"M\S+ (\S+)V(\S+)", point["line"]).groups())  # type: ignore[union-attr]
                assert [value(low), value(high)] == pytest.approx([row["low"], row["high"]], abs=1e-6)
            assert (point["line"] is None) == (row["low"] is None)
            drawn += 1
    assert drawn == sum(row[axis] != "all" for axis in ("depth", "chain") for row in numbers[f"by_{axis}"]["rows"]) * 3


def test_what_tells_the_best_agent_is_in_sight(page: Page, evaluated: EvaluationReport) -> None:
    page.go("#/agents")
    heads = page.texts("[data-table='main-first'] thead th")
    assert [head.removesuffix(" ↑") for head in heads[2:]] == ["SR", "SPL-look", "BSA-all", "CSR-all", "justified", "n"]
    script = """return [...document.querySelectorAll('.scroll')].filter((box) =>
        !box.closest('details:not([open])') && box.scrollWidth > box.clientWidth)
        .map((box) => box.getAttribute('aria-label'))"""
    assert page.run(script) == [], "a table is scrolled sideways at 1280 px"
    rows = [row.split("|") for row in cells(page, "main-first")]
    assert {row[0] for row in rows[: len(AGENTS)]} == {"all"}
    best = page.run(
        "return document.querySelector('[data-table=main-first] tbody tr b').closest('tr').children[1].textContent"
    )
    assert best == "perfect"


def outcome(row: dict[str, Any]) -> str:
    """Return what became of an episode, from the scores that `condvln evaluate --scores` writes."""
    named = {"missing": "no prediction", "success": "success", "wrong_branch": "wrong branch", "no_commit": "no commit"}
    return next((text for name, text in named.items() if row[name] == 1), "right leaf, failed")


def test_where_two_agents_differ_is_what_their_scores_say(page: Page, evaluated: EvaluationReport) -> None:
    report = evaluated
    became = {one.agent: {str(row["episode_id"]): outcome(row) for row in one.rows()} for one in report.evaluations}
    page.go("#/agents")
    for first, second in ((0, 1), (1, 2)):
        Select(page.one("#first-agent")).select_by_index(first)
        Select(page.one("#second-agent")).select_by_index(second)
        a, b = AGENTS[first], AGENTS[second]
        wanted = Counter((became[a][name], became[b][name]) for name in became[a])
        heads = [text.removeprefix(f"{b}: ") for text in page.texts("[data-table='compared'] thead th")[1:]]
        rows = [row.split("|") for row in cells(page, "compared")]
        shown = {
            (row[0].removeprefix(f"{a}: "), head): int(n)
            for row in rows
            for head, n in zip(heads, row[1:], strict=True)
        }
        assert {pair: n for pair, n in shown.items() if n} == wanted
    link = page.one("[data-table='compared'] tbody a")
    wanted_count = int(link.text)
    link.click()
    page.until("return location.hash.startsWith('#/browse') && Boolean(document.getElementById('count'))")
    assert count(page) == wanted_count
