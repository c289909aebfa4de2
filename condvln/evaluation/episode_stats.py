"""Read per-episode results of other evaluators. The results may be ``stats_<id>.json`` files, a single JSON object with
the results by episode id, or the lines that StreamVLN, JanusVLN and InternNav write, ``{"scene_id", "episode_id",
"success", "spl", "os", "ne", …}``.

They are aggregated into the same tables and intervals as our own scores. Their goals, budgets and success distances are
those of the other evaluator (see docs/metrics.md before comparing). Numbers that are not finite count as undefined,
never as 0.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping, Sequence, Set
from dataclasses import fields
from pathlib import Path
from typing import Any, Final, NoReturn, Protocol

import numpy as np

from condvln.evaluation.evaluate import AXES, Evaluation
from condvln.evaluation.measures import NO_LEAF
from condvln.evaluation.score import Score, ScoreRules
from condvln.formats.json_entries import document, head, json_lines, parsed
from schemas.errors import FormatError

__all__ = ["NAMES", "evaluation_of_stats", "is_episode_stats", "read_episode_stats"]

NAMES: Final[Mapping[str, str]] = {
    "distance_to_goal": "navigation_error",
    "path_length": "path_length",
    "success": "success",
    "oracle_success": "oracle_success",
    "os": "oracle_success",
    "ne": "navigation_error",
    "steps": "steps",
    "spl": "spl",
    "ndtw": "ndtw",
    "sdtw": "sdtw",
    "cls": "cls",
    "steps_taken": "steps",
    "collisions": "collisions",
    "bsa": "bsa_all",
    "branch_subgoal_accuracy": "bsa_all",
    "branch_selection_accuracy": "bsa_all",
    "csr": "csr_all",
    "conditional_success_rate": "csr_all",
}
"""The names of measures in those files, and our names for them."""

_UNBOUNDED: Final = {"navigation_error", "path_length", "steps", "collisions"}
"""Measures that are not rates: metres and counts."""
LARGEST: Final = 1e7
"""Largest accepted value of an episode's metres and counts."""
TOLERANCE: Final = 1e-6
"""Tolerance for rates beyond 0 and 1 due to rounding."""

_PREFIX: Final = "stats_"
_BY_ID: Final = re.compile(rb'\s*\{\s*"(?:[^"\\]|\\.)*"\s*:\s*\{')
"""How ``{id: {measure: number}}`` begins; the values of predictions are lists instead."""
_LINE: Final = re.compile(rb'\s*\{[^{}\[\]\n]*"episode_id"\s*:[^{}\[\]\n]*"success"\s*:')
"""How lines of results begin; lines of predictions have no key ``success``."""
_HEAD: Final = 1 << 12


class Judged(Protocol):
    """What this module needs to know of the episode that a result is about. The episode is a task, or comes from a
    stock file.
    """

    @property
    def episode_id(self) -> str: ...

    @property
    def aliases(self) -> tuple[str, ...]: ...

    @property
    def group_id(self) -> str | None: ...

    @property
    def axes(self) -> Mapping[str, str | int | None]: ...

    @property
    def gold_leaf(self) -> int: ...

    @property
    def n_leaves(self) -> int: ...

    @property
    def subgoals(self) -> int: ...


def is_episode_stats(path: Path) -> bool:
    """Return whether a folder or file holds per-episode measures rather than predictions."""
    if path.is_dir() or path.name.startswith(_PREFIX):
        return True
    start = head(path, _HEAD)
    return _BY_ID.match(start) is not None or _LINE.match(start) is not None


def read_episode_stats(path: Path) -> dict[str, dict[str, float]]:
    """Return each episode's measures by episode id, under the names that CondVLN gives these measures.

    Parameters
    ----------
    path : a folder of ``stats_<id>.json``, one such file, one file ``{id: {measure: number}}``, or lines of results

    Raises
    ------
    FormatError : the files have another format, or an id occurs twice
    """
    found: dict[str, dict[str, float]] = {}
    for file in sorted(path.glob(f"{_PREFIX}*.json")) if path.is_dir() else [path]:
        for name, stats, place in _of_file(file):
            if name in found:
                raise FormatError(
                    "the files hold two results of this episode",
                    where=file,
                    place=f"episode {name}",
                    remedy="Keep one of the two",
                )
            found[name] = _measures(stats, file, place)
    if not found:
        raise FormatError(
            "this folder holds no episode results", where=path, remedy=f"Name a folder of {_PREFIX}<id>.json files"
        )
    return found


def _of_file(path: Path) -> Iterator[tuple[str, Mapping[str, Any], str]]:
    if _LINE.match(head(path, _HEAD)):
        yield from _of_lines(path)
        return
    # A file of one episode holds numbers, a file of several holds objects; numbers may be NaN.
    content = document(path, nonfinite=True)
    if isinstance(content, dict) and content and all(isinstance(value, dict) for value in content.values()):
        yield from ((str(name), stats, f"episode {name}") for name, stats in content.items())
    elif isinstance(content, dict) and path.stem.startswith(_PREFIX):
        yield path.stem.removeprefix(_PREFIX), content, "the file"
    else:
        raise FormatError(
            "the file is neither {episode id: {measure: number}} nor one episode's measures",
            where=path,
            remedy=f"Name a folder of {_PREFIX}<id>.json files, or one file {{episode id: {{measure: number}}}}",
        )


