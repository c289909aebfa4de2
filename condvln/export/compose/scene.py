"""A whole scene as one GLB file, and the navmesh that Habitat would build of it.

Stock loaders (VLN-CE's among them) open a scene by one file and refuse dataset configurations. They take a bare
``.glb`` to be z-up, whatever glTF says (habitat-sim, ``StageAttributesManager::setDefaultAssetNameBasedAttributes``),
and look for the navmesh of the same name beside it. So the file is z-up, as Matterport3D's are, and the navmesh, in
Habitat's frame, is built of the very file that was written.
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
    """A scene as files.

    glb : z-up
    navmesh : in Habitat's frame, built of `glb`
    triangles : of all that stands there
    bodies : objects that stand there; what is drawn as structure (floors, walls, windows, doors) is none
    left_out : objects whose surfaces are not known
    textures_left_out : textures whose images stand in no file of the scene
    approximate : drawn walls and boxes in place of surfaces
    """

    glb: bytes
    navmesh: NavMeshFile
    triangles: int
    bodies: tuple[str, ...]
    left_out: tuple[str, ...]
    textures_left_out: int
    approximate: bool


def compose_scene(scene: Scene, geometry: SceneGeometry | None, agent: AgentConfig) -> ComposedScene:
    """One file of a scene's stage and bodies where it has meshes, of its drawn surfaces where it has none.

    Parameters
    ----------
    geometry : the scene's surfaces, as its source gives them
    agent : whom the navmesh is for

    Raises
    ------
    InputError : the scene has no surfaces, a part can't be read, or nobody can stand on what is composed
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
        # A scan is one body: its objects are in it, though nothing tells where.
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
    """Stage and bodies, each file taken in once; gives the number of textures that can't come along."""
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
    """Floor and walls, then each object, in the order of the geometry: builders of navmeshes mind it."""
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
    """Vertices and faces of some faces alone, in their order."""
    used, corners = np.unique(geometry.faces[rows], return_inverse=True)
    return geometry.vertices[used], corners.reshape(-1, 3).astype(np.int64)


def _navmesh(glb: bytes, scene: Scene, agent: AgentConfig) -> NavMeshFile:
    vertices, faces = glb_triangles(glb, f"{scene.family}/{scene.scene_id}, composed", Z_UP)
    return build_navmesh(vertices, faces, NavMeshSettings.furnished(agent))
