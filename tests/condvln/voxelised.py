"""The triangles of made layouts, and the navmeshes that voxelising them gives."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from condvln.navigation.navmesh_file import NavMeshFile
from condvln.navigation.recast.builder import build_navmesh
from condvln.navigation.settings import NavMeshSettings
from condvln.samples import Layout
from condvln.samples.replicacad import RADII
from condvln.samples.solid import CORNERS, floor_boxes, piece_corners, wall_boxes
from condvln.sources.solids import BOX_FACES


def layout_triangles(layout: Layout) -> tuple[NDArray[np.float64], NDArray[np.int32]]:
    """Vertices (n, 3) in metres and faces (m, 3): floors first, then walls, then the furniture in its order."""
    shell = np.concatenate([floor_boxes(layout), wall_boxes(layout)])
    corners = np.take_along_axis(shell[:, :, None, :], CORNERS[None, None], axis=1)[:, 0]
    boxes = np.concatenate([corners, *(piece_corners(piece) for piece in layout.furniture)])
    faces = BOX_FACES[None] + 8 * np.arange(len(boxes), dtype=np.int32)[:, None, None]
    return boxes.reshape(-1, 3), faces.reshape(-1, 3)


def voxelised(layout: Layout, settings: NavMeshSettings) -> NavMeshFile:
    """The navmesh of a layout as Habitat would build it, with islands on tops of furniture."""
    return build_navmesh(*layout_triangles(layout), settings)


def voxelise(root: Path, layouts: Mapping[str, Layout]) -> None:
    """Put such navmeshes in place of those of a made ReplicaCAD dataset."""
    for folder, radius in RADII.items():
        settings = NavMeshSettings(agent_radius=radius, include_static_objects=True)
        for name, layout in layouts.items():
            (root / folder / f"{name}.navmesh").write_bytes(voxelised(layout, settings).to_bytes())