def _of_lines(path: Path) -> Iterator[tuple[str, Mapping[str, Any], str]]:
    for number, line in json_lines(path):
        content = parsed(line, path, f"line {number}", nonfinite=True)
        if not isinstance(content, dict):
            raise FormatError(
                "the line is not an object with an episode's results",
                where=path,
                place=f"line {number}",
                remedy="Remove the line",
            )
        # The last line is a summary without an episode id.
        if "episode_id" in content:
            yield str(content["episode_id"]), content, f"line {number}"


def _measures(stats: Mapping[str, Any], path: Path, place: str) -> dict[str, float]:
    measures = {}
    for theirs, ours in NAMES.items():
        value = stats.get(theirs)
        if isinstance(value, dict):  # habitat-lab writes collisions as {count, is_collision}
            value = value.get("count")
        if value is None:
            continue
        if not isinstance(value, int | float):
            _refuse(path, place, f"{theirs} is not a number")
        most = LARGEST if ours in _UNBOUNDED else 1
        # A non-finite number counts as undefined; a finite one out of range is an error of the file.
        if abs(value) < math.inf and not -TOLERANCE <= value <= most + TOLERANCE:
            _refuse(path, place, f"{theirs} is {value!r:.40}, outside of 0 to {most:g}")
        measures[ours] = float(value) if abs(value) < math.inf else math.nan
    return measures


def _refuse(path: Path, place: str, what: str) -> NoReturn:
    raise FormatError(what, where=path, place=place, remedy="Write the results again")


def evaluation_of_stats(
    tasks: Sequence[Judged], stats: Mapping[str, Mapping[str, float]], *, agent: str = "agent", where: str = ""
) -> Evaluation:
    """Return the scores of a split from another evaluator's results; an episode without a result is a failure.

    A measure that no result has is undefined: BSA and CSR are not derived from the success of stock VLN-CE's results.

    Raises
    ------
    FormatError : a result's episode is not in the split, or has two results
    """
    known = {name: task.episode_id for task in tasks for name in (task.episode_id, *task.aliases)}
    results: dict[str, Mapping[str, float]] = {}
    for name, measures in stats.items():
        if name not in known:
            raise FormatError(
                f"no episode {name!r} in this split",
                where=where or None,
                remedy="Choose the split that the results belong to",
            )
        if known[name] in results:
            raise FormatError(f"two results of episode {name!r}", where=where or None, remedy="Keep one of the two")
        results[known[name]] = measures
    names = [item.name for item in fields(Score)]
    told = set().union(*results.values()) if results else set(NAMES.values())
    rows = [_row(task, results.get(task.episode_id), told) for task in tasks]
    return Evaluation(
        agent,
        ScoreRules(),
        tuple(task.episode_id for task in tasks),
        tuple(task.group_id for task in tasks),
        {axis: np.array([task.axes[axis] for task in tasks], dtype=object) for axis in AXES},
        np.array([task.gold_leaf for task in tasks], dtype=np.int64),
        np.array([task.n_leaves for task in tasks], dtype=np.int64),
        {name: np.array([row.get(name, math.nan) for row in rows], dtype=np.float64) for name in names},
    )


def _row(task: Judged, stats: Mapping[str, float] | None, told: Set[str]) -> dict[str, float]:
    """Return the scores of one task; the task counts as failed if ``stats`` is None. ``told`` has the names of the
    measures that occur in the results of any task.
    """
    branches = "bsa_all" in told or "csr_all" in told
    if stats is None:
        failed = dict.fromkeys(told - {"navigation_error", "steps", "collisions"}, 0.0)
        row = {**failed, "missing": 1.0, "committed_leaf": float(NO_LEAF)}
        if not branches:
            return row
        kept = row | _by_the_paper(task, 0.0, 0.0, 0.0)
        return kept if "bsa_all" in told else kept | {"bsa": math.nan, "bsa_all": math.nan}
    row = {**stats, "missing": 0.0, "committed_leaf": float(NO_LEAF)}
    if not branches:
        return row
    success = stats.get("success", math.nan)
    bsa = stats.get("bsa_all", math.nan) if task.subgoals else success
    csr = stats.get("csr_all", float(bsa == 1 and success == 1) if not math.isnan(bsa) else math.nan)
    row |= _by_the_paper(task, success, bsa, csr)
    return row if "bsa_all" in told else row | {"bsa": math.nan, "bsa_all": math.nan}


def _by_the_paper(task: Judged, success: float, bsa: float, csr: float) -> dict[str, float]:
    """Return an episode's BSA and CSR by two rules. ``bsa_all`` and ``csr_all`` are for means over all episodes;
    ``bsa`` and ``csr`` follow the paper's rule, which leaves out failed episodes without subgoals (NaN).
    """
    if task.subgoals:
        return {"bsa": bsa, "csr": csr, "bsa_all": bsa, "csr_all": csr}
    paper = 1.0 if success == 1 else math.nan
    return {"bsa": paper, "csr": paper, "bsa_all": success, "csr_all": success}
