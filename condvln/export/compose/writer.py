"""Write one GLB file from many parts. The meshes of each source file are written once; each placement of a part has its
own tree of nodes.

The bytes depend on the calls only, not on time, machine or path.
"""

from __future__ import annotations

import json
import struct
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from condvln.formats.glb import MAX_GLB_BYTES
from condvln.formats.glb_material import shifted
from condvln.formats.glb_part import Accessor, GlbPart, Primitive
from schemas.errors import InputError

__all__ = ["GENERATOR", "GlbWriter", "is_composed"]

GENERATOR: Final = "condvln compose"
_ASSET: Final = {"version": "2.0", "generator": GENERATOR}

_HEADER, _CHUNK = struct.Struct("<4sII"), struct.Struct("<I4s")
_VERTICES, _INDICES = 34962, 34963
_FLOAT, _UINT = 5126, 5125
_TRIANGLES: Final = 4

Tree = dict[str, Any]
F64 = NDArray[np.float64]


def is_composed(start: bytes) -> bool:
    """Return whether a file was written by this module, judged by `start`, the first few hundred bytes of the file or
    more.
    """
    text = start[_HEADER.size + _CHUNK.size :]
    return start[:4] == b"glTF" and text.startswith(json.dumps({"asset": _ASSET}, separators=(",", ":"))[:-1].encode())


