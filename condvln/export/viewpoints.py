"""Discrete R2R over Matterport3D viewpoints, in the format of Matterport3DSimulator's agents (``R2R_<split>.json``).

Episodes on a navmesh become items of ``r2r/``: start, subgoals and goal become the nearest viewpoints, joined by
shortest paths in the connectivity graph. Headings are radians clockwise from +y of the scan, which is −z in Habitat's
frame.

Scans without a mesh have instructions but no such episodes. These instructions are placed on the viewpoint graph and
written to ``viewpoints/``, with manifests of their own, whose positions are viewpoints and whose ``navmesh`` is the
connectivity file. That folder can be read like an export: ``condvln evaluate EXPORT/viewpoints val_unseen …``. Its
``export.json`` has the numbers of episodes placed and left out, so that ``condvln verify`` notices lost ones.
"""

from __future__ import annotations

import hashlib
import math
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from contextlib import ExitStack
from dataclasses import dataclass, field
from functools import cached_property
from itertools import combinations
from pathlib import Path
from typing import Any, Final

import numpy as np
import orjson
import pyarrow as pa
import pyarrow.compute as pc

from condvln.episodes.graph_placing import REACH, GraphPlacement, GraphPlacer, NotOnGraph
from condvln.episodes.identity import content_hash, numeric_id
from condvln.episodes.placing import heading_degrees, yaw_quaternion
from condvln.episodes.table import LOOKING_COLUMNS
from condvln.export.contents import INDEX, document_digest
from condvln.export.report import WrittenFile
from condvln.export.splits import Split, scene_group
from condvln.export.tables import FolderTables, Row, rows_of
from condvln.export.vlnce import encode, gold
from condvln.formats.streams import ByteStream, JsonArrayStream, atomic_stream
from condvln.instructions import names_compass, programs_from_table, with_preamble
from condvln.manifest import manifest_path, manifest_row
from condvln.navigation.graph_pathfinder import GraphPathfinder
from condvln.scene import Scene, round_mm
from condvln.scene.tables import scene_from_tables
from schemas.config import SplitsConfig, WordingConfig
from schemas.errors import MissingFileError
from schemas.program import Program
from schemas.tables import TABLES

__all__ = [
    "ERROR_MARGIN",
    "FAMILY",
    "FOLDER",
    "GraphEpisode",
    "GraphEpisodes",
    "Graphs",
    "ViewpointReport",
    "r2r_episode",
    "reason_against",
    "write_viewpoints",
]

FAMILY: Final = "mp3d"
"""The family whose scans have viewpoints."""

FOLDER: Final = "viewpoints"
"""Folder of the export for what is on viewpoints alone."""

ERROR_MARGIN: Final = 3.0
"""R2R's success distance in metres."""

_TEXTS: Final = 3
"""Instructions of a path: Matterport3DSimulator's ``tasks/R2R/eval.py`` asks for trajectories ``<path_id>_0`` to
``_2``, whatever the file holds. Ours are the one proven text three times, so that means over them are means over paths.
"""

Graphs = Mapping[str, GraphPathfinder]
"""Connectivity graph by scan."""


def r2r_episode(row: Row, graph: GraphPathfinder) -> dict[str, Any] | str:
    """Return the R2R item of an episode, or the reason why there is none."""
    leaf = gold(row)
    start = graph.viewpoint(row["start_position"])
    stops = [graph.viewpoint(subgoal["position"]) for subgoal in leaf["subgoals"]] + [graph.viewpoint(leaf["goals"][0])]
    ends = [graph.viewpoint(other["goals"][0]) for other in row["leaves"]]
    reason = reason_against(start, stops, ends) or _too_near(graph, str(start), [str(end) for end in ends])
    if reason is not None:
        return reason
    path = [str(start)]
    for stop in stops:
        part = graph.viewpoint_path(path[-1], str(stop))
        if not part:
            return "its viewpoints are not connected"
        path += part[1:]
    return {
        "distance": graph.path_length(path),
        "scan": row["scene_id"],
        "path_id": row["episode_id"],
        "path": path,
        "heading": math.radians(row["start_heading_degrees"]) % (2 * math.pi),
        "instructions": [row["instruction_text"]] * _TEXTS,
    }


def _too_near(graph: GraphPathfinder, start: str, ends: list[str]) -> str | None:
    """Return a reason if two leaves, or a leaf and the start, are too close to each other, else None. R2R's evaluator
    counts everything within 3 m as reached.
    """
    between = graph.viewpoint_distance
    if any(between(one, other) < ERROR_MARGIN for one, other in combinations(ends, 2)):
        return f"two leaves within {ERROR_MARGIN:g} m on the graph"
    if any(between(start, end) < ERROR_MARGIN for end in ends):
        return f"a leaf within {ERROR_MARGIN:g} m of the start on the graph"
    return None


