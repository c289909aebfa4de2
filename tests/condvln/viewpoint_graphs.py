"""Graphs of viewpoints for tests."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from condvln.navigation.graph_pathfinder import GraphPathfinder, ViewpointGraph


def graph_of(positions: npt.ArrayLike, edges: Sequence[tuple[int, int]]) -> GraphPathfinder:
    """Viewpoints ``0``, ``1``, … at positions (n, 3), and edges as long as they are apart."""
    places, pairs = np.array(positions, np.float32), np.sort(np.array(edges, np.int32).reshape(-1, 2), axis=1)
    lengths = np.linalg.norm(places[pairs[:, 0]].astype(float) - places[pairs[:, 1]], axis=1)
    return GraphPathfinder(ViewpointGraph(tuple(map(str, range(len(places)))), places, pairs, lengths))
