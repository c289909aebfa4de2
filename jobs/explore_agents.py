"""What the page shows of agents: their results and tables on each split, and their walks."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from condvln.evaluation.episode_stats import is_episode_stats, read_episode_stats
from condvln.evaluation.evaluate import Evaluation
from condvln.evaluation.predictions import Prediction, detect_format, read_predictions
from condvln.evaluation.split import SplitOptions, evaluate_split
from condvln.evaluation.tables import ORACLE_TEXT, Table, all_tables
from condvln.explorer.differences import difference_table
from condvln.explorer.tables import table_document
from condvln.explorer.walks import AgentResults, walk_document
from condvln.manifest import manifest_lines, manifest_paths
from condvln.navigation.navmesh_folder import NavmeshFolder
from jobs.evaluate import EvaluationReport, Question
from schemas.errors import InputError, UsageError

__all__ = ["ExploredAgents", "ScoredSplit", "asked_split", "scored_splits"]

Document = dict[str, Any]


@dataclass(frozen=True)
class ScoredSplit:
    """Agents' results on one split, with the options that they were scored by.

    Attributes
    ----------
    files : the file of predictions or results of each evaluation, in the same order
    assume_stop : the last pose of a walk counts as a STOP
    """

    split: str
    evaluations: Sequence[Evaluation]
    tables: Sequence[Table]
    files: Sequence[Path]
    assume_stop: bool = False


def scored_splits(export: Path, predictions: Sequence[Path], roots: Sequence[Path]) -> list[ScoredSplit]:
    """Score files of predictions by the default rules, each on the split that has its episodes.

    Raises
    ------
    UsageError : a file fits no split of the export, or has paths over viewpoints
    InputError : from the readers
    """
    split_of = {name: path.stem for path in manifest_paths(export) for name in _ids(path)}
    by_split: dict[str, list[Path]] = {}
    for path in predictions:
        by_split.setdefault(_split(path, split_of), []).append(path)
    found = []
    for split, paths in sorted(by_split.items()):
        evaluations, tasks = evaluate_split(export, split, paths, SplitOptions(navmesh_roots=tuple(roots)))
        found.append(ScoredSplit(split, evaluations, all_tables(evaluations, tasks), paths))
    return found


def asked_split(asked: Question, report: EvaluationReport) -> ScoredSplit:
    """Return the result of an evaluation in the form that the page shows: its scores and tables, and the agents' scores
    on the split's oracle twin if that was evaluated.
    """
    twins = zip(report.evaluations, report.twins, strict=True) if report.twins else ()
    return ScoredSplit(
        asked.split,
        [*report.evaluations, *(replace(twin, agent=own.agent + ORACLE_TEXT) for own, twin in twins)],
        report.tables,
        [*asked.predictions, *asked.oracle],
        asked.assume_stop,
    )


@dataclass
class ExploredAgents:
    """Results, tables and walks of all agents.

    Attributes
    ----------
    walks : by agent and episode id, or hash where the file has hashes
    """

    results: list[AgentResults] = field(default_factory=list)
    walks: dict[str, dict[str, Prediction]] = field(default_factory=dict)
    tables: list[Document] = field(default_factory=list)

    def add(self, scored: ScoredSplit) -> None:
        """Add the agents of one split. Raises InputError from the readers."""
        tables = [*scored.tables, difference_table(scored.evaluations)]
        self.tables += [table_document(table, scored.split) for table in tables if table.rows]
        for evaluation, path in zip(scored.evaluations, scored.files, strict=True):
            stats = is_episode_stats(path)
            viewpoints = not stats and detect_format(path) == "r2r"
            # R2R's agents name an instruction: <episode>_<number>.
            ids = tuple(name.rsplit("_", 1)[0] if viewpoints else name for name in evaluation.episode_ids)
            self.results.append(AgentResults.of(replace(evaluation, episode_ids=ids), scored.split))
            if not stats and not viewpoints:  # neither has positions
                walks = self.walks.setdefault(evaluation.agent, {})
                walks.update({one.episode_id: one for one in read_predictions(path, assume_stop=scored.assume_stop)})

    def walks_of(self, rows: Sequence[Mapping[str, Any]], folder: NavmeshFolder) -> dict[str, Document]:
        """Return the agents' walks of the episodes `rows`, by episode id and agent. For an episode whose navmesh is not
        in `folder`, distances are those along straight lines.
        """
        found: dict[str, Document] = {}
        for row in rows:
            name = str(row["episode_id"])
            by_agent = {}
            for agent, walks in self.walks.items():
                prediction = walks.get(name) or walks.get(str(row.get("episode_hash")))
                if prediction is None or not len(prediction.positions):
                    continue
                goals = next(leaf["goals"] for leaf in row["leaves"] if leaf["leaf"] == row["gold_leaf"])
                try:
                    pathfinder = folder.load(row["navmesh"], row["navmesh_sha256"], f"episode {name}")
                except InputError:
                    pathfinder = None  # straight distances are shown, and called so
                by_agent[agent] = walk_document(prediction, goals, pathfinder)
            if by_agent:
                found[name] = by_agent
        return found


def _ids(manifest: Path) -> Iterator[str]:
    for line in manifest_lines(manifest):
        fields = line.fields()
        yield str(fields.get("episode_id"))
        yield str(fields.get("episode_hash") or fields.get("episode_id"))


def _split(path: Path, split_of: Mapping[str, str]) -> str:
    """Return the split that a file of predictions belongs to: the split of its first episode that the export has."""
    stats = is_episode_stats(path)
    if not stats and detect_format(path) == "r2r":
        raise UsageError(
            "this file has paths over viewpoints",
            place=str(path),
            remedy="Run condvln evaluate EXPORT SPLIT FILE --connectivity DIR --html DIR, which scores it and writes "
            "the page.",
        )
    ids = read_episode_stats(path) if stats else (one.episode_id for one in read_predictions(path))
    for name in ids:
        if name in split_of:
            return split_of[name]
    raise UsageError(
        "no episode of the export is in this file of predictions",
        place=str(path),
        remedy="Name predictions that were made on this export.",
    )
