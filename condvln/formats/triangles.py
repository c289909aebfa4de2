"""Triangles of mesh files and trimesh scenes, placed as in Habitat, with all node transforms applied in float32.

Follows ``ResourceManager::joinHierarchy`` of habitat-sim: the nodes of a file are visited depth first, transforms are
multiplied down the tree and applied to float32 positions, and the triangles are concatenated in that order.
"""

from __future__ import annotations

import io
import os
import re
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
import numpy.typing as npt

from condvln.formats.dataset_root import DatasetRoot
from condvln.formats.glb import MAX_GLB_BYTES, check_faces, glb_scene, gltf_scene
from schemas.errors import FormatError, MissingFileError

if TYPE_CHECKING:  # slow to import, and not needed to build from arrays
    import trimesh

Array: TypeAlias = npt.NDArray[Any]

__all__ = ["Z_UP", "MeshSource", "PlacedMesh", "glb_triangles", "mesh_triangles"]

# Converts a z-up file (MP3D, HM3D, Gibson scans) to Habitat's frame: (x, y, z) -> (x, z, -y).
Z_UP: Array = np.array([[1, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 0], [0, 0, 0, 1]], np.float32)

# A deeper scene graph is an error or an attack.
MAX_DEPTH = 512


@dataclass(frozen=True, eq=False)
class PlacedMesh:
    """A mesh (path of a file, trimesh scene or trimesh mesh), and the (4, 4) transform that takes the mesh to the
    Habitat frame of the whole scene, metres.
    """

    mesh: str | os.PathLike[str] | trimesh.Scene | trimesh.Trimesh
    transform: npt.ArrayLike


MeshSource: TypeAlias = "str | os.PathLike[str] | trimesh.Scene | trimesh.Trimesh | PlacedMesh"


def mesh_triangles(sources: Iterable[MeshSource]) -> tuple[Array, Array]:
    """Return vertices (n, 3) float32 and faces (m, 3) int32 of all sources, concatenated.

    Raises
    ------
    MissingFileError
        A file does not exist.
    FormatError
        A file can't be read, or a transform is not a finite (4, 4) matrix.
    """
    import trimesh

    parts: list[tuple[Array, Array]] = []
    for source in sources:
        placed = source if isinstance(source, PlacedMesh) else PlacedMesh(source, np.eye(4))
        root = _matrix(placed.transform, "transform")
        mesh = placed.mesh
        if isinstance(mesh, trimesh.Trimesh):
            parts.append((_placed(mesh.vertices, root), np.asarray(mesh.faces)))
        elif isinstance(mesh, trimesh.Scene):
            parts += _join(mesh, _depth_first(mesh), root)
        else:
            parts += _read(Path(mesh), root)
    return _joined(parts)


def _joined(parts: list[tuple[Array, Array]]) -> tuple[Array, Array]:
    first = np.cumsum([0] + [len(points) for points, _ in parts])
    vertices = np.concatenate([np.zeros((0, 3), np.float32), *(points for points, _ in parts)])
    faces = np.concatenate([np.zeros((0, 3), np.int64), *(f + k for (_, f), k in zip(parts, first[:-1], strict=True))])
    return vertices, faces.astype(np.int32)


def glb_triangles(data: bytes, where: str, transform: npt.ArrayLike) -> tuple[Array, Array]:
    """Return vertices (n, 3) float32 and faces (m, 3) int32 of a GLB file's bytes, as :func:`mesh_triangles` does.

    Raises
    ------
    FormatError
        As for `condvln.formats.glb.glb_scene`; `where` names the file.
    """
    return _joined(_parts_of_glb(data, where, _matrix(transform, "transform")))


def _parts_of_glb(data: bytes, where: str, root: Array) -> list[tuple[Array, Array]]:
    return _in_file_order(glb_scene(data, where), root)


def _in_file_order(scene: trimesh.Scene, root: Array) -> list[tuple[Array, Array]]:
    return _join(scene, sorted(scene.graph.nodes_geometry, key=_node_number), root)


