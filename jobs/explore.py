"""``condvln explore``: the page of a snapshot or an export, with what agents did on it."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

import orjson

from condvln.evaluation.episode_stats import is_episode_stats, read_episode_stats
from condvln.evaluation.predictions import Prediction, read_predictions
from condvln.evaluation.render import as_document
from condvln.evaluation.split import SplitOptions, evaluate_split
from condvln.evaluation.tables import all_tables
from condvln.explorer import Site, episode_document, plan_document
from condvln.explorer.graph import graph_document
from condvln.explorer.views import first_views, pictures
from condvln.explorer.walks import AgentResults, walk_document
from condvln.export.contents import read_document
from condvln.formats.json_entries import json_lines
from condvln.manifest import manifest_lines, manifest_paths
from condvln.navigation.navmesh_folder import NavmeshFolder
from condvln.sources.source import hash_file
from condvln.world import open_world
from jobs.explore_scenes import ExploredScene, export_scenes, snapshot_scenes
from jobs.explore_statistics import Counts, former_cells, statistics_document
from jobs.pipeline import open_configured
from jobs.report import Report
from schemas.config import Config
from schemas.errors import InputError, UsageError

__all__ = ["Exploration", "explore"]

CERTIFICATES: Final = "certificates"
Document = dict[str, Any]


@dataclass(frozen=True)
class Exploration:
    """What the page shows.

    Attributes
    ----------
    export : folder of the export; None where the configuration has none
    config : the configuration whose snapshot is shown; None to show the export alone
    predictions : a file an agent and split; its split is found by its ids
    roots : folders of datasets with navmeshes that the export does not ship
    before : an export with which the counts are compared
    views : number of episodes of each scene with pictures and places of first sight; they need the sources' files
    """

    out: Path
    export: Path | None
    config: Config | None = None
    predictions: tuple[Path, ...] = ()
    roots: tuple[Path, ...] = ()
    before: Path | None = None
    views: int = 0


@dataclass
class _Agents:
    """Results and walks of all agents, and the tables of each split."""

    results: list[AgentResults] = field(default_factory=list)
    walks: dict[str, dict[str, Prediction]] = field(default_factory=dict)
    tables: list[Document] = field(default_factory=list)


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
    scenes = (
        snapshot_scenes(asked.config, export) if asked.config is not None else export_scenes(_folder(export), roots)
    )
    agents = _agents(export, asked.predictions, roots)
    if asked.views and asked.config is None:
        raise UsageError("an export has nothing to see", place="--views", remedy="Name its configuration.")
    former = None if asked.before is None else former_cells(asked.before)
    site = Site(asked.out)
    counts = Counts()
    proofs = _Certificates(export)
    folder = NavmeshFolder(tuple(path for path in (export, *roots) if path is not None))
    for scene in scenes.scenes():
        counts.add(scene)
        _add(site, scene, proofs, agents, folder, asked)
    record = None if export is None else read_document(export / "export.json")
    statistics = statistics_document(counts, record, former)
    page = site.finish(
        scenes.title, snapshot=scenes.snapshot, statistics=statistics, agents=agents.results, tables=agents.tables
    )
    document = {"page": str(page), "scenes": counts.scenes, "episodes": counts.episodes, "agents": len(agents.results)}
    return Report(document, [f"{counts.episodes} episodes of {counts.scenes} scenes: open {page}"])


def _folder(export: Path | None) -> Path:
    assert export is not None
    return export


def _add(
    site: Site, scene: ExploredScene, proofs: _Certificates, agents: _Agents, folder: NavmeshFolder, asked: Exploration
) -> None:
    documents = [
        episode_document(row, facts=scene.facts, certificate=proofs.of(row)) for row in scene.rows
    ]  # fmt: skip
    if asked.config is not None and documents[: asked.views]:
        _look(site, scene, documents[: asked.views], asked.config)
    ids = [item.object_id for item in scene.scene.objects]
    site.add_scene(
        scene.scene.family,
        scene.scene.scene_id,
        scene.rows,
        documents,
        plan=plan_document(scene.scene, scene.tile, scene.seeable),
        graph=None if scene.relations is None else graph_document(scene.relations, ids),
        walks=_walks(scene.rows, agents, folder),
    )


def _look(site: Site, scene: ExploredScene, documents: Sequence[Document], config: Config) -> None:
    """Add pictures and places of first sight to the documents of some episodes."""
    configured = next(one for one in config.sources if one.family == scene.scene.family)
    name = scene.scene.scene_id
    asked = configured.model_copy(update={"scenes": (name,), "exclude": ()})
    world = open_world(open_configured(config, asked, hash_file), name, config.agent)
    for document in documents:
        document["views"] = first_views(document, world.view, config.places, config.episodes)
        for k, (caption, data) in enumerate(pictures(document, world.renderer)):
            document["frames"].append({"file": site.add_picture(f"{document['id']}-{k}", data), "caption": caption})


def _walks(rows: Sequence[Mapping[str, Any]], agents: _Agents, folder: NavmeshFolder) -> dict[str, Document]:
    found: dict[str, Document] = {}
    for row in rows:
        name = str(row["episode_id"])
        by_agent = {}
        for agent, walks in agents.walks.items():
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


class _Certificates:
    """The certificates of an export by episode id, kept as unparsed JSON lines."""

    def __init__(self, export: Path | None) -> None:
        self._lines: dict[str, bytes] = {}
        for path in sorted((export / CERTIFICATES).glob("*.jsonl")) if export is not None else ():
            for _, text in json_lines(path):
                line = orjson.loads(text)
                if isinstance(line, dict) and "episode_id" in line:
                    self._lines[str(line["episode_id"])] = text

    def of(self, row: Mapping[str, Any]) -> Document | None:
        """Return the certificate of an episode; None if there is none."""
        text = self._lines.get(str(row["episode_id"]))
        found: Document | None = None if text is None else orjson.loads(text)
        return found


def _agents(export: Path | None, predictions: Sequence[Path], roots: Sequence[Path]) -> _Agents:
    agents = _Agents()
    if export is None or not predictions:
        return agents
    split_of = {str(name): path.stem for path in manifest_paths(export) for name in _ids(path)}
    by_split: dict[str, list[Path]] = {}
    for path in predictions:
        by_split.setdefault(_split(path, split_of), []).append(path)
    for split, paths in sorted(by_split.items()):
        evaluations, tasks = evaluate_split(export, split, paths, SplitOptions(navmesh_roots=tuple(roots)))
        agents.results += [AgentResults.of(evaluation, split) for evaluation in evaluations]
        agents.tables += [{"split": split, **as_document(table)} for table in all_tables(evaluations, tasks)]
        for evaluation, path in zip(evaluations, paths, strict=True):
            if not is_episode_stats(path):
                walks = agents.walks.setdefault(evaluation.agent, {})
                walks.update({one.episode_id: one for one in read_predictions(path)})
    return agents


def _ids(manifest: Path) -> Iterator[object]:
    for line in manifest_lines(manifest):
        fields = line.fields()
        yield fields.get("episode_id")
        yield fields.get("episode_hash") or fields.get("episode_id")


def _split(path: Path, split_of: Mapping[str, str]) -> str:
    """Return the split that a file of predictions belongs to: the split of the first episode in the file that the
    export has.
    """
    ids = read_episode_stats(path) if is_episode_stats(path) else (one.episode_id for one in read_predictions(path))
    for name in ids:
        if name in split_of:
            return split_of[name]
    raise UsageError(
        "no episode of the export is in this file of predictions",
        place=str(path),
        remedy="Name predictions that were made on this export.",
    )
