"""A layout as boxes (floor slabs, walls with door openings, lintels above the openings), and as one mesh, given as
triangles or as a GLB file, with all parts of every piece of furniture in place.
"""

from __future__ import annotations

from collections import defaultdict
from itertools import pairwise
from typing import Final

import numpy as np
import shapely

from condvln.arrays import F64
from condvln.samples.catalogue import catalogue
from condvln.samples.layout import WALL_THICKNESS, Furniture, Layout
from condvln.samples.models import box_placements, glb_of_cubes, part_boxes

__all__ = ["FLOOR_THICKNESS", "box_corners", "floor_boxes", "layout_glb", "piece_corners", "wall_boxes"]


FLOOR_THICKNESS: Final = 0.1
"""Thickness of the floor slab in metres; its upper side is at y = 0. It is half a voxel of Habitat's, which puts the
navmesh 0.1 m up.
"""

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


CORNERS: Final = np.array([[i, j, k] for i in (0, 1) for j in (0, 1) for k in (0, 1)])
"""For each corner of a box, whether x, y and z are those of the upper corner."""


def piece_corners(piece: Furniture) -> F64:
    """Return the corners (n, 8, 3) of the parts of a placed piece."""
    boxes = part_boxes(catalogue()[piece.kind].shape, piece.size)
    placed: F64 = box_corners(boxes) @ piece.yaw.matrix.T + np.array(piece.center)
    return placed


def layout_glb(layout: Layout, frame: F64 | None = None) -> bytes:
    """Return the whole scene as one GLB file, like a scan. `frame` (4, 4) is the transform from Habitat's frame to the
    file's.
    """
    parts = {"floor": box_placements(floor_boxes(layout)), "walls": box_placements(wall_boxes(layout))}
    for piece in layout.furniture:
        stand = np.eye(4)
        stand[:3, :3], stand[:3, 3] = piece.yaw.matrix, piece.center
        parts[piece.object_id] = stand @ box_placements(part_boxes(catalogue()[piece.kind].shape, piece.size))
    return glb_of_cubes(parts, frame)


def box_corners(boxes: F64) -> F64:
    """Return the corners (n, 8, 3) of boxes (n, 2, 3)."""
    corners: F64 = np.take_along_axis(boxes[:, :, None, :], CORNERS[None, None], axis=1)[:, 0]
    return corners
