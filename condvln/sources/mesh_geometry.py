"""Surfaces of scenes with meshes: either a scan, which is a single mesh, or a stage with all bodies in place."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from condvln.formats.dataset_root import DatasetRoot
from condvln.formats.glb import MAX_GLB_BYTES
from condvln.formats.triangles import glb_triangles
from condvln.scene import Scene
from condvln.scene.geometry import STRUCTURE, SceneGeometry
from condvln.scene.meshes import MeshLibrary, WorldMesh
from condvln.sources.solids import Piece, joined

__all__ = ["assembled_geometry", "scan_geometry"]


def scan_geometry(files: DatasetRoot, scene: Scene) -> SceneGeometry | None:
    """Return the triangles of a scene that is one scan, in the order and float32 precision of Habitat's navmesh
    builder.

    No triangle is assigned to an object. None if the scan's mesh is missing.

    Raises
    ------
    InputError : the mesh can't be read
    """
    if not scene.stage:
        return None
    scans = [
        glb_triangles(files.read(part.path, MAX_GLB_BYTES), str(files.folder / part.path), part.transform)
        for part in scene.stage
    ]
    return joined([_piece(vertices, faces, STRUCTURE) for vertices, faces in scans], approximate=False)


def assembled_geometry(meshes: MeshLibrary, scene: Scene) -> SceneGeometry | None:
    """Return the triangles of the stage, followed by those of each object that has a mesh.

    None if the stage is missing, since floor and walls are then unknown.

    Raises
    ------
    InputError : a mesh can't be read
    """
    if not scene.stage:
        return None
    pieces = [_of_mesh(meshes.placed(part), STRUCTURE) for part in scene.stage]
    for number, item in enumerate(scene.objects):
        mesh = meshes.world_mesh(item)
        if mesh is not None:
            pieces.append(_of_mesh(mesh, number))
    return joined(pieces, approximate=False)


def _of_mesh(mesh: WorldMesh, owner: int) -> Piece:
    return _piece(mesh.vertices, mesh.faces, owner)


def _piece(vertices: NDArray[np.floating], faces: NDArray[np.integer], owner: int) -> Piece:
    return Piece(vertices.astype(np.float64), faces.astype(np.int64), np.full(len(faces), owner, np.int64))
