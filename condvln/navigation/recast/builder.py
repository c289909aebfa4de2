"""Build the navmesh that Habitat would build from the same triangles, byte for byte.

The algorithms are those of Recast & Detour (Mikko Mononen, zlib licence) as habitat-sim (MIT) configures them: one
tile, no border, watershed regions.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from condvln.formats.triangles import MeshSource, PlacedMesh, mesh_triangles
from condvln.navigation.navmesh_file import NavMeshFile
from condvln.navigation.recast.compact import compact, distance_field, erode
from condvln.navigation.recast.config import (
    MEMORY_LIMIT_BYTES,
    RecastConfig,
    RecastProfile,
    checked_triangles,
    walkable_faces,
)
from condvln.navigation.recast.contours import merge_holes, trace_contours
from condvln.navigation.recast.detail import DetailMesh, build_detail
from condvln.navigation.recast.geometry import Array
from condvln.navigation.recast.heightfield import (
    Heightfield,
    filter_ledges,
    filter_low_hanging_obstacles,
    filter_low_height,
    rasterize,
)
from condvln.navigation.recast.polymesh import NO_INDEX, PolyMesh, build_polymesh
from condvln.navigation.recast.regions import merge_regions
from condvln.navigation.recast.watershed import watershed
from condvln.navigation.settings import NavMeshSettings
from condvln.navigation.tile import (
    DETAIL_MESH,
    POLYGON,
    WALKABLE,
    Floats,
    NavMeshTile,
    Records,
    build_bv_tree,
    link_tile,
    quantise_bounds,
)
from schemas.errors import FormatError, InputError

__all__ = ["Notify", "assemble_tile", "build_navmesh", "build_scene_navmesh"]

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


# Called with the name of each stage when it begins.
Notify = Callable[[str], None]


def build_navmesh(
    vertices: npt.ArrayLike,
    faces: npt.ArrayLike,
    settings: NavMeshSettings | None = None,
    profile: RecastProfile | str = RecastProfile.HABITAT_0_3_4,
    *,
    memory_limit: int = MEMORY_LIMIT_BYTES,
    report: Notify | None = None,
) -> NavMeshFile:
    """Build the navmesh of a triangle mesh.

    Parameters
    ----------
    vertices : (n, 3) float, metres, Habitat frame (y up); rounded to float32. The bounds include unused vertices.
    faces : (m, 3) int; the order of touching faces matters
    settings : Habitat's defaults if not given
    profile : the version of Recast; see :class:`RecastProfile`
    memory_limit : size limit in bytes of the voxel grid
    report : called with the name of each stage as it begins

    Raises
    ------
    UsageError
        A setting is out of range.
    FormatError
        The mesh is malformed, or too large for a tile or for ``memory_limit``.
    InputError
        There is no walkable floor.
    """
    settings, begin = settings or NavMeshSettings(), report or (lambda _: None)
    begin("checking triangles")
    points, corners = checked_triangles(vertices, faces)
    config = RecastConfig.of(points, settings, memory_limit)
    begin("rasterising")
    solid = rasterize(points, corners, walkable_faces(points, corners, config.walkable_slope_cosine), config)
    begin("filtering")
    area = _filtered(solid, settings, RecastProfile.named(profile), config)
    begin("connecting")
    field = compact(solid, area, config.walkable_height, config.walkable_climb)
    eroded = erode(field, config.walkable_radius)
    begin("partitioning")
    distance, highest = distance_field(field, eroded)
    region, count = watershed(field, eroded, distance, highest)
    region, _ = merge_regions(field, eroded, region, count, config.min_region_area, config.merge_region_area)
    begin("tracing contours")
    contours = merge_holes(trace_contours(field, eroded, region, config.max_edge_error, config.max_edge_length))
    begin("making polygons")
    mesh = build_polymesh(contours, config.verts_per_poly)
    begin("sampling heights")
    detail = build_detail(mesh, field, region, config)
    begin("assembling the tile")
    return NavMeshFile.of_tile(assemble_tile(mesh, detail, config, settings), settings)


def _filtered(solid: Heightfield, settings: NavMeshSettings, profile: RecastProfile, config: RecastConfig) -> Array:
    """Return the area ids of the spans after the filters."""
    if settings.filter_low_hanging_obstacles:
        solid = replace(solid, area=filter_low_hanging_obstacles(solid, config.walkable_climb))
    if settings.filter_ledge_spans:
        solid = replace(solid, area=filter_ledges(solid, config.walkable_height, config.walkable_climb))
    if settings.filter_walkable_low_height_spans:
        strict = profile is RecastProfile.HABITAT_0_3_3
        solid = replace(solid, area=filter_low_height(solid, config.walkable_height, strict))
    return solid.area


def build_scene_navmesh(
    stage: MeshSource,
    settings: NavMeshSettings | None = None,
    profile: RecastProfile | str = RecastProfile.HABITAT_0_3_4,
    *,
    static_objects: Iterable[PlacedMesh] = (),
    memory_limit: int = MEMORY_LIMIT_BYTES,
    report: Notify | None = None,
) -> NavMeshFile:
    """Build the navmesh of a scene: its stage and, if ``settings.include_static_objects``, its static objects.

    Parameters
    ----------
    stage : a mesh file, a ``trimesh.Scene`` or a mesh, in Habitat's frame or with the transform that takes it there
    static_objects : the same for each object, placed in the scene
    others : as for :func:`build_navmesh`
    """
    settings = settings or NavMeshSettings()
    objects = static_objects if settings.include_static_objects else ()
    vertices, faces = mesh_triangles([stage, *objects])
    return build_navmesh(vertices, faces, settings, profile, memory_limit=memory_limit, report=report)
