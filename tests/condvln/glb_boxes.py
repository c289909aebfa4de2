"""GLB files of one box."""

from __future__ import annotations

import trimesh


def box_glb(size: list[float], centre: list[float] | None = None) -> bytes:
    """A GLB file of one box."""
    box = trimesh.creation.box(size, trimesh.transformations.translation_matrix(centre or [0, 0, 0]))
    return bytes(box.export(file_type="glb"))