class GlbWriter:
    """Builds a scene below one root node.

    Parameters
    ----------
    frame : (4, 4) transform of the root node, from the scene's frame to the file's
    """

    def __init__(self, frame: F64) -> None:
        self._lists: dict[str, list[Tree]] = {
            key: []
            for key in ("nodes", "meshes", "accessors", "bufferViews", "materials", "textures", "samplers", "images")
        }
        self._binary = bytearray()
        self._used: set[str] = set()
        self._required: set[str] = set()
        self._lists["nodes"].append({"name": "scene", "matrix": _columns(frame), "children": []})
        self._triangles = 0

    @property
    def triangles(self) -> int:
        """Number of triangles placed so far."""
        return self._triangles

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
        accessors = [self._accessor(a, _is_index(part, k)) for k, a in enumerate(part.accessors)]
        start = len(self._lists["meshes"])
        for primitives in part.meshes:
            made = [_primitive(p, accessors, first["materials"]) for p in primitives]
            self._lists["meshes"].append({"primitives": made})
        nodes = [n if n.mesh is None else type(n)(n.transform, n.mesh + start, n.children) for n in part.nodes]
        return GlbPart(nodes, part.roots, part.meshes, part.accessors, look)

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
                tree: Tree = dict(node.transform)
                if node.mesh is not None:
                    tree["mesh"] = node.mesh
                    self._triangles += self._triangles_of(node.mesh)
                if node.children:
                    tree["children"] = []
                number[own] = self._node(tree, number[parent[own]] if own in parent else stand)

    def surface(self, name: str, pieces: list[tuple[F64, NDArray[np.int64], tuple[float, float, float]]]) -> None:
        """Add a node called `name` with a mesh of its own. Each of `pieces` has vertices (n, 3), faces (m, 3) and a
        colour.
        """
        primitives = []
        for vertices, faces, colour in pieces:
            points = np.ascontiguousarray(vertices, "<f4")
            at = self._accessor(
                Accessor(_FLOAT, "VEC3", len(points), False, points.tobytes(), *_ends(points)), is_index=False
            )
            corners = np.ascontiguousarray(faces, "<u4").reshape(-1)
            index = self._accessor(Accessor(_UINT, "SCALAR", len(corners), False, corners.tobytes()), is_index=True)
            primitives.append(
                {"attributes": {"POSITION": at}, "indices": index, "material": self._paint(colour), "mode": _TRIANGLES}
            )
        mesh = len(self._lists["meshes"])
        self._lists["meshes"].append({"primitives": primitives})
        self._node({"name": name, "mesh": mesh}, 0)
        self._triangles += self._triangles_of(mesh)

    def to_bytes(self) -> bytes:
        """Return the bytes of the file.

        Raises
        ------
        InputError : the file exceeds the size that `read_glb` accepts
        """
        tree: Tree = {
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
        text += b" " * (-len(text) % 4)
        size = _HEADER.size + 2 * _CHUNK.size + len(text) + len(self._binary)
        if size > MAX_GLB_BYTES:
            raise InputError(
                f"the composed scene takes {size} bytes, but at most {MAX_GLB_BYTES} are read",
                remedy="Leave out what the scene does not need, or shrink its textures",
            )
        return b"".join(
            [
                _HEADER.pack(b"glTF", 2, size),
                _CHUNK.pack(len(text), b"JSON"),
                text,
                _CHUNK.pack(len(self._binary), b"BIN\0"),
                self._binary,
            ]
        )

    def _node(self, tree: Tree, parent: int) -> int:
        number = len(self._lists["nodes"])
        self._lists["nodes"].append(tree)
        self._lists["nodes"][parent]["children"].append(number)
        return number

    def _triangles_of(self, mesh: int) -> int:
        total = 0
        for primitive in self._lists["meshes"][mesh]["primitives"]:
            at = primitive.get("indices", primitive["attributes"]["POSITION"])
            corners = self._lists["accessors"][at]["count"]
            total += corners // 3 if primitive["mode"] == _TRIANGLES else corners - 2
        return total

    def _paint(self, colour: tuple[float, float, float]) -> int:
        material = {
            "pbrMetallicRoughness": {"baseColorFactor": [*colour, 1.0], "metallicFactor": 0.0, "roughnessFactor": 0.9},
            "doubleSided": True,
        }
        if material not in self._lists["materials"]:
            self._lists["materials"].append(material)
        return self._lists["materials"].index(material)

    def _accessor(self, own: Accessor, is_index: bool) -> int:
        tree: Tree = {
            "bufferView": self._view(own.data, _INDICES if is_index else _VERTICES),
            "componentType": own.component,
            "count": own.count,
            "type": own.kind,
        }
        if own.normalized:
            tree["normalized"] = True
        if own.low:
            tree |= {"min": list(own.low), "max": list(own.high)}
        self._lists["accessors"].append(tree)
        return len(self._lists["accessors"]) - 1

    def _view(self, data: bytes, target: int | None) -> int:
        tree: Tree = {"buffer": 0, "byteOffset": len(self._binary), "byteLength": len(data)}
        if target is not None:
            tree["target"] = target
        self._binary += data + b"\0" * (-len(data) % 4)
        self._lists["bufferViews"].append(tree)
        return len(self._lists["bufferViews"]) - 1


def _primitive(own: Primitive, accessors: list[int], materials: int) -> Tree:
    tree: Tree = {"attributes": {name: accessors[at] for name, at in own.attributes.items()}, "mode": own.mode}
    if own.indices is not None:
        tree["indices"] = accessors[own.indices]
    if own.material is not None:
        tree["material"] = own.material + materials
    return tree


def _is_index(part: GlbPart, accessor: int) -> bool:
    return any(p.indices == accessor for primitives in part.meshes for p in primitives)


def _placed_texture(texture: Tree, images: int, samplers: int) -> Tree:
    made = dict(texture)
    if "source" in made:
        made["source"] += images
    if "sampler" in made:
        made["sampler"] += samplers
    if "extensions" in made:
        made["extensions"] = {name: {"source": e["source"] + images} for name, e in made["extensions"].items()}
    return made


def _ends(points: NDArray[np.float32]) -> tuple[tuple[float, ...], tuple[float, ...]]:
    low, high = points.min(axis=0), points.max(axis=0)
    return tuple(float(v) for v in low), tuple(float(v) for v in high)


def _columns(matrix: F64) -> list[float]:
    """Return a (4, 4) matrix in glTF's column-major order."""
    return [float(v) + 0.0 for v in np.asarray(matrix, dtype=np.float64).T.reshape(-1)]
