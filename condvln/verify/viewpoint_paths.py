"""Prove paths over Matterport3D's viewpoints by the scan's graph: those of ``viewpoints/`` of an export, which has
manifests of its own, and those of ``r2r/``, whose episodes are also on a navmesh.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from itertools import combinations, groupby, pairwise
from pathlib import Path
from typing import Any, Final

import networkx as nx
import numpy as np
import orjson
import shapely
from numpy.typing import NDArray
from pydantic import ValidationError

from condvln.arrays import F64
from condvln.formats.json_entries import json_lines
from condvln.formats.regular_file import read_regular
from condvln.kept import kept
from condvln.navigation.graph_pathfinder import ViewpointGraph
from condvln.scene import Room, Scene
from condvln.verify.certificate import Certificate, VerifierRules
from condvln.verify.corpus import Corpus
from condvln.verify.files import split_names
from condvln.verify.footprints import Ground
from condvln.verify.program_check import check_program
from condvln.verify.referents import SceneReferents
from condvln.verify.standpoint import heading_of, yaw_of
from condvln.verify.surfaces import Shapes
from condvln.verify.text_check import check_meaning
from schemas.config import EpisodeConfig
from schemas.episode import EpisodeLeaf
from schemas.errors import FormatError, InputError
from schemas.evaluation import ManifestEpisode

__all__ = [
    "VIEWPOINTS",
    "ProvenScan",
    "ViewpointMap",
    "prove_paths",
]


REACH: Final = 3.0
"""R2R's success distance in metres, which is also the largest distance from a stop's viewpoint to its object's box, and
the least distance between two leaves, and between a leaf and the start.
"""
FARTHEST: Final = 30.0
"""Largest distance in metres along the graph from the start to a leaf."""
ABOVE: Final = 2.5
"""Largest height in metres of a viewpoint's floor above the floor of its room."""
BELOW: Final = 0.5
"""Largest depth in metres of a viewpoint's floor below the floor of its room."""
ADJOINING: Final = 0.3
"""Largest gap in metres between the outlines of adjacent rooms."""
SAME_PLACE: Final = 0.002
"""Tolerance in metres of a viewpoint's position in a file, which is rounded to 1 mm."""
PANORAMA_SHIFT: Final = 0.05
"""Tolerance in metres on the ground between a panorama of the scan and the viewpoint of its name."""
TEXTS: Final = 3
"""Number of texts of an R2R item, which R2R's evaluation counts on; all three are the row's text."""
MILLIMETRE: Final = 1e-3
RADIAN: Final = 1e-6

MESHLESS: Final = {
    "seeable": "the scan has no mesh, so it is unknown what its things hide",
    "goal_side": "the scan has no mesh, so it is unknown whether a wall is between a viewpoint and its object",
    "observability": "the scan has no mesh, so it is unknown from where the evidence is visible",
    "in_the_way": "an agent steps from viewpoint to viewpoint, as the edges say",
}
"""Facts that can't be proven of an episode on viewpoints alone, with the reason."""


