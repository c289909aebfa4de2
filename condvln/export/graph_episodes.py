"""Discrete R2R episodes for Matterport3D scans without a mesh: instructions placed on the viewpoint graph.

These episodes are only in ``r2r/``: items of the R2R file, and manifest rows whose positions are viewpoints and whose
``navmesh`` is the connectivity file, so that branches can be scored on the graph.
"""

from __future__ import annotations

import hashlib
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from condvln.episodes.graph_placing import REACH, GraphPlacement, GraphPlacer, NotOnGraph
from condvln.episodes.identity import content_hash, numeric_id
from condvln.episodes.placing import heading_degrees, yaw_quaternion
from condvln.export.r2r import Graphs, r2r_episode
from condvln.export.rows import Row, rows_of
from condvln.export.splits import Split, scene_group
from condvln.export.tables import SnapshotTables
from condvln.instructions import names_compass, programs_from_table, with_preamble
from condvln.navigation.graph_pathfinder import GraphPathfinder
from condvln.scene import Scene, round_mm
from condvln.scene.tables import scene_from_tables
from schemas.config import SplitsConfig, WordingConfig
from schemas.errors import MissingFileError
from schemas.program import Program
from schemas.tables import TABLES

__all__ = ["GraphEpisode", "GraphEpisodes"]

FAMILY = "mp3d"


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

    tables: SnapshotTables
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
        try:
            rows = rows_of(self._whole["scenes"].select(["scene_id", "navmesh_path"]))
        except KeyError:
            return []  # tables in memory without this family
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
        scans have only about ten thousand instructions.
        """
        found = {}
        for name in ("scenes", "rooms", "objects", "instructions"):
            try:
                found[name] = pa.Table.from_batches(self.tables.batches(name, FAMILY), TABLES[name])
            except MissingFileError:
                found[name] = TABLES[name].empty_table()
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
        "observability": None,
        "evidence_in_view": None,
        "observability_approximate": None,
        "evidence": None,
        "gold_leaf": gold,
        "n_leaves": len(program.leaves),
        "gold_label": program.leaves[gold].goal.label,
        "moves": len(program.leaves[gold].moves),
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
