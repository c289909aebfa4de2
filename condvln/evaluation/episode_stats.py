"""Read per-episode results of other evaluators. The results may be ``stats_<id>.json`` files, a single JSON object with
the results by episode id, or the lines (or an array of the objects) that StreamVLN, JanusVLN and InternNav write,
``{"scene_id", "episode_id", "success", "spl", "os", "ne", …}``.

They are aggregated into the same tables and intervals as our own scores. Their goals, budgets and success distances are
those of the other evaluator (see docs/metrics.md before comparing). A number that is not finite is undefined, except
where the success decides it: a failure's SPL is 0. What is undefined, and what was changed, is counted in the notes.

The split may be one of R2R_VLNCE or another stock file without a manifest. Such a file has no branches, and no navmesh
on which paths could be scored, so only the measures in the results are summarised, by scene.
"""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence, Set
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any, Final, NoReturn, TypeAlias

import numpy as np
import orjson

from condvln.evaluation.evaluate import AXES, Evaluation
from condvln.evaluation.measures import NO_LEAF
from condvln.evaluation.metrics import METRICS
from condvln.evaluation.reading import (
    ReadRules,
    episode_name,
    named_entries,
    records,
    unfinished,
    without_duplicates,
    without_summaries,
)
from condvln.evaluation.score import Score, ScoreRules
from condvln.evaluation.task import Task
from condvln.formats.json_entries import document, head, parsed
from schemas.errors import FormatError

__all__ = [
    "NAMES",
    "Judged",
    "StockEpisode",
    "evaluation_of_stats",
    "is_episode_stats",
    "read_episode_stats",
    "stock_episodes",
    "stock_file",
]

NAMES: Final[Mapping[str, str]] = {theirs: metric.key for metric in METRICS for theirs in metric.theirs}
"""The names of measures in those files, and our names for them."""

_UNBOUNDED: Final = {metric.key for metric in METRICS if metric.kind != "percent"}
"""Measures that are not rates: metres and counts."""
_YES_OR_NO: Final = {metric.key for metric in METRICS if metric.yes_or_no}
_AT_MOST_SUCCESS: Final = tuple(metric.key for metric in METRICS if metric.success == "factor")
"""Measures that are multiplied by the success, so 0 after a failure."""
_WITH_SUCCESS: Final = {metric.key for metric in METRICS if metric.success}
"""Measures that are undefined where the success is, so that their means stay comparable with its mean."""
LARGEST: Final = 1e7
"""Largest accepted value of an episode's metres and counts."""
TOLERANCE: Final = 1e-6
"""Tolerance for rates beyond 0 and 1 due to rounding."""

_PREFIX: Final = "stats_"
_BY_ID: Final = re.compile(rb'\s*\{\s*"(?:[^"\\]|\\.)*"\s*:\s*\{')
"""How ``{id: {measure: number}}`` begins; the values of predictions are lists instead."""
_ENTRY: Final = re.compile(
    rb'[\[\s]*(?:\{[^{}\[\]]*\}[\s,]*){0,8}\{(?=[^{}\[\]]*"episode_id"\s*:)(?=[^{}\[\]]*"success"\s*:)'
)
"""How entries of results begin, after a few summaries; entries of predictions have no key ``success``."""
_HEAD: Final = 1 << 16
_ENTRY_BYTES: Final = 1 << 12
_FIRST_LINES: Final = 8


def is_episode_stats(path: Path) -> bool:
    """Return whether a folder or file holds per-episode measures rather than predictions."""
    if path.is_dir() or path.name.startswith(_PREFIX):
        return True
    return _has_entries(start := head(path, _HEAD)) or _BY_ID.match(start) is not None


def _has_entries(start: bytes) -> bool:
    """Return whether a file that begins with ``start`` holds entries with an ``episode_id``, a summary first or not."""
    if _ENTRY.match(start[:_ENTRY_BYTES]) is not None:
        return True
    for line in start.split(b"\n")[:_FIRST_LINES]:
        try:
            value = orjson.loads(line)
        except orjson.JSONDecodeError:
            continue
        first = value[0] if isinstance(value, list) and value else value
        if isinstance(first, dict) and "episode_id" in first and any(name in first for name in NAMES):
            return not any(isinstance(first.get(key), list) for key in ("path", "trajectory"))
    return False