class ViewpointMap:
    """A scan's viewpoints and the ways between them.

    Parameters
    ----------
    file : name of the connectivity file, as manifests have it
    panoramas : place (x, z) in metres of each panorama of the scan by name; None if the scan's files list none
    """

    def __init__(
        self, graph: ViewpointGraph, file: str, panoramas: Mapping[str, tuple[float, float]] | None = None
    ) -> None:
        self.graph, self.file, self.panoramas = graph, file, panoramas
        self.places: F64 = graph.positions.astype(np.float64)
        self.ways: nx.Graph[str] = nx.Graph()
        self.ways.add_nodes_from(graph.ids)
        for (one, other), length in zip(graph.edges.tolist(), graph.lengths.tolist(), strict=True):
            self.ways.add_edge(graph.ids[one], graph.ids[other], length=length)
        self._metres: dict[str, dict[str, float]] = {}

    def at(self, point: Sequence[float], tolerance: float = SAME_PLACE) -> str | None:
        """Return the viewpoint nearest to a point; None if it is farther than `tolerance` metres."""
        away = np.linalg.norm(self.places - np.array(point), axis=1)
        nearest = int(away.argmin())
        return self.graph.ids[nearest] if away[nearest] <= tolerance else None

    def between(self, one: str, other: str) -> float:
        """Return the length in metres of the shortest way between two viewpoints; infinite if there is none."""
        if one not in self._metres:
            self._metres[one] = nx.single_source_dijkstra_path_length(self.ways, one, weight="length")
        return self._metres[one].get(other, math.inf)

    def broken(self, path: Sequence[str]) -> list[tuple[str, str]]:
        """Return the steps of a path that are no edge."""
        return [step for step in pairwise(path) if not self.ways.has_edge(*step)]

    def length(self, path: Sequence[str]) -> float:
        """Return the length in metres of a path along edges; infinite if a step is no edge."""
        return sum(
            self.ways.edges[step]["length"] if self.ways.has_edge(*step) else math.inf for step in pairwise(path)
        )

    def sha256(self) -> str:
        """Return the hash of names, places and edges that manifests have."""
        digest = hashlib.sha256("\n".join(self.graph.ids).encode())
        digest.update(np.ascontiguousarray(self.graph.positions, dtype="<f4").tobytes())
        digest.update(np.ascontiguousarray(self.graph.edges, dtype="<i4").tobytes())
        return digest.hexdigest()


class PlacedOnGraph:
    """Which viewpoint is an object's: the nearest one in its room or, if its room has none, in adjacent rooms."""

    def __init__(self, scene: Scene, viewpoints: ViewpointMap) -> None:
        self._scene, self._map = scene, viewpoints
        self._outlines = {
            room.room_id: shapely.Polygon(room.polygon) for room in scene.rooms if room.polygon is not None
        }
        self._inside = {room.room_id: self._viewpoints_in(room) for room in scene.rooms}

    @kept
    def distances(self, object_id: str) -> dict[str, float]:
        """Return the distance in metres on the ground from an object's box to each viewpoint at which a stop for it may
        lie; empty if there is no such object.
        """
        item = self._scene.object_of.get(object_id)
        found: dict[str, float] = {}
        if item is not None and item.room_id in self._scene.room_of:
            here = self._inside[item.room_id]
            if not here.any():
                here = self._adjoining(self._scene.room_of[item.room_id])
            away = Ground(item).distances(self._map.places)
            found = {self._map.graph.ids[k]: float(away[k]) for k in np.flatnonzero(here).tolist()}
        return found

    def _viewpoints_in(self, room: Room) -> NDArray[np.bool_]:
        places = self._map.places
        inside = (places[:, 1] >= room.floor_y - BELOW) & (places[:, 1] <= room.floor_y + ABOVE)
        if room.room_id in self._outlines:
            inside &= shapely.intersects_xy(self._outlines[room.room_id], places[:, 0], places[:, 2])
        return np.asarray(inside, dtype=np.bool_)

    def _adjoining(self, room: Room) -> NDArray[np.bool_]:
        found = np.zeros(len(self._map.places), dtype=np.bool_)
        own = self._outlines.get(room.room_id)
        for other in self._scene.rooms:
            its = self._outlines.get(other.room_id)
            if own is None or its is None or other.room_id == room.room_id or other.level != room.level:
                continue
            if own.distance(its) <= ADJOINING:
                found |= self._inside[other.room_id]
        return found


