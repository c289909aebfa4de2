"""``condvln walk`` and ``condvln evaluate``: reference agents on a split, and metrics of any agent's predictions."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from rich.console import Console, ConsoleOptions, RenderResult

from condvln.evaluation.agents import agent_named, predict_all
from condvln.evaluation.navmeshes import NavmeshFolder
from condvln.evaluation.predictions import write_predictions
from condvln.evaluation.render import as_document, as_latex, as_markdown, as_rich
from condvln.evaluation.score import Rules
from condvln.evaluation.split import SplitOptions, evaluate_split, split_tasks
from condvln.evaluation.tables import Table, all_tables
from jobs.report import Report

__all__ = ["EvaluationReport", "evaluate_predictions", "walk_split"]


class EvaluationReport:
    """The tables of one evaluation; rich draws the terminal form."""

    def __init__(self, tables: Sequence[Table]) -> None:
        self.tables = tables

    def as_json(self) -> dict[str, Any]:
        """All tables as plain values."""
        return {"tables": [as_document(table) for table in self.tables]}

    def as_markdown(self) -> str:
        """All tables as Markdown."""
        return "\n".join(as_markdown(table) for table in self.tables)

    def as_latex(self) -> str:
        """All tables as LaTeX (booktabs)."""
        return "\n".join(as_latex(table) for table in self.tables)

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        yield from (as_rich(table) for table in self.tables)


def walk_split(export: Path, split: str, agent: str, out: Path, roots: Sequence[Path], seed: int) -> Report:
    """Write the predictions of one reference agent, walked on the episodes' own navmeshes."""
    chosen = agent_named(agent)
    tasks = split_tasks(export, split)
    count = write_predictions(out, predict_all(chosen, tasks, NavmeshFolder((export, *roots)), seed=seed))
    return Report({"predictions": count, "file": str(out)}, [f"{count} predictions of {agent} in {out}"])


def evaluate_predictions(
    export: Path,
    split: str,
    predictions: Sequence[Path],
    roots: Sequence[Path],
    *,
    euclidean: bool,
    radii: Sequence[float],
    assume_stop: bool,
    scores: Path | None,
) -> EvaluationReport:
    """Metrics and tables of one or several agents on one split.

    scores : file for one JSON line an episode and agent
    """
    rules = Rules(distance="euclidean" if euclidean else "geodesic")
    options = SplitOptions(rules, tuple(radii), tuple(roots), assume_stop)
    evaluations, tasks = evaluate_split(export, split, predictions, options)
    if scores is not None:
        with scores.open("w", encoding="utf-8") as stream:
            for evaluation in evaluations:
                for row in evaluation.rows():
                    stream.write(json.dumps({"agent": evaluation.agent, **row}) + "\n")
    return EvaluationReport(all_tables(evaluations, tasks))
