"""The shell of an apartment as boxes: floor slabs, walls with door openings, lintels above the openings."""

from __future__ import annotations

from collections import defaultdict
from itertools import pairwise
from typing import Final

import numpy as np
import shapely
from numpy.typing import NDArray

from condvln.samples.layout import WALL_THICKNESS, Layout

__all__ = ["FLOOR_THICKNESS", "floor_boxes", "wall_boxes"]

FLOOR_THICKNESS: Final = 0.1
"""Thickness of the floor slab in metres; its upper side is at y = 0. It is half a voxel of Habitat's, which puts the
navmesh 0.1 m up.
"""

F64 = NDArray[np.float64]
Span = tuple[float, float]


def floor_boxes(layout: Layout) -> F64:
    """Return slabs (n, 2, 3), lower and upper corners in metres, that cover all rooms to the middle of the walls."""
    boxes = []
    for room in layout.rooms:
        # An L-shaped room is split at every corner's x: two slabs, edge to edge.
        cuts = sorted({x for x, _ in room.polygon})
        low, high = (f(z for _, z in room.polygon) for f in (min, max))
        for x0, x1 in pairwise(cuts):
            x_min, z_min, x_max, z_max = room.shape.intersection(shapely.box(x0, low, x1, high)).bounds
            boxes.append([[x_min, -FLOOR_THICKNESS, z_min], [x_max, 0.0, z_max]])
    return np.asarray(np.round(boxes, 6), dtype=np.float64)


def wall_boxes(layout: Layout) -> F64:
    """Return boxes (n, 2, 3) of wall pieces between openings, floor to ceiling, and of the lintels above openings.

    Pieces overlap by half a wall in the corners, so that there are no gaps.
    """
    half = WALL_THICKNESS / 2
    doors = defaultdict(list)
    for door in layout.doors:
        axis = 0 if door.along_x else 1
        doors[axis, door.start[1 - axis]].append(((door.start[axis], door.end[axis]), door.height))
    boxes = []
    for (axis, at), spans in _lines(layout).items():
        openings = sorted(doors.get((axis, at), []))
        for low, high in spans:
            inside = [(span, height) for span, height in openings if low <= span[0] and span[1] <= high]
            starts = [low - half, *(span[1] for span, _ in inside)]
            ends = [*(span[0] for span, _ in inside), high + half]
            boxes += [_box(axis, at, (a, b), (0.0, layout.ceiling)) for a, b in zip(starts, ends, strict=True)]
            boxes += [_box(axis, at, span, (height, layout.ceiling)) for span, height in inside]
    return np.asarray(np.round(boxes, 6), dtype=np.float64)


def _lines(layout: Layout) -> dict[tuple[int, float], list[Span]]:
    """Return, for each centre line of walls, the separate spans that have a wall. The key of a line is (0, z) if the
    line runs along x, and (1, x) if the line runs along z.
    """
    pieces: dict[tuple[int, float], list[Span]] = defaultdict(list)
    for room in layout.rooms:
        for (x0, z0), (x1, z1) in zip(room.polygon, (*room.polygon[1:], room.polygon[0]), strict=True):
            axis, at = (0, z0) if z0 == z1 else (1, x0)
            ends = (x0, x1) if axis == 0 else (z0, z1)
            pieces[axis, at].append((min(ends), max(ends)))
    lines: dict[tuple[int, float], list[Span]] = {}
    for line in sorted(pieces):
        spans: list[Span] = []
        for low, high in sorted(pieces[line]):
            if spans and low <= spans[-1][1]:
                spans[-1] = spans[-1][0], max(spans[-1][1], high)
            else:
                spans.append((low, high))
        lines[line] = spans
    return lines


def _box(axis: int, at: float, along: Span, up: Span) -> list[list[float]]:
    across = at - WALL_THICKNESS / 2, at + WALL_THICKNESS / 2
    x, z = (along, across) if axis == 0 else (across, along)
    return [[x[0], up[0], z[0]], [x[1], up[1], z[1]]]