def check_places(
    row: ManifestEpisode, viewpoints: ViewpointMap, placed: PlacedOnGraph, scene: Scene, certificate: Certificate
) -> list[str] | None:
    """Check the start and all leaves of a row whose places are viewpoints, each leaf as if it were gold. Return the
    gold leaf's viewpoints; None if a place is none.
    """
    certificate.same("navmesh", (row.navmesh, row.navmesh_sha256), (viewpoints.file, viewpoints.sha256()))
    certificate.same("success_distance", row.success_distance, REACH)
    certificate.holds("start_rotation", yaw_of(row.start_rotation) is not None, "about +Y", row.start_rotation)
    start = viewpoints.at(row.start_position)
    goals = [viewpoints.at(leaf.goals[0]) if len(leaf.goals) == 1 else None for leaf in row.leaves]
    stops = [[*(viewpoints.at(stop.position) for stop in leaf.subgoals), goals[k]] for k, leaf in enumerate(row.leaves)]
    paths = [[viewpoints.at(point) for point in leaf.reference_path] for leaf in row.leaves]
    known = start is not None and all(None not in names for names in (*stops, *paths))
    if not certificate.holds("viewpoints", known, "viewpoints", "other places"):
        return None
    ways, targets = [[str(name) for name in path] for path in paths], [str(goal) for goal in goals]
    apart = [viewpoints.between(one, other) for one, other in combinations(targets, 2)]
    certificate.holds("leaves_apart", min(apart, default=math.inf) >= REACH, REACH, min(apart, default=math.inf))
    for k, (leaf, moves) in enumerate(zip(row.leaves, row.program.leaves, strict=True)):
        name, own = f"leaf {k}", [str(start), *map(str, stops[k])]
        claimed = [*(stop.object_id for stop in leaf.subgoals), leaf.object_id]
        certificate.same("leaf_objects", claimed, [move.object_id for move in moves.moves], name)
        for object_id, stop in zip(claimed, own[1:], strict=True):
            around = placed.distances(object_id)
            nearest = min(around.values(), default=math.inf)
            good = around.get(stop, math.inf) <= min(nearest + MILLIMETRE, REACH)
            certificate.holds("goal_reach", good, (object_id, stop), (nearest, around.get(stop)), name)
        _check_way(leaf, ways[k], own, viewpoints, scene.single_room, certificate, name)
        others = [goal for goal in targets if goal != targets[k] and goal in ways[k]]
        certificate.holds("path_apart", not others, "no other leaf's viewpoint", others, name)
    longest = 2 * max(len(way) for way in ways)
    certificate.same("budget", row.max_steps, longest)
    gold = row.leaves[row.gold_leaf] if 0 <= row.gold_leaf < len(ways) else row.leaves[0]
    certificate.same("geodesic_distance", row.geodesic_distance, gold.geodesic_distance)
    certificate.same("route_length", row.route_length, gold.route_length)
    return ways[row.gold_leaf] if 0 <= row.gold_leaf < len(ways) else None


def _check_way(
    leaf: EpisodeLeaf,
    way: Sequence[str],
    stops: Sequence[str],
    viewpoints: ViewpointMap,
    single_room: bool,
    certificate: Certificate,
    name: str,
) -> None:
    """Check the way of one leaf from the start through its other stops, and its lengths."""
    legs = [viewpoints.between(one, other) for one, other in pairwise(stops)]
    direct, route = viewpoints.between(stops[0], stops[-1]), sum(legs)
    broken = viewpoints.broken(way)
    certificate.holds("viewpoint_edges", not broken, "edges", broken, name)
    shortest = not broken and abs(viewpoints.length(way) - route) <= MILLIMETRE
    certificate.holds("reference_path", shortest and _visits(way, stops), list(stops), list(way), name)
    certificate.close("geodesic_distance", leaf.geodesic_distance, direct, MILLIMETRE, name)
    certificate.close("route_length", leaf.route_length, route, MILLIMETRE, name)
    certificate.holds("distance_range", REACH <= direct <= FARTHEST, (REACH, FARTHEST), direct, name)
    certificate.holds(
        "start_apart", all(one != other for one, other in pairwise(stops)), "stops apart", list(stops), name
    )
    if not single_room:
        rules = EpisodeConfig()
        most = rules.detour_factor * direct + rules.detour_slack
        certificate.holds("detour", route <= most + MILLIMETRE, most, route, name)


def _visits(way: Sequence[str], stops: Sequence[str]) -> bool:
    """Return whether a way begins at the first stop, comes through all in order, and ends at the last."""
    ahead = iter(way)
    return bool(way) and way[0] == stops[0] and way[-1] == stops[-1] and all(stop in ahead for stop in stops)


