"""``condvln benchmark score``: a leaderboard of a split, made from the agents' predictions, with rows of reference
agents.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Sequence
from contextlib import nullcontext, suppress
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

from condvln.evaluation.agents import Agent, agent_named, predict_all
from condvln.evaluation.aggregate import Estimate, compare, summary
from condvln.evaluation.evaluate import Evaluation, evaluate
from condvln.evaluation.metrics import keys_of, metrics_of
from condvln.evaluation.split import SplitOptions, evaluate_split, split_tasks
from condvln.export.contents import exported_snapshot
from condvln.formats.streams import indented, write_file
from condvln.navigation.scene_navmesh import NavmeshFolder
from jobs.agents import LOOKER, datasets_of, evidence_seen, looking_agent
from jobs.benchmark import read_record
from jobs.evaluate import HandedIn, handed_in
from jobs.report import Report, Section
from schemas.benchmark import BenchmarkPack, Leaderboard, LeaderboardRow, MeasuredMean, PairedDifference
from schemas.errors import FormatError, MissingFileError, UsageError

__all__ = ["REFERENCES", "score_benchmark"]

REFERENCES: Final = ("looking", "oracle", "always-then", "always-else", "nearest", "random-leaf", "stop-at-start")
"""Reference agents of every leaderboard: two that know the branch, and guessers that see no scene. ``looker`` is one
more, where the scenes are named.
"""

_MEASURES: Final = keys_of("board")
_SEED: Final = 0
_RANKED: Final = metrics_of("ranking")
_COLUMNS: Final = (
    *("agent", "kind", _RANKED[0].heading, "95 %"),
    *(metric.heading for metric in _RANKED[1:]),
    *("missing", "p to the row above"),
)


def score_benchmark(
    export: Path,
    split: str,
    predictions: Sequence[Path],
    *,
    out: Path | None = None,
    roots: Sequence[Path] = (),
    references: bool = True,
    scenes: Sequence[str] = (),
    forward: float | None = None,
) -> Report:
    """Score every file of predictions, run and score the reference agents, and rank all agents by success.

    out : file for the board as JSON
    forward : length of the submitted agents' action forward in metres; None for that of the export's configuration
    scenes : ``FAMILY=FOLDER`` of each dataset of the split; with them the agent ``looker`` is walked too

    Raises
    ------
    UsageError : the export is not the one that its record is of, or an agent has the name of a reference
    FormatError : a submission has steps that no action can have made, or poses off the navmesh
    InputError : from the readers
    """
    record = read_record(export)
    if exported_snapshot(export) != record.snapshot_id:
        raise UsageError(
            "the export is another than the one that was unpacked here", where=str(export), remedy="Unpack it again."
        )
    found: list[tuple[Evaluation, LeaderboardRow]] = []
    roots = (*roots, *datasets_of(scenes).values())
    if predictions:
        sees = evidence_seen(export, scenes, roots) if scenes else None
        options = SplitOptions(navmesh_roots=tuple(roots), forward=forward, sees_of=sees)
        evaluations, _ = evaluate_split(export, split, predictions, options)
        for path, evaluation in zip(predictions, evaluations, strict=True):
            _refuse_impossible_walks(handed_in(path, evaluation))
            if evaluation.agent in (*REFERENCES, LOOKER):
                raise UsageError(
                    f"{evaluation.agent!r} is the name of a reference agent", where=str(path), remedy="Rename the file."
                )
            found.append((evaluation, _row(evaluation, path)))
    if references:
        found += [(evaluation, _row(evaluation, None)) for evaluation in _references(export, split, roots, scenes)]
    board = _board(record, split, found)
    if out is not None:
        write_file(out, indented(board.model_dump(mode="json")))
    return _report(board, out, asked=references)


def _refuse_impossible_walks(submission: HandedIn) -> None:
    impossible = replace(submission, missing=()).faults  # a missing prediction is a failure, which the board counts
    if impossible:
        raise FormatError(
            impossible[0],
            where=submission.file,
            remedy="A board takes whole walks on the navmesh: hand in every pose, and name an action forward that is "
            "longer with --forward-step",
        )


def _references(export: Path, split: str, roots: Sequence[Path], scenes: Sequence[str]) -> list[Evaluation]:
    tasks, navmeshes = split_tasks(export, split), NavmeshFolder((export, *roots))
    agents: dict[str, Agent] = {name: agent_named(name) for name in REFERENCES}
    if scenes:
        agents[LOOKER] = looking_agent(scenes, ())
    sees = evidence_seen(export, scenes, roots) if scenes else None
    found = []
    for name, agent in agents.items():
        with suppress(MissingFileError, UsageError) if name == LOOKER else nullcontext():  # it walks where all is there
            walked = predict_all(agent, tasks, navmeshes, seed=_SEED)
            found.append(evaluate(tasks, walked, navmeshes, agent=name, sees_of=sees))
    return found


def _row(evaluation: Evaluation, path: Path | None) -> LeaderboardRow:
    found = summary(evaluation, seed=_SEED, measures=_MEASURES)
    return LeaderboardRow(
        agent=evaluation.agent,
        kind="reference" if path is None else "submission",
        predictions_sha256=None if path is None or path.is_dir() else hashlib.sha256(path.read_bytes()).hexdigest(),
        episodes=len(evaluation),
        missing=int((evaluation.scores["missing"] == 1).sum()),
        measures={name: _mean(one) for name, one in found.estimates.items()},
        notes=evaluation.notes,
        against_above=None,
    )


def _mean(one: Estimate) -> MeasuredMean:
    return MeasuredMean(mean=_known(one.mean), low=_known(one.low), high=_known(one.high), n=one.n)


def _known(value: float) -> float | None:
    return round(value, 6) if math.isfinite(value) else None


def _board(record: BenchmarkPack, split: str, found: list[tuple[Evaluation, LeaderboardRow]]) -> Leaderboard:
    def place(item: tuple[Evaluation, LeaderboardRow]) -> tuple[float, float, str]:
        measures = item[1].measures
        return -(measures["success"].mean or 0.0), -(measures["spl_route"].mean or 0.0), item[1].agent

    ranked = sorted(found, key=place)
    rows = []
    for at, (evaluation, row) in enumerate(ranked):
        against = None
        if at:
            above = ranked[at - 1][0]
            test = compare(evaluation, above, seed=_SEED)
            if math.isfinite(test.difference):
                against = PairedDifference(
                    above=above.agent,
                    difference=round(test.difference, 6),
                    p_value=round(test.p_value, 6),
                    scenes=test.scenes,
                )
        rows.append(row.model_copy(update={"against_above": against}))
    return Leaderboard(
        benchmark=record.benchmark,
        version=record.version,
        draft=record.draft,
        snapshot_id=record.snapshot_id,
        split=split,
        seed=_SEED,
        rows=rows,
    )


def _report(board: Leaderboard, out: Path | None, *, asked: bool) -> Report:
    """Return the board for people; `asked` tells whether rows of reference agents were."""
    episodes = f", {board.rows[0].episodes:,} episodes" if board.rows else ""
    lines = [f"{board.benchmark} {board.version}, split {board.split}{episodes}, snapshot {board.snapshot_id}"]
    if asked and not any(row.agent == LOOKER for row in board.rows):
        lines.append(
            f"no row {LOOKER}, and justified not told everywhere: name all scenes of the split with --data "
            "FAMILY=DIR to walk this agent too, and to check what all agents saw"
        )
    lines += [f"{row.agent}: {note}" for row in board.rows for note in row.notes]
    if board.draft:
        lines.append("this version is a draft: do not publish these numbers as results")
    if out is not None:
        lines.append(f"written to {out}")
    rows: list[tuple[Any, ...]] = []
    for row in board.rows:
        success = row.measures["success"]
        spread = "–" if success.low is None else f"{100 * success.low:.1f}–{100 * (success.high or 0):.1f}"
        means = [row.measures[metric.key].mean for metric in _RANKED]
        percent = [None if value is None else round(100 * value, 1) for value in means]
        p_value = None if row.against_above is None else row.against_above.p_value
        rows.append((row.agent, row.kind, percent[0], spread, *percent[1:], row.missing, p_value))
    return Report(board.model_dump(mode="json"), lines, [Section("Leaderboard", _COLUMNS, [*rows])])
