"""Tables in every form: the same numbers, valid in their format."""

from __future__ import annotations

import csv
import io
import json
import re
from collections import Counter
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from condvln.evaluation.evaluate import Evaluation, evaluate
from condvln.evaluation.plots import axis_figure, save_figures
from condvln.evaluation.render import as_csv, as_document, as_latex, as_markdown, written
from condvln.evaluation.tables import (
    MAIN_COLUMNS,
    Cell,
    Column,
    Table,
    all_tables,
    main_table,
)
from condvln.evaluation.task import Task
from tests.condvln.evaluation.conftest import OpenPlain
from tests.condvln.evaluation.test_aggregate import choosing, fleet


@pytest.fixture(scope="module")
def tasks() -> list[Task]:
    return fleet()


@pytest.fixture(scope="module")
def evaluations(tasks: list[Task]) -> list[Evaluation]:
    gold = {t.episode_id: t.gold_leaf for t in tasks}
    first = {t.episode_id: 0 for t in tasks}
    return [
        evaluate(tasks, choosing(tasks, which), lambda task: OpenPlain(), agent=name, radii=(0.5, 3.0))
        for name, which in (("oracle_100%", gold), ("always|first", first))
    ]


@pytest.fixture(scope="module")
def tables(evaluations: list[Evaluation], tasks: list[Task]) -> list[Table]:
    return all_tables(evaluations, tasks)


def test_main_table_says_what_the_scores_say(evaluations: list[Evaluation]) -> None:
    table = main_table(evaluations)
    headings = [column.heading for column in table.columns]
    first = ["SR", "SPL-look", "nDTW-look", "BSA-all", "CSR-all", "justified"]
    shown = [heading for heading in first if heading not in ("SPL-look", "nDTW-look", "justified")]
    assert headings[: 2 + len(shown)] == ["source", "agent", *shown], "no task here has a looking path"
    assert [column.heading for column in MAIN_COLUMNS[:6]] == first
    row = table.rows[1]
    scores = evaluations[1].scores
    assert row[headings.index("SR")].value == scores["success"].mean()
    assert row[headings.index("n")].value == 120
    assert headings[-3:-1] == ["BSA (paper)", "CSR (paper)"], "the honest ones come first"
    bsa = row[headings.index("BSA (paper)")]
    assert (bsa.n, bsa.total) == (int((scores["bsa"] == scores["bsa"]).sum()), 120)
    assert [cell.value for cell in main_table(evaluations).rows[0]] == [cell.value for cell in table.rows[0]]


def test_no_table_shows_more_conditional_success_than_success(tables: list[Table]) -> None:
    """By the paper's rule an agent that always takes the first branch has CSR above SR: that column is named so."""
    seen = 0
    for table in tables:
        headings = [column.heading for column in table.columns]
        assert not {"BSA", "CSR"} & {*headings}, table.name
        if "CSR-all" not in headings:
            continue
        for row in table.rows:
            success, honest = (row[headings.index(name)] for name in ("SR", "CSR-all"))
            assert honest.value <= success.value, table.name  # type: ignore[operator]
            assert (honest.n, honest.total) == (success.n, success.total), "over the same episodes"
            if "CSR (paper)" in headings:
                place = headings.index("CSR (paper)")
                paper = row[place]
                assert headings.index("CSR-all") < place
                assert (f"({paper.n:,})" in written(paper, table.columns[place])) == (paper.n != paper.total)
                seen += paper.value > success.value  # type: ignore[operator]
    assert seen, "the case that misleads is among the rows"


def test_results_without_subgoals_have_neither_their_columns_nor_the_note(evaluations: list[Evaluation]) -> None:
    """As real results of VLN-CE: they were explained under a table that lacks them."""
    unknown = np.full(len(evaluations[0].scores["bsa"]), np.nan)
    missing = dict.fromkeys(("bsa", "csr", "bsa_all", "csr_all"), unknown)
    table = main_table([replace(evaluations[0], scores={**evaluations[0].scores, **missing})])
    assert not any("BSA" in column.heading or "CSR" in column.heading for column in table.columns)
    assert (table.note, bool(table.intervals)) == ("", True)
    assert main_table(evaluations).note