def check_item(
    item: Mapping[str, Any],
    row: ManifestEpisode,
    way: Sequence[str] | None,
    viewpoints: ViewpointMap,
    certificate: Certificate,
) -> None:
    """Check the R2R item of a row: its names, text, heading, path and distance.

    way : the viewpoints of the gold leaf, where the row's places are viewpoints; without it the path must lead through
        the viewpoints nearest to the row's places
    """
    certificate.same("record", item.get("scan"), row.scene_id, "scan")
    certificate.same("record", item.get("path_id"), row.episode_id, "path_id")
    certificate.same("record", item.get("instructions"), [row.instruction_text] * TEXTS, "instructions")
    yaw, heading = yaw_of(row.start_rotation), item.get("heading")
    if yaw is not None:
        off = math.inf
        if isinstance(heading, (int, float)) and 0.0 <= heading < 2 * math.pi:
            off = (heading - math.radians(heading_of(yaw)) + math.pi) % (2 * math.pi) - math.pi
        certificate.holds("record", abs(off) <= RADIAN, heading, math.radians(heading_of(yaw)), "heading")
    path = item.get("path")
    if not (isinstance(path, list) and len(path) > 1 and all(isinstance(name, str) for name in path)):
        certificate.holds("viewpoints", False, "two viewpoints or more", path, "path")
        return
    unknown = [name for name in path if name not in viewpoints.ways]
    if not certificate.holds("viewpoints", not unknown, "viewpoints of the graph", unknown, "path"):
        return
    _check_panoramas(path, viewpoints, certificate)
    broken = viewpoints.broken(path)
    certificate.holds("viewpoint_edges", not broken, "edges", broken, "path")
    length, distance = viewpoints.length(path), item.get("distance")
    number = float(distance) if isinstance(distance, (int, float)) else math.nan
    certificate.holds("viewpoint_length", abs(number - length) <= MILLIMETRE, distance, length, "path")
    if way is not None:
        certificate.same("viewpoint_path", path, list(way), "path")
        return
    gold = row.leaves[row.gold_leaf] if 0 <= row.gold_leaf < len(row.leaves) else row.leaves[0]
    places = [row.start_position, *(stop.position for stop in gold.subgoals), gold.goals[0]]
    # Two stops of a row may have the same nearest viewpoint: the path visits it once.
    stops = [name for name, _ in groupby(str(viewpoints.at(place, REACH)) for place in places)]
    route = sum(
        viewpoints.between(one, other) if one in viewpoints.ways else math.inf for one, other in pairwise(stops)
    )
    through = _visits(path, stops) and abs(length - route) <= MILLIMETRE
    certificate.holds("viewpoint_path", through, stops, path, "path")
    ends = [viewpoints.at(leaf.goals[0], REACH) for leaf in row.leaves]
    metres = [
        viewpoints.between(one, other) if one is not None and other is not None else -math.inf
        for one, other in (*combinations(ends, 2), *((stops[0], end) for end in ends))
    ]
    certificate.holds("leaves_apart", min(metres) >= REACH, REACH, min(metres), "path")


def _check_panoramas(path: Sequence[str], viewpoints: ViewpointMap, certificate: Certificate) -> None:
    """Check that a path's viewpoints are panoramas of the scan, at the same places on the ground."""
    if viewpoints.panoramas is None:
        certificate.unproven["panoramas"] = "the scan's .house file lists no panoramas"
        return
    number = {name: k for k, name in enumerate(viewpoints.graph.ids)}
    wrong = []
    for name in path:
        place = viewpoints.panoramas.get(name)
        x, _, z = viewpoints.places[number[name]]
        if place is None or math.hypot(place[0] - x, place[1] - z) > PANORAMA_SHIFT:
            wrong.append(name)
    certificate.holds("panoramas", not wrong, "panoramas of the scan", wrong, "path")


VIEWPOINTS: Final = "viewpoints"
"""Folder of the export whose episodes are on viewpoint graphs alone."""

ScanReader = Callable[[str], tuple[Scene, ViewpointMap]]
"""Reads a scan and its viewpoints. Raises InputError if a file is missing or can't be read."""

_SOURCE: Final = "mp3d"


