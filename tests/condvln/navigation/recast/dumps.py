"""The stages of a build as flat arrays, in the layout of the reference dumps."""

from __future__ import annotations

import numpy as np

from condvln.navigation.recast.builder import BuildStages
from condvln.navigation.recast.compact import MAX_LAYERS
from condvln.navigation.recast.contours import Contours
from condvln.navigation.recast.geometry import Array

# The value of "no neighbour" in the dumps.
NOT_CONNECTED = MAX_LAYERS + 1


def arrays_of(stages: BuildStages) -> dict[str, Array]:
    """Return the flat arrays of all stages by name, in order. Names and layout are those of the reference dumps
    (``*.stages.npz``).
    """
    solid, field = stages.solid, stages.compact
    cell = np.repeat(np.arange(solid.width * solid.depth), np.diff(solid.start))
    out = {
        f"solid{k}": np.stack([cell, solid.bottom, solid.top, area], axis=1).ravel()
        for k, area in enumerate((solid.area, *stages.filtered))
    }
    counts = np.diff(field.start)
    first = np.where(np.diff(solid.start) > 0, field.start[:-1], 0)
    layer = field.neighbour - field.start[field.column[field.neighbour]]
    steps = np.where(field.neighbour < 0, NOT_CONNECTED, layer)
    out["chf_cells"] = np.stack([first, counts], axis=1).ravel()
    out["chf_spans"] = np.concatenate([field.floor[:, None], field.clearance[:, None], steps], axis=1).ravel()
    out["chf_area0"], out["chf_area1"] = field.area, stages.eroded
    out["chf_dist"], out["chf_reg"] = stages.distance, stages.region
    out["rawcontours"] = _flat(stages.raw_contours, with_area=False)
    out["contours"] = _flat(stages.contours, with_area=True)
    out["pm_verts"], out["pm_polys"] = stages.polymesh.vertices.ravel(), stages.polymesh.polygons.ravel()
    out["pm_regs"] = stages.polymesh.region
    out["dm_meshes"], out["dm_verts"] = stages.detail.meshes.ravel(), stages.detail.vertices.ravel()
    out["dm_tris"] = stages.detail.triangles.ravel()
    out["tile"] = np.frombuffer(stages.tile.to_bytes(), np.uint8)
    return out


def _flat(contours: Contours, with_area: bool) -> Array:
    rows = []
    for k in range(len(contours)):
        head = [len(contours[k]), contours.region[k], contours.area[k]]
        rows += [np.array(head if with_area else head[:2]), contours[k].ravel()]
    return np.concatenate(rows) if rows else np.zeros(0, np.int64)
