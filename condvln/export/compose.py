"""Compose a whole scene into one GLB file, with the navmesh that Habitat would build from it.

Stock loaders (VLN-CE's among them) open a scene as a single file and don't support scene dataset configurations. They
treat a bare ``.glb`` as z-up, against the glTF standard (habitat-sim,
``StageAttributesManager::setDefaultAssetNameBasedAttributes``), and look for the navmesh of the same name beside it. So
the file is z-up, as Matterport3D's are, and the navmesh, in Habitat's frame, is built from exactly this file.

The meshes of each source file are written once; each placement of a part has its own tree of nodes. The bytes depend on
the scene only, not on time, machine or path.
"""

from __future__ import annotations

import hashlib
import json
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from condvln.arrays import F64
from condvln.formats.dataset_root import DatasetRoot
from condvln.formats.glb import MAX_GLB_BYTES
from condvln.formats.glb_part import GlbPart, Primitive, read_part, shifted
from condvln.formats.gltf_tree import GLB_CHUNK, GLB_HEADER, CheckedNode, packed_glb
from condvln.formats.triangles import Z_UP, glb_triangles
from condvln.navigation.navmesh_file import NavMeshFile
from condvln.navigation.recast import build_navmesh
from condvln.navigation.settings import NavMeshSettings
from condvln.scene import MeshPart, Scene
from condvln.scene.boxes import placement
from condvln.scene.rotations import Z_UP_TO_HABITAT
from condvln.scene.scene import FLOOR_COLOUR, STRUCTURE, WALL_COLOUR, SceneGeometry, label_colour
from schemas.base import Json
from schemas.config import AgentConfig
from schemas.errors import InputError

__all__ = ["GENERATOR", "ComposedScene", "GlbWriter", "compose_scene", "is_composed"]


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


GENERATOR: Final = "condvln compose"
_ASSET: Final = {"version": "2.0", "generator": GENERATOR}

_VERTICES, _INDICES = 34962, 34963
_COMPONENTS: Final = {"u1": 5121, "u2": 5123, "u4": 5125, "f4": 5126}
_KINDS: Final = {1: "SCALAR", 2: "VEC2", 3: "VEC3", 4: "VEC4"}
_TRIANGLES: Final = 4


def is_composed(start: bytes) -> bool:
    """Return whether a file was written by this module, judged by `start`, the first few hundred bytes of the file or
    more.
    """
    text = start[GLB_HEADER.size + GLB_CHUNK.size :]
    return start[:4] == b"glTF" and text.startswith(json.dumps({"asset": _ASSET}, separators=(",", ":"))[:-1].encode())