def read_episode_stats(
    path: Path, rules: ReadRules | None = None, notes: list[str] | None = None
) -> dict[str, dict[str, float]]:
    """Return each episode's measures by episode id, under the names that CondVLN gives these measures. NaN where a
    measure is not finite; a measure that an entry lacks is not in its dictionary.

    Parameters
    ----------
    path : a folder of ``stats_<id>.json``, one such file, one file ``{id: {measure: number}}``, or entries with an
        ``episode_id``, as lines or as an array
    notes : receives a sentence for each kind of thing that was left out

    Raises
    ------
    FormatError : the files have another format, or an id occurs twice
    """
    rules, notes = rules or ReadRules(), [] if notes is None else notes
    files = sorted(path.glob(f"{_PREFIX}*.json")) if path.is_dir() else [path]
    every = (
        (name, _measures(stats, file, place)) for file in files for name, stats, place in _of_file(file, rules, notes)
    )
    found = dict(without_duplicates(every, lambda item: item[0], path, rules, notes, "results"))
    if path.is_dir() and not found:
        raise FormatError(
            "this folder holds no episode results", where=path, remedy=f"Name a folder of {_PREFIX}<id>.json files"
        )
    if not any(found.values()):
        raise FormatError(
            "the file holds no measure that is known",
            where=path,
            remedy=f"Give each episode some of {', '.join(NAMES)}",
        )
    return found


def _of_file(path: Path, rules: ReadRules, notes: list[str]) -> Iterator[tuple[str, Mapping[str, Any], str]]:
    start = head(path, _HEAD)
    if _has_entries(start):
        yield from _of_entries(path, rules, notes)
        return
    if _BY_ID.match(start) is not None and not _of_one_episode(start):
        for key, data in named_entries(path, rules, notes):
            stats = parsed(data, path, f"episode {key}", nonfinite=True)
            if not isinstance(stats, dict):
                _refuse(path, f"episode {key}", "the value is not an object of measures")
            yield str(episode_name(key)), stats, f"episode {key}"
        return
    try:
        content = document(path, nonfinite=True)
    except FormatError as error:
        if not path.stem.startswith(_PREFIX):
            raise
        if not rules.allow_partial:
            raise unfinished(error) from error
        notes.append(f"{path.name} can't be read and was left out ({error.what})")
        return
    if not isinstance(content, dict) or not content or not path.stem.startswith(_PREFIX):
        raise FormatError(
            "the file is neither {episode id: {measure: number}} nor one episode's measures",
            where=path,
            remedy=f"Name a folder of {_PREFIX}<id>.json files, or one file {{episode id: {{measure: number}}}}",
        )
    yield str(episode_name(path.stem.removeprefix(_PREFIX))), content, "the file"


def _of_one_episode(start: bytes) -> bool:
    """Return whether a file begins with a measure that is an object itself, as habitat-lab's collisions are."""
    return any(start.lstrip(b"{ \t\r\n").startswith(b'"' + name.encode() + b'"') for name in NAMES)


def _of_entries(path: Path, rules: ReadRules, notes: list[str]) -> Iterator[tuple[str, Mapping[str, Any], str]]:
    for place, content in without_summaries(records(path, rules, notes), ("episode_id",), notes):
        if not isinstance(content, dict):
            _refuse(path, place, "the entry is not an object with an episode's results")
        name = episode_name(content.get("episode_id"))
        if name is None:
            _refuse(path, place, f"episode_id is {content.get('episode_id')!r:.40}, not text or a number")
        yield name, content, place


