"""``condvln walk`` and ``condvln evaluate``: reference agents on a split, and metrics of any agent's predictions."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final
from urllib.parse import quote

from rich.console import Console, ConsoleOptions, RenderResult
from rich.text import Text

from condvln.evaluation.agents import agent_named, predict_all
from condvln.evaluation.evaluate import Evaluation
from condvln.evaluation.measures import DistanceMode
from condvln.evaluation.plots import save_figures
from condvln.evaluation.predictions import write_predictions
from condvln.evaluation.render import as_csv, as_document, as_latex, as_markdown, as_rich
from condvln.evaluation.score import ScoreRules
from condvln.evaluation.split import SplitOptions, evaluate_split, split_tasks
from condvln.evaluation.tables import Table, all_tables, twin_tables
from condvln.formats.streams import atomic_stream
from condvln.navigation.navmesh_folder import NavmeshFolder
from jobs.looker import LOOKER, datasets_of, looking_agent
from jobs.policy import eyes_of, is_policy, policy_named, walk_policy
from jobs.report import Report
from schemas.config import Config
from schemas.errors import FormatError, UsageError

__all__ = ["EvaluationReport", "HandedIn", "Question", "evaluate_predictions", "walk_split"]

SHOWN: Final = 5
"""Number of ids of missing episodes in a message; ``--json`` has all of them."""

MAIN_TABLES: Final = ("main", "sweep", "twin_main")
"""Tables that are printed by default, where they exist; ``--json`` and ``--csv`` have all."""
ALL_TABLES: Final = "all"
"""Value of ``tables`` that stands for all tables."""


@dataclass(frozen=True)
class Question:
    """The files and options of one evaluation.

    Attributes
    ----------
    predictions : a file an agent: VLN-CE's, RxR's or R2R's predictions, or others' results by episode
    oracle : the same agents on the split's oracle-linear twin, in the same order; none where that is not asked
    roots : folders of datasets with the navmeshes that the export does not ship
    connectivity : folders of ``<scan>_connectivity.json``, for paths over viewpoints
    radii : success distances of a sweep, metres
    oracle_radius : distance of OSR, metres, where it is larger than the success distance; none for that
    fast_dtw : nDTW by VLN-CE's approximation
    strict : an episode without a prediction is an error
    tables : names of the tables to print, or ``ALL_TABLES``; the main ones where empty
    """

    export: Path
    split: str
    predictions: tuple[Path, ...]
    oracle: tuple[Path, ...] = ()
    roots: tuple[Path, ...] = ()
    connectivity: tuple[Path, ...] = ()
    distance: DistanceMode = "geodesic"
    radii: tuple[float, ...] = ()
    assume_stop: bool = False
    oracle_radius: float | None = None
    fast_dtw: bool = False
    strict: bool = False
    tables: tuple[str, ...] = ()


@dataclass(frozen=True)
class HandedIn:
    """The number of episodes of a split that have a prediction or a result in one file.

    missing : ids of those without, in the order of the split; an empty path counts as none
    """

    file: Path
    episodes: int
    missing: tuple[str, ...]

    def warning(self) -> str:
        """Return a warning if predictions are missing, else an empty text."""
        shown = ", ".join(self.missing[:SHOWN]) + (", …" if len(self.missing) > SHOWN else "")
        return (
            f"{len(self.missing)} of {self.episodes} episodes have no prediction, or an empty path, and count as "
            f"failures: {shown}"
        )


class EvaluationReport:
    """The tables of one evaluation, and the episodes that each file of predictions lacks. The library rich can print
    this report on a terminal.
    """

    def __init__(
        self,
        evaluations: Sequence[Evaluation],
        tables: Sequence[Table],
        handed_in: Sequence[HandedIn] = (),
        asked: Sequence[str] = (),
        twins: Sequence[Evaluation] = (),
    ) -> None:
        self.evaluations = evaluations
        self.twins = twins
        self.tables = tables
        self.handed_in = handed_in
        self._asked = tuple(asked) or tuple(name for name in MAIN_TABLES if name in {t.name for t in tables})

    @property
    def shown(self) -> list[Table]:
        """Return the tables to print: those requested by name, else the main ones."""
        return [table for table in self.tables if self._asked == (ALL_TABLES,) or table.name in self._asked]

    @property
    def warnings(self) -> list[str]:
        """Return a warning for each file that lacks episodes."""
        return [f"{one.file}: {one.warning()}" for one in self.handed_in if one.missing]

    def as_json(self) -> dict[str, Any]:
        """Return all tables as plain values, and the counts of episodes of each file."""
        predictions = [
            {
                "file": str(one.file),
                "episodes": one.episodes,
                "missing": len(one.missing),
                "missing_ids": [*one.missing],
            }
            for one in self.handed_in
        ]
        return {
            "warnings": self.warnings,
            "predictions": predictions,
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
        written = []
        for table in self.tables:
            written.append(folder / f"{quote(table.name, safe=' ')}.csv")
            with atomic_stream(written[-1]) as stream:
                stream.write(as_csv(table).encode())
        return written

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
        yield from (as_rich(table) for table in self.shown)
        others = [table.name for table in self.tables if table not in self.shown]
        if others:
            yield Text(f"more tables, with --table NAME or --all: {', '.join(others)}")


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
    count = write_predictions(out, predictions)
    return Report({"predictions": count, "file": str(out)}, [f"{count} predictions of {agent} in {out}"])


def evaluate_predictions(asked: Question) -> EvaluationReport:
    """Compute metrics and tables of one or several agents on one split.

    Raises
    ------
    UsageError : not one file of the twin for each agent
    FormatError : an episode without a prediction, where that is asked for
    InputError : from the readers
    """
    if asked.oracle and len(asked.oracle) != len(asked.predictions):
        raise UsageError(
            f"--oracle is given {len(asked.oracle)} times for {len(asked.predictions)} agents",
            remedy="Give --oracle once for each agent, in the same order.",
        )
    said = [("--radius", radius) for radius in asked.radii]
    if asked.oracle_radius is not None:
        said.append(("--oracle-radius", asked.oracle_radius))
    for option, radius in said:
        if not (math.isfinite(radius) and radius > 0):
            raise UsageError(f"{option} {radius:g}", remedy="Success distances are positive numbers of metres.")
    rules = ScoreRules(
        distance=asked.distance,
        oracle_success_distance=asked.oracle_radius,
        fast_dtw=asked.fast_dtw,
    )
    options = SplitOptions(rules, asked.radii, asked.roots, asked.assume_stop, asked.connectivity)
    evaluations, tasks = evaluate_split(asked.export, asked.split, asked.predictions, options)
    # The twin has the same episodes, goals and budgets: one manifest serves both.
    twins = [evaluate_split(asked.export, asked.split, (path,), options)[0][0] for path in asked.oracle]
    handed_in = [
        _handed_in(path, evaluation)
        for path, evaluation in zip((*asked.predictions, *asked.oracle), (*evaluations, *twins), strict=True)
    ]
    short = next((one for one in handed_in if one.missing), None)
    if asked.strict and short is not None:
        raise FormatError(
            short.warning(), where=short.file, remedy="Predict every episode, or leave out --strict to count failures"
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
    return EvaluationReport(evaluations, tables, handed_in, asked.tables, twins)


def _handed_in(path: Path, evaluation: Evaluation) -> HandedIn:
    lacking = evaluation.scores["missing"] == 1
    ids = tuple(name for name, absent in zip(evaluation.episode_ids, lacking.tolist(), strict=True) if absent)
    return HandedIn(path, len(evaluation), ids)
