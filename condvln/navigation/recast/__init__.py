"""The navmesh builder: from triangles to the same ``.navmesh`` that Habitat would build, byte for byte."""

from condvln.formats.triangles import Z_UP, PlacedMesh, mesh_triangles
from condvln.navigation.recast.builder import build_navmesh, build_scene_navmesh
from condvln.navigation.recast.config import RecastProfile

__all__ = ["Z_UP", "PlacedMesh", "RecastProfile", "build_navmesh", "build_scene_navmesh", "mesh_triangles"]
