"""Stage 12: assemble the Detour tile from the polygon mesh and the detail mesh (``dtCreateNavMeshData``), with the
links that Habitat saves.
"""

from __future__ import annotations

import numpy as np

from condvln.navigation.bvtree import build_bv_tree, quantise_bounds
from condvln.navigation.links import link_tile
from condvln.navigation.recast.config import RecastConfig
from condvln.navigation.recast.detail import DetailMesh
from condvln.navigation.recast.polymesh import NO_INDEX, PolyMesh
from condvln.navigation.settings import NavMeshSettings
from condvln.navigation.tile import DETAIL_MESH, POLYGON, WALKABLE, Floats, NavMeshTile, Records
from schemas.errors import FormatError, InputError

__all__ = ["assemble_tile"]

# Detour counts detail vertices in sixteen bits, and the highest bit of a neighbour marks another tile.
MAX_DETAIL_VERTICES = 0xFFFF
MAX_POLYGONS = 0x8000


def assemble_tile(mesh: PolyMesh, detail: DetailMesh, config: RecastConfig, settings: NavMeshSettings) -> NavMeshTile:
    """Return the tile in the state in which Habitat saves it.

    Raises
    ------
    InputError
        The mesh has no walkable floor.
    FormatError
        There are more polygons or vertices than a tile can hold.
    """
    if len(mesh.polygons) == 0:
        raise InputError(
            f"the mesh has no floor for an agent of radius {settings.agent_radius:g} m "
            f"and height {settings.agent_height:g} m",
            place="polygon mesh",
            remedy="Check that y is up and faces point up, or lower agent sizes and region_min_size",
        )
    beyond = len(detail.vertices) - int(mesh.vert_counts.sum())
    if len(mesh.polygons) > MAX_POLYGONS or beyond > MAX_DETAIL_VERTICES:
        raise FormatError(
            f"{len(mesh.polygons):,} polygons with {beyond:,} detail vertices are more than a tile holds",
            place="tile",
            remedy="Use a larger cell_size or detail_sample_dist, or cut the mesh into parts",
        )
    bounds_max = config.bounds_max.copy()
    bounds_max[1] += np.float32(config.walkable_height) * config.cell_height
    low, high = _polygon_bounds(detail)
    cells = quantise_bounds(low, high, config.bounds_min, settings.cell_size)
    tile = NavMeshTile.assemble(
        bmin=config.bounds_min,
        bmax=bounds_max,
        cell_size=settings.cell_size,
        walkable_height=settings.agent_height,
        walkable_radius=settings.agent_radius,
        walkable_climb=settings.agent_max_climb,
        verts=config.bounds_min
        + mesh.vertices.astype(np.float32)
        * np.array([config.cell_size, config.cell_height, config.cell_size], np.float32),
        polys=_polygon_records(mesh),
        detail_meshes=_detail_records(mesh, detail),
        detail_verts=detail.vertices[_beyond_corners(mesh, detail)],
        detail_tris=detail.triangles,
        bv_nodes=build_bv_tree(*cells),
    )
    return link_tile(tile)


def _polygon_records(mesh: PolyMesh) -> Records:
    most = mesh.verts_per_poly
    counts = mesh.vert_counts
    used = np.arange(most) < counts[:, None]
    polys = np.zeros(len(mesh.polygons), POLYGON)
    polys["verts"][:, :most] = np.where(used, mesh.polygons[:, :most], 0)
    beside = mesh.polygons[:, most:]
    polys["neis"][:, :most] = np.where(used & (beside != NO_INDEX), beside + 1, 0)
    polys["flags"] = WALKABLE
    polys["vert_count"] = counts
    return polys


def _detail_records(mesh: PolyMesh, detail: DetailMesh) -> Records:
    records = np.zeros(len(detail.meshes), DETAIL_MESH)
    extra = detail.meshes[:, 1] - mesh.vert_counts
    records["vert_base"] = np.cumsum(extra) - extra
    records["vert_count"] = extra
    records["tri_base"] = detail.meshes[:, 2]
    records["tri_count"] = detail.meshes[:, 3]
    return records


def _beyond_corners(mesh: PolyMesh, detail: DetailMesh) -> Records:
    """Return a mask (v,) of the detail vertices that are not corners of their polygon. The vertices of a polygon begin
    with its corners.
    """
    within = np.arange(len(detail.vertices)) - np.repeat(detail.meshes[:, 0], detail.meshes[:, 1])
    beyond: Records = within >= np.repeat(mesh.vert_counts, detail.meshes[:, 1])
    return beyond


def _polygon_bounds(detail: DetailMesh) -> tuple[Floats, Floats]:
    first = detail.meshes[:, 0]
    return np.minimum.reduceat(detail.vertices, first), np.maximum.reduceat(detail.vertices, first)
