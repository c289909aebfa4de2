"""Build the navmesh that Habitat would build from the same triangles, byte for byte.

The algorithms are those of Recast & Detour (Mikko Mononen, zlib licence) as habitat-sim (MIT) configures them: one
tile, no border, watershed regions.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
import numpy.typing as npt

from condvln.compiled import register_warm_up
from condvln.formats.triangles import MeshSource, PlacedMesh, mesh_triangles
from condvln.navigation.navmesh_file import NavMeshFile
from condvln.navigation.recast.config import MEMORY_LIMIT_BYTES, RecastProfile
from condvln.navigation.recast.stages import Notify, build_stages
from condvln.navigation.settings import NavMeshSettings

__all__ = ["build_navmesh", "build_scene_navmesh"]


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
    settings = settings or NavMeshSettings()
    stages = build_stages(
        vertices, faces, settings, RecastProfile.named(profile), memory_limit=memory_limit, report=report
    )
    return NavMeshFile.of_tile(stages.tile, settings)


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


def _warm_up() -> None:
    """Build the navmesh of a floor with a pillar, so that every kernel is called. The pillar is placed so that it makes
    a hole in a region.
    """
    floor = [[-1.5, 0, -1.5], [-1.5, 0, 1.5], [1.5, 0, 1.5], [1.5, 0, -1.5]]
    pillar = [[x, y, z] for y in (0, 2) for x, z in ((0.85, -0.05), (0.85, 0.05), (0.95, 0.05), (0.95, -0.05))]
    sides = [[4 + k, 4 + (k + 1) % 4, 8 + (k + 1) % 4] for k in range(4)]
    build_navmesh(np.array(floor + pillar, np.float32), np.array([[0, 1, 2], [0, 2, 3], *sides], np.int32))


register_warm_up("navmesh builder", _warm_up)
