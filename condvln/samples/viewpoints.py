"""Viewpoints in an apartment, like Matterport3D's panoramas: their positions, and which pairs of viewpoints see and
reach each other.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import networkx as nx
import numpy as np
import shapely
from numpy.typing import NDArray

from condvln.samples.floor_mesh import convex_polygons
from condvln.samples.free_floor import free_floor, open_plan
from condvln.samples.layout import Layout

__all__ = ["Viewpoints", "viewpoints_of"]

SPACING: Final = 1.8
"""Distance in metres between viewpoints on open floor."""

DOOR_STEP: Final = 0.45
"""Distance in metres of the viewpoints on both sides of a doorway."""

REACH: Final = 4.0
"""Largest distance in metres between two connected viewpoints."""

MARGIN: Final = 0.1
"""Least distance in metres of viewpoints from the edge of the free floor."""

F64 = NDArray[np.float64]
Place = tuple[float, float]
Flags = NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class Viewpoints:
    """The positions (n, 2) of n viewpoints as (x, z), and the room of each. Two masks (n, n) say whether two viewpoints
    see each other, and whether the straight path between them is free.
    """

    places: F64
    rooms: tuple[str, ...]
    visible: Flags
    unobstructed: Flags


def viewpoints_of(layout: Layout) -> Viewpoints:
    """Return viewpoints on both sides of every doorway and across the floor. Any two of them are connected by a chain
    of straight free segments.
    """
    floor = free_floor(layout)
    shapely.prepare(floor)
    doors = _thinned(_before_doors(layout), DOOR_STEP / 2)
    places = _thinned(np.concatenate([doors, _grid(layout, floor)]), SPACING / 2, kept=len(doors))
    places = _bridged(places, floor)
    rooms = _rooms(layout, places)
    return Viewpoints(places, rooms, _joined(places, open_plan(layout)), _walks(places, floor))


def _walks(places: F64, floor: shapely.Geometry) -> Flags:
    near: Flags = np.linalg.norm(places[:, None] - places[None], axis=-1) <= REACH
    return _joined(places, floor) & near


def _bridged(places: F64, floor: shapely.Geometry) -> F64:
    """Return the viewpoints `places`, with new viewpoints added until all are connected. The new viewpoints are on
    shortest paths over the floor's convex polygons.
    """
    ways: nx.Graph[Place] = nx.Graph()
    vertices, polygons = convex_polygons(floor)
    shapes = [shapely.Polygon(vertices[polygon]) for polygon in polygons]
    for polygon, shape in zip(polygons, shapes, strict=True):
        middle = _rounded(np.array(shape.centroid.coords[0]))
        for a, b in zip(polygon, [*polygon[1:], polygon[0]], strict=True):
            edge = _rounded((vertices[a] + vertices[b]) / 2)
            ways.add_edge(middle, edge, length=float(np.linalg.norm(np.subtract(middle, edge))))
    for place in places:
        shape = min(shapes, key=lambda s: s.distance(shapely.Point(place)))
        middle = _rounded(np.array(shape.centroid.coords[0]))
        ways.add_edge(_rounded(place), middle, length=float(np.linalg.norm(place - middle)))
    while True:
        parts = list(nx.connected_components(nx.from_numpy_array(_walks(places, floor))))
        if len(parts) == 1:
            return places
        here = {_rounded(places[i]) for i in parts[0]}
        there = {_rounded(place) for place in places} - here
        lengths = nx.multi_source_dijkstra_path_length(ways, here, weight="length")
        paths = nx.multi_source_dijkstra_path(ways, here, weight="length")
        nearest = min(there, key=lambda place: (lengths[place], place))
        known = here | there
        places = np.concatenate([places, [step for step in paths[nearest] if step not in known]])


def _rounded(place: F64) -> Place:
    x, z = np.round(place, 4).tolist()
    return x + 0.0, z + 0.0


def _before_doors(layout: Layout) -> F64:
    places = []
    for door in layout.doors:
        x, z = door.center
        away = (0.0, DOOR_STEP) if door.along_x else (DOOR_STEP, 0.0)
        places += [(x - away[0], z - away[1]), (x + away[0], z + away[1])]
    return np.array(places)


def _grid(layout: Layout, floor: shapely.Geometry) -> F64:
    (x0, z0), (x1, z1) = layout.bounds
    xs, zs = np.arange(x0 + 0.6, x1, SPACING), np.arange(z0 + 0.6, z1, SPACING)
    grid = np.round(np.stack(np.meshgrid(xs, zs, indexing="ij"), axis=-1).reshape(-1, 2), 3)
    kept: F64 = grid[shapely.covers(floor.buffer(-MARGIN), shapely.points(grid))]
    return kept


def _thinned(places: F64, distance: float, kept: int = 0) -> F64:
    """Return `places` in order, without those nearer than `distance` to an earlier place. The first `kept` places are
    always included.
    """
    chosen: list[F64] = list(places[:kept])
    for place in places[kept:]:
        if all(np.linalg.norm(place - other) >= distance for other in chosen):
            chosen.append(place)
    return np.array(chosen)


def _joined(places: F64, area: shapely.Geometry) -> Flags:
    """Return a mask (n, n): whether two different viewpoints are connected by a straight line inside `area`."""
    n = len(places)
    pairs = np.stack(np.broadcast_arrays(places[:, None], places[None]), axis=2)
    joined: Flags = shapely.covers(area, shapely.linestrings(pairs.reshape(-1, 2, 2))).reshape(n, n)
    return joined & ~np.eye(n, dtype=bool)


def _rooms(layout: Layout, places: F64) -> tuple[str, ...]:
    inside = [shapely.covers(room.shape, shapely.points(places)) for room in layout.rooms]
    return tuple(layout.rooms[index].room_id for index in np.argmax(inside, axis=0))
