"""Navigation as in habitat-sim, without habitat-sim: navmesh files, paths, steps, ground-truth walks, navmesh builder.

The names below are loaded when first used, so that reading a configuration does not start numba.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from condvln.navigation.follower import RXR, VLN_CE, ActionSpace, FollowedRoute, Follower
    from condvln.navigation.graph_pathfinder import GraphPathfinder
    from condvln.navigation.habitat_pathfinder import HabitatPathfinder
    from condvln.navigation.navmesh_file import NavMeshFile, parse_navmesh, read_navmesh, write_navmesh
    from condvln.navigation.occluders import BoxOccluders, MeshOccluders, Occluders, wall_boxes
    from condvln.navigation.pathfinder import HitRecord, Pathfinder
    from condvln.navigation.polygon_tile import tile_of_polygons
    from condvln.navigation.protocol import PathfinderProtocol, ShortestPath
    from condvln.navigation.recast import build_navmesh, build_scene_navmesh
    from condvln.navigation.settings import NavMeshSettings
    from condvln.navigation.sight import SightTarget, View, eyes_at, first_sights, visible_points, visible_shares
    from condvln.navigation.surface_samples import box_samples, mesh_samples

__all__ = [
    "RXR",
    "VLN_CE",
    "ActionSpace",
    "BoxOccluders",
    "FollowedRoute",
    "Follower",
    "GraphPathfinder",
    "HabitatPathfinder",
    "HitRecord",
    "MeshOccluders",
    "NavMeshFile",
    "NavMeshSettings",
    "Occluders",
    "Pathfinder",
    "PathfinderProtocol",
    "ShortestPath",
    "SightTarget",
    "View",
    "box_samples",
    "build_navmesh",
    "build_scene_navmesh",
    "eyes_at",
    "first_sights",
    "mesh_samples",
    "parse_navmesh",
    "read_navmesh",
    "tile_of_polygons",
    "visible_points",
    "visible_shares",
    "wall_boxes",
    "write_navmesh",
]

_MODULES = {
    "follower": ("RXR", "VLN_CE", "ActionSpace", "FollowedRoute", "Follower"),
    "graph_pathfinder": ("GraphPathfinder",),
    "habitat_pathfinder": ("HabitatPathfinder",),
    "navmesh_file": ("NavMeshFile", "parse_navmesh", "read_navmesh", "write_navmesh"),
    "occluders": ("BoxOccluders", "MeshOccluders", "Occluders", "wall_boxes"),
    "pathfinder": ("HitRecord", "Pathfinder"),
    "polygon_tile": ("tile_of_polygons",),
    "protocol": ("PathfinderProtocol", "ShortestPath"),
    "recast": ("build_navmesh", "build_scene_navmesh"),
    "settings": ("NavMeshSettings",),
    "sight": ("SightTarget", "View", "eyes_at", "first_sights", "visible_points", "visible_shares"),
    "surface_samples": ("box_samples", "mesh_samples"),
}
_MODULE_OF = {name: module for module, names in _MODULES.items() for name in names}


def __getattr__(name: str) -> object:
    if name not in _MODULE_OF:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_MODULE_OF[name]}"), name)
