"""``condvln walk`` and ``condvln evaluate``: reference agents on a split, and metrics of any agent's predictions."""

from __future__ import annotations

import json
import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, ClassVar, Final
from urllib.parse import quote

import numpy as np
from rich.console import Console, ConsoleOptions, RenderResult
from rich.measure import Measurement
from rich.text import Text

from condvln.evaluation.agents import agent_named, predict_all
from condvln.evaluation.evaluate import Evaluation
from condvln.evaluation.goal_distances import OFF_NAVMESH
from condvln.evaluation.plots import save_figures
from condvln.evaluation.predictions import write_predictions
from condvln.evaluation.render import as_csv, as_document, as_latex, as_markdown, as_rich
from condvln.evaluation.split import SplitOptions, evaluate_split, split_tasks
from condvln.evaluation.tables import Table, all_tables, twin_tables
from condvln.formats.streams import atomic_stream, write_file
from condvln.navigation.scene_navmesh import NavmeshFolder
from jobs.agents import LOOKER, datasets_of, eyes_of, is_policy, looking_agent, policy_named, walk_policy
from jobs.report import PIPE_WIDTH, Report, followed
from schemas.config import Config
from schemas.errors import FormatError, UsageError

__all__ = ["EvaluationReport", "HandedIn", "Question", "evaluate_predictions", "handed_in", "walk_split"]

EMPTY: Final = "the split has no episodes; the export's README.md says which have some"
SHOWN: Final = 5
"""Number of ids of missing episodes in a message; ``--json`` has all of them."""

MAIN_TABLES: Final = ("main", "sweep", "twin_main")
"""Tables that are printed by default, where they exist; ``--json`` and ``--csv`` have all."""
FIRST: Final = ("success_distance", "success", "spl_look", "bsa_all", "csr_all", "justified", "episodes")
"""Measures of these tables that are printed by default; a table that is asked for has all."""
LEGEND: Final = (
    "In %, SR: walks that stop at the goal; SPL-look: SR weighted by the looking path's length ÷ the walk's; "
    "BSA-all: subgoals reached in order; CSR-all: walks that reach all of them and succeed; justified: walks that "
    "succeed and saw what decides the conditions. condvln evaluate --all prints all measures; docs/metrics.md has "
    "their definitions."
)
LEAST_COLUMNS: Final = 4
"""Columns of a table that a narrow terminal shows, however many digits it breaks."""
ALL_TABLES: Final = "all"
"""Value of ``tables`` that stands for all tables."""


@dataclass(frozen=True)
class Question:
    """The files and options of one evaluation.

    Attributes
    ----------
    predictions : a file an agent: VLN-CE's, RxR's or R2R's predictions, or others' results by episode
    oracle : the same agents on the split's oracle-linear twin, in the same order; none where that is not asked
    options : how files are read and scored
    strict : an episode without a prediction, a step that no action can have made and a pose off the navmesh are errors
    tables : names of the tables to print, or ``ALL_TABLES``; the main ones where empty
    """

    export: Path
    split: str
    predictions: tuple[Path, ...]
    oracle: tuple[Path, ...] = ()
    options: SplitOptions = field(default_factory=SplitOptions)
    strict: bool = False
    tables: tuple[str, ...] = ()


@dataclass(frozen=True)
class HandedIn:
    """What is wrong with one file of predictions or results; ids are in the order of the split.

    Attributes
    ----------
    missing : episodes without a prediction or a result; an empty path counts as none
    gaps : episodes with steps that no single action can have made, and the number of these steps
    off_navmesh : episodes with poses that are not on the navmesh, and the number of these poses
    notes : what was left out or changed when the file was read
    """

    file: Path
    episodes: int
    missing: tuple[str, ...]
    gaps: Mapping[str, int]
    off_navmesh: Mapping[str, int]
    notes: tuple[str, ...]

    @property
    def faults(self) -> list[str]:
        """What a strict evaluation refuses, a sentence each."""
        gaps, off = sum(self.gaps.values()), sum(self.off_navmesh.values())
        told: tuple[tuple[Collection[str], str], ...] = (
            (self.missing, "have no prediction, or an empty path, and count as failures"),
            (
                self.gaps,
                "have steps that no single action can make (too long, through a wall, or between viewpoints without a "
                f"common edge), {gaps} in all; TL and SPL measure them along the shortest way",
            ),
            (self.off_navmesh, f"have poses more than {OFF_NAVMESH:g} m off the navmesh, {off} in all"),
        )
        return [f"{len(ids)} of {self.episodes} episodes {what}: {_shown(tuple(ids))}" for ids, what in told if ids]

    @property
    def warnings(self) -> list[str]:
        """All that is to be said about the file, a sentence each."""
        return [*self.faults, *self.notes]

    def as_json(self) -> dict[str, Any]:
        """Return the counts and all ids."""
        return {
            "file": str(self.file),
            "episodes": self.episodes,
            "missing": len(self.missing),
            "missing_ids": [int(name) for name in self.missing],
            "gaps": sum(self.gaps.values()),
            "gap_ids": [int(name) for name in self.gaps],
            "off_navmesh": sum(self.off_navmesh.values()),
            "off_navmesh_ids": [int(name) for name in self.off_navmesh],
            "notes": [*self.notes],
        }


