"""One build, stage by stage, with the results of every stage."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from condvln.navigation.recast.arrays import Array
from condvln.navigation.recast.assembly import assemble_tile
from condvln.navigation.recast.compact import MAX_LAYERS, CompactHeightfield, compact
from condvln.navigation.recast.config import MEMORY_LIMIT_BYTES, RecastConfig, RecastProfile
from condvln.navigation.recast.contours import Contours, trace_contours
from condvln.navigation.recast.detail import DetailMesh, build_detail
from condvln.navigation.recast.distance import distance_field, erode
from condvln.navigation.recast.filters import filter_ledges, filter_low_hanging_obstacles, filter_low_height
from condvln.navigation.recast.heightfield import Heightfield, rasterize
from condvln.navigation.recast.holes import merge_holes
from condvln.navigation.recast.polymesh import PolyMesh, build_polymesh
from condvln.navigation.recast.regions import merge_regions
from condvln.navigation.recast.triangles import checked_triangles, walkable_faces
from condvln.navigation.recast.watershed import watershed
from condvln.navigation.settings import NavMeshSettings
from condvln.navigation.tile import NavMeshTile

__all__ = ["BuildStages", "Notify", "build_stages"]

# Called with the name of each stage when it begins.
Notify = Callable[[str], None]
# The value of "no neighbour" in the reference dumps of stages.
NOT_CONNECTED = MAX_LAYERS + 1


@dataclass(frozen=True, eq=False)
class BuildStages:
    """Results of the stages of one build, in order.

    Attributes
    ----------
    solid : heightfield as rasterised
    filtered : its area ids after the low-hanging, the ledge and the low-height filter, (s,) uint8 each
    compact : walkable spans before erosion
    eroded : their area ids after it
    distance, region : (s,) int32, per compact span
    """

    config: RecastConfig
    solid: Heightfield
    filtered: tuple[Array, Array, Array]
    compact: CompactHeightfield
    eroded: Array
    distance: Array
    region: Array
    raw_contours: Contours
    contours: Contours
    polymesh: PolyMesh
    detail: DetailMesh
    tile: NavMeshTile

    def arrays(self) -> dict[str, Array]:
        """Return the flat arrays of all stages by name, in order. Names and layout are those of the reference dumps
        (``*.stages.npz``).
        """
        solid, field = self.solid, self.compact
        cell = np.repeat(np.arange(solid.width * solid.depth), np.diff(solid.start))
        out = {
            f"solid{k}": np.stack([cell, solid.bottom, solid.top, area], axis=1).ravel()
            for k, area in enumerate((solid.area, *self.filtered))
        }
        counts = np.diff(field.start)
        first = np.where(np.diff(solid.start) > 0, field.start[:-1], 0)
        layer = field.neighbour - field.start[field.column[field.neighbour]]
        steps = np.where(field.neighbour < 0, NOT_CONNECTED, layer)
        out["chf_cells"] = np.stack([first, counts], axis=1).ravel()
        out["chf_spans"] = np.concatenate([field.floor[:, None], field.clearance[:, None], steps], axis=1).ravel()
        out["chf_area0"], out["chf_area1"] = field.area, self.eroded
        out["chf_dist"], out["chf_reg"] = self.distance, self.region
        out["rawcontours"] = _flat(self.raw_contours, with_area=False)
        out["contours"] = _flat(self.contours, with_area=True)
        out["pm_verts"], out["pm_polys"] = self.polymesh.vertices.ravel(), self.polymesh.polygons.ravel()
        out["pm_regs"] = self.polymesh.region
        out["dm_meshes"], out["dm_verts"] = self.detail.meshes.ravel(), self.detail.vertices.ravel()
        out["dm_tris"] = self.detail.triangles.ravel()
        out["tile"] = np.frombuffer(self.tile.to_bytes(), np.uint8)
        return out


def _flat(contours: Contours, with_area: bool) -> Array:
    rows = []
    for k in range(len(contours)):
        head = [len(contours[k]), contours.region[k], contours.area[k]]
        rows += [np.array(head if with_area else head[:2]), contours[k].ravel()]
    return np.concatenate(rows) if rows else np.zeros(0, np.int64)


def build_stages(
    vertices: npt.ArrayLike,
    faces: npt.ArrayLike,
    settings: NavMeshSettings,
    profile: RecastProfile = RecastProfile.HABITAT_0_3_4,
    *,
    memory_limit: int = MEMORY_LIMIT_BYTES,
    report: Notify | None = None,
) -> BuildStages:
    """Build a navmesh and keep the results of every stage. Parameters and errors are those of ``build_navmesh``."""
    begin = report or _silent
    begin("checking triangles")
    points, corners = checked_triangles(vertices, faces)
    config = RecastConfig.of(points, settings, memory_limit)
    begin("rasterising")
    solid = rasterize(points, corners, walkable_faces(points, corners, config.walkable_slope_cosine), config)
    begin("filtering")
    filtered = _filter(solid, settings, profile, config)
    begin("connecting")
    field = compact(solid, filtered[-1], config.walkable_height, config.walkable_climb)
    eroded = erode(field, config.walkable_radius)
    begin("partitioning")
    distance, highest = distance_field(field, eroded)
    region, count = watershed(field, eroded, distance, highest)
    region, _ = merge_regions(field, eroded, region, count, config.min_region_area, config.merge_region_area)
    begin("tracing contours")
    raw_contours, contours = trace_contours(field, eroded, region, config.max_edge_error, config.max_edge_length)
    contours = merge_holes(contours)
    begin("making polygons")
    mesh = build_polymesh(contours, config.verts_per_poly)
    begin("sampling heights")
    detail = build_detail(mesh, field, region, config)
    begin("assembling the tile")
    tile = assemble_tile(mesh, detail, config, settings)
    return BuildStages(
        config, solid, filtered, field, eroded, distance, region, raw_contours, contours, mesh, detail, tile
    )


def _filter(
    solid: Heightfield, settings: NavMeshSettings, profile: RecastProfile, config: RecastConfig
) -> tuple[Array, Array, Array]:
    first = second = third = solid.area
    if settings.filter_low_hanging_obstacles:
        first = second = third = filter_low_hanging_obstacles(solid, config.walkable_climb)
    if settings.filter_ledge_spans:
        second = third = filter_ledges(replace(solid, area=first), config.walkable_height, config.walkable_climb)
    if settings.filter_walkable_low_height_spans:
        strict = profile is RecastProfile.HABITAT_0_3_3
        third = filter_low_height(replace(solid, area=second), config.walkable_height, strict)
    return first, second, third


def _silent(_: str) -> None:
    pass
