"""The input of a build: checked triangles, which of them are level enough to walk on, the parameters converted to whole
cells as Recast does, and the limits of what can be built.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import Enum

import numpy as np
import numpy.typing as npt

from condvln.navigation.recast.geometry import Array
from condvln.navigation.settings import NavMeshSettings
from condvln.navigation.tile import MAX_VERTS_PER_POLYGON
from schemas.errors import FormatError, UsageError

__all__ = [
    "MAX_SPAN_HEIGHT",
    "MEMORY_LIMIT_BYTES",
    "WALKABLE_AREA",
    "RecastConfig",
    "RecastProfile",
    "checked_triangles",
    "walkable_faces",
]

# Recast stores the height of a span in 13 bits, distances of erosion and clearances in 8, mesh coordinates in 16.
MAX_SPAN_HEIGHT = 0x1FFF
MAX_AGENT_CELLS = 0xFF
MAX_RADIUS_CELLS = 0x7F
MAX_GRID_CELLS = 0xFFFF
# Memory of the arrays alive at once: 12 bytes per column and about 60 per span; two spans (floor, ceiling) are assumed.
BYTES_PER_COLUMN = 132
# A build that needs more memory is rejected. 4 GiB are about 32 million columns: 280 m x 280 m in cells of 5 cm.
MEMORY_LIMIT_BYTES = 4 << 30
# With less than this many cells between height samples, habitat-sim takes no samples.
LEAST_SAMPLE_CELLS = np.float32(0.9)


class RecastProfile(str, Enum):
    """The version of Recast to reproduce. The two versions differ in one comparison, which decides whether low passages
    are walkable.
    """

    HABITAT_0_3_3 = "habitat<=0.3.3"
    """The Recast of habitat-sim 0.1.7 (VLN-CE) to 0.3.3: a span needs more free voxels than the agent is high."""
    HABITAT_0_3_4 = "habitat>=0.3.4"
    """Recast 1.6: equal to the agent's height is enough."""

    @classmethod
    def named(cls, name: str) -> RecastProfile:
        """Return the profile of this name.

        Raises
        ------
        UsageError
            There is no profile of this name.
        """
        try:
            return cls(name)
        except ValueError:
            known = " or ".join(repr(profile.value) for profile in cls)
            raise UsageError(f"no Recast profile is called {name!r}", remedy=f"Use {known}") from None


@dataclass(frozen=True, eq=False)
class RecastConfig:
    """Parameters of one build in cells (``rcConfig`` as ``PathFinder::build`` of habitat-sim fills it).

    Attributes
    ----------
    bounds_min, bounds_max : (3,) float32, metres, of all vertices
    cell_size, cell_height : float32, metres
    width, depth : columns along x and z
    walkable_height, walkable_climb, walkable_radius : cells
    walkable_slope_cosine : float32, least upward component of a walkable face's normal
    max_edge_length : cells
    max_edge_error : float32, cells
    min_region_area, merge_region_area : cells
    verts_per_poly : 3 to 6
    detail_sample_distance, detail_sample_max_error : float32, metres; a distance of 0 takes no samples
    """

    bounds_min: Array
    bounds_max: Array
    cell_size: np.float32
    cell_height: np.float32
    width: int
    depth: int
    walkable_height: int
    walkable_climb: int
    walkable_radius: int
    walkable_slope_cosine: np.float32
    max_edge_length: int
    max_edge_error: np.float32
    min_region_area: int
    merge_region_area: int
    verts_per_poly: int
    detail_sample_distance: np.float32
    detail_sample_max_error: np.float32

    @classmethod
    def of(cls, vertices: Array, settings: NavMeshSettings, memory_limit: int = MEMORY_LIMIT_BYTES) -> RecastConfig:
        """Return the configuration for finite (n, 3) float32 ``vertices``, n > 0.

        Raises
        ------
        UsageError
            A setting is out of range.
        FormatError
            The mesh is too small, too large or too high for a tile of such cells, or its grid needs more than
            ``memory_limit`` bytes.
        """
        _check_settings(settings)
        low, high = vertices.min(axis=0), vertices.max(axis=0)
        cell, height = np.float32(settings.cell_size), np.float32(settings.cell_height)
        with np.errstate(over="ignore"):
            extent = (high - low)[[0, 2]] / cell + np.float32(0.5)
            levels = (high[1] - low[1]) / height
        _check_extent(extent, levels, settings, memory_limit)
        sample = np.float32(settings.detail_sample_dist)
        return cls(
            bounds_min=low,
            bounds_max=high,
            cell_size=cell,
            cell_height=height,
            width=int(extent[0]),
            depth=int(extent[1]),
            walkable_height=math.ceil(np.float32(settings.agent_height) / height),
            walkable_climb=math.floor(np.float32(settings.agent_max_climb) / height),
            walkable_radius=math.ceil(np.float32(settings.agent_radius) / cell),
            # The C library rounds cosf correctly at all angles in use; numpy's float32 cosine does not.
            walkable_slope_cosine=np.float32(
                math.cos(np.float32(settings.agent_max_slope) / np.float32(180.0) * np.float32(math.pi))
            ),
            max_edge_length=int(np.float32(settings.edge_max_len) / cell),
            max_edge_error=np.float32(settings.edge_max_error),
            min_region_area=int(np.float32(settings.region_min_size) * np.float32(settings.region_min_size)),
            merge_region_area=int(np.float32(settings.region_merge_size) * np.float32(settings.region_merge_size)),
            verts_per_poly=int(settings.verts_per_poly),
            detail_sample_distance=np.float32(0) if sample < LEAST_SAMPLE_CELLS else cell * sample,
            detail_sample_max_error=height * np.float32(settings.detail_sample_max_error),
        )


