"""Write GLB files of boxes: one unit cube per mesh, placed by node transforms below a rotated and translated root.

The files test readers: no node transform is the identity, so the vertices alone do not give the extent.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from typing import Final

import numpy as np
import trimesh
from numpy.typing import NDArray

__all__ = ["Z_UP", "box_placements", "glb_of_boxes", "glb_of_cubes"]

F64 = NDArray[np.float64]

ROOT: Final = np.array([[1.0, 0.0, 0.0, 0.25], [0.0, 0.0, 1.0, -0.5], [0.0, -1.0, 0.0, 0.125], [0.0, 0.0, 0.0, 1.0]])
"""Transform of the root node: z-up, as modelling tools export, with the origin elsewhere."""

Z_UP: Final = np.array([[1.0, 0.0, 0.0, 0.0], [0.0, 0.0, -1.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0]])
"""From Habitat's frame to that of scans: (x, y, z) becomes (x, −z, y)."""

PALE: Final = 0.35
"""Least brightness of a colour; the rest follows from the name."""

DECIMALS: Final = 9
"""Decimals in metres kept of a node's transform."""


def box_placements(boxes: F64) -> F64:
    """Return the transforms (n, 4, 4) that turn the unit cube about the origin into the boxes (n, 2, 3). A box is given
    by its lower and upper corner.
    """
    placements = np.zeros((len(boxes), 4, 4))
    placements[:, [0, 1, 2], [0, 1, 2]] = boxes[:, 1] - boxes[:, 0]
    placements[:, :3, 3] = (boxes[:, 0] + boxes[:, 1]) / 2
    placements[:, 3, 3] = 1.0
    return placements


def glb_of_boxes(parts: Mapping[str, F64]) -> bytes:
    """Return a binary glTF of axis-aligned boxes (n, 2, 3), metres, by name; see `glb_of_cubes`."""
    return glb_of_cubes({name: box_placements(boxes) for name, boxes in parts.items()})


def glb_of_cubes(parts: Mapping[str, F64], frame: F64 | None = None) -> bytes:
    """Return a binary glTF of placed unit cubes.

    Parameters
    ----------
    parts : name to (n, 4, 4) transforms of the unit cube, metres; each name becomes a mesh with its own colour
    frame : (4, 4) from the frame of `parts` to the file's; identity if None
    """
    scene = trimesh.Scene()
    scene.graph.update(frame_from="world", frame_to="root", matrix=ROOT)
    back = np.linalg.inv(ROOT) if frame is None else np.linalg.inv(ROOT) @ frame
    for name, placements in parts.items():
        cube = trimesh.creation.box()
        cube.metadata.clear()
        cube.visual = trimesh.visual.TextureVisuals(material=_material(name))
        scene.geometry[name] = cube
        for number, place in enumerate(placements):
            matrix = np.round(back @ place, DECIMALS)
            scene.graph.update(frame_from="root", frame_to=f"{name}.{number}", matrix=matrix, geometry=name)
    return bytes(scene.export(file_type="glb"))


def _material(name: str) -> trimesh.visual.material.PBRMaterial:
    shade = np.frombuffer(hashlib.sha256(name.encode()).digest()[:3], np.uint8) / 255
    colour = [*(float(round(PALE + (1 - PALE) * s, 3)) for s in shade), 1.0]
    return trimesh.visual.material.PBRMaterial(
        name=name, baseColorFactor=colour, metallicFactor=0.0, roughnessFactor=0.9
    )
