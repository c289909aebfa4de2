"""A whole layout as one mesh, given as triangles or as a GLB file: floor slabs, walls, and all parts of every piece of
furniture in place.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from condvln.samples.catalogue import catalogue
from condvln.samples.glb import box_placements, glb_of_cubes
from condvln.samples.layout import Furniture, Layout
from condvln.samples.shapes import part_boxes
from condvln.samples.stage import floor_boxes, wall_boxes

__all__ = ["layout_glb", "layout_triangles", "piece_corners"]

F64 = NDArray[np.float64]

CORNERS: Final = np.array([[i, j, k] for i in (0, 1) for j in (0, 1) for k in (0, 1)])
"""For each corner of a box, whether x, y and z are those of the upper corner."""

FACES: Final = np.array(
    [
        [0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5],
        [0, 4, 5], [0, 5, 1], [2, 3, 7], [2, 7, 6],
        [0, 2, 6], [0, 6, 4], [1, 5, 7], [1, 7, 3],
    ],
    dtype=np.int32,
)  # fmt: skip
"""Twelve triangles over `CORNERS`, counter-clockwise seen from outside."""


def piece_corners(piece: Furniture) -> F64:
    """Return the corners (n, 8, 3) of the parts of a placed piece."""
    boxes = part_boxes(catalogue()[piece.kind].shape, piece.size)
    placed: F64 = _corners(boxes) @ piece.yaw.matrix.T + np.array(piece.center)
    return placed


def layout_triangles(layout: Layout) -> tuple[F64, NDArray[np.int32]]:
    """Return the vertices (n, 3) in metres and faces (m, 3) of a layout: floors first, then walls, then the furniture
    in the layout's order.
    """
    shell = _corners(np.concatenate([floor_boxes(layout), wall_boxes(layout)]))
    boxes = np.concatenate([shell, *(piece_corners(piece) for piece in layout.furniture)])
    faces = FACES[None] + 8 * np.arange(len(boxes), dtype=np.int32)[:, None, None]
    return boxes.reshape(-1, 3), faces.reshape(-1, 3)


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


def _corners(boxes: F64) -> F64:
    """Return the corners (n, 8, 3) of boxes (n, 2, 3)."""
    corners: F64 = np.take_along_axis(boxes[:, :, None, :], CORNERS[None, None], axis=1)[:, 0]
    return corners
