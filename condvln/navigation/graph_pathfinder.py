"""Shortest paths over Matterport3D's graphs of viewpoints, ``<scan>_connectivity.json``, which are read with strict
checks.

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
from scipy.sparse.csgraph import dijkstra

from condvln.arrays import F64
from condvln.formats.dataset_root import DatasetRoot
from condvln.formats.json_document import parse_json
from condvln.navigation.points import one_point
from condvln.navigation.tile import Floats
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


class GraphPathfinder:
    """Paths along the edges of a graph.

    A point is replaced by the nearest viewpoint; lengths are sums of edge weights, as in R2R. Points are (3,), metres,
    Habitat frame.
    """

    def __init__(self, graph: ViewpointGraph) -> None:
        self.graph = graph
        self.numbers = {name: number for number, name in enumerate(graph.ids)}
        count = len(graph.ids)
        weights = np.maximum(graph.lengths, np.finfo(float).tiny)  # a zero would mean "no edge"
        matrix = csr_array((weights, (graph.edges[:, 0], graph.edges[:, 1])), shape=(count, count))
        self._lengths, self._before = dijkstra(matrix, directed=False, return_predecessors=True)
        self._weights = {(a, b): w for (a, b), w in zip(graph.edges.tolist(), graph.lengths.tolist(), strict=True)}

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> GraphPathfinder:
        """Load a pathfinder over a Matterport3D connectivity file.

        Raises
        ------
        MissingFileError, FormatError : from :func:`~condvln.navigation.graph_pathfinder.read_connectivity`
        """
        return cls(read_connectivity(path))

    def viewpoint(self, point: npt.ArrayLike) -> str | None:
        """Return the name of the viewpoint that a point snaps to; None if none is in reach."""
        away = np.linalg.norm(one_point(point).astype(np.float64) - self.graph.positions, axis=1)
        near = np.flatnonzero(away <= SNAP_REACH)
        return self.graph.ids[near[np.argmin(away[near])]] if len(near) else None

    def position(self, viewpoint: str) -> Floats:
        """Return the position (3,) of a viewpoint in metres."""
        place: Floats = self.graph.positions[self._index(viewpoint)]
        return place

    def viewpoint_distance(self, start: str, end: str) -> float:
        """Return the shortest distance in metres between two viewpoints; infinite if there is no path."""
        return float(self._lengths[self._index(start), self._index(end)])

    def viewpoint_path(self, start: str, end: str) -> list[str]:
        """Return the viewpoint names along the shortest path between two viewpoints; empty if there is no path."""
        first, last = self._index(start), self._index(end)
        if not np.isfinite(self._lengths[first, last]):
            return []
        chain = [last]
        while chain[-1] != first:
            chain.append(int(self._before[first, chain[-1]]))
        return [self.graph.ids[number] for number in chain[::-1]]

    def path_length(self, viewpoints: Sequence[str]) -> float:
        """Return the length in metres of a sequence of viewpoints.

        Raises
        ------
        InputError : two consecutive viewpoints are not connected
        """
        total = 0.0
        for first, second in pairwise(viewpoints):
            a, b = sorted((self._index(first), self._index(second)))
            if (a, b) not in self._weights:
                raise InputError(f"{first} and {second} are not connected", remedy="Give a path along edges")
            total += self._weights[a, b]
        return total

    def between(self, first: Sequence[int], second: Sequence[int]) -> F64:
        """Return the shortest distances in metres from each viewpoint of `first` to each of `second`, by their
        `numbers`, as a table (len(first), len(second)); infinite where there is no path.
        """
        found: F64 = self._lengths[np.ix_(first, second)]
        return found

    def along(self, path: Sequence[int]) -> float:
        """Return the length in metres of a path, with consecutive viewpoints joined by their shortest path."""
        return float(self._lengths[list(path[:-1]), list(path[1:])].sum())

    def gaps(self, path: Sequence[int]) -> int:
        """Return the number of steps between different viewpoints that share no edge."""
        return sum(a != b and (min(a, b), max(a, b)) not in self._weights for a, b in pairwise(path))

    def _index(self, viewpoint: str) -> int:
        if viewpoint not in self.numbers:
            raise UsageError(f"there is no viewpoint {viewpoint!r}", remedy="Take a name from the graph's ids")
        return self.numbers[viewpoint]


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