def _shown(ids: Sequence[str]) -> str:
    return ", ".join(ids[:SHOWN]) + (", …" if len(ids) > SHOWN else "")


def handed_in(path: Path, evaluation: Evaluation) -> HandedIn:
    """Return what is wrong with a file, from its evaluation."""

    def counted(measure: str) -> dict[str, int]:
        values = np.nan_to_num(evaluation.scores[measure]).astype(int).tolist()
        return {name: count for name, count in zip(evaluation.episode_ids, values, strict=True) if count}

    return HandedIn(
        path,
        len(evaluation),
        tuple(counted("missing")),
        counted("gaps"),
        counted("off_navmesh"),
        evaluation.notes,
    )


@dataclass
class EvaluationReport:
    """The tables of one evaluation, and the episodes that each file of predictions lacks. The library rich can print
    this report on a terminal.
    """

    evaluations: Sequence[Evaluation]
    tables: Sequence[Table]
    handed_in: Sequence[HandedIn] = ()
    asked: Sequence[str] = ()
    twins: Sequence[Evaluation] = ()
    exit_code: ClassVar[int] = 0

    @property
    def shown(self) -> list[Table]:
        """Return the tables to print: those requested by name, else the main ones."""
        asked = self.asked or MAIN_TABLES
        return [table for table in self.tables if (*asked,) == (ALL_TABLES,) or table.name in asked]

    @property
    def warnings(self) -> list[str]:
        """Return what is to be said about each file, and about all, a sentence each."""
        said = [f"{one.file}: {warning}" for one in self.handed_in for warning in one.warnings]
        said += [] if not self.evaluations or len(self.evaluations[0]) else [EMPTY]
        unchecked = max((int(np.isnan(one.scores["justified"]).sum()) for one in self.evaluations), default=0)
        if unchecked:
            said.append(
                f"justified is undefined in {unchecked} of {len(self.evaluations[0])} episodes: what an agent saw is "
                "checked in the scenes that --data FAMILY=DIR names"
            )
        return said

    def as_json(self) -> dict[str, Any]:
        """Return all tables as plain values, and the counts of episodes of each file."""
        return {
            "warnings": self.warnings,
            "predictions": [one.as_json() for one in self.handed_in],
            "tables": [as_document(table) for table in self.tables],
        }

    def as_markdown(self) -> str:
        """Return the tables to print as Markdown."""
        return "\n".join(as_markdown(table) for table in self.shown)

    def as_latex(self) -> str:
        """Return the tables to print as LaTeX (booktabs)."""
        return "\n".join(as_latex(table) for table in self.shown)

    def write_csv(self, folder: Path) -> list[Path]:
        """Write one CSV file per table, with unrounded numbers; return the paths of the files.

        Raises
        ------
        StoreError : the disk refused
        """
        files = {folder / f"{quote(table.name, safe=' ')}.csv": as_csv(table) for table in self.tables}
        return [write_file(path, text.encode()) for path, text in files.items()]

    def write_plots(self, folder: Path) -> list[Path]:
        """Plot SR, BSA and CSR against depth and chain length; return the paths of the plots."""
        return save_figures(self.evaluations, folder)

    def write_scores(self, path: Path) -> None:
        """Write one JSON line per episode and agent.

        Raises
        ------
        StoreError : the disk refused
        """
        with atomic_stream(path) as stream:
            for evaluation in self.evaluations:
                for row in evaluation.rows():
                    stream.write(json.dumps({"agent": evaluation.agent, **row}).encode() + b"\n")

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        yield from (Text(f"warning: {warning}") for warning in self.warnings)
        for table in self.shown:
            yield from _fitting(table if self.asked else _first(table), console, options)
        if not self.asked:
            yield Text(LEGEND)
        others = [table.name for table in self.tables if table not in self.shown]
        if others:
            yield Text(f"more tables, with --table NAME or --all: {', '.join(others)}")


def _first(table: Table) -> Table:
    """Return a table with its leading columns and the measures of FIRST alone."""
    kept = [k for k, column in enumerate(table.columns) if column.kind == "text" or column.key in FIRST]
    return replace(_part(table, kept), note="")


