"""``condvln explore``: the page of a snapshot or an export, with the results, tables and walks of agents."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Final

import orjson

from condvln.evaluation.episode_stats import is_episode_stats, read_episode_stats
from condvln.evaluation.evaluate import Evaluation
from condvln.evaluation.predictions import Prediction, detect_format, read_predictions
from condvln.evaluation.reading import ReadRules
from condvln.evaluation.split import SplitOptions, evaluate_split
from condvln.evaluation.tables import ORACLE_TEXT, Table, all_tables
from condvln.explorer import Site, episode_document, plan_document
from condvln.explorer.agents import AgentResults, difference_table, table_document, walk_document
from condvln.explorer.plan import graph_document
from condvln.explorer.views import pictures
from condvln.export.contents import read_document
from condvln.formats.json_entries import json_lines
from condvln.manifest import manifest_lines, manifest_paths
from condvln.navigation.scene_navmesh import NavmeshFolder
from jobs.agents import evidence_seen
from jobs.evaluate import EvaluationReport, Question
from jobs.explore_scenes import ExploredScene, export_scenes, snapshot_scenes
from jobs.explore_statistics import Counts, former_episodes, scene_yield, statistics_document
from jobs.report import Report, followed
from jobs.show import world_of
from schemas.base import Json
from schemas.config import Config
from schemas.errors import InputError, UsageError

__all__ = ["Exploration", "ExploredAgents", "ScoredSplit", "asked_split", "explore", "scored_splits"]

CERTIFICATES: Final = "certificates"


@dataclass(frozen=True)
class Exploration:
    """What the page shows.

    Attributes
    ----------
    export : folder of the export; None where the configuration has none
    config : the configuration whose snapshot is shown; None to show the export alone
    predictions : a file an agent and split; its split is found by its ids
    roots : folders of datasets with navmeshes that the export does not ship
    before : a former export, or a former snapshot's id or ref, with which the episodes are compared
    views : number of episodes of each scene with pictures and places of first sight; they need the sources' files
    scored : agents that were scored already
    """

    out: Path
    export: Path | None
    config: Config | None = None
    predictions: tuple[Path, ...] = ()
    roots: tuple[Path, ...] = ()
    before: Path | str | None = None
    views: int = 0
    scored: tuple[ScoredSplit, ...] = ()


def explore(asked: Exploration) -> Report:
    """Write the page of an export or of a published snapshot.

    Raises
    ------
    UsageError : there is nothing to show, the folder holds something else, or a file of predictions fits no split
    InputError : from the readers
    """
    export = asked.export if asked.export is not None and manifest_paths(asked.export) else None
    if export is None and asked.config is None:
        raise UsageError(
            "neither a configuration nor an export", place=str(asked.export), remedy="Name a YAML file or an export."
        )
    if export is None and asked.predictions:
        raise UsageError("there is no export to score predictions on", remedy="Run condvln export CONFIG first.")
    roots = (*asked.roots, *(() if asked.config is None else [source.root for source in asked.config.sources]))
    if asked.config is not None:
        scenes = snapshot_scenes(asked.config, export)
    else:
        assert export is not None
        scenes = export_scenes(export, roots)
    agents = ExploredAgents()
    options = SplitOptions(navmesh_roots=roots)
    if asked.config is not None and export is not None and asked.predictions:
        datasets = [f"{source.family}={source.root}" for source in asked.config.sources if source.root.exists()]
        options = replace(options, sees_of=evidence_seen(export, datasets, roots))
    for scored in (*asked.scored, *(() if export is None else scored_splits(export, asked.predictions, options))):
        agents.add(scored)
    if asked.views and asked.config is None:
        raise UsageError(
            "an export holds no scenes of which views could be made", place="--views", remedy="Name its configuration."
        )
    former = None if asked.before is None else former_episodes(str(asked.before), asked.config)
    site = Site(asked.out)
    counts = Counts()
    proofs = _Certificates(export)
    folder = NavmeshFolder(tuple(path for path in (export, *roots) if path is not None))
    for scene in followed(scenes.scenes(), "scenes"):
        counts.add(scene)
        _add(site, scene, proofs, agents, folder, asked)
    record = None if export is None else read_document(export / "export.json")
    statistics = statistics_document(counts, record, former)
    page = site.finish(
        scenes.title, snapshot=scenes.snapshot, statistics=statistics, agents=agents.results, tables=agents.tables
    )
    document = {"page": str(page), "scenes": counts.scenes, "episodes": counts.episodes, "agents": len(agents.results)}
    return Report(document, [f"{counts.episodes} episodes of {counts.scenes} scenes: open {page}"])


def _add(
    site: Site,
    scene: ExploredScene,
    proofs: _Certificates,
    agents: ExploredAgents,
    folder: NavmeshFolder,
    asked: Exploration,
) -> None:
    documents = [episode_document(row, facts=scene.facts, certificate=proofs.of(row)) for row in scene.rows]
    walks = agents.walks_of(scene.rows, folder)
    if asked.config is not None and documents and asked.views:
        shown = sorted(documents, key=lambda one: one["id"] not in walks)[: asked.views]  # those of agents first
        _look(site, scene, shown, asked.config, walks)
    ids = [item.object_id for item in scene.scene.objects]
    site.add_scene(
        scene.scene.family,
        scene.scene.scene_id,
        scene.rows,
        documents,
        plan=plan_document(scene.scene, scene.tile, scene.seen),
        graph=None if scene.relations is None else graph_document(scene.relations, ids),
        made=scene_yield(scene),
        walks=walks,
    )


def _look(
    site: Site, scene: ExploredScene, documents: Sequence[Json], config: Config, walks: Mapping[str, Json]
) -> None:
    """Add pictures to the documents of some episodes."""
    world = world_of(config, {"source": scene.scene.family, "scene_id": scene.scene.scene_id})
    for document in documents:
        for k, (caption, data) in enumerate(pictures(document, world.renderer, walks.get(document["id"], {}))):
            document["frames"].append({"file": site.add_picture(f"{document['id']}-{k}", data), "caption": caption})


class _Certificates:
    """The certificates of an export by episode id, kept as unparsed JSON lines."""

    def __init__(self, export: Path | None) -> None:
        self._lines: dict[str, bytes] = {}
        for path in sorted((export / CERTIFICATES).glob("*.jsonl")) if export is not None else ():
            for _, text in json_lines(path):
                line = orjson.loads(text)
                if isinstance(line, dict) and "episode_id" in line:
                    self._lines[str(line["episode_id"])] = text

    def of(self, row: Mapping[str, Any]) -> Json | None:
        """Return the certificate of an episode; None if there is none."""
        text = self._lines.get(str(row["episode_id"]))
        found: Json | None = None if text is None else orjson.loads(text)
        return found


@dataclass(frozen=True)
class ScoredSplit:
    """Agents' results on one split, with the options that they were scored by.

    Attributes
    ----------
    files : the file of predictions or results of each evaluation, in the same order
    reading : how the files are read
    """

    split: str
    evaluations: Sequence[Evaluation]
    tables: Sequence[Table]
    files: Sequence[Path]
    reading: ReadRules = field(default_factory=ReadRules)


def scored_splits(export: Path, predictions: Sequence[Path], options: SplitOptions) -> list[ScoredSplit]:
    """Score files of predictions by the same rules, each on the split that has its episodes.

    Raises
    ------
    UsageError : a file fits no split of the export, or has paths over viewpoints
    InputError : from the readers
    """
    split_of = {
        str(name): path.stem for path in manifest_paths(export) for line in manifest_lines(path) for name in line.ids()
    }
    by_split: dict[str, list[Path]] = {}
    for path in predictions:
        by_split.setdefault(_split(path, split_of), []).append(path)
    found = []
    for split, paths in followed(sorted(by_split.items()), "scoring"):
        evaluations, tasks = evaluate_split(export, split, paths, options)
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
        asked.options.reading,
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
    tables: list[Json] = field(default_factory=list)

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
                walks.update({one.episode_id: one for one in read_predictions(path, rules=scored.reading)})

    def walks_of(self, rows: Sequence[Mapping[str, Any]], folder: NavmeshFolder) -> dict[str, Json]:
        """Return the agents' walks of the episodes `rows`, by episode id and agent. For an episode whose navmesh is not
        in `folder`, distances are those along straight lines.
        """
        found: dict[str, Json] = {}
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