class GlbWriter:
    """Builds a scene below one root node.

    Parameters
    ----------
    frame : (4, 4) transform of the root node, from the scene's frame to the file's
    """

    def __init__(self, frame: F64) -> None:
        self._lists: dict[str, list[Json]] = {
            key: []
            for key in ("nodes", "meshes", "accessors", "bufferViews", "materials", "textures", "samplers", "images")
        }
        self._binary = bytearray()
        self._used: set[str] = set()
        self._required: set[str] = set()
        self._lists["nodes"].append({"name": "scene", "matrix": _columns(frame), "children": []})
        self._accessors: dict[tuple[object, ...], int] = {}
        self.triangles = 0

    def add(self, part: GlbPart) -> GlbPart:
        """Add the meshes of `part` to the scene. Return a copy of `part` that refers to its meshes by their numbers in
        the scene; `place` expects this copy.
        """
        look = part.look
        first = {key: len(self._lists[key]) for key in ("materials", "textures", "samplers", "images")}
        if look is not None:
            self._lists["images"] += [
                {"bufferView": self._view(image.data, None), "mimeType": image.mime} for image in look.images
            ]
            self._lists["samplers"] += look.samplers
            self._lists["textures"] += [_placed_texture(t, first["images"], first["samplers"]) for t in look.textures]
            self._lists["materials"] += [shifted(m, first["textures"]) for m in look.materials]
            self._used |= look.used
            self._required |= look.required
        start = len(self._lists["meshes"])
        for primitives in part.meshes:
            made = [self._primitive(own, first["materials"]) for own in primitives]
            self._lists["meshes"].append({"primitives": made})
        nodes = [n if n.mesh is None else CheckedNode(n.transform, n.mesh + start, n.children) for n in part.nodes]
        return GlbPart(nodes, part.meshes, look)

    def place(self, name: str, instances: list[tuple[GlbPart, F64]]) -> None:
        """Add a node called `name`; below it, add the node tree of each part in `instances` with that part's (4, 4)
        transform.
        """
        body = self._node({"name": name, "children": []}, 0)
        for part, matrix in instances:
            stand = self._node({"matrix": _columns(matrix), "children": []}, body)
            number: dict[int, int] = {}
            parent = {child: own for own, node in enumerate(part.nodes) for child in node.children}
            for own, node in enumerate(part.nodes):  # parents come before their children
                tree: Json = dict(node.transform)
                if node.mesh is not None:
                    tree["mesh"] = node.mesh
                    self.triangles += self._triangles_of(node.mesh)
                if node.children:
                    tree["children"] = []
                number[own] = self._node(tree, number[parent[own]] if own in parent else stand)

    def surface(self, name: str, pieces: list[tuple[F64, NDArray[np.int64], tuple[float, float, float]]]) -> None:
        """Add a node called `name` with a mesh of its own. Each of `pieces` has vertices (n, 3), faces (m, 3) and a
        colour.
        """
        primitives = []
        for vertices, faces, colour in pieces:
            at = self._accessor(np.asarray(vertices, "<f4"), bounded=True)
            index = self._accessor(_indices(faces, len(vertices)), is_index=True)
            primitives.append(
                {"attributes": {"POSITION": at}, "indices": index, "material": self._paint(colour), "mode": _TRIANGLES}
            )
        mesh = len(self._lists["meshes"])
        self._lists["meshes"].append({"primitives": primitives})
        self._node({"name": name, "mesh": mesh}, 0)
        self.triangles += self._triangles_of(mesh)

    def to_bytes(self) -> bytes:
        """Return the bytes of the file.

        Raises
        ------
        InputError : the file exceeds the size that `read_glb` accepts
        """
        tree: Json = {
            "asset": _ASSET,
            "scene": 0,
            "scenes": [{"nodes": [0]}],
            **{key: found for key, found in self._lists.items() if found},
            "buffers": [{"byteLength": len(self._binary)}],
        }
        for key, names in (("extensionsUsed", self._used), ("extensionsRequired", self._required)):
            if names:
                tree[key] = sorted(names)
        text = json.dumps(tree, separators=(",", ":"), allow_nan=False).encode("ascii")
        data = packed_glb(text, bytes(self._binary))
        if len(data) > MAX_GLB_BYTES:
            raise InputError(
                f"the composed scene takes {len(data)} bytes, but at most {MAX_GLB_BYTES} are read",
                remedy="Leave out what the scene does not need, or shrink its textures",
            )
        return data

    def _node(self, tree: Json, parent: int) -> int:
        number = len(self._lists["nodes"])
        self._lists["nodes"].append(tree)
        self._lists["nodes"][parent]["children"].append(number)
        return number

    def _triangles_of(self, mesh: int) -> int:
        primitives = self._lists["meshes"][mesh]["primitives"]
        return sum(int(self._lists["accessors"][own["indices"]]["count"]) // 3 for own in primitives)

    def _paint(self, colour: tuple[float, float, float]) -> int:
        material = {
            "pbrMetallicRoughness": {"baseColorFactor": [*colour, 1.0], "metallicFactor": 0.0, "roughnessFactor": 0.9},
            "doubleSided": True,
        }
        if material not in self._lists["materials"]:
            self._lists["materials"].append(material)
        return self._lists["materials"].index(material)

    def _primitive(self, own: Primitive, materials: int) -> Json:
        attributes = {"POSITION": self._accessor(own.points, bounded=True)}
        for name, rows in own.attributes.items():
            attributes[name] = self._accessor(rows, normalized=name in own.normalized)
        index = self._accessor(_indices(own.faces, len(own.points)), is_index=True)
        tree: Json = {"attributes": attributes, "indices": index, "mode": _TRIANGLES}
        return tree if own.material is None else tree | {"material": own.material + materials}

    def _accessor(
        self, rows: NDArray[Any], *, is_index: bool = False, normalized: bool = False, bounded: bool = False
    ) -> int:
        """Return the number of an accessor with numbers (n, width), or indices (n,). Equal ones are written once, since
        primitives often share their vertices.
        """
        data = np.ascontiguousarray(rows, rows.dtype.newbyteorder("<")).tobytes()
        kind = (rows.dtype.str, rows.shape, is_index, normalized, bounded)
        key = (*kind, hashlib.sha256(data).digest())
        if key not in self._accessors:
            tree: Json = {
                "bufferView": self._view(data, _INDICES if is_index else _VERTICES),
                "componentType": _COMPONENTS[rows.dtype.str[1:]],
                "count": len(rows),
                "type": _KINDS[1 if rows.ndim == 1 else rows.shape[1]],
            }
            if normalized:
                tree["normalized"] = True
            if bounded:
                tree |= {"min": rows.min(axis=0).tolist(), "max": rows.max(axis=0).tolist()}
            self._lists["accessors"].append(tree)
            self._accessors[key] = len(self._lists["accessors"]) - 1
        return self._accessors[key]

    def _view(self, data: bytes, target: int | None) -> int:
        tree: Json = {"buffer": 0, "byteOffset": len(self._binary), "byteLength": len(data)}
        if target is not None:
            tree["target"] = target
        self._binary += data + b"\0" * (-len(data) % 4)
        self._lists["bufferViews"].append(tree)
        return len(self._lists["bufferViews"]) - 1


def _indices(faces: NDArray[np.integer], vertices: int) -> NDArray[np.unsignedinteger]:
    """Return the corners (3 n,) of faces (n, 3), in 16 bits where the number of vertices allows it."""
    return faces.reshape(-1).astype("<u2" if vertices < 1 << 16 else "<u4")


def _placed_texture(texture: Json, images: int, samplers: int) -> Json:
    made = dict(texture)
    if "source" in made:
        made["source"] += images
    if "sampler" in made:
        made["sampler"] += samplers
    if "extensions" in made:
        made["extensions"] = {name: {"source": e["source"] + images} for name, e in made["extensions"].items()}
    return made


def _columns(matrix: F64) -> list[float]:
    """Return a (4, 4) matrix in glTF's column-major order."""
    return [float(v) + 0.0 for v in np.asarray(matrix, dtype=np.float64).T.reshape(-1)]