# By setting: least and greatest value, and whether the least value itself is allowed.
_RANGES: dict[str, tuple[float, float, bool]] = {
    "cell_size": (0.0, math.inf, False),
    "cell_height": (0.0, math.inf, False),
    "agent_height": (0.0, math.inf, False),
    "agent_radius": (0.0, math.inf, True),
    "agent_max_climb": (0.0, math.inf, True),
    "agent_max_slope": (0.0, 90.0, True),
    "region_min_size": (0.0, MAX_GRID_CELLS, True),
    "region_merge_size": (0.0, MAX_GRID_CELLS, True),
    "edge_max_len": (0.0, math.inf, True),
    "edge_max_error": (0.0, MAX_GRID_CELLS, True),
    "verts_per_poly": (3.0, MAX_VERTS_PER_POLYGON, True),
    "detail_sample_dist": (0.0, math.inf, True),
    "detail_sample_max_error": (0.0, math.inf, True),
}


def _check_settings(settings: NavMeshSettings) -> None:
    for name, (least, most, with_least) in _RANGES.items():
        with np.errstate(over="ignore"):
            value = np.float32(getattr(settings, name))
        if not math.isfinite(value) or value < least or value > most or (value == least and not with_least):
            bound = f"{'at least' if with_least else 'above'} {least:g}"
            bound += f" and at most {most:g}" if math.isfinite(most) else " and finite"
            raise UsageError(
                f"{name} is out of range: {value:g}", place="navmesh settings", remedy=f"It must be {bound}"
            )
    for name, unit, most in (
        ("agent_height", "cell_height", MAX_AGENT_CELLS),
        ("agent_max_climb", "cell_height", MAX_AGENT_CELLS),
        ("agent_radius", "cell_size", MAX_RADIUS_CELLS),
        ("edge_max_len", "cell_size", MAX_GRID_CELLS),
    ):
        cells = np.float32(getattr(settings, name)) / np.float32(getattr(settings, unit))
        if not cells <= most:
            raise UsageError(
                f"{name} {getattr(settings, name):g} makes {cells:.0f} cells of {unit} {getattr(settings, unit):g}",
                place="navmesh settings",
                remedy=f"Recast takes at most {most} cells; use a larger {unit}",
            )


