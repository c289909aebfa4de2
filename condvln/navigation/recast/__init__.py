"""The navmesh builder: triangles to the very ``.navmesh`` that Habitat would build."""

from condvln.formats.triangles import Z_UP, PlacedMesh, mesh_triangles
from condvln.navigation.recast.builder import build_navmesh, build_scene_navmesh
from condvln.navigation.recast.config import RecastProfile

__all__ = ["Z_UP", "PlacedMesh", "RecastProfile", "build_navmesh", "build_scene_navmesh", "mesh_triangles"]
