"""The tables of an evaluation, as data; ``render`` turns them into text."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from typing import Final

from condvln.evaluation.aggregate import (
    Summary,
    by_axis,
    compare,
    divergences,
    group_accuracy,
    leaf_confusion,
    summary,
    sweep_summary,
)
from condvln.evaluation.evaluate import AXES, Evaluation
from condvln.evaluation.metrics import Better, Kind, Shown, keys_of, metrics_of
from condvln.evaluation.task import Task
from condvln.export.splits import OBSERVED

__all__ = [
    "BRANCH_COLUMNS",
    "MAIN_COLUMNS",
    "ORACLE_TEXT",
    "TWIN_COLUMNS",
    "Cell",
    "Column",
    "Table",
    "all_tables",
    "axis_table",
    "branch_table",
    "comparison_table",
    "confusion_tables",
    "divergence_table",
    "group_table",
    "main_table",
    "sweep_table",
    "twin_tables",
]


@dataclass(frozen=True)
class Column:
    """One column: its measure, its heading, and its number format."""

    key: str
    heading: str
    kind: Kind
    better: Better = ""


@dataclass(frozen=True)
class Cell:
    """A cell of a table. It holds either a text, or a number with its interval and two counts: of the episodes that
    have a value, and of all episodes.
    """

    value: float | int | str | None
    low: float = float("nan")
    high: float = float("nan")
    n: int | None = None
    total: int | None = None


@dataclass(frozen=True)
class Table:
    """A table with a title.

    blocks : number of leading columns; a change in one of them begins a new block
    intervals : description of the intervals, for formats that show them
    """

    name: str
    title: str
    columns: tuple[Column, ...]
    rows: tuple[tuple[Cell, ...], ...]
    note: str = ""
    blocks: int = 0
    intervals: str = ""


def _columns(table: Shown) -> tuple[Column, ...]:
    return tuple(Column(metric.key, metric.heading, metric.kind, metric.better) for metric in metrics_of(table))


MAIN_COLUMNS: Final = _columns("main")
TWIN_COLUMNS: Final = _columns("twin")
"""Fewer measures, to leave room for the longer agent names."""
BRANCH_COLUMNS: Final = _columns("branches")
_SWEEP_COLUMNS: Final = _columns("sweep")

_AGENT: Final = Column("agent", "agent", "text")
_EPISODES: Final = Column("episodes", "n", "count")
_NOTE: Final = (
    "BSA-all and CSR-all are over every episode. BSA and CSR by the paper's rule leave out failed episodes without "
    "subgoals (in brackets: how many count), and so may be above SR."
)

_INTERVALS: Final = "Means with 95 % intervals, scenes drawn with replacement; none if all episodes are of one scene."


def main_table(evaluations: Sequence[Evaluation]) -> Table:
    """Return a table of the main results by source and agent, and over all sources if there are several."""
    return _grouped("main", "Main results", evaluations, ("source",), MAIN_COLUMNS, note=_NOTE)


def axis_table(evaluations: Sequence[Evaluation], *axes: str, columns: Sequence[Column] = MAIN_COLUMNS) -> Table:
    """Return a table of the results by one or several of :data:`~condvln.evaluation.evaluate.AXES`."""
    note = "; ".join(f"{name}: {what}" for name, what in OBSERVED.items()) if "observability" in axes else ""
    return _grouped("by_" + "_".join(axes), f"Results by {' and '.join(axes)}", evaluations, axes, columns, note=note)


def branch_table(evaluations: Sequence[Evaluation]) -> Table:
    """Return the table of the branches that agents took, by source and agent."""
    return _grouped("branches", "Branches taken", evaluations, ("source",), BRANCH_COLUMNS)


def sweep_table(evaluations: Sequence[Evaluation]) -> Table:
    """Return a table of the results at each success distance of the sweep."""
    found = [(e.agent, row) for e in evaluations for row in sweep_summary(e)]
    found.sort(key=lambda pair: pair[1].group["success_distance"])
    columns = (Column("success_distance", "τ", "metres"), _AGENT, *_SWEEP_COLUMNS, _EPISODES)
    rows = tuple(
        (
            Cell(row.group["success_distance"]),
            Cell(agent),
            *_cells(row, _SWEEP_COLUMNS),
            Cell(row.episodes),
        )
        for agent, row in found
    )
    return Table("sweep", "Success distance swept", columns, rows, blocks=1)


def group_table(evaluations: Sequence[Evaluation]) -> Table:
    """Return a table of the share of counterfactual groups in which every episode is right."""
    columns = (
        _AGENT,
        Column("groups", "groups", "count"),
        Column("episodes", "n", "count"),
        Column("all_right", "all succeed", "percent", "higher"),
        Column("all_leaves_right", "all leaves right", "percent", "higher"),
        Column("single", "SR of the same", "percent", "higher"),
    )
    rows = []
    for evaluation in evaluations:
        found = group_accuracy(evaluation)
        estimates = (found.all_right, found.all_leaves_right, found.single)
        cells = (Cell(e.mean, e.low, e.high, e.n, e.total) for e in estimates)
        rows.append((Cell(evaluation.agent), Cell(found.groups), Cell(found.episodes), *cells))
    return Table("groups", "Counterfactual groups", columns, tuple(rows))


def confusion_tables(evaluation: Evaluation) -> list[Table]:
    """Return, for each category, a table that counts episodes by gold leaf and reached leaf."""
    tables = []
    for category, counts in leaf_confusion(evaluation).items():
        leaves = counts.shape[0]
        columns = (
            Column("gold_leaf", "gold leaf", "count"),
            *(Column(f"leaf_{leaf}", f"leaf {leaf}", "count") for leaf in range(leaves)),
            Column("none", "none", "count"),
        )
        rows = tuple((Cell(leaf), *(Cell(int(value)) for value in counts[leaf])) for leaf in range(leaves))
        title = f"Leaves of {category}: {evaluation.agent}"
        tables.append(Table(f"leaves_{category}_{evaluation.agent}", title, columns, rows))
    return tables


def divergence_table(evaluations: Sequence[Evaluation], tasks: Sequence[Task]) -> Table:
    """Return a table of the share of wrong answers at each condition of the gold path, among the episodes in which all
    earlier conditions were answered correctly.
    """
    columns = (
        _AGENT,
        Column("place", "condition", "count"),
        Column("met", "met", "count"),
        Column("erred", "wrong here", "percent", "lower"),
    )
    rows = []
    for evaluation in evaluations:
        for place, (met, erred) in divergences(evaluation, tasks).items():
            rows.append((Cell(evaluation.agent), Cell(place + 1), Cell(met), Cell(erred / met)))
    return Table("divergence", "Where agents leave the right branch", columns, tuple(rows), blocks=1)


def comparison_table(evaluations: Sequence[Evaluation]) -> Table:
    """Return a table of the differences between each two agents, with the p-value of a paired permutation test by
    scene.
    """
    columns = (
        Column("first", "agent", "text"),
        Column("second", "against", "text"),
        Column("measure", "measure", "text"),
        Column("difference", "difference", "percent"),
        Column("p_value", "p", "p"),
        Column("n", "n", "count"),
        Column("scenes", "scenes", "count"),
    )
    rows = []
    for first, second in combinations(evaluations, 2):
        for measure in keys_of("comparison"):
            found = compare(first, second, measure)
            values = (found.difference, found.p_value, found.n, found.scenes)
            rows.append((Cell(first.agent), Cell(second.agent), Cell(measure), *map(Cell, values)))
    note = "Agents' labels swapped scene by scene; with k scenes p is never below 2 ÷ 2^k."
    return Table("comparison", "Agents compared", columns, tuple(rows), note, blocks=2)


def twin_tables(pairs: Sequence[tuple[Evaluation, Evaluation]]) -> list[Table]:
    """Return tables that compare each agent's results on a split with its results on the split's oracle-linear twin.
    Each of ``pairs`` is (original, oracle).

    The difference is the cost of resolving the conditions; the gap to 100 % under oracle text is plain instruction
    following.
    """
    told = [
        (
            replace(oracle, agent=original.agent + ORACLE_TEXT),
            replace(original, agent=original.agent + _CONDITIONAL),
        )
        for original, oracle in pairs
    ]
    side_by_side = [evaluation for pair in told for evaluation in pair]
    tables = [_grouped("main", "Main results", side_by_side, ("source",), TWIN_COLUMNS, note=_NOTE)]
    tables += [axis_table(side_by_side, axis, columns=TWIN_COLUMNS) for axis in ("category", "observability")]
    compared = [comparison_table(pair) for pair in told]
    tables.append(replace(compared[0], rows=tuple(row for table in compared for row in table.rows)))
    return [replace(t, name=f"twin_{t.name}", title=f"Oracle and conditional text: {t.title}") for t in tables]


_CONDITIONAL: Final = " (conditions)"
ORACLE_TEXT: Final = " (oracle text)"
"""What follows an agent's name in results on the oracle-linear twin."""


