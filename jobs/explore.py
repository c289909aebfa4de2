"""``condvln explore``: the page of a snapshot or an export, with the results and walks of agents."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import orjson

from condvln.explorer import Site, episode_document, plan_document
from condvln.explorer.graph import graph_document
from condvln.explorer.views import first_views, pictures
from condvln.export.contents import read_document
from condvln.formats.json_entries import json_lines
from condvln.manifest import manifest_paths
from condvln.navigation.navmesh_folder import NavmeshFolder
from condvln.sources.source import hash_file
from condvln.world import open_world
from jobs.explore_agents import ExploredAgents, ScoredSplit, scored_splits
from jobs.explore_drift import former_episodes
from jobs.explore_scenes import ExploredScene, export_scenes, snapshot_scenes
from jobs.explore_statistics import Counts, statistics_document
from jobs.pipeline import open_configured
from jobs.report import Report
from schemas.config import Config
from schemas.errors import UsageError

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
    scenes = (
        snapshot_scenes(asked.config, export) if asked.config is not None else export_scenes(_folder(export), roots)
    )
    agents = ExploredAgents()
    for scored in (*asked.scored, *(() if export is None else scored_splits(export, asked.predictions, roots))):
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
    site: Site,
    scene: ExploredScene,
    proofs: _Certificates,
    agents: ExploredAgents,
    folder: NavmeshFolder,
    asked: Exploration,
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
        plan=plan_document(scene.scene, scene.tile, scene.seen),
        graph=None if scene.relations is None else graph_document(scene.relations, ids),
        walks=agents.walks_of(scene.rows, folder),
    )


def _look(site: Site, scene: ExploredScene, documents: Sequence[Document], config: Config) -> None:
    """Add pictures, and the places from which the conditions' evidence is first seen, to the documents of some
    episodes.
    """
    configured = next(one for one in config.sources if one.family == scene.scene.family)
    name = scene.scene.scene_id
    asked = configured.model_copy(update={"scenes": (name,), "exclude": ()})
    world = open_world(open_configured(config, asked, hash_file), name, config.agent)
    centers = {item.object_id: item.center for item in scene.scene.objects}
    for document in documents:
        document["views"] = first_views(document, world.view, config.places, config.episodes)
        for k, (caption, data) in enumerate(pictures(document, world.renderer, centers)):
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

    def of(self, row: Mapping[str, Any]) -> Document | None:
        """Return the certificate of an episode; None if there is none."""
        text = self._lines.get(str(row["episode_id"]))
        found: Document | None = None if text is None else orjson.loads(text)
        return found