def _check_extent(extent: Array, levels: np.float32, settings: NavMeshSettings, memory_limit: int) -> None:
    columns = float(extent[0]) * float(extent[1])
    needed = columns * BYTES_PER_COLUMN
    if not needed <= memory_limit:
        raise FormatError(
            f"a grid of {float(extent[0]):.3g} x {float(extent[1]):.3g} cells of {settings.cell_size:g} m would need "
            f"about {needed / 2**30:,.1f} GiB, and the limit is {memory_limit / 2**30:,.1f} GiB",
            place="mesh bounds",
            remedy="Check the unit of the mesh and remove far-off vertices, or use a larger cell_size",
        )
    if extent.max() > MAX_GRID_CELLS:
        raise FormatError(
            f"the mesh is {extent.max():.0f} cells long, but a tile holds at most {MAX_GRID_CELLS:,}",
            place="mesh bounds",
            remedy="Use a larger cell_size or cut the mesh into parts",
        )
    if extent.min() < 1:
        raise FormatError(
            f"the mesh is thinner than half a cell of {settings.cell_size:g} m",
            place="mesh bounds",
            remedy="Check the unit of the mesh (metres) and that it has a floor",
        )
    if not levels < MAX_SPAN_HEIGHT:
        raise FormatError(
            f"the mesh is {levels:.0f} cells high, each of {settings.cell_height:g} m, "
            f"but a tile holds at most {MAX_SPAN_HEIGHT:,}",
            place="mesh bounds",
            remedy="Check the unit of the mesh and remove far-off vertices, or use a larger cell_height",
        )


# Recast's area id of a walkable surface.
WALKABLE_AREA = 63


def checked_triangles(vertices: npt.ArrayLike, faces: npt.ArrayLike) -> tuple[Array, Array]:
    """Return vertices as (n, 3) float32 and faces as (m, 3) int32, in the given order.

    Raises
    ------
    FormatError
        The shapes are wrong, there is no triangle, a vertex is NaN or infinite, or an index is out of range.
    """
    points = np.asarray(vertices)
    corners = np.asarray(faces)
    if (
        points.ndim != 2
        or points.shape[1] != 3
        or not np.issubdtype(points.dtype, np.number)
        or np.iscomplexobj(points)
    ):
        raise FormatError(
            f"vertices can't be {points.dtype} of shape {points.shape}",
            place="vertices",
            remedy="Give (n, 3) numbers in metres",
        )
    if corners.size == 0:
        raise FormatError(
            "the mesh has no triangles",
            place="faces",
            remedy="Check that the file holds geometry and not only empty nodes",
        )
    if corners.ndim != 2 or corners.shape[1] != 3 or not np.issubdtype(corners.dtype, np.integer):
        raise FormatError(
            f"faces can't be {corners.dtype} of shape {corners.shape}",
            place="faces",
            remedy="Give (m, 3) integer indices",
        )
    with np.errstate(over="ignore"):
        points = np.require(points, np.float32, ["C", "W"])  # kernels are compiled for plain arrays only
    bad = ~np.isfinite(points).all(axis=1)
    if bad.any():
        where = int(np.argmax(bad))
        raise FormatError(
            f"{int(bad.sum())} of {len(points)} vertices are NaN, infinite or beyond float32",
            place=f"vertex {where}",
            remedy="Repair or remove them",
        )
    bad = ((corners < 0) | (corners >= len(points))).any(axis=1)
    if bad.any():
        where = int(np.argmax(bad))
        raise FormatError(
            f"face {corners[where].tolist()} refers to a vertex outside 0..{len(points) - 1}",
            place=f"face {where}",
            remedy="Repair the mesh; indices count from 0",
        )
    return points, np.require(corners, np.int32, ["C", "W"])


def walkable_faces(vertices: Array, faces: Array, least_upward: np.float32) -> Array:
    """Return the area id of each face, (m,) uint8: WALKABLE_AREA if the unit normal's y exceeds ``least_upward``, else
    0.

    Follows ``rcMarkWalkableTriangles`` of Recast, in float32 throughout. A degenerate face has no normal and is not
    walkable.
    """
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    with np.errstate(all="ignore"):
        u, v = b - a, c - a
        x = u[:, 1] * v[:, 2] - u[:, 2] * v[:, 1]
        y = u[:, 2] * v[:, 0] - u[:, 0] * v[:, 2]
        z = u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]
        upward = y * (np.float32(1) / np.sqrt((x * x + y * y) + z * z))
        return np.where(upward > least_upward, np.uint8(WALKABLE_AREA), np.uint8(0))