@pytest.mark.parametrize(
    ("cell", "kind", "text"),
    [
        (Cell(0.4213, 0.4, 0.45, 90, 100), "percent", "42.1 [40.0, 45.0] (90)"),
        (Cell(0.4213, 0.4, 0.45, 100, 100), "percent", "42.1 [40.0, 45.0]"),
        (Cell(3.14159), "metres", "3.14"),
        (Cell(float("nan")), "metres", "–"),
        (Cell(None), "count", "–"),
        (Cell(7), "count", "7"),
        (Cell(0.00391), "p", "0.0039"),
        (Cell("a"), "text", "a"),
    ],
)
def test_cells(cell: Cell, kind: str, text: str) -> None:
    assert written(cell, Column("k", "K", kind)) == text  # type: ignore[arg-type]


def test_markdown_is_a_table(tables: list[Table]) -> None:
    for table in tables:
        lines = [line for line in as_markdown(table).splitlines() if line.startswith("|")]
        assert len(lines) == len(table.rows) + 2
        assert {len(re.findall(r"(?<!\\)\|", line)) for line in lines} == {len(table.columns) + 1}


def test_latex_is_booktabs_with_everything_escaped(tables: list[Table]) -> None:
    for table in tables:
        text = as_latex(table)
        for rule in (r"\toprule", r"\bottomrule", r"\begin{tabular}", r"\end{table"):
            assert text.count(rule) == 1
        body = text.split(r"\midrule", 1)[1].split(r"\bottomrule")[0]
        rows = [line for line in body.splitlines() if line.endswith(r"\\")]
        assert len(rows) == len(table.rows)
        assert {len(re.findall(r"(?<!\\)&", row)) for row in rows} == {len(table.columns) - 1}
        assert not re.search(r"(?<!\\)[%#_]", body.replace(r"\textbf", ""))
        assert text.count("{") - text.count(r"\{") == text.count("}") - text.count(r"\}")
    # The caption tells of no intervals where none are shown; a dozen columns span the page.
    assert all("interval" not in as_latex(table) for table in tables)
    assert "95 % intervals" in as_markdown(tables[0])
    assert "95 % intervals" in as_document(tables[0])["note"]
    assert all((r"\begin{table*}" in as_latex(table)) == (len(table.columns) > 9) for table in tables)
    main = as_latex(tables[0])
    assert r"oracle\_100\%" in main
    assert r"\textbf{100.0}" in main
    assert r"SR $\uparrow$" in main


def test_json_and_csv_hold_the_same_unrounded_numbers(tables: list[Table]) -> None:
    for table in tables:
        document = json.loads(json.dumps(as_document(table), allow_nan=False))
        rows = list(csv.DictReader(io.StringIO(as_csv(table))))
        assert len(document["rows"]) == len(rows) == len(table.rows)
        for entry, row in zip(document["rows"], rows, strict=True):
            for key, value in entry.items():
                mean = value["mean"] if isinstance(value, dict) else value
                assert row[key] == ("" if mean is None else str(mean))
                if isinstance(value, dict):
                    assert row[f"{key}_n"] == str(value["n"])


def test_plots_show_the_means_and_repeat(evaluations: list[Evaluation], tmp_path: Path) -> None:
    figure = axis_figure(evaluations, "depth")
    lines = figure.axes[0].get_lines()
    oracle = next(line for line in lines if len(line.get_ydata()) == 3)
    assert list(oracle.get_ydata()) == [100, 100, 100]
    assert [panel.get_title() for panel in figure.axes] == ["SR", "BSA-all", "CSR-all"], "none by the paper's rule"
    counts = Counter(evaluations[0].axes["depth"])
    for panel in figure.axes:
        assert [tick.get_text() for tick in panel.get_xticklabels()] == [
            f"{depth}\nn = {counts[depth]:,}" for depth in sorted(counts)
        ]
    ceiling, floor = (
        next(line for line in figure.axes[panel].get_lines()[::-1] if len(line.get_ydata()) == 3).get_ydata()
        for panel in (0, 2)
    )
    assert (np.asarray(floor) <= np.asarray(ceiling)).all()
    paths = save_figures(evaluations, tmp_path / "a")
    again = save_figures(evaluations, tmp_path / "b")
    assert [path.name for path in paths] == ["depth.png", "depth.pdf", "chain.png", "chain.pdf"]
    assert [path.read_bytes() for path in paths] == [path.read_bytes() for path in again]
    assert paths[0].read_bytes().startswith(b"\x89PNG")
