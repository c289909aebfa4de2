"""Place programs on a viewpoint graph, for scans that consist of annotations and a graph only.

R2R's rules replace those of a navmesh: an agent stops at a viewpoint, and success is within 3 m along the graph
(Anderson et al., Vision-and-Language Navigation, CVPR 2018).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import combinations, pairwise
from typing import Final

import numpy as np
from numpy.typing import NDArray
from shapely import Polygon, contains_xy

from condvln.episodes.footprint import Footprint
from condvln.instructions.stops import Stops
from condvln.navigation.graph_pathfinder import GraphPathfinder
from condvln.scene import Room, Scene, SceneObject
from condvln.seeding import generator
from schemas.config import EpisodeConfig
from schemas.program import Program

__all__ = ["GraphLeaf", "GraphPlacement", "GraphPlacer", "NotOnGraph", "viewpoint_stops"]


REACH: Final = 3.0
"""Largest distance in metres from an object's box to the viewpoint that represents it; R2R's success distance."""
FARTHEST: Final = 30.0
"""Bounds in metres along the graph of the distance from the start to a leaf, as on a navmesh."""
STOREY: Final = 2.5
"""Largest height in metres of a camera above the floor of its room."""
UNEVEN: Final = 0.5
"""Largest depth in metres of the floor below a camera under its region's floor: regions have one height, scans are
uneven.
"""
BORDER: Final = 0.3
"""Largest gap in metres between the outlines of adjacent regions: a region without cameras is seen from its
neighbours.
"""

RULES: Final = EpisodeConfig()
"""Bounds of a route through its stops relative to the direct path: the defaults of placing on a navmesh."""


class NotOnGraph(Exception):
    """A program can't be placed on the graph; the message says why.

    object_without_viewpoint : no viewpoint within 3 m of the object (in its room, or around a room without any)
    leaves_too_close : two leaves are less than 3 m apart along the graph
    one_viewpoint : two consecutive stops share a viewpoint
    no_start_in_range : no start has every leaf 3 to 30 m away without a detour or another leaf on the way
    """


@dataclass(frozen=True, slots=True)
class GraphLeaf:
    """One leaf, computed as if it were gold: the viewpoints of its stops, the viewpoints of the path from the start,
    and two lengths in metres along the graph, `direct` from start to goal and `length` through all stops.
    """

    stops: tuple[str, ...]
    path: tuple[str, ...]
    direct: float
    length: float


@dataclass(frozen=True, slots=True)
class GraphPlacement:
    """A program placed on a viewpoint graph: the start viewpoint, the start yaw in radians about +Y, and all leaves."""

    start: str
    yaw: float
    leaves: tuple[GraphLeaf, ...]


class GraphPlacer:
    """Places programs on the viewpoints of one scan; the result depends only on scene, graph and seed."""

    def __init__(self, scene: Scene, graph: GraphPathfinder, seed: int) -> None:
        self._scene, self._graph, self._seed = scene, graph, seed
        self._places = graph.graph.positions.astype(np.float64)
        own = {room.room_id: self._of_room(room) for room in scene.rooms}
        self._in_room = {
            room.room_id: own[room.room_id] if own[room.room_id].any() else self._around(room, own)
            for room in scene.rooms
        }
        self._nearest: dict[str, str | None] = {}

    def viewpoint(self, item: SceneObject) -> str | None:
        """Return the viewpoint in the object's room that is nearest to the object's box; None if no viewpoint is within
        reach.

        An object in a region without viewpoints (a church's chancel, scanned from the nave) uses the viewpoints of
        adjacent regions on its level. Walls are unknown here, so there may be one in between.
        """
        if item.object_id not in self._nearest:
            self._nearest[item.object_id] = self._find(item)
        return self._nearest[item.object_id]

    def place(self, program: Program, instruction_id: str, *, compass: bool) -> GraphPlacement:
        """Return the start and the stops of a program; with `compass` the start yaw is a multiple of 45°.

        Raises
        ------
        NotOnGraph : the program can't be placed; the message is the reason
        """
        stops = [tuple(self._stop(move.object_id) for move in leaf.moves) for leaf in program.leaves]
        goals = [route[-1] for route in stops]
        if any(self._graph.viewpoint_distance(one, other) < REACH for one, other in combinations(goals, 2)):
            raise NotOnGraph("leaves_too_close")
        if any(one == other for route in stops for one, other in pairwise(route)):
            raise NotOnGraph("one_viewpoint")
        rng = generator(self._seed, self._scene.scene_id, instruction_id, "graph")
        order = rng.permutation(len(self._graph.graph.ids))
        yaw = float(np.radians(45.0 * rng.integers(8)) if compass else rng.uniform(-np.pi, np.pi))
        for number in order.tolist():
            start = self._graph.graph.ids[number]
            leaves = self._leaves(start, stops, goals)
            if leaves is not None:
                return GraphPlacement(start, yaw, leaves)
        raise NotOnGraph("no_start_in_range")

    def _leaves(self, start: str, stops: list[tuple[str, ...]], goals: list[str]) -> tuple[GraphLeaf, ...] | None:
        between = self._graph.viewpoint_distance
        direct = [between(start, goal) for goal in goals]
        if not all(REACH <= metres <= FARTHEST for metres in direct) or any(start == route[0] for route in stops):
            return None
        found = []
        for route, goal, metres in zip(stops, goals, direct, strict=True):
            legs = [*pairwise((start, *route))]
            if not all(np.isfinite(between(one, other)) for one, other in legs):
                return None
            path = (start, *(name for one, other in legs for name in self._graph.viewpoint_path(one, other)[1:]))
            if any(other in path for other in goals if other != goal):
                return None
            length = sum(between(one, other) for one, other in legs)
            if not self._scene.single_room and length > RULES.detour_factor * metres + RULES.detour_slack:
                return None
            found.append(GraphLeaf(route, path, metres, length))
        return tuple(found)

    def _stop(self, object_id: str) -> str:
        found = self.viewpoint(self._scene.object_of[object_id])
        if found is None:
            raise NotOnGraph("object_without_viewpoint")
        return found

    def _find(self, item: SceneObject) -> str | None:
        here = self._in_room.get(item.room_id)
        box = Footprint.of(item) or Footprint(item.center[[0, 2]], np.zeros(2), np.eye(2))
        if here is None or not here.any():
            return None
        away = np.where(here, box.distance(self._places), np.inf)
        # Ties (several cameras above one box) are decided by the distance to the box's centre.
        middle = np.linalg.norm(self._places[:, [0, 2]] - item.center[[0, 2]], axis=1)
        best = int(np.lexsort((middle, away))[0])
        return self._graph.graph.ids[best] if away[best] <= REACH else None

    def _of_room(self, room: Room) -> NDArray[np.bool_]:
        above = self._places[:, 1] - room.floor_y
        level = (above >= -UNEVEN) & (above <= STOREY)
        if room.polygon is None:
            return np.asarray(level, dtype=np.bool_)
        inside = contains_xy(Polygon(room.polygon), self._places[:, 0], self._places[:, 2])
        return np.asarray(level & inside, dtype=np.bool_)

    def _around(self, room: Room, own: Mapping[str, NDArray[np.bool_]]) -> NDArray[np.bool_]:
        """Return a mask of the viewpoints in rooms that adjoin `room`. `own` has, by room id, the mask of the
        viewpoints inside that room.
        """
        found = np.zeros(len(self._places), dtype=np.bool_)
        if room.polygon is None:
            return found
        outline = Polygon(room.polygon)
        for other in self._scene.rooms:
            if other.polygon is not None and other.level == room.level and other is not room:
                found |= own[other.room_id] & (outline.distance(Polygon(other.polygon)) <= BORDER)
        return found


def viewpoint_stops(scene: Scene, graph: GraphPathfinder) -> Stops:
    """Return, for the program sampler, the objects that have a viewpoint, and which pairs of them are far enough apart.

    Two objects are far enough apart if the distance between their viewpoints is at least R2R's success distance. The
    sampler then draws no program that `GraphPlacer` would have to reject for its objects.
    """
    placer = GraphPlacer(scene, graph, 0)
    ordered = sorted(scene.objects, key=lambda item: item.object_id)
    stood = [(item.object_id, name) for item in ordered if (name := placer.viewpoint(item)) is not None]
    number = {name: k for k, name in enumerate(sorted({name for _, name in stood}))}
    between = np.array([[graph.viewpoint_distance(a, b) for b in number] for a in number]).reshape(len(number), -1)
    rows = [number[name] for _, name in stood]
    apart = np.isfinite(between) & (between >= REACH)
    return Stops(tuple(name for name, _ in stood), np.asarray(apart[np.ix_(rows, rows)], dtype=np.bool_))
