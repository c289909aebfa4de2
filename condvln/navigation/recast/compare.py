"""Compare two builds: find the first stage, array and index that differ."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from condvln.navigation.navmesh_file import NavMeshFile
from condvln.navigation.recast.arrays import Array
from condvln.navigation.recast.stages import BuildStages

__all__ = ["Difference", "compare_builds", "compare_navmeshes", "first_difference"]

# The stage that makes each array of a dump, and each part of a navmesh file, in build order.
STAGE_OF_ARRAY = {
    "solid0": "rasterisation",
    "solid1": "low-hanging obstacle filter",
    "solid2": "ledge filter",
    "solid3": "low height filter",
    "chf_cells": "compact heightfield",
    "chf_spans": "compact heightfield",
    "chf_area0": "compact heightfield",
    "chf_area1": "erosion",
    "chf_dist": "distance field",
    "chf_reg": "regions",
    "rawcontours": "contour tracing",
    "contours": "contour simplification and hole merging",
    "pm_verts": "polygon mesh",
    "pm_polys": "polygon mesh",
    "pm_regs": "polygon mesh",
    "dm_meshes": "detail mesh",
    "dm_verts": "detail mesh",
    "dm_tris": "detail mesh",
    "tile": "tile assembly",
}
STAGE_OF_PART = {
    "settings": "settings",
    "bounds": "mesh bounds",
    "verts": "polygon mesh",
    "polys": "polygon mesh",
    "detail_meshes": "detail mesh",
    "detail_verts": "detail mesh",
    "detail_tris": "detail mesh",
    "bv_nodes": "bounding volume tree",
    "links": "links",
    "header": "tile header",
    "file": "file header",
}


@dataclass(frozen=True)
class Difference:
    """The first difference of two builds.

    Attributes
    ----------
    stage : the stage that made it
    array : name of the array or part
    index : first row or item that differs; if one array is shorter, its length
    first, second : the values there, None beyond the end
    """

    stage: str
    array: str
    index: int
    first: Any
    second: Any

    def __str__(self) -> str:
        return f"{self.stage}: {self.array}[{self.index}] is {self.first} in the first and {self.second} in the second"


def first_difference(first: Mapping[str, Array], second: Mapping[str, Array]) -> Difference | None:
    """Return the first difference, in build order, between the arrays of two builds (see :meth:`BuildStages.arrays`);
    None if all are equal.
    """
    return _first(first, second, STAGE_OF_ARRAY)


def compare_builds(first: BuildStages, second: BuildStages) -> Difference | None:
    """Return the first difference between two builds, in the earliest stage in which they differ; None if they are
    equal.
    """
    return first_difference(first.arrays(), second.arrays())


def compare_navmeshes(first: NavMeshFile, second: NavMeshFile) -> Difference | None:
    """Return the first difference between two navmesh files, in the order in which a build makes their parts; None if
    the files are equal byte for byte.
    """
    return _first(_parts(first), _parts(second), STAGE_OF_PART)


def _parts(navmesh: NavMeshFile) -> dict[str, Array]:
    tile = navmesh.tile
    parts = {name: getattr(tile, name) for name in STAGE_OF_PART if hasattr(tile, name)}
    settings = navmesh.settings
    parts["settings"] = np.array([] if settings is None else list(vars(settings).values()), np.float64)
    parts["bounds"] = np.concatenate(tile.bounds)
    parts["header"] = tile.header.reshape(1)
    parts["file"] = np.frombuffer(navmesh.to_bytes(), np.uint8)
    return parts


def _first(first: Mapping[str, Array], second: Mapping[str, Array], stages: Mapping[str, str]) -> Difference | None:
    for name, stage in stages.items():
        if name not in first or name not in second:
            continue
        a, b = np.asarray(first[name]), np.asarray(second[name])
        shared = min(len(a), len(b))
        rows = np.flatnonzero(_unequal(a[:shared], b[:shared]))
        if len(rows) or len(a) != len(b):
            index = int(rows[0]) if len(rows) else shared
            return Difference(stage, name, index, _item(a, index), _item(b, index))
    return None


def _unequal(a: Array, b: Array) -> Array:
    """Return a mask (n,) of the rows of ``a`` that differ from the same row of ``b``. If both arrays have the same
    dtype, their rows are compared bitwise, so that NaN equals NaN; otherwise by value.
    """
    count = len(a)
    if count and a.dtype == b.dtype:
        a, b = (np.frombuffer(rows.tobytes(), np.uint8).reshape(count, -1) for rows in (a, b))
    different: Array = (a != b).any(axis=tuple(range(1, a.ndim)))
    return different


def _item(array: Array, index: int) -> Any:
    return array[index].tolist() if index < len(array) else None
