"""Write ``connectivity_graphs.pkl``: for each scene a graph of places, which VLN-CE's top-down map requires.

``TopDownMapVLNCE`` (VLN-CE, NaVid, VLN-Zero) unpickles ``{scene: networkx.Graph}`` when it is created, finds the place
nearest to the agent at every step, and draws places and edges. A scene that is missing in the file raises KeyError. A
node has ``position`` ``[x, y, z]``, metres, Habitat frame. Scans with a viewpoint graph use their viewpoints as nodes.
In other scenes the nodes are the places, one per cubic metre, on the routes to all leaves of all episodes, so that the
graph does not reveal the gold leaf. Agents never observe the map.

The file is safe to load: the only name in it is ``networkx.classes.graph.Graph``, and its state consists of
dictionaries, lists, texts and numbers. It loads with networkx 2 and 3.
"""

from __future__ import annotations

import copyreg
import io
import pickle
from collections.abc import Iterable, Mapping
from typing import Any, Final

import networkx as nx
import numpy as np
import numpy.typing as npt

from condvln.export.tables import Row
from condvln.navigation.graph_pathfinder import ViewpointGraph
from condvln.navigation.points import densify_many
from schemas.config.constants import PATH_SPACING

__all__ = ["PLACES", "Places", "graph_keys", "pickled_graphs"]

PLACES: Final = "connectivity_graphs.pkl"
"""Path below the export's folder."""

_PROTOCOL: Final = 2
"""Pickle protocol: the oldest that names classes in a form that the loaders' Python 3.7 finds."""
_CELL: Final = 1.0
"""Edge length of a cell in metres; each cell on a route becomes a node."""


class Places:
    """The place graph of each scene, collected while scenes are written."""

    def __init__(self) -> None:
        self._graphs: dict[str, tuple[list[str], npt.NDArray[np.float64], npt.NDArray[np.int64]]] = {}

    def add(self, scene_id: str, rows: Iterable[Row], viewpoints: ViewpointGraph | None = None) -> None:
        """Add the places of one scene: its ``viewpoints``, or, without them, places on the routes of its ``rows``.

        scene_id : the episodes' scene id, ``<family>/<scene>/<scene>.glb``
        """
        if viewpoints is None:
            names, positions, edges = _of_routes(rows)
        else:
            names, edges = list(viewpoints.ids), viewpoints.edges.astype(np.int64)
            positions = viewpoints.positions.astype(np.float64)
        if names:
            for key in graph_keys(scene_id):
                # Two scenes may be in one folder; the map then looks up the folder's name.
                self._graphs.setdefault(key, (names, positions, edges))

    def pickled(self) -> bytes:
        """Return the bytes of the file; equal places give equal bytes."""
        return pickled_graphs({key: _graph(*self._graphs[key]) for key in sorted(self._graphs)})


def graph_keys(scene_id: str) -> list[str]:
    """Return the keys under which VLN-CE's map looks for a scene: the scene's file name up to the first dot, and the
    name of its folder.
    """
    parts = scene_id.split("/")
    return sorted({parts[-1].split(".")[0], *parts[-2:-1]})


def pickled_graphs(graphs: Mapping[str, nx.Graph[str]]) -> bytes:
    """Return ``{name: graph}`` as a pickle whose only class is :class:`networkx.Graph`."""
    stream = io.BytesIO()
    pickler = _GraphPickler(stream, protocol=_PROTOCOL)
    pickler.fast = True  # without a memo, equal graphs give equal bytes even if they share objects
    pickler.dump(dict(graphs))
    return stream.getvalue()


class _GraphPickler(pickle.Pickler):
    """Pickles the part of a graph that networkx 2 and 3 share, independent of the installed version."""

    def reducer_override(self, value: Any) -> Any:
        if type(value) is nx.Graph:
            held = vars(value)
            state = {key: dict(held[key]) for key in ("graph", "_node", "_adj")}
            return copyreg.__newobj__, (nx.Graph,), state  # type: ignore[attr-defined]
        return NotImplemented


def _of_routes(rows: Iterable[Row]) -> tuple[list[str], npt.NDArray[np.float64], npt.NDArray[np.int64]]:
    """Return a name and a point for each grid cell on the routes, and the edges between cells that a route connects. Of
    the points of a cell, the least one is taken.
    """
    routes = [np.array(leaf["reference_path"], np.float64).reshape(-1, 3) for row in rows for leaf in row["leaves"]]
    if not routes:
        return [], np.zeros((0, 3)), np.zeros((0, 2), dtype=np.int64)
    dense, ends = densify_many(np.concatenate(routes), np.cumsum([0, *map(len, routes)]), PATH_SPACING)
    route = np.repeat(np.arange(len(routes)), np.diff(ends))
    millimetres = np.rint(dense * 1000.0).astype(np.int64)
    cells = np.floor(millimetres / 1000.0 / _CELL).astype(np.int64)
    cell = np.unique(cells, axis=0, return_inverse=True)[1].reshape(-1)
    order = np.lexsort((*millimetres.T[::-1], cell))
    points = millimetres[order[np.unique(cell[order], return_index=True)[1]]] / 1000.0
    crossing = (cell[1:] != cell[:-1]) & (route[1:] == route[:-1])
    one, other = cell[:-1][crossing], cell[1:][crossing]
    edges = np.unique(np.stack([np.minimum(one, other), np.maximum(one, other)], axis=1), axis=0)
    return [f"p{k}" for k in range(len(points))], points, edges


def _graph(names: list[str], positions: npt.NDArray[np.float64], edges: npt.NDArray[np.int64]) -> nx.Graph[str]:
    graph: nx.Graph[str] = nx.Graph()
    for name, position in zip(names, positions.tolist(), strict=True):
        graph.add_node(name, position=position)
    graph.add_edges_from((names[a], names[b]) for a, b in edges.tolist())
    return graph