def _measures(stats: Mapping[str, Any], path: Path, place: str) -> dict[str, float]:
    measures: dict[str, float] = {}
    if any(isinstance(value, dict) and not NAMES.keys().isdisjoint(value) for value in stats.values()):
        _refuse(
            path, place, "the value holds the results of several episodes: write it alone, as {id: {measure: number}}"
        )
    for theirs, ours in NAMES.items():
        value = stats.get(theirs)
        if isinstance(value, dict):  # habitat-lab writes collisions as {count, is_collision}
            value = value.get("count")
        if value is None:
            continue
        if not isinstance(value, int | float):
            _refuse(path, place, f"{theirs} is {value!r:.40}, which is not a number")
        number = math.nan
        # A number that is not finite is undefined; a finite one out of range is an error of the file.
        if not isinstance(value, float) or math.isfinite(value):
            most = LARGEST if ours in _UNBOUNDED else 1.0
            if not -TOLERANCE <= value <= most + TOLERANCE:
                _refuse(path, place, f"{theirs} is {value!r:.40}, outside of 0 to {most:g}")
            number = min(max(float(value), 0.0), most)
            if ours in _YES_OR_NO:
                if min(number, 1 - number) > TOLERANCE:
                    _refuse(path, place, f"{theirs} is {value!r:.40}, neither 0 nor 1, so not one episode's result")
                number = float(round(number))
        before = measures.get(ours, math.nan)
        if number != before and not math.isnan(number) and not math.isnan(before):
            _refuse(path, place, f"two keys have values of {ours}: {before:g}, and {theirs} {number:g}")
        measures[ours] = number if math.isnan(before) else before
    return measures


def _refuse(path: Path, place: str, what: str) -> NoReturn:
    raise FormatError(what, where=path, place=place, remedy="Write the results again")


def evaluation_of_stats(
    tasks: Sequence[Judged],
    stats: Mapping[str, Mapping[str, float]],
    *,
    agent: str = "agent",
    where: str = "",
    notes: Sequence[str] = (),
) -> Evaluation:
    """Return the scores of a split from another evaluator's results; an episode without a result is a failure.

    A measure that no result has is undefined: BSA and CSR are not derived from the success of stock VLN-CE's results.

    Parameters
    ----------
    notes : those of the reader; the evaluation has them, and what was undefined or changed here

    Raises
    ------
    FormatError : a result's episode is not in the split, or has two results
    """
    known = {name: task.episode_id for task in tasks for name in (task.episode_id, *task.aliases)}
    results: dict[str, Mapping[str, float]] = {}
    changed: Counter[str] = Counter()
    told = set().union(*stats.values()) if stats else set(NAMES.values())
    for name, measures in stats.items():
        if name not in known:
            raise FormatError(
                f"no episode {name!r} in this split",
                where=where or None,
                remedy="Choose the split that the results belong to",
            )
        if known[name] in results:
            raise FormatError(f"two results of episode {name!r}", where=where or None, remedy="Keep one of the two")
        results[known[name]] = _consistent(measures, told, changed)
    names = [item.name for item in fields(Score)]
    rows = [_row(task, results.get(task.episode_id), told) for task in tasks]
    said = [f"{what} in {count} of {len(results)} results" for what, count in sorted(changed.items())]
    for name in sorted(told):
        lacking = sum(math.isnan(measures.get(name, math.nan)) for measures in results.values())
        if lacking:
            said.append(f"{name} is undefined in {lacking} of {len(results)} results, which its mean leaves out")
    return Evaluation(
        agent,
        ScoreRules(),
        tuple(task.episode_id for task in tasks),
        tuple(task.group_id for task in tasks),
        {axis: np.array([task.axes[axis] for task in tasks], dtype=object) for axis in AXES},
        np.array([task.gold_leaf for task in tasks], dtype=np.int64),
        np.array([task.n_leaves for task in tasks], dtype=np.int64),
        {name: np.array([row.get(name, math.nan) for row in rows], dtype=np.float64) for name in names},
        notes=(*notes, *said),
    )


