"""Check the JSON of a glTF file against the actual bytes, and reduce it to what trimesh can decode safely.

In the reduced tree every index is in range, every count is covered by bytes, the nodes form a forest, and names are our
own. trimesh (5.2) reads plain and strided accessors, triangles, strips and Draco. What it lacks is written as plain
numbers here: sparse accessors, quantized ones (``KHR_mesh_quantization``), and triangle fans.
"""

from __future__ import annotations

import json
import struct
from collections.abc import Sequence
from dataclasses import dataclass, field
from importlib.util import find_spec
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from condvln.formats.json_document import JsonNode
from schemas.base import Json

__all__ = [
    "ATTRIBUTES",
    "GLB_CHUNK",
    "GLB_HEADER",
    "MAX_TRIANGLES",
    "CheckedNode",
    "CheckedTree",
    "checked_tree",
    "packed_glb",
]

GLB_HEADER: Final = struct.Struct("<4sII")
"""Of a GLB file: its magic bytes, version and length in bytes."""
GLB_CHUNK: Final = struct.Struct("<I4s")
"""Of a chunk of a GLB file: its length in bytes and its kind."""


def packed_glb(text: bytes, binary: bytes) -> bytes:
    """Return a GLB file of its JSON and its binary chunk, whose length must be a multiple of four bytes."""
    text += b" " * (-len(text) % 4)
    size = GLB_HEADER.size + 2 * GLB_CHUNK.size + len(text) + len(binary)
    heads = GLB_HEADER.pack(b"glTF", 2, size), GLB_CHUNK.pack(len(text), b"JSON"), GLB_CHUNK.pack(len(binary), b"BIN\0")
    return b"".join([*heads[:2], text, heads[2], binary])


@dataclass(frozen=True, slots=True)
class CheckedNode:
    """A node: its local glTF transform, and the numbers of its mesh and its children in the checked tree."""

    transform: dict[str, list[float]]
    mesh: int | None
    children: tuple[int, ...]


@dataclass(frozen=True, eq=False, slots=True)
class DracoClaim:
    """What a file says of a primitive that is compressed with Draco: the numbers of its vertices and corners, and the
    box (2, 3) of its positions; None if the file names no box.
    """

    vertices: int
    corners: int
    box: NDArray[np.float64] | None

    def check(self, points: NDArray[np.floating], faces: NDArray[np.integer]) -> None:
        """Raise a ValueError if decoded points (n, 3) and faces (m, 3) are not those of the claim. Draco has no
        checksum, and quantizes positions.
        """
        if (len(points), faces.size) != (self.vertices, self.corners):
            what = f"{len(points)} vertices and {faces.size} corners, not {self.vertices} and {self.corners}"
            raise ValueError(f"the Draco data is damaged: it has {what}")
        if self.box is not None:
            off = np.abs([points.min(axis=0), points.max(axis=0)] - self.box).max()
            if not off <= DRACO_TOLERANCE * max(float(np.ptp(self.box, axis=0).max()), DRACO_TOLERANCE):
                raise ValueError(f"the Draco data is damaged: its positions reach {off:.3g} beyond their stated box")