def reason_against(start: str | None, stops: list[str | None], ends: list[str | None]) -> str | None:
    """Return why an episode can't be an R2R item on the graph; None if it can."""
    if start is None or None in stops or None in ends:
        return "a start or goal with no viewpoint in reach"
    if len(set(ends)) < len(ends):
        return "two leaves at one viewpoint"
    if start in ends:
        return "a leaf at the start's viewpoint"
    return None


@dataclass(frozen=True)
class GraphEpisode:
    """An episode on a graph: its split, its row of the episodes table, the row of its instruction, and its R2R item."""

    split: Split
    row: Row
    instruction: Row
    item: Row


@dataclass
class GraphEpisodes:
    """All episodes on graphs of a snapshot, scan by scan.

    Parameters
    ----------
    graphs : connectivity by scan
    seed : seed of the start positions
    preamble : texts with compass words begin with the start heading, in the form that `wording` sets
    left_out : counts by reason, filled while iterating
    """

    tables: FolderTables
    graphs: Graphs
    splits: SplitsConfig
    seed: int = 0
    preamble: bool = True
    wording: WordingConfig = field(default_factory=WordingConfig)
    left_out: Counter[str] = field(default_factory=Counter)

    def __iter__(self) -> Iterator[GraphEpisode]:
        for scan in self._scans():
            graph = self.graphs[scan]
            scene = self._scene(scan)
            placer = GraphPlacer(scene, graph, self.seed)
            split = scene_group(FAMILY, scan, self.splits)
            table = self._table("instructions", scan)
            programs = dict(programs_from_table(table))
            for instruction in rows_of(table):
                program = programs[instruction["instruction_id"]]
                made = self._episode(scan, split, instruction, program, placer, graph)
                if made is not None:
                    yield made

    def _episode(
        self,
        scan: str,
        split: Split,
        instruction: Row,
        program: Program,
        placer: GraphPlacer,
        graph: GraphPathfinder,
    ) -> GraphEpisode | None:
        compass = self.preamble and names_compass(program)
        try:
            placement = placer.place(program, instruction["instruction_id"], compass=compass)
        except NotOnGraph as refused:
            self.left_out[str(refused)] += 1
            return None
        heading = heading_degrees(placement.yaw)
        text = (
            with_preamble(instruction["text"], heading, self.seed, instruction["instruction_id"], self.wording)
            if compass
            else instruction["text"]
        )
        row = _row(scan, instruction, program, placement, graph, text)
        item = r2r_episode(row, graph)
        if isinstance(item, str):
            self.left_out[item] += 1
            return None
        return GraphEpisode(split, row, instruction, item)

    def _scans(self) -> list[str]:
        """Return the scans with a graph and without a navmesh."""
        if not self._whole:
            return []
        rows = rows_of(self._whole["scenes"].select(["scene_id", "navmesh_path"]))
        return sorted(row["scene_id"] for row in rows if row["navmesh_path"] is None and row["scene_id"] in self.graphs)

    def _scene(self, scan: str) -> Scene:
        tables = {name: self._table(name, scan) for name in ("scenes", "rooms", "objects")}
        return scene_from_tables(tables, Path(), family=FAMILY)

    def _table(self, name: str, scan: str) -> pa.Table:
        found = self._whole[name]
        return found.filter(pc.equal(found["scene_id"], scan))

    @cached_property
    def _whole(self) -> dict[str, pa.Table]:
        """The tables that are queried for each scan, by name. Each is read once and as a whole, since even a hundred
        scans have only about ten thousand instructions. Empty where the snapshot has no scan.

        Raises
        ------
        MissingFileError : some tables of the family are there, and others are not
        """
        found, lost = {}, None
        for name in ("scenes", "rooms", "objects", "instructions"):
            try:
                found[name] = pa.Table.from_batches(self.tables.batches(name, FAMILY), TABLES[name])
            except (MissingFileError, KeyError) as error:  # KeyError: of tables in memory
                lost = error
        if lost is not None and (found or FAMILY in self.tables.sources):
            raise lost
        return found


def _row(
    scan: str, instruction: Row, program: Program, placement: GraphPlacement, graph: GraphPathfinder, text: str
) -> Row:
    def at(viewpoint: str) -> list[float]:
        place: list[float] = round_mm(graph.position(viewpoint)).tolist()
        return place

    leaves = [
        {
            "leaf": k,
            "object_id": leaf.moves[-1].object_id,
            "goals": [at(placed.stops[-1])],
            "subgoals": [
                {"object_id": move.object_id, "position": at(stop)}
                for move, stop in zip(leaf.moves[:-1], placed.stops[:-1], strict=True)
            ],
            "reference_path": [at(viewpoint) for viewpoint in placed.path],
            "geodesic_distance": placed.direct,
            "route_length": placed.length,
        }
        for k, (leaf, placed) in enumerate(zip(program.leaves, placement.leaves, strict=True))
    ]
    gold = program.gold_leaf()
    start = np.array(at(placement.start))
    name = instruction["instruction_id"]
    own_hash = content_hash(scan, name, start, placement.yaw)
    return {
        "scene_id": scan,
        "episode_id": numeric_id(own_hash),
        "episode_hash": own_hash,
        "instruction_id": name,
        "group_id": None,
        "category": program.category,
        "composition": instruction["composition"],
        "oddness": instruction["oddness"],
        "observability": None,
        "evidence_in_view": None,
        "observability_approximate": None,
        "evidence": None,
        # A viewpoint graph has no headings from which things could be looked at.
        **dict.fromkeys(LOOKING_COLUMNS),
        "gold_leaf": gold,
        "n_leaves": len(program.leaves),
        "gold_label": program.leaves[gold].goal.label,
        "moves": len(program.leaves[gold].moves),
        "leads": 0,
        "start_position": start.tolist(),
        "start_rotation": list(yaw_quaternion(placement.yaw)),
        "start_heading_degrees": heading_degrees(placement.yaw),
        "geodesic_distance": placement.leaves[gold].direct,
        "route_length": placement.leaves[gold].length,
        "leaves": leaves,
        "success_distance": REACH,
        # R2R has no step budget; agents get one step per viewpoint, there and back.
        "max_steps": 2 * max(len(leaf.path) for leaf in placement.leaves),
        "words": len(text.split()),
        "instruction_text": text,
        "navmesh_sha256": _hash(graph),
    }