def _consistent(stats: Mapping[str, float], told: Set[str], changed: Counter[str]) -> dict[str, float]:
    """Return one episode's measures such that SPL, SDTW and CSR are at most the success, and OSR, BSA and nDTW at least
    what they imply. ``changed`` counts the values that contradicted the success.
    """
    found = dict(stats)

    def becomes(name: str, value: float, because: str) -> None:
        if name in told:
            if not math.isnan(found.get(name, math.nan)) and found[name] != value:
                changed[f"{name} was set to {value:g}, as {because} has it,"] += 1
            found[name] = value

    success = found.get("success", math.nan)
    if "success" in told and math.isnan(success):
        found |= dict.fromkeys(told & _WITH_SUCCESS, math.nan)
    elif success == 0:
        for name in _AT_MOST_SUCCESS:
            becomes(name, 0.0, "a failure")
    elif success == 1:
        becomes("oracle_success", 1.0, "a success")
    if found.get("csr_all") == 1:
        becomes("bsa_all", 1.0, "a CSR of 1")
    if found.get("sdtw", 0.0) > found.get("ndtw", 1.0):
        becomes("sdtw", found["ndtw"], "a smaller nDTW")
    return found


def _row(task: Judged, stats: Mapping[str, float] | None, told: Set[str]) -> dict[str, float]:
    """Return the scores of one task; the task counts as failed if ``stats`` is None. ``told`` has the names of the
    measures that occur in the results of any task.
    """
    branches = "bsa_all" in told or "csr_all" in told
    row: dict[str, float] = {"committed_leaf": float(NO_LEAF), "missing": float(stats is None)}
    if stats is None:
        stats = dict.fromkeys(told - {"navigation_error", "steps", "collisions"}, 0.0)
    row |= stats
    if not branches:
        return row
    success = stats.get("success", math.nan)
    bsa = stats.get("bsa_all", math.nan) if task.subgoals else success
    csr = stats.get("csr_all", math.nan)
    if success == 0:
        csr = 0.0
    elif math.isnan(csr) and not math.isnan(bsa + success):
        csr = float(bsa == 1)
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


_SHAPES: Final = ("{split}.json.gz", "{split}/{split}.json.gz", "vlnce/{split}/{split}.json.gz")


@dataclass(frozen=True)
class StockEpisode:
    """One episode of a file in the format of R2R_VLNCE, without a manifest."""

    episode_id: str
    axes: Mapping[str, str | int | None]
    aliases: tuple[str, ...] = ()
    group_id: str | None = None
    gold_leaf: int = NO_LEAF
    n_leaves: int = 0
    subgoals: int = 0


Judged: TypeAlias = Task | StockEpisode
"""The episode that a result is about."""


def stock_file(folder: Path, split: str) -> Path | None:
    """Return the split's file in a folder with R2R_VLNCE's layout; None if there is none."""
    paths = (folder / shape.format(split=split) for shape in _SHAPES)
    return next((path for path in paths if path.is_file()), None)


def stock_episodes(path: Path) -> list[StockEpisode]:
    """Read the episodes of a stock VLN-CE, ANSR-v1 or RxR file.

    Raises
    ------
    FormatError : the file has another format, or an id occurs twice
    """
    content = document(path)
    episodes = content.get("episodes") if isinstance(content, dict) else None
    if not isinstance(episodes, list):
        raise _not_stock("the file has no list of episodes", path)
    found: dict[str, StockEpisode] = {}
    for number, episode in enumerate(episodes):
        name, scene = (episode.get(key) if isinstance(episode, dict) else None for key in ("episode_id", "scene_id"))
        key = episode_name(name)
        if key is None or not isinstance(scene, str):
            raise _not_stock("an episode lacks its id or its scene", path, f"episodes.{number}")
        if key in found:
            raise _not_stock("the id occurs twice", path, f"episode {name}")
        stops = episode.get("subgoals")
        axes = dict.fromkeys(AXES) | {"source": scene.split("/")[0], "scene": scene}
        found[key] = StockEpisode(key, axes, subgoals=len(stops) if isinstance(stops, list) else 0)
    return list(found.values())


def _not_stock(what: str, path: Path, place: str = "") -> FormatError:
    return FormatError(what, where=path, place=place, remedy="Check the file with condvln verify PATH --lint")