@dataclass(slots=True)
class CheckedTree:
    """The default scene of a file, checked.

    nodes : parents before their children
    roots : numbers of the nodes without a parent
    meshes : numbers of the primitives of each mesh
    materials : the material of each primitive, as the file states it
    draco : what the file says of each primitive that is compressed with Draco; None for the others
    normalized : attributes of each primitive that are integers to be scaled to [0, 1]
    """

    nodes: list[CheckedNode] = field(default_factory=list)
    roots: tuple[int, ...] = ()
    meshes: list[list[int]] = field(default_factory=list)
    materials: list[JsonNode | None] = field(default_factory=list)
    draco: list[DracoClaim | None] = field(default_factory=list)
    normalized: list[frozenset[str]] = field(default_factory=list)
    _primitives: list[Json] = field(default_factory=list)
    _accessors: list[Json] = field(default_factory=list)
    _views: list[Json] = field(default_factory=list)
    _pieces: list[bytes] = field(default_factory=list)

    def to_glb(self) -> bytes:
        """Return a GLB file of the default scene for a decoder: primitive k is the mesh ``p<k>``; the node n is
        ``node<n>``, with children ``node<n>_<j>`` if its mesh has several primitives. Attributes other than the
        position have an underscore before their name, so that they are returned unchanged.
        """
        nodes: list[Json] = [{"name": f"node{n}", **node.transform} for n, node in enumerate(self.nodes)]
        for n, node in enumerate(self.nodes):
            children = list(node.children)
            primitives = self.meshes[node.mesh] if node.mesh is not None else []
            if len(primitives) == 1:
                nodes[n]["mesh"] = primitives[0]
            else:
                for j, primitive in enumerate(primitives):
                    children.append(len(nodes))
                    nodes.append({"name": f"node{n}_{j}", "mesh": primitive})
            if children:
                nodes[n]["children"] = children
        tree: Json = {
            "asset": {"version": "2.0"},
            "scene": 0,
            "scenes": [{"nodes": list(self.roots)}],
            "nodes": nodes,
            "meshes": [{"name": f"p{k}", "primitives": [own]} for k, own in enumerate(self._primitives)],
            "accessors": self._accessors,
            "bufferViews": self._views,
            "buffers": [{"byteLength": sum(map(len, self._pieces))}],
        }
        return packed_glb(json.dumps(tree).encode(), b"".join(self._pieces))

    def add_view(self, data: bytes | memoryview, stride: int = 0) -> int:
        """Add bytes of the binary chunk, and return the number of their buffer view."""
        start = self._views[-1]["byteOffset"] + len(self._pieces[-1]) if self._views else 0
        self._views.append({"buffer": 0, "byteOffset": start, "byteLength": len(data)})
        if stride:
            self._views[-1]["byteStride"] = stride
        self._pieces.append(bytes(data) + b"\0" * (-len(data) % 4))
        return len(self._views) - 1

    def add_accessor(self, component: int, kind: str, count: int, view: int | None) -> int:
        """Add an accessor, and return its number; without a view it is filled by an extension."""
        own: Json = {"componentType": component, "count": count, "type": kind}
        if view is not None:
            own["bufferView"] = view
        self._accessors.append(own)
        return len(self._accessors) - 1

    def count(self, accessor: int) -> int:
        """Return the number of items of an accessor."""
        return int(self._accessors[accessor]["count"])

    def component(self, accessor: int) -> int:
        """Return glTF's code of an accessor's numbers."""
        return int(self._accessors[accessor]["componentType"])

    def add_primitive(
        self, own: Json, material: JsonNode | None, normalized: frozenset[str], draco: DracoClaim | None
    ) -> int:
        """Add a primitive, and return its number."""
        self._primitives.append(own)
        self.materials.append(material)
        self.normalized.append(normalized)
        self.draco.append(draco)
        return len(self._primitives) - 1


MAX_TRIANGLES: Final = 10_000_000
"""Largest number of triangles of a file, each instance counted; several times the largest scan of Matterport3D."""
MAX_VERTICES: Final = 3 * MAX_TRIANGLES
"""Largest number of vertices of all primitives; each has a copy in memory, even if they share an accessor."""
MAX_NODES: Final = 200_000
MAX_NODE_DEPTH: Final = 64
"""Largest depth of nested nodes. Exporters nest a handful; a decoder walks from each node up to its root."""
MAX_STRIDE: Final = 252
"""Largest stride in bytes; glTF's own limit."""
MAX_OVERLAP: Final = 4
"""Largest ratio of the bytes that all accessors read to the file's bytes; each read is a copy in memory."""
MAX_GROWTH: Final = 100
FREE_BYTES: Final = 1 << 20
"""Numbers that are not stored one by one (Draco, sparse accessors) may take this many bytes, and `MAX_GROWTH` times the
file's bytes. Draco compresses meshes about 20:1.
"""
MAX_SCALE: Final = 1e6
DRACO_TOLERANCE: Final = 0.01
"""Largest distance of the box of decoded positions from the stated one, as a share of its longest side. Draco rounds
positions to a 2,048th of it or less.
"""

ATTRIBUTES: Final = {
    "NORMAL": ("VEC3",),
    "TANGENT": ("VEC4",),
    "TEXCOORD_0": ("VEC2",),
    "TEXCOORD_1": ("VEC2",),
    "COLOR_0": ("VEC3", "VEC4"),
}
"""Vertex attributes that a renderer of static scenes uses, with their allowed types."""