def _read(path: Path, root: Array) -> list[tuple[Array, Array]]:
    import trimesh

    if not path.is_file():
        raise MissingFileError("the mesh file does not exist", where=path, remedy="Check the path")
    folder, kind = DatasetRoot(path.resolve().parent), path.suffix.lower().removeprefix(".")
    data = folder.read(path.resolve().name, MAX_GLB_BYTES)
    if kind == "glb":
        return _parts_of_glb(data, str(path), root)
    if kind == "gltf":
        return _in_file_order(gltf_scene(data, str(path), folder), root)
    if kind == "ply":
        _check_ply(data, path)
    try:
        # Without a resolver no other file is opened, and no texture. Unprocessed, because merging vertices or dropping
        # faces would change the navmesh.
        scene = trimesh.load_scene(io.BytesIO(data), file_type=kind, skip_materials=True, process=False)
        for mesh in scene.geometry.values():
            if isinstance(mesh, trimesh.Trimesh):
                check_faces(mesh)
    except Exception as error:  # trimesh lets any exception of its readers through
        what = f"can't be read as a mesh ({type(error).__name__}: {error})"
        raise FormatError(what, where=path, remedy="Give a sound GLB, glTF, OBJ or PLY file") from error
    return _join(scene, _depth_first(scene), root)


def _check_ply(data: bytes, path: Path) -> None:
    """Raise a FormatError if the header of a PLY file claims more elements than the file has bytes."""
    for claimed in re.findall(rb"(?m)^element[ \t]+\S+[ \t]+(\S+)", data[: data.find(b"end_header")]):
        if not claimed.isdigit() or int(claimed) > len(data):
            what = f"the header claims {claimed.decode('latin1'):.40} elements, but the file has {len(data)} bytes"
            raise FormatError(what, where=path, remedy="Write the file again")


def _node_number(name: str) -> tuple[int, int]:
    """Return the depth-first index of a node and the index of its primitive, read from the node's name in a
    ``glb_scene``.
    """
    node, _, primitive = name.removeprefix("node").partition("_")
    return int(node), int(primitive or 0)


def _depth_first(scene: trimesh.Scene) -> list[str]:
    """Return the nodes of a scene graph depth first, children in the order in which they were added."""
    children = scene.graph.transforms.children
    found: list[str] = []
    pending: list[tuple[str, int]] = [(scene.graph.base_frame, 0)]
    while pending:
        node, depth = pending.pop()
        if depth > MAX_DEPTH:
            raise FormatError(
                "the scene graph is nested too deeply or has a cycle", place=node, remedy="Repair the scene"
            )
        found.append(node)
        pending += [(child, depth + 1) for child in reversed(children.get(node, []))]
    return found


def _join(scene: trimesh.Scene, nodes: Iterable[str], root: Array) -> list[tuple[Array, Array]]:
    """Return the placed vertices and faces of the nodes that have a mesh."""
    import trimesh

    graph = scene.graph.transforms
    world: dict[str, Array] = {scene.graph.base_frame: root}

    def placed_at(node: str) -> Array:
        if node not in world:
            parent = graph.parents[node]
            local = _matrix(graph.edge_data[parent, node].get("matrix", np.eye(4)), f"node {node}")
            world[node] = _product(placed_at(parent), local)
        return world[node]

    parts: list[tuple[Array, Array]] = []
    for node in nodes:
        geometry = scene.geometry.get(graph.node_data.get(node, {}).get("geometry"))
        if isinstance(geometry, trimesh.Trimesh):
            parts.append((_placed(geometry.vertices, placed_at(node)), np.asarray(geometry.faces)))
    return parts


def _matrix(values: npt.ArrayLike, place: str) -> Array:
    with np.errstate(over="ignore"):
        matrix = np.asarray(values, np.float32)
    if matrix.shape != (4, 4) or not np.isfinite(matrix).all():
        raise FormatError("the transform is not a finite (4, 4) matrix", place=place, remedy="Repair the file")
    return matrix


def _product(a: Array, b: Array) -> Array:
    """Return the float32 matrix product, summed in Magnum's order. numpy's product may use wider or fused steps."""
    product: Array = ((a[:, :1] * b[:1] + a[:, 1:2] * b[1:2]) + a[:, 2:3] * b[2:3]) + a[:, 3:] * b[3:]
    return product


def _placed(points: npt.ArrayLike, transform: Array) -> Array:
    p = np.asarray(points, np.float32)
    t = transform
    return ((p[:, :1] * t[:3, 0] + p[:, 1:2] * t[:3, 1]) + p[:, 2:3] * t[:3, 2]) + t[:3, 3]