def all_tables(evaluations: Sequence[Evaluation], tasks: Sequence[Task]) -> list[Table]:
    """Return all tables that compare agents, with one of `evaluations` for each agent. An axis without known values has
    no table.
    """
    tables = [main_table(evaluations), branch_table(evaluations)]
    for axis in AXES[2:]:  # source is in the main table, and scene would fill pages
        if any(value is not None for evaluation in evaluations for value in evaluation.axes[axis]):
            tables.append(axis_table(evaluations, axis))
    if any(evaluation.sweep for evaluation in evaluations):
        tables.append(sweep_table(evaluations))
    tables.append(divergence_table(evaluations, tasks))
    tables += [table for evaluation in evaluations for table in confusion_tables(evaluation)]
    if any(group is not None for evaluation in evaluations for group in evaluation.group_ids):
        tables.append(group_table(evaluations))
    if len(evaluations) > 1:
        tables.append(comparison_table(evaluations))
    return [table for table in tables if table.rows]


def _grouped(
    name: str,
    title: str,
    evaluations: Sequence[Evaluation],
    axes: Sequence[str],
    columns: Sequence[Column],
    note: str = "",
) -> Table:
    measures = tuple(column.key for column in columns)
    blocks: dict[tuple[object, ...], list[tuple[str, Summary]]] = {}
    for evaluation in evaluations:
        for row in by_axis(evaluation, *axes, measures=measures):
            blocks.setdefault(tuple(row.group.values()), []).append((evaluation.agent, row))
    if len(blocks) > 1:
        for evaluation in evaluations:
            row = summary(evaluation, group=dict.fromkeys(axes, "all"), measures=measures)
            blocks.setdefault(("all",) * len(axes), []).append((evaluation.agent, row))
    # A measure that no agent's file has gets no column.
    told = [row for found in blocks.values() for _, row in found]
    columns = [column for column in columns if any(row.estimates[column.key].n for row in told)]
    rows = tuple(
        (
            *(Cell("" if p is None else str(p)) for p in key),
            Cell(agent),
            *_cells(row, columns),
            Cell(row.episodes),
        )
        for key, found in blocks.items()
        for agent, row in found
    )
    headings = tuple(Column(axis, axis, "text") for axis in axes)
    every = (*headings, _AGENT, *columns, _EPISODES)
    intervals = _INTERVALS if note else ""
    if not any(column.key.startswith(("bsa", "csr")) for column in columns):
        note = ""  # it is about these columns
    return Table(name, title, every, rows, note, blocks=len(axes), intervals=intervals)


def _cells(row: Summary, columns: Sequence[Column]) -> tuple[Cell, ...]:
    found = (row.estimates[column.key] for column in columns)
    return tuple(Cell(e.mean, e.low, e.high, e.n, e.total) for e in found)
