"""Compose a whole scene into one GLB file, with the navmesh that Habitat would build from it.

Stock loaders (VLN-CE's among them) open a scene as a single file and don't support scene dataset configurations. They
treat a bare ``.glb`` as z-up, against the glTF standard (habitat-sim,
``StageAttributesManager::setDefaultAssetNameBasedAttributes``), and look for the navmesh of the same name beside it. So
the file is z-up, as Matterport3D's are, and the navmesh, in Habitat's frame, is built from exactly this file.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from condvln.export.compose.writer import GlbWriter
from condvln.formats.dataset_root import DatasetRoot
from condvln.formats.glb import MAX_GLB_BYTES
from condvln.formats.glb_part import GlbPart, read_part
from condvln.formats.triangles import Z_UP, glb_triangles
from condvln.navigation.navmesh_file import NavMeshFile
from condvln.navigation.recast import build_navmesh
from condvln.navigation.settings import NavMeshSettings
from condvln.scene import MeshPart, Scene
from condvln.scene.boxes import placement
from condvln.scene.frames import Z_UP_TO_HABITAT
from condvln.scene.geometry import STRUCTURE, SceneGeometry
from condvln.scene.palette import FLOOR_COLOUR, WALL_COLOUR, label_colour
from schemas.config import AgentConfig
from schemas.errors import InputError

__all__ = ["ComposedScene", "compose_scene"]

F64 = NDArray[np.float64]

STAGE: Final = "stage"


@dataclass(frozen=True, eq=False)
class ComposedScene:
    """A composed scene as files.

    glb : bytes, z-up
    navmesh : bytes, in Habitat's frame, built from `glb`
    triangles : number of triangles
    bodies : number of objects, without structure (floors, walls, windows, doors)
    left_out : number of objects whose surfaces are unknown
    textures_left_out : number of textures whose images are in no file of the scene
    approximate : walls and boxes were drawn in place of surfaces
    """

    glb: bytes
    navmesh: NavMeshFile
    triangles: int
    bodies: tuple[str, ...]
    left_out: tuple[str, ...]
    textures_left_out: int
    approximate: bool


def compose_scene(scene: Scene, geometry: SceneGeometry | None, agent: AgentConfig) -> ComposedScene:
    """Compose a scene from the meshes of its stage and objects. If it has no meshes, walls and boxes are drawn in their
    place.

    Parameters
    ----------
    geometry : the scene's triangles, from its source
    agent : the agent that the navmesh is for

    Raises
    ------
    InputError : the scene has no surfaces, a part can't be read, or the composed scene has no walkable floor
    """
    if geometry is None:
        raise InputError(
            "the scene has neither a mesh nor walls to compose",
            where=f"{scene.family}/{scene.scene_id}",
            remedy="Download the mesh of its stage or scan; 'condvln sources' names what is missing",
        )
    writer = GlbWriter(placement(Z_UP_TO_HABITAT.T))
    lost, drawn = 0, set(geometry.owner.tolist())
    if geometry.approximate:
        _draw(writer, scene, geometry)
        known = drawn | {n for n, o in enumerate(scene.objects) if o.obb is not None or o.box is not None}
    else:
        lost = _assemble(writer, scene)
        # A scan is a single mesh that contains its objects; which triangles are whose is unknown.
        known = drawn if any(item.mesh for item in scene.objects) else set(range(len(scene.objects)))
    glb = writer.to_bytes()
    return ComposedScene(
        glb=glb,
        navmesh=_navmesh(glb, scene, agent),
        triangles=writer.triangles,
        bodies=tuple(o.object_id for number, o in enumerate(scene.objects) if number in drawn),
        left_out=tuple(o.object_id for number, o in enumerate(scene.objects) if number not in known),
        textures_left_out=lost,
        approximate=geometry.approximate,
    )


def _assemble(writer: GlbWriter, scene: Scene) -> int:
    """Add the stage and the objects to the file. The meshes of a source file that several objects use are written once.
    Return the number of textures that can't be copied.
    """
    files = DatasetRoot(scene.root)
    known: dict[str, GlbPart] = {}
    lost = 0

    def instance(part: MeshPart) -> tuple[GlbPart, F64]:
        nonlocal lost
        if part.path not in known:
            read = read_part(files.read(part.path, MAX_GLB_BYTES), str(files.folder / part.path))
            lost += read.look.lost if read.look is not None else 0
            known[part.path] = writer.add(read)
        return known[part.path], part.transform

    writer.place(STAGE, [instance(part) for part in scene.stage])
    for item in scene.objects:
        if item.mesh:
            writer.place(item.object_id, [instance(part) for part in item.mesh])
    return lost


def _draw(writer: GlbWriter, scene: Scene, geometry: SceneGeometry) -> None:
    """Add floor and walls, then each object, in the order of the geometry: navmesh builders depend on the order."""
    structure = np.flatnonzero(geometry.owner == STRUCTURE)
    heights = geometry.vertices[geometry.faces[structure]][:, :, 1]
    level = np.ptp(heights, axis=1) == 0
    ends = np.flatnonzero(~level)
    floors = len(structure) if not len(ends) else int(ends[0])
    writer.surface(
        STAGE,
        [
            (*_own(geometry, rows), colour)
            for rows, colour in ((structure[:floors], FLOOR_COLOUR), (structure[floors:], WALL_COLOUR))
            if len(rows)
        ],
    )
    order = np.argsort(geometry.owner, kind="stable")
    starts = np.searchsorted(geometry.owner[order], np.arange(len(scene.objects) + 1))
    for number, item in enumerate(scene.objects):
        rows = order[starts[number] : starts[number + 1]]
        if len(rows):
            writer.surface(item.object_id, [(*_own(geometry, rows), label_colour(item.label))])


def _own(geometry: SceneGeometry, rows: NDArray[np.int64]) -> tuple[F64, NDArray[np.int64]]:
    """Return a mesh (vertices, faces) of the faces with the indices `rows`, in that order. It has only the vertices
    that these faces use, renumbered from 0.
    """
    used, corners = np.unique(geometry.faces[rows], return_inverse=True)
    return geometry.vertices[used], corners.reshape(-1, 3).astype(np.int64)


def _navmesh(glb: bytes, scene: Scene, agent: AgentConfig) -> NavMeshFile:
    vertices, faces = glb_triangles(glb, f"{scene.family}/{scene.scene_id}, composed", Z_UP)
    return build_navmesh(vertices, faces, NavMeshSettings.furnished(agent))
