"""Read a GLB file as a part of a larger GLB file. Sizes and indices that the file states are checked against the actual
bytes.

`condvln.formats.gltf_tree` first checks the geometry and rejects unreadable files. The attributes and materials
that a renderer of static scenes uses are then copied; skins, animations, cameras and lights are dropped.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from condvln.formats.glb import glb_chunks
from condvln.formats.glb_material import MaterialReader
from condvln.formats.gltf_tree import geometry_tree
from condvln.formats.json_document import JsonNode

__all__ = ["Accessor", "GlbPart", "Node", "Primitive", "read_part"]

_TYPES: Final = {5120: np.int8, 5121: np.uint8, 5122: np.int16, 5123: np.uint16, 5125: np.uint32, 5126: np.float32}
_WIDTHS: Final = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4}
_KINDS: Final = {
    "POSITION": ("VEC3",),
    "NORMAL": ("VEC3",),
    "TANGENT": ("VEC4",),
    "TEXCOORD_0": ("VEC2",),
    "TEXCOORD_1": ("VEC2",),
    "COLOR_0": ("VEC3", "VEC4"),
}
"""Attributes that are copied, in this order, with their allowed types."""
_TRIANGLES, _STRIP = 4, 5
_FLOAT: Final = 5126
_INDEX_TYPES: Final = frozenset({5121, 5123, 5125})
MAX_COPIES: Final = 6
"""Largest ratio of the bytes that all attributes read to the file's bytes."""


@dataclass(frozen=True, slots=True)
class Accessor:
    """The content of one glTF accessor: glTF's codes for the component type and the type (such as ``VEC3``), the count,
    and the bytes without gaps.
    """

    component: int
    kind: str
    count: int
    normalized: bool
    data: bytes
    low: tuple[float, ...] = ()
    high: tuple[float, ...] = ()


@dataclass(frozen=True, slots=True)
class Primitive:
    """Triangles or a triangle strip. All numbers are indices within the part: of the accessor of each attribute, of the
    accessor with the triangles' indices, and of the material.
    """

    mode: int
    attributes: dict[str, int]
    indices: int | None
    material: int | None


@dataclass(frozen=True, slots=True)
class Node:
    """A node: its local glTF transform, and the indices, within the part, of its mesh and its children."""

    transform: dict[str, list[float]]
    mesh: int | None
    children: tuple[int, ...]


@dataclass(slots=True)
class GlbPart:
    """The content copied from one file. `look` has its materials and their textures."""

    nodes: list[Node] = field(default_factory=list)
    roots: tuple[int, ...] = ()
    meshes: list[list[Primitive]] = field(default_factory=list)
    accessors: list[Accessor] = field(default_factory=list)
    look: MaterialReader | None = None


def read_part(data: bytes, where: str) -> GlbPart:
    """Read the default scene of a GLB file.

    Raises
    ------
    FormatError : the file is truncated, inconsistent, malicious, compressed, or without triangles; `where` names it
    """
    root, binary = glb_chunks(data, where)
    tree = geometry_tree(root, len(binary))
    return _Copier(root, binary, tree).part