_NUMBERS: Final = {5120: np.int8, 5121: np.uint8, 5122: np.int16, 5123: np.uint16, 5125: np.uint32, 5126: np.float32}
_WIDTHS: Final = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4}
_FLOAT, _UINT = 5126, 5125
_INDEX_TYPES: Final = frozenset({5121, 5123, 5125})
_NORMALIZED: Final = frozenset({5121, 5123})
_SCALED: Final = ("TEXCOORD_0", "TEXCOORD_1", "COLOR_0")
"""Attributes that may be normalized integers without an extension; trimesh returns them as they are stored."""
_TRIANGLES, _STRIP, _FAN = 4, 5, 6
_DRACO: Final = "KHR_draco_mesh_compression"
_QUANTIZED: Final = "KHR_mesh_quantization"
_UNREADABLE: Final = frozenset({"EXT_meshopt_compression", "KHR_meshopt_compression", "EXT_mesh_gpu_instancing"})


def checked_tree(root: JsonNode, buffers: Sequence[bytes | None], attributes: bool = False) -> CheckedTree:
    """Return the default scene of a glTF file, of only the triangles.

    Parameters
    ----------
    root : the file's JSON
    buffers : content of the buffers, in the order of the JSON; None for one that must not be read
    attributes : keep `ATTRIBUTES` beside the positions

    Raises
    ------
    FormatError : an index is out of range, a count is not covered by bytes, nodes form a cycle, or geometry is in an
        extension that can't be read
    """
    return _Checker(root, buffers, attributes).tree()


