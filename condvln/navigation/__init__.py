"""Navigation as in habitat-sim, without habitat-sim: navmesh files, paths, steps, ground-truth walks, navmesh builder.

The names below are loaded when first used, so that reading a configuration does not start numba.
"""

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from condvln.navigation.follower import Follower
    from condvln.navigation.graph_pathfinder import GraphPathfinder
    from condvln.navigation.pathfinder import HitRecord, Pathfinder
    from condvln.navigation.protocol import MultiGoalShortestPath, ShortestPath
    from condvln.navigation.recast import build_navmesh, build_scene_navmesh
    from condvln.navigation.settings import NavMeshSettings

_MODULE_OF = {
    "Follower": "follower",
    "GraphPathfinder": "graph_pathfinder",
    "HitRecord": "pathfinder",
    "MultiGoalShortestPath": "protocol",
    "NavMeshSettings": "settings",
    "Pathfinder": "pathfinder",
    "ShortestPath": "protocol",
    "build_navmesh": "recast",
    "build_scene_navmesh": "recast",
}

__all__ = [
    "Follower",
    "GraphPathfinder",
    "HitRecord",
    "MultiGoalShortestPath",
    "NavMeshSettings",
    "Pathfinder",
    "ShortestPath",
    "build_navmesh",
    "build_scene_navmesh",
]


def __getattr__(name: str) -> object:
    if name not in _MODULE_OF:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_MODULE_OF[name]}"), name)
