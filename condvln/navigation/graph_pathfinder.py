"""Shortest paths over viewpoint graphs, by the methods of the pathfinder protocol; and Matterport3D's graphs of
viewpoints, ``<scan>_connectivity.json``, read with strict checks.

The rules of the files are Matterport3DSimulator's (``NavGraph.cpp``, MIT) and those of R2R's ``load_nav_graphs``: a
viewpoint counts if it is ``included``; an edge joins two such viewpoints that are ``unobstructed`` both ways.
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Final

import numpy as np
import numpy.typing as npt
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components, dijkstra

from condvln.formats.dataset_root import DatasetRoot
from condvln.formats.json_document import parse_json
from condvln.navigation.points import RandomSource, many_points, one_point, paired_points
from condvln.navigation.protocol import ShortestPath
from condvln.navigation.settings import NavMeshSettings
from condvln.navigation.tile import Floats, Ints
from schemas.errors import FormatError, InputError, UsageError

__all__ = ["GraphFolder", "GraphPathfinder", "ViewpointGraph", "read_connectivity"]

# The largest scan has about 350 viewpoints; a file lists visibility for every pair.
MAX_VIEWPOINTS = 2000
MAX_FILE_BYTES = 64 * 1024 * 1024
# Coordinates beyond 1000 km can't belong to a building.
MOST_METRES = 1e6

REMEDY = "Take the file from the Matterport3DSimulator repository again"


@dataclass(frozen=True, eq=False)
class ViewpointGraph:
    """A graph of n viewpoints and m edges.

    Attributes
    ----------
    ids : names of the viewpoints, in file order
    positions : (n, 3) float32 on the floor below the camera, metres, Habitat frame
    edges : (m, 2) int32 pairs, each once, the lower index first
    lengths : (m,) float64 metres between the two cameras, R2R's edge weight
    """

    ids: tuple[str, ...]
    positions: Floats
    edges: npt.NDArray[np.int32]
    lengths: npt.NDArray[np.float64]


def read_connectivity(path: str | os.PathLike[str]) -> ViewpointGraph:
    """Read a connectivity file.

    Camera positions are z-up in metres: (x, y, z) becomes (x, z, −y). The floor lies ``height`` metres below the
    camera.

    Raises
    ------
    MissingFileError : the file does not exist, or can't be opened
    FormatError : it does not hold a valid connectivity graph
    """
    file, real = Path(path), Path(os.path.realpath(path))  # a link may lead anywhere
    items = parse_json(DatasetRoot(real.parent).read(real.name, MAX_FILE_BYTES), str(file)).elements()
    count = len(items)
    if not 1 <= count <= MAX_VIEWPOINTS:
        raise _error(file, "", f"not a list of 1 to {MAX_VIEWPOINTS} viewpoints")
    names = [item["image_id"].text() for item in items]
    poses = [item["pose"].vector(16, MOST_METRES) for item in items]
    heights = [item["height"].number(MOST_METRES) for item in items]
    included = [item["included"].boolean() for item in items]
    blocked = np.zeros((count, count), bool)
    for number, item in enumerate(items):
        free = item["unobstructed"].value
        if not isinstance(free, list) or len(free) != count or not all(isinstance(one, bool) for one in free):
            item["unobstructed"].fail(f"a list of {count} booleans is expected")
        blocked[number] = ~np.array(free, bool)
    if "" in names:
        raise _error(file, f"[{names.index('')}].image_id", "the name is empty")
    if len(set(names)) != count:
        twice = next(name for name in names if names.count(name) > 1)
        raise _error(file, f"[{names.index(twice)}].image_id", f"viewpoint {twice!r} occurs twice")
    kept = np.flatnonzero(included)
    if not len(kept):
        raise _error(file, "", "no viewpoint is included")
    joined = ~blocked[np.ix_(kept, kept)]
    if np.diagonal(joined).any():
        number = int(kept[np.argmax(np.diagonal(joined))])
        raise _error(file, f"[{number}].unobstructed", "a viewpoint is connected to itself")
    if (joined != joined.T).any():
        a, b = np.argwhere(joined & ~joined.T)[0]
        raise _error(file, f"[{kept[a]}].unobstructed[{kept[b]}]", "an edge exists in one direction only")
    matrix = np.array(poses)[kept].reshape(-1, 4, 4)
    cameras = np.stack([matrix[:, 0, 3], matrix[:, 2, 3], -matrix[:, 1, 3]], axis=1)
    floors = cameras - np.array([0.0, 1.0, 0.0]) * np.array(heights)[kept][:, None]
    edges = np.argwhere(np.triu(joined)).astype(np.int32)
    lengths = np.linalg.norm(cameras[edges[:, 0]] - cameras[edges[:, 1]], axis=1)
    return ViewpointGraph(tuple(names[i] for i in kept), floors.astype(np.float32), edges, lengths)


def _error(file: Path, place: str, what: str) -> FormatError:
    return FormatError(what, where=file, place=place, remedy=REMEDY)


# Largest distance in metres from a point to the viewpoint it snaps to: R2R's success radius, about 1.5 edges.
SNAP_REACH = 3.0
# Largest horizontal distance in metres of a navigable point from a viewpoint, as on a navmesh.
NAVIGABLE_SHIFT = 1e-2

NOWHERE = -1


class GraphPathfinder:
    """Paths along the edges of a graph.

    A point is replaced by the nearest viewpoint; lengths are sums of edge weights, as in R2R. Points
    are (3,) and batches (n, 3), metres, Habitat frame.
    """

    def __init__(self, graph: ViewpointGraph, snap_reach: float = SNAP_REACH) -> None:
        self.graph, self.snap_reach = graph, snap_reach
        count = len(graph.ids)
        # scipy treats a zero weight as no edge, so two viewpoints at one position get a nanometre.
        weights = np.maximum(graph.lengths, 1e-9)
        matrix = csr_array((weights, (graph.edges[:, 0], graph.edges[:, 1])), shape=(count, count))
        self._lengths, self._before = dijkstra(matrix, directed=False, return_predecessors=True)
        _, labels = connected_components(matrix, directed=False)
        self._islands = labels.astype(np.int32)
        self._number = {name: number for number, name in enumerate(graph.ids)}

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> GraphPathfinder:
        """Load a pathfinder over a Matterport3D connectivity file.

        Raises
        ------
        MissingFileError, FormatError : from :func:`~condvln.navigation.graph_pathfinder.read_connectivity`
        """
        return cls(read_connectivity(path))

    @classmethod
    def from_edges(cls, positions: npt.ArrayLike, edges: npt.ArrayLike) -> GraphPathfinder:
        """Build a pathfinder over any graph: positions (n, 3) and index pairs (m, 2), weighted by distance."""
        places = np.array(positions, np.float32).reshape(-1, 3)
        pairs = np.sort(np.array(edges, np.int32).reshape(-1, 2), axis=1)
        if not len(places) or not np.isfinite(places).all():
            raise InputError(
                "the graph has no viewpoints, or a coordinate that is NaN or infinite", remedy="Correct the graph"
            )
        if len(pairs) and (pairs.min() < 0 or pairs.max() >= len(places) or (pairs[:, 0] == pairs[:, 1]).any()):
            raise InputError(
                "an edge refers to an unknown viewpoint, or connects a viewpoint to itself", remedy="Correct the graph"
            )
        pairs = np.unique(pairs, axis=0)
        lengths = np.linalg.norm(places[pairs[:, 0]].astype(float) - places[pairs[:, 1]], axis=1)
        return cls(ViewpointGraph(tuple(str(i) for i in range(len(places))), places, pairs, lengths))

    # -- properties
    # --------------------------------------------------------------------------------------------------------

    @property
    def settings(self) -> NavMeshSettings | None:
        """Always None, since a graph is not built for a particular agent."""
        return None

    @property
    def bounds(self) -> tuple[Floats, Floats]:
        """Lowest and highest corner of the viewpoints, (3,) each, in metres."""
        return self.graph.positions.min(axis=0), self.graph.positions.max(axis=0)

    @property
    def navigable_area(self) -> float:
        """Navigable area: always 0, since viewpoints have no area."""
        return 0.0

    @property
    def num_islands(self) -> int:
        """Number of connected components."""
        return int(self._islands.max()) + 1

    def island_area(self, island_index: int) -> float:
        """Return 0: viewpoints have no area."""
        self._island(island_index)
        return 0.0

    # -- points --------------------------------------------------------------------------------------------------------

    def viewpoint(self, point: npt.ArrayLike) -> str | None:
        """Return the name of the viewpoint that a point snaps to; None if none is in reach."""
        number = int(self._nearest(one_point(point))[0])
        return self.graph.ids[number] if number != NOWHERE else None

    def position(self, viewpoint: str) -> Floats:
        """Return the position (3,) of a viewpoint in metres."""
        place: Floats = self.graph.positions[self._index(viewpoint)]
        return place

    def snap_point(self, point: npt.ArrayLike, island_index: int | None = None) -> Floats:
        """Return the position (3,) of the viewpoint nearest to a point, among all or among those of one island; NaN if
        none is in reach.
        """
        snapped: Floats = self.snap_points(one_point(point), island_index)[0]
        return snapped

    def snap_points(self, points: npt.ArrayLike, island: int | None = None) -> Floats:
        """Return the positions (n, 3) to which n points snap; see :meth:`snap_point`."""
        nearest = self._nearest(many_points(points), island)
        places = self.graph.positions[nearest]
        return np.where((nearest == NOWHERE)[:, None], np.float32(np.nan), places).astype(np.float32)

    def is_navigable(self, point: npt.ArrayLike, max_y_delta: float = 0.5) -> bool:
        """Return whether the point is a viewpoint, within 1 cm horizontally and ``max_y_delta`` metres in height."""
        asked = one_point(point)[0]
        away = self.graph.positions - asked
        in_plane = np.hypot(away[:, 0], away[:, 2]) <= NAVIGABLE_SHIFT
        return bool((in_plane & (np.abs(away[:, 1]) <= max_y_delta)).any())

    def get_island(self, point: npt.ArrayLike) -> int:
        """Return the index of the connected component that the point snaps to; -1 if the point is off the graph."""
        return int(self.get_islands(one_point(point))[0])

    def get_islands(self, points: npt.ArrayLike) -> Ints:
        """Return the component indices (n,) of n points; see :meth:`get_island`."""
        nearest = self._nearest(many_points(points))
        return np.where(nearest == NOWHERE, -1, self._islands[nearest]).astype(np.int32)

    def island_radius(self, point_or_index: npt.ArrayLike) -> float:
        """Return the distance in metres from the mean of a connected component's viewpoints to the viewpoint farthest
        from this mean. The component is given by its index or by a point in it.
        """
        where = np.asarray(point_or_index)
        index = self._island(int(where)) if where.ndim == 0 else self.get_island(where)
        if index < 0:
            return 0.0
        members = self.graph.positions[self._islands == index].astype(np.float64)
        return float(np.linalg.norm(members - members.mean(axis=0), axis=1).max())

    def get_random_navigable_points(self, count: int, rng: RandomSource, island: int | None = None) -> Floats:
        """Return ``count`` viewpoints (count, 3), drawn uniformly with replacement."""
        chosen = np.arange(len(self.graph.ids))
        if island is not None:
            chosen = np.flatnonzero(self._islands == self._island(island))
        drawn: Floats = self.graph.positions[np.random.default_rng(rng).choice(chosen, count)]
        return drawn

    # -- paths ---------------------------------------------------------------------------------------------------------

    def find_path(self, start: npt.ArrayLike, end: npt.ArrayLike) -> ShortestPath:
        """Return the shortest path between the viewpoints of two points."""
        return self._path(int(self._nearest(one_point(start))[0]), int(self._nearest(one_point(end))[0]), 0)

    def find_multi_goal_path(self, start: npt.ArrayLike, ends: npt.ArrayLike) -> ShortestPath:
        """Return the shortest of the paths to several ends; ends off the graph are ignored."""
        begin, goals = int(self._nearest(one_point(start))[0]), self._nearest(many_points(ends))
        lengths = np.where((goals == NOWHERE) | (begin == NOWHERE), np.inf, self._lengths[begin, goals])
        if not np.isfinite(lengths).any():
            return ShortestPath()
        goal = int(np.argmin(lengths))
        return self._path(begin, int(goals[goal]), goal)

    def geodesic_distance(self, start: npt.ArrayLike, end: npt.ArrayLike) -> float:
        """Return the shortest distance in metres to ``end``, or to the nearest of several ends; infinite if there is
        no path.
        """
        if np.ndim(end) == 2:
            return self.find_multi_goal_path(start, end).geodesic_distance
        return float(self.geodesic_distances(start, end)[0])

    def geodesic_distances(self, starts: npt.ArrayLike, ends: npt.ArrayLike) -> Floats:
        """Return the shortest distances (n,), float32, of n pairs; see :meth:`geodesic_distance`. A single start is
        paired with every end, and a single end with every start.
        """
        first, second = (self._nearest(points) for points in paired_points(starts, ends))
        lost = (first == NOWHERE) | (second == NOWHERE)
        return np.where(lost, np.inf, self._lengths[first, second]).astype(np.float32)

    def distance_table(self, starts: npt.ArrayLike, ends: npt.ArrayLike) -> Floats:
        """Return a table (n, m), float32, of the shortest distances in metres from each of n starts to each of m ends;
        see :meth:`geodesic_distance`.
        """
        first, second = self._nearest(many_points(starts))[:, None], self._nearest(many_points(ends))[None, :]
        lost = (first == NOWHERE) | (second == NOWHERE)
        return np.where(lost, np.inf, self._lengths[first, second]).astype(np.float32)

    def viewpoint_distance(self, start: str, end: str) -> float:
        """Return the shortest distance in metres between two viewpoints; infinite if there is no path."""
        return float(self._lengths[self._index(start), self._index(end)])

    def viewpoint_path(self, start: str, end: str) -> list[str]:
        """Return the viewpoint names along the shortest path between two viewpoints; empty if there is no path."""
        return [self.graph.ids[number] for number in self._chain(self._index(start), self._index(end))]

    def path_length(self, viewpoints: Sequence[str]) -> float:
        """Return the length in metres of a sequence of viewpoints.

        Raises
        ------
        InputError : two consecutive viewpoints are not connected
        """
        total = 0.0
        weights = {(int(a), int(b)): float(w) for (a, b), w in zip(self.graph.edges, self.graph.lengths, strict=True)}
        for first, second in pairwise(viewpoints):
            a, b = sorted((self._index(first), self._index(second)))
            if (a, b) not in weights:
                raise InputError(f"{first} and {second} are not connected", remedy="Give a path along edges")
            total += weights[a, b]
        return total

    def _nearest(self, points: Floats, island: int | None = None) -> Ints:
        """Return the index of the viewpoint nearest to each of n points, as an array (n,); NOWHERE if none is in
        reach.
        """
        asked = points.astype(np.float64)
        away = np.linalg.norm(asked[:, None, :] - self.graph.positions[None, :, :], axis=2)
        if island is not None:
            away[:, self._islands != self._island(island)] = np.inf
        away[np.isnan(away)] = np.inf
        nearest = np.argmin(away, axis=1)
        reached = away[np.arange(len(asked)), nearest] <= self.snap_reach
        return np.where(reached, nearest, NOWHERE).astype(np.int32)

    def _chain(self, start: int, end: int) -> list[int]:
        if not np.isfinite(self._lengths[start, end]):
            return []
        chain = [end]
        while chain[-1] != start:
            chain.append(int(self._before[start, chain[-1]]))
        return chain[::-1]

    def _path(self, start: int, end: int, goal: int) -> ShortestPath:
        if NOWHERE in (start, end) or not (chain := self._chain(start, end)):
            return ShortestPath()
        length = float(np.float32(self._lengths[start, end]))
        return ShortestPath(length, self.graph.positions[chain], goal)

    def _index(self, viewpoint: str) -> int:
        if viewpoint not in self._number:
            raise UsageError(f"there is no viewpoint {viewpoint!r}", remedy="Take a name from the graph's ids")
        return self._number[viewpoint]

    def _island(self, index: int) -> int:
        if not 0 <= index < self.num_islands:
            raise UsageError(
                f"there is no island {index}: the graph has {self.num_islands}", remedy="Take an index from get_island"
            )
        return index


_SUFFIX: Final = "_connectivity.json"


class GraphFolder(Mapping[str, GraphPathfinder]):
    """Graphs by scan, read from folders of ``<scan>_connectivity.json``; the first folder with a scan's file is used.

    Raises
    ------
    FormatError : when a scan is requested whose file is damaged
    """

    def __init__(self, *folders: Path) -> None:
        self._files: dict[str, Path] = {}
        self._read: dict[str, GraphPathfinder] = {}
        for folder in folders:
            for path in sorted(folder.glob(f"*{_SUFFIX}")):
                self._files.setdefault(path.name.removesuffix(_SUFFIX), path)

    def __getitem__(self, scan: str) -> GraphPathfinder:
        if scan not in self._read:
            self._read[scan] = GraphPathfinder.load(self._files[scan])
        return self._read[scan]

    def __iter__(self) -> Iterator[str]:
        return iter(self._files)

    def __len__(self) -> int:
        return len(self._files)