class _Checker:
    def __init__(self, root: JsonNode, buffers: Sequence[bytes | None], attributes: bool) -> None:
        self.root = root.object()
        self.buffers = [None if buffer is None else memoryview(buffer) for buffer in buffers]
        self.size = sum(len(buffer) for buffer in buffers if buffer is not None)
        self.names = ("POSITION", *ATTRIBUTES) if attributes else ("POSITION",)
        self.overlap = MAX_OVERLAP * (2 if attributes else 1)
        self.lists = {key: root.array(key) for key in ("scenes", "nodes", "meshes", "accessors", "bufferViews")}
        self.found = CheckedTree()
        self.accessor_of: dict[tuple[int, str], int] = {}
        self.mesh_of: dict[int, int | None] = {}
        self.triangles: list[int] = []
        self.triangles_of: list[int] = []
        self.read = self.unstored = self.vertices = 0
        self.required = {node.text() for node in root.array("extensionsRequired")}
        self.used = self.required | {node.text() for node in root.array("extensionsUsed")}

    def tree(self) -> CheckedTree:
        for node in self.root.array("extensionsRequired"):
            if node.text() in _UNREADABLE:
                node.fail(f"geometry under the extension {node.text()} can't be read", "Export it uncompressed")
        self._nodes()
        if not self.found.meshes:
            self.root.fail("the file holds no triangles")
        return self.found

    def _nodes(self) -> None:
        """Add the nodes reached from the default scene, parents first."""
        transforms: list[Json] = []
        meshes: list[int | None] = []
        children: list[list[int]] = []
        roots: list[int] = []
        seen: set[int] = set()
        triangles = 0
        waiting: list[tuple[int, int | None, int]] = [(i, None, 0) for i in self._roots()]
        while waiting:
            index, parent, depth = waiting.pop()
            source = self.lists["nodes"][index]
            if index in seen:
                source.fail("the node has two parents, or is its own ancestor")
            if depth > MAX_NODE_DEPTH or len(transforms) >= MAX_NODES:
                source.fail(f"more than {MAX_NODES} nodes, or nested more than {MAX_NODE_DEPTH} deep")
            seen.add(index)
            own = len(transforms)
            mesh = source.get("mesh")
            at = None if mesh is None else self._mesh(mesh.index(len(self.lists["meshes"])))
            if at is not None:
                triangles += self.triangles_of[at]
                if triangles > MAX_TRIANGLES:
                    source.fail(f"more than {MAX_TRIANGLES} triangles")
            transforms.append(_transform(source))
            meshes.append(at)
            children.append([])
            (roots if parent is None else children[parent]).append(own)
            below = [c.index(len(self.lists["nodes"])) for c in source.array("children")]
            waiting.extend((child, own, depth + 1) for child in reversed(below))
        self.found.nodes = [CheckedNode(t, m, tuple(c)) for t, m, c in zip(transforms, meshes, children, strict=True)]
        self.found.roots = tuple(roots)

    def _roots(self) -> list[int]:
        nodes = self.lists["nodes"]
        if len(nodes) > MAX_NODES:
            self.root.fail(f"more than {MAX_NODES} nodes")
        if self.lists["scenes"]:
            chosen = self.root.get("scene")
            scene = self.lists["scenes"][chosen.index(len(self.lists["scenes"])) if chosen is not None else 0]
            return [n.index(len(nodes)) for n in scene.array("nodes")][::-1]
        children = {c.index(len(nodes)) for node in nodes for c in node.array("children")}
        return [i for i in range(len(nodes)) if i not in children][::-1]

    def _mesh(self, index: int) -> int | None:
        """Return the number of a mesh in the checked tree; None if it has no triangles."""
        if index not in self.mesh_of:
            sources = self.lists["meshes"][index].array("primitives")
            primitives = [p for p in map(self._primitive, sources) if p is not None]
            self.mesh_of[index] = len(self.found.meshes) if primitives else None
            if primitives:
                self.triangles_of.append(sum(self.triangles[p] for p in primitives))
                self.found.meshes.append(primitives)
        return self.mesh_of[index]

    def _primitive(self, source: JsonNode) -> int | None:
        """Return the number of a primitive in the checked tree; None if it has no triangles."""
        extensions = source.get("extensions")
        for name, _ in extensions.items() if extensions is not None else ():
            if name in _UNREADABLE:
                source.fail(f"geometry under the extension {name} can't be read", "Export it uncompressed")
        mode_node, attributes = source.get("mode"), source["attributes"]
        mode = _TRIANGLES if mode_node is None else mode_node.integer()
        if mode not in (_TRIANGLES, _STRIP, _FAN) or attributes.get("POSITION") is None:
            return None
        packed = None if extensions is None else extensions.get(_DRACO)
        if packed is not None and _DRACO not in self.required and self._is_stored(source):
            packed = None  # the file holds the same numbers uncompressed
        own: Json = {"attributes": {}, "mode": mode}
        scaled = set()
        for name in self.names:
            node = attributes.get(name)
            if node is not None:
                at = self._accessor(node, name, stored=packed is None)
                own["attributes"][name if name == "POSITION" else f"_{name}"] = at
                if name in _SCALED and self.found.component(at) != _FLOAT:
                    scaled.add(name)
        vertices = self.found.count(own["attributes"]["POSITION"])
        for name, at in own["attributes"].items():
            if self.found.count(at) != vertices:
                attributes[name.removeprefix("_")].fail(
                    f"the attribute has {self.found.count(at)} entries, but there are {vertices} vertices"
                )
        self.vertices += vertices
        if self.vertices > MAX_VERTICES:
            source.fail(f"more than {MAX_VERTICES} vertices")
        indices = source.get("indices")
        corners = vertices
        if indices is not None:
            own["indices"] = self._accessor(indices, "indices", stored=packed is None)
            corners = self.found.count(own["indices"])
        if mode == _TRIANGLES and corners % 3:
            source.fail(f"{corners} corners are not a multiple of three")
        if corners < 3 or not vertices:
            return None
        claim: DracoClaim | None = None
        if packed is not None:
            if mode != _TRIANGLES or indices is None:
                source.fail(f"{_DRACO} is read for indexed triangles only", "Export it uncompressed")
            own["extensions"] = {_DRACO: self._draco(packed, own["attributes"])}
            claim = DracoClaim(vertices, corners, self._stated_box(attributes["POSITION"]))
        elif mode == _FAN:
            own |= {"mode": _TRIANGLES, "indices": self._fan(indices, vertices)}
        self.triangles.append(corners // 3 if mode == _TRIANGLES else corners - 2)
        material = source.get("material")
        return self.found.add_primitive(own, material, frozenset(scaled), claim)

    def _stated_box(self, node: JsonNode) -> NDArray[np.float64] | None:
        """Return the box (2, 3) that the file names for an accessor; None if it names none."""
        source = self.lists["accessors"][node.integer()]
        ends = [source.get(key) for key in ("min", "max")]
        return None if None in ends else np.array([end.vector(3) for end in ends if end is not None])

    def _is_stored(self, source: JsonNode) -> bool:
        """Return whether all numbers of a primitive are in buffers, not only in its compressed form."""
        nodes = [node for _, node in source["attributes"].items()] + list(filter(None, [source.get("indices")]))
        return all("bufferView" in self.lists["accessors"][n.index(len(self.lists["accessors"]))] for n in nodes)

    def _draco(self, packed: JsonNode, attributes: Json) -> Json:
        if find_spec("DracoPy") is None:
            packed.fail(
                "the geometry is compressed with Draco, and DracoPy is not installed",
                "Install DracoPy, or export it uncompressed",
            )
        named = packed["attributes"].items()
        ids = {f"_{name}" if name in ATTRIBUTES else name: node.integer() for name, node in named}
        data = self._view(packed["bufferView"])[0]
        self.read += len(data)
        return {
            "bufferView": self.found.add_view(data),
            "attributes": {name: number for name, number in ids.items() if name in attributes},
        }

    def _fan(self, indices: JsonNode | None, vertices: int) -> int:
        """Return the number of an accessor with the corners of a fan's triangles."""
        order = np.arange(vertices, dtype=np.uint32)
        if indices is not None:
            source = self.lists["accessors"][indices.integer()]
            order = self._rows(source, source["componentType"].integer(), 1)[:, 0].astype(np.uint32)
        corners = np.column_stack([np.full(len(order) - 2, order[0]), order[1:-1], order[2:]]).astype("<u4")
        return self.found.add_accessor(_UINT, "SCALAR", corners.size, self.found.add_view(corners.tobytes()))

    def _accessor(self, node: JsonNode, name: str, *, stored: bool) -> int:
        """Return the number, in the checked tree, of the accessor to which `node` refers. Each accessor has its own
        buffer view there.

        stored : its numbers are in a buffer, not in compressed form
        """
        index = node.index(len(self.lists["accessors"]))
        if (index, name) in self.accessor_of and stored:
            return self.accessor_of[index, name]
        source = self.lists["accessors"][index]
        kind, component, count = source["type"].text(), source["componentType"].integer(), _count(source["count"])
        flag = source.get("normalized")
        normalized = flag is not None and flag.boolean()
        if not self._is_allowed(name, kind, component, normalized):
            source.fail(f"type {kind} of component {component} is not allowed for {name}")
        item = np.dtype(_NUMBERS[component]).itemsize * _WIDTHS[kind]
        scaled = normalized and name in _SCALED and component in _NORMALIZED
        as_stored = component == _FLOAT or name == "indices" or scaled
        view: int | None
        if not stored:
            self._grow(source, count * item)
            view = None
        elif as_stored and "sparse" not in source:
            view = self.found.add_view(*self._span(source, count, item))
        else:
            rows = self._rows(source, component, _WIDTHS[kind])
            if not as_stored:
                rows, component = _as_floats(rows, normalized), _FLOAT
            view = self.found.add_view(rows.tobytes())
        made = self.found.add_accessor(component, kind, count, view)
        if stored:
            self.accessor_of[index, name] = made
        return made

    def _is_allowed(self, name: str, kind: str, component: int, normalized: bool) -> bool:
        if name == "indices":
            return kind == "SCALAR" and component in _INDEX_TYPES
        if kind not in (("VEC3",) if name == "POSITION" else ATTRIBUTES[name]):
            return False
        if component == _FLOAT or (name in _SCALED and normalized and component in _NORMALIZED):
            return True
        return _QUANTIZED in self.used and component in _NUMBERS and component != _UINT

    def _span(self, source: JsonNode, count: int, item: int) -> tuple[memoryview, int]:
        """Return the bytes of an accessor, from its first item to its last, and the stride (0 if there is none)."""
        data, stride = self._view(source["bufferView"])
        offset, step = _count_or(source, "byteOffset", 0), stride or item
        if count and offset + (count - 1) * step + item > len(data):
            source.fail(f"{count} items of {item} bytes do not fit into the view's {len(data)} bytes")
        span = (count - 1) * step + item if count else 0
        self._count_read(source, span)
        return data[offset : offset + span], stride if count else 0

    def _rows(self, source: JsonNode, component: int, width: int) -> NDArray[Any]:
        """Return the numbers of an accessor (count, width) without gaps, those of a sparse one in their places."""
        dtype, count = np.dtype(_NUMBERS[component]).newbyteorder("<"), _count(source["count"])
        item = dtype.itemsize * width
        if "bufferView" in source:
            data, stride = self._span(source, count, item)
            rows = np.array(np.ndarray((count, width), dtype, data, 0, (stride or item, dtype.itemsize)))
        else:
            self._grow(source, count * item)
            rows = np.zeros((count, width), dtype)
        sparse = source.get("sparse")
        if sparse is not None:
            number, places = _count(sparse["count"]), sparse["indices"]
            kind = places["componentType"].integer()
            if kind not in _INDEX_TYPES:
                places.fail(f"component type {kind} is not allowed for indices")
            at = np.frombuffer(self._packed(places, number, np.dtype(_NUMBERS[kind]).itemsize), _NUMBERS[kind])
            if number and int(at.max()) >= count:
                places.fail(f"the index {int(at.max())} is out of range: there are {count} entries")
            rows[at] = np.frombuffer(self._packed(sparse["values"], number, item), dtype).reshape(number, width)
        return rows

    def _packed(self, node: JsonNode, count: int, item: int) -> memoryview:
        """Return the bytes of `count` items without gaps."""
        data, offset = self._view(node["bufferView"])[0], _count_or(node, "byteOffset", 0)
        if offset + count * item > len(data):
            node.fail(f"{count} items of {item} bytes do not fit into the view's {len(data)} bytes")
        self._count_read(node, count * item)
        return data[offset : offset + count * item]

    def _view(self, node: JsonNode) -> tuple[memoryview, int]:
        """Return the bytes and the stride (0 if there is none) of the buffer view to which `node` refers."""
        view = self.lists["bufferViews"][node.index(len(self.lists["bufferViews"]))]
        data = self.buffers[view["buffer"].index(len(self.buffers))]
        if data is None:
            view["buffer"].fail(
                "geometry outside the file's own binary chunk can't be read", "Export it as one GLB file"
            )
        start, length = _count_or(view, "byteOffset", 0), _count(view["byteLength"])
        stride = _count_or(view, "byteStride", 0)
        if stride and not 4 <= stride <= MAX_STRIDE:
            view.fail(f"the stride must be 4 to {MAX_STRIDE} bytes, got {stride}")
        if start + length > len(data):
            view.fail(f"the view claims bytes {start} to {start + length}, but the binary chunk has {len(data)}")
        return data[start : start + length], stride

    def _count_read(self, source: JsonNode, size: int) -> None:
        self.read += size
        if self.read > self.overlap * self.size:
            source.fail(f"accessors read the same bytes more than {self.overlap} times")

    def _grow(self, source: JsonNode, size: int) -> None:
        self.unstored += size
        limit = FREE_BYTES + MAX_GROWTH * self.size
        if self.unstored > limit:
            source.fail(f"accessors claim more than {limit} bytes that are not stored as such")


def _as_floats(rows: NDArray[Any], normalized: bool) -> NDArray[np.float32]:
    """Return quantized numbers as floats; normalized ones are scaled to [0, 1] or [−1, 1]."""
    if not normalized:
        return rows.astype("<f4")
    return np.maximum(rows / np.iinfo(rows.dtype).max, -1.0).astype("<f4")


def _transform(node: JsonNode) -> Json:
    """Check the numbers of a node's own transform and return it."""
    if "matrix" in node:
        return {"matrix": node["matrix"].vector(16, MAX_SCALE).tolist()}
    kept: Json = {}
    for key, length in (("translation", 3), ("rotation", 4), ("scale", 3)):
        if key in node:
            kept[key] = node[key].vector(length, MAX_SCALE).tolist()
    if "rotation" in kept and not sum(q * q for q in kept["rotation"]) > 0.5:
        node["rotation"].fail("the quaternion is not a rotation")
    return kept


def _count(node: JsonNode) -> int:
    value = node.integer()
    if value < 0:
        node.fail(f"{value} is not a count")
    return value


def _count_or(node: JsonNode, key: str, default: int) -> int:
    return _count(node[key]) if key in node else default