def _hash(graph: GraphPathfinder) -> str:
    own = graph.graph
    digest = hashlib.sha256("\n".join(own.ids).encode())
    digest.update(np.ascontiguousarray(own.positions, dtype="<f4").tobytes())
    digest.update(np.ascontiguousarray(own.edges, dtype="<i4").tobytes())
    return digest.hexdigest()


@dataclass
class ViewpointReport:
    """Numbers of placed episodes by split, the scans of each split, and the numbers of episodes that could not be
    placed, by reason.
    """

    episodes: dict[str, int] = field(default_factory=dict)
    scans: dict[str, list[str]] = field(default_factory=dict)
    left_out: dict[str, int] = field(default_factory=dict)
    files: dict[str, WrittenFile] = field(default_factory=dict)
    """Files by path below the export's folder."""

    def document(self) -> dict[str, Any]:
        """Return the report as plain JSON values."""
        return {"episodes": self.episodes, "scans": self.scans, "left_out": self.left_out}


def write_viewpoints(
    out: Path, episodes: Iterable[GraphEpisode], snapshot: str, left_out: Counter[str] | None = None
) -> ViewpointReport:
    """Write the episodes below ``out/viewpoints``, each file atomically; a split without episodes gets no file.

    Parameters
    ----------
    out : the export's new folder
    episodes : episodes ordered by scan; all episodes of a scan are in one split
    snapshot : id of the episodes' snapshot
    left_out : counts by reason, filled by the iterator `episodes` and read at its end

    Raises
    ------
    StoreError : a file can't be written
    """
    report = ViewpointReport()
    folder = out / FOLDER
    opened: dict[str, tuple[JsonArrayStream, ByteStream]] = {}
    with ExitStack() as stack:
        for episode in episodes:
            split = episode.split
            if split not in opened:
                items = stack.enter_context(atomic_stream(folder / f"R2R_{split}.json", closing=b"]\n"))
                items.write(b"[")
                manifest = stack.enter_context(atomic_stream(manifest_path(folder, split)))
                opened[split] = JsonArrayStream(items), manifest
            items_of, manifest = opened[split]
            items_of.entry(encode(episode.item))
            scan = episode.row["scene_id"]
            names = {
                "source": FAMILY,
                "split": split,
                "navmesh": f"connectivity/{scan}_connectivity.json",
                "snapshot": snapshot,
            }
            manifest.write(encode(manifest_row(episode.row, episode.instruction, **names)) + b"\n")
            report.episodes[split] = report.episodes.get(split, 0) + 1
            scans = report.scans.setdefault(split, [])
            if scan not in scans:
                scans.append(scan)
    for stream in [each for items_of, manifest in opened.values() for each in (items_of.stream, manifest)]:
        name = stream.path.relative_to(out).as_posix()
        report.files[name] = WrittenFile(stream.size, stream.digest.hexdigest())
    report.left_out = dict(sorted((left_out or Counter()).items()))
    _write_index(out, snapshot, report)
    return report


def _write_index(out: Path, snapshot: str, report: ViewpointReport) -> None:
    """Write what the folder must hold; nothing where there was nothing to place."""
    if not report.episodes and not report.left_out:
        return
    files = {
        name.removeprefix(f"{FOLDER}/"): {"bytes": file.bytes, "sha256": file.sha256}
        for name, file in sorted(report.files.items())
    }
    document = {"snapshot": snapshot, "episodes": report.episodes, "left_out": report.left_out, "files": files}
    document["digest"] = document_digest(document)
    content = orjson.dumps(document, option=orjson.OPT_INDENT_2 | orjson.OPT_SORT_KEYS) + b"\n"
    with atomic_stream(out / FOLDER / INDEX) as stream:
        stream.write(content)
    report.files[f"{FOLDER}/{INDEX}"] = WrittenFile(stream.size, stream.digest.hexdigest())