def prove_paths(folder: Path, rules: VerifierRules, read_scan: ScanReader) -> Iterator[Certificate]:
    """Yield the certificate of each path over viewpoints of an export, and of each R2R item without a row."""
    corpus = Corpus()
    scans: dict[str, ProvenScan] = {}
    for base, splits, alone in (
        (folder / VIEWPOINTS, split_names(folder / VIEWPOINTS), True),
        (folder, [name for name in split_names(folder) if (folder / "r2r" / f"R2R_{name}.json").is_file()], False),
    ):
        for split in splits:
            file = base / f"R2R_{split}.json" if alone else base / "r2r" / f"R2R_{split}.json"
            try:
                items = _items(file)
            except InputError as error:
                certificate = Certificate(file.name, _SOURCE, "", split, kind="path")
                certificate.holds("readable", False, "an R2R file", str(error))
                yield certificate
                items = {}
            for row, certificate in _rows(base / "manifest" / f"{split}.jsonl", split, None if alone else items):
                if row is None:
                    yield certificate
                    continue
                item = items.pop(str(row.episode_id), None)
                try:
                    if row.scene_id not in scans:
                        scans[row.scene_id] = ProvenScan(*read_scan(row.scene_id), rules)
                    scans[row.scene_id].check(row, item, certificate, alone=alone)
                except InputError as error:
                    certificate.holds("readable", False, f"{row.source}/{row.scene_id}", str(error))
                if alone:
                    corpus.check(row, split, certificate)
                yield certificate
            for name, item in items.items():
                certificate = Certificate(name, _SOURCE, str(item.get("scan")), split, kind="path")
                certificate.holds("record", False, name, "no such episode in the manifest")
                yield certificate


class ProvenScan:
    """What all paths of one scan are checked against."""

    def __init__(self, scene: Scene, viewpoints: ViewpointMap, rules: VerifierRules) -> None:
        self._scene, self._map, self._rules = scene, viewpoints, rules
        self._placed = PlacedOnGraph(scene, viewpoints)
        self._referents = SceneReferents(scene, rules.thresholds, rules.anchor_size, Shapes(scene.root))

    def check(
        self, row: ManifestEpisode, item: Mapping[str, Any] | None, certificate: Certificate, *, alone: bool
    ) -> None:
        """Check a row and its item. A row that is `alone` has no other proof than this one."""
        way = None
        if alone:
            check_meaning(row, self._referents, self._rules, certificate)
            check_program(row, certificate)
            way = check_places(row, self._map, self._placed, self._scene, certificate)
            certificate.unproven.update(MESHLESS)
        if item is None:
            certificate.holds("record", False, row.episode_id, "no R2R item")
        elif way is not None or not alone:
            check_item(item, row, way, self._map, certificate)


def _rows(
    manifest: Path, split: str, wanted: Mapping[str, Any] | None
) -> Iterator[tuple[ManifestEpisode | None, Certificate]]:
    """Yield the rows of a manifest that are `wanted` (all if None), each with a new certificate; None for a line that
    can't be read.
    """
    for number, line in json_lines(manifest):
        try:
            if wanted is not None and str(orjson.loads(line)["episode_id"]) not in wanted:
                continue
            row = ManifestEpisode.model_validate_json(line)
            if len(row.leaves) != len(row.program.leaves):
                raise ValueError(f"{len(row.leaves)} leaves for the program's {len(row.program.leaves)}")
        except (ValidationError, ValueError, KeyError, TypeError) as error:
            if wanted is None:  # otherwise the proof of the split's episodes says so
                certificate = Certificate(f"line {number}", _SOURCE, "", split, kind="path")
                certificate.holds("readable", False, "a manifest row", str(error).splitlines()[0])
                yield None, certificate
            continue
        yield row, Certificate(row.episode_id, row.source, row.scene_id, split, kind="path")


def _items(file: Path) -> dict[str, Mapping[str, Any]]:
    """Return the items of an R2R file by id.

    Raises
    ------
    FormatError : the file does not exist, or is not a list of items with ids of their own
    """
    try:
        items = orjson.loads(read_regular(file))
    except (OSError, ValueError) as error:
        raise FormatError(f"can't be read: {error}", where=file, remedy="Export again") from error
    if not isinstance(items, list) or not all(isinstance(item, dict) and "path_id" in item for item in items):
        raise FormatError("not a list of items that each have a path_id", where=file, remedy="Export again")
    found = {str(item["path_id"]): item for item in items}
    if len(found) < len(items):
        raise FormatError("two items have the same path_id", where=file, remedy="Export again")
    return found