def _part(table: Table, kept: Sequence[int]) -> Table:
    """Return some columns of a table."""
    rows = tuple(tuple(row[k] for k in kept) for row in table.rows)
    return replace(table, columns=tuple(table.columns[k] for k in kept), rows=rows)


def _fitting(table: Table, console: Console, options: ConsoleOptions) -> RenderResult:
    """Yield a table with as many columns as fit, the leading ones first and the count of episodes, and the names of the
    others: numbers that are broken into lines of two digits can't be read.
    """
    kept = [*range(len(table.columns))]
    left_out: list[str] = []
    unbounded = options.update_width(10 * PIPE_WIDTH)
    while True:
        shown = as_rich(_part(table, kept))
        if len(kept) <= LEAST_COLUMNS or Measurement.get(console, unbounded, shown).maximum <= options.max_width:
            break
        left_out.insert(0, table.columns[kept.pop(-2)].heading)
    yield shown
    if left_out:
        yield Text(f"no room for {', '.join(left_out)}: a wider terminal, --csv or --markdown has them")


def walk_split(
    export: Path,
    split: str,
    agent: str,
    out: Path,
    roots: Sequence[Path],
    seed: int,
    objects: Config | None = None,
    datasets: Sequence[str] = (),
    looker: Sequence[str] = (),
) -> Report:
    """Run one agent on the episodes of a split, each on the episode's own navmesh, and write the agent's predictions to
    `out`.

    Parameters
    ----------
    agent : a reference agent, or ``module:Class`` of one's own
    objects : the configuration whose published objects one's own agent sees; without it, it sees none
    datasets, looker : ``FAMILY=FOLDER`` of what the agent ``looker`` sees, and ``KEY=VALUE`` of its configuration

    Raises
    ------
    UsageError : no such agent, or it answers something that is not an action
    MissingFileError, FormatError : the navmesh of an episode is in no folder, or differs; nothing is walked then
    """
    tasks = split_tasks(export, split)
    navmeshes = NavmeshFolder((export, *roots, *datasets_of(datasets).values()))
    navmeshes.check(tasks)
    if agent == LOOKER:
        predictions = predict_all(looking_agent(datasets, looker), tasks, navmeshes, seed=seed)
    elif is_policy(agent):
        eyes = eyes_of(objects, navmeshes) if objects is not None else None
        predictions = walk_policy(policy_named(agent), tasks, navmeshes, eyes)
    else:
        predictions = predict_all(agent_named(agent), tasks, navmeshes, seed=seed)
    count = write_predictions(out, followed(predictions, "walking", len(tasks)))
    said = f"{count} predictions of {agent} in {out}{'' if tasks else f': {EMPTY}'}"
    return Report({"predictions": count, "file": str(out)}, [said])


def evaluate_predictions(asked: Question) -> EvaluationReport:
    """Compute metrics and tables of one or several agents on one split.

    Raises
    ------
    UsageError : not one file of the twin for each agent
    FormatError : a file has a fault, and the question is strict
    InputError : from the readers
    """
    if asked.oracle and len(asked.oracle) != len(asked.predictions):
        raise UsageError(
            f"--oracle is given {len(asked.oracle)} times for {len(asked.predictions)} agents",
            remedy="Give --oracle once for each agent, in the same order.",
        )
    options = asked.options
    lengths: list[tuple[str, float | None]] = [("--radius", radius) for radius in options.radii]
    lengths += [("--oracle-radius", options.rules.oracle_success_distance), ("--forward-step", options.forward)]
    for option, length in lengths:
        if length is not None and not (math.isfinite(length) and length > 0):
            raise UsageError(f"{option} {length:g}", remedy="Give a positive number of metres.")
    evaluations, tasks = evaluate_split(asked.export, asked.split, asked.predictions, options)
    # The twin has the same episodes, goals and budgets: one manifest serves both.
    twins = [evaluate_split(asked.export, asked.split, (path,), options)[0][0] for path in asked.oracle]
    files = [
        handed_in(path, evaluation)
        for path, evaluation in zip((*asked.predictions, *asked.oracle), (*evaluations, *twins), strict=True)
    ]
    wrong = next((one for one in files if one.faults), None)
    if asked.strict and wrong is not None:
        raise FormatError(
            wrong.faults[0], where=wrong.file, remedy="Correct the file, or leave out --strict to score it as it is"
        )
    tables = all_tables(evaluations, tasks)
    if twins:
        tables += twin_tables(list(zip(evaluations, twins, strict=True)))
    names = [table.name for table in tables]
    unknown = [name for name in asked.tables if name not in (*names, ALL_TABLES)]
    if unknown:
        raise UsageError(
            f"there is no table {unknown[0]!r}", place="--table", remedy=f"Choose one of: {', '.join(names)}."
        )
    return EvaluationReport(evaluations, tables, files, asked.tables, twins)