class _Copier:
    """Copies the default scene, whose nodes and triangles have already been checked."""

    def __init__(self, root: JsonNode, binary: bytes, tree: dict[str, Any]) -> None:
        self.root, self.binary = root, binary
        self.copied = 0
        self.look = MaterialReader(root, binary)
        self.part = GlbPart(look=self.look)
        self.mesh_of: dict[int, int | None] = {}
        self.accessor_of: dict[tuple[int, str], int] = {}
        nodes = self.root.array("nodes")
        roots = self._roots(nodes)
        # Parents come before their children, so no recursion is needed.
        order, at = list(roots), 0
        while at < len(order):
            order += [c.integer() for c in nodes[order[at]].array("children")]
            at += 1
        number = {old: new for new, old in enumerate(order)}
        for old in order:
            own = nodes[old]
            mesh = own.get("mesh")
            self.part.nodes.append(
                Node(
                    _transform(own),
                    None if mesh is None else self._mesh(mesh.integer()),
                    tuple(number[c.integer()] for c in own.array("children")),
                )
            )
        self.part.roots = tuple(number[r] for r in roots)
        assert len(order) == len(tree["nodes"])

    def _roots(self, nodes: list[JsonNode]) -> list[int]:
        scenes = self.root.array("scenes")
        if scenes:
            chosen = self.root.get("scene")
            return [n.integer() for n in scenes[0 if chosen is None else chosen.integer()].array("nodes")]
        below = {c.integer() for node in nodes for c in node.array("children")}
        return [n for n in range(len(nodes)) if n not in below]

    def _mesh(self, index: int) -> int | None:
        if index not in self.mesh_of:
            found = [p for p in map(self._primitive, self.root.array("meshes")[index].array("primitives")) if p]
            self.mesh_of[index] = len(self.part.meshes) if found else None
            if found:
                self.part.meshes.append(found)
        return self.mesh_of[index]

    def _primitive(self, source: JsonNode) -> Primitive | None:
        mode_node, attributes = source.get("mode"), source["attributes"]
        mode = _TRIANGLES if mode_node is None else mode_node.integer()
        position = attributes.get("POSITION")
        if mode not in (_TRIANGLES, _STRIP) or position is None:
            return None
        kept = {name: self._accessor(attributes[name], name) for name in _KINDS if attributes.get(name) is not None}
        vertices = self.part.accessors[kept["POSITION"]].count
        for name, at in kept.items():
            if self.part.accessors[at].count != vertices:
                attributes[name].fail(
                    f"the attribute has {self.part.accessors[at].count} entries, but there are {vertices} vertices"
                )
        indices_node = source.get("indices")
        indices = None if indices_node is None else self._accessor(indices_node, "indices")
        corners = vertices
        if indices is not None and indices_node is not None:
            own = self.part.accessors[indices]
            corners = own.count
            named = np.frombuffer(own.data, np.dtype(_TYPES[own.component]).newbyteorder("<"))
            if corners and int(named.max()) >= vertices:
                indices_node.fail(f"a face refers to vertex {int(named.max())}, but there are {vertices}")
        if corners < 3 or not vertices:
            return None
        material = source.get("material")
        return Primitive(mode, kept, indices, None if material is None else self.look.material(material))

    def _accessor(self, node: JsonNode, name: str) -> int:
        index = node.index(len(self.root.array("accessors")))
        if (index, name) not in self.accessor_of:
            source = self.root.array("accessors")[index]
            kind, component = source["type"].text(), source["componentType"].integer()
            kinds = ("SCALAR",) if name == "indices" else _KINDS[name]
            normal = source.get("normalized")
            normalized = normal is not None and normal.boolean()
            floats = component == _FLOAT
            fits = (
                component in _INDEX_TYPES if name == "indices" else floats or (normalized and component in (5121, 5123))
            )
            if kind not in kinds or not fits or (name in ("POSITION", "NORMAL", "TANGENT") and not floats):
                source.fail(f"type {kind} of component {component} is not allowed for {name}")
            packed = self._packed(source, component, _WIDTHS[kind])
            bounds: tuple[tuple[float, ...], ...] = ((), ())
            if name == "POSITION":
                if not np.isfinite(packed).all():
                    source.fail("a vertex is not finite")
                ends = (packed.min(axis=0), packed.max(axis=0)) if len(packed) else (np.zeros(3), np.zeros(3))
                bounds = tuple(tuple(float(v) for v in end) for end in ends)
            self.accessor_of[index, name] = len(self.part.accessors)
            self.part.accessors.append(
                Accessor(component, kind, len(packed), normalized and not floats, packed.tobytes(), *bounds)
            )
        return self.accessor_of[index, name]

    def _packed(self, source: JsonNode, component: int, width: int) -> NDArray[Any]:
        """Return the numbers of an accessor as an array (count, width), read without the padding between them."""
        if "sparse" in source:
            source.fail("sparse accessors can't be read", "Export it with plain accessors")
        dtype = np.dtype(_TYPES[component]).newbyteorder("<")
        count, view = source["count"].integer(), self._view(source)
        offset = _or(source, "byteOffset", 0)
        item = dtype.itemsize * width
        step = _or(view, "byteStride", 0) or item
        start, length = _or(view, "byteOffset", 0), view["byteLength"].integer()
        sound = min(count, offset, start, length, step) >= 0 and start + length <= len(self.binary)
        if not sound or (count and offset + (count - 1) * step + item > length):
            source.fail(f"{count} items of {item} bytes do not fit into the view")
        self.copied += count * item
        if self.copied > MAX_COPIES * len(self.binary):
            source.fail(f"accessors read the same bytes more than {MAX_COPIES} times")
        rows = np.ndarray((count, width), dtype, self.binary, start + offset, (step, dtype.itemsize))
        return np.ascontiguousarray(rows)

    def _view(self, source: JsonNode) -> JsonNode:
        views = self.root.array("bufferViews")
        view = views[source["bufferView"].index(len(views))]
        if view["buffer"].integer() != 0:
            view.fail("numbers outside the file's own binary chunk can't be read", "Export it as one GLB file")
        return view


def _transform(node: JsonNode) -> dict[str, list[float]]:
    keys = ("matrix",) if "matrix" in node else ("translation", "rotation", "scale")
    lengths = {"matrix": 16, "translation": 3, "rotation": 4, "scale": 3}
    return {key: node[key].vector(lengths[key], 1e6).tolist() for key in keys if key in node}


def _or(node: JsonNode, key: str, default: int) -> int:
    return node[key].integer() if key in node else default
