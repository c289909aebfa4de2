"""Check the JSON of a glTF file against the actual bytes, and reduce it to its geometry.

The reduced tree (triangles, their accessors, the nodes of the default scene) is safe for a decoder: every index is in
range, every count is covered by bytes, the nodes form a forest, and names are our own.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, Final

from condvln.formats.json_document import JsonNode

__all__ = ["MAX_TRIANGLES", "geometry_tree"]

MAX_TRIANGLES: Final = 10_000_000
"""Largest number of triangles of a file, each instance counted; several times the largest scan of Matterport3D."""
MAX_NODES: Final = 200_000
MAX_NODE_DEPTH: Final = 64
"""Largest depth of nested nodes. Exporters nest a handful; a decoder walks from each node up to its root."""
MAX_STRIDE: Final = 252
"""Largest stride in bytes; glTF's own limit."""
MAX_OVERLAP: Final = 4
"""Largest ratio of the bytes that all accessors read to the file's bytes; each read is a copy in memory."""
MAX_SCALE: Final = 1e6

_COMPONENT_BYTES: Final = {5121: 1, 5123: 2, 5125: 4, 5126: 4}
_FLOAT: Final = 5126
_TRIANGLES, _STRIP, _FAN = 4, 5, 6
_UNREADABLE: Final = frozenset(
    {
        "KHR_draco_mesh_compression",
        "EXT_meshopt_compression",
        "KHR_meshopt_compression",
        "KHR_mesh_quantization",
        "EXT_mesh_gpu_instancing",
    }
)

Tree = dict[str, Any]


def geometry_tree(root: JsonNode, binary_size: int) -> Tree:
    """Return a glTF tree of only the default scene's triangles, over one binary chunk of `binary_size` bytes.

    Raises
    ------
    FormatError : an index is out of range, a count is not covered by bytes, nodes form a cycle, or geometry is in an
        extension
    """
    return _GeometryTree(root, binary_size).tree()


class _GeometryTree:
    def __init__(self, root: JsonNode, binary_size: int) -> None:
        self.root = root.object()
        self.binary_size = binary_size
        self.lists = {key: root.array(key) for key in ("scenes", "nodes", "meshes", "accessors", "bufferViews")}
        self.views: list[Tree] = []
        self.accessors: list[Tree] = []
        self.accessor_of: dict[tuple[int, str], int] = {}
        self.meshes: list[Tree] = []
        self.mesh_of: dict[int, int | None] = {}
        self.triangles_of: dict[int, int] = {}
        self.spanned = 0

    def tree(self) -> Tree:
        for node in self.root.array("extensionsRequired"):
            if node.text() in _UNREADABLE:
                node.fail(f"geometry under the extension {node.text()} can't be read", "Export it uncompressed")
        nodes = self._nodes()
        if not self.meshes:
            self.root.fail("the file holds no triangles")
        return {
            "asset": {"version": "2.0"},
            "scene": 0,
            "scenes": [{"nodes": [i for i, (_, parent) in enumerate(nodes) if parent is None]}],
            "nodes": [node for node, _ in nodes],
            "meshes": self.meshes,
            "accessors": self.accessors,
            "bufferViews": self.views,
            "buffers": [{"byteLength": self.binary_size}],
        }

    def _nodes(self) -> list[tuple[Tree, int | None]]:
        """Return the nodes reached from the default scene, parents first, each with its parent's index."""
        reached: list[tuple[Tree, int | None]] = []
        seen: set[int] = set()
        triangles = 0
        waiting: list[tuple[int, int | None, int]] = [(i, None, 0) for i in self._roots()]
        while waiting:
            index, parent, depth = waiting.pop()
            source = self.lists["nodes"][index]
            if index in seen:
                source.fail("the node has two parents, or is its own ancestor")
            if depth > MAX_NODE_DEPTH or len(reached) >= MAX_NODES:
                source.fail(f"more than {MAX_NODES} nodes, or nested more than {MAX_NODE_DEPTH} deep")
            seen.add(index)
            own = len(reached)
            node: Tree = {"name": f"node{own}", **_transform(source)}
            mesh = source.get("mesh")
            if mesh is not None:
                at = self._mesh(mesh.index(len(self.lists["meshes"])))
                if at is not None:
                    node["mesh"] = at
                    triangles += self.triangles_of[at]
                    if triangles > MAX_TRIANGLES:
                        source.fail(f"more than {MAX_TRIANGLES} triangles")
            if parent is not None:
                reached[parent][0].setdefault("children", []).append(own)
            reached.append((node, parent))
            children = [c.index(len(self.lists["nodes"])) for c in source.array("children")]
            waiting.extend((child, own, depth + 1) for child in reversed(children))
        return reached

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
        """Return the index of a mesh in the reduced tree; None if it has no triangles."""
        if index not in self.mesh_of:
            primitives = [p for source in self.lists["meshes"][index].array("primitives") for p in self._drawn(source)]
            self.mesh_of[index] = len(self.meshes) if primitives else None
            if primitives:
                self.triangles_of[len(self.meshes)] = sum(count for _, count in primitives)
                self.meshes.append({"name": f"mesh{len(self.meshes)}", "primitives": [p for p, _ in primitives]})
        return self.mesh_of[index]

    def _drawn(self, source: JsonNode) -> Iterator[tuple[Tree, int]]:
        """Yield each triangle primitive and its number of triangles."""
        for name, _ in source["extensions"].items() if "extensions" in source else ():
            if name in _UNREADABLE:
                source.fail(f"geometry under the extension {name} can't be read", "Export it uncompressed")
        mode_node = source.get("mode")
        mode = _TRIANGLES if mode_node is None else mode_node.integer()
        if mode == _FAN:
            source.fail("triangle fans can't be read", "Export it as plain triangles")
        position = source["attributes"].get("POSITION")
        if mode not in (_TRIANGLES, _STRIP) or position is None:
            return
        at = self._accessor(position, "VEC3")
        corners = vertices = int(self.accessors[at]["count"])
        primitive: Tree = {"attributes": {"POSITION": at}, "mode": mode}
        indices = source.get("indices")
        if indices is not None:
            primitive["indices"] = self._accessor(indices, "SCALAR")
            corners = int(self.accessors[primitive["indices"]]["count"])
        if mode == _TRIANGLES and corners % 3:
            source.fail(f"{corners} corners are not a multiple of three")
        if corners >= 3 and vertices:
            yield primitive, corners // 3 if mode == _TRIANGLES else corners - 2

    def _accessor(self, node: JsonNode, kind: str) -> int:
        """Return the index, in the reduced tree, of the accessor to which `node` refers. In that tree each accessor has
        its own buffer view.
        """
        index = node.index(len(self.lists["accessors"]))
        if (index, kind) not in self.accessor_of:
            source = self.lists["accessors"][index]
            if "sparse" in source:
                source.fail("sparse accessors can't be read", "Export it with plain accessors")
            component = source["componentType"].integer()
            if source["type"].text() != kind or (component == _FLOAT) != (kind == "VEC3"):
                source.fail(f"type {source['type'].text()} of component {component} is not allowed here")
            if component not in _COMPONENT_BYTES:
                source.fail(f"component type {component} is not allowed here")
            item = _COMPONENT_BYTES[component] * (3 if kind == "VEC3" else 1)
            count = _count(source["count"])
            view = self.lists["bufferViews"][source["bufferView"].index(len(self.lists["bufferViews"]))]
            start, length, stride = self._view(view)
            offset = _count_or(source, "byteOffset", 0)
            step = stride or item
            if count and offset + (count - 1) * step + item > length:
                source.fail(f"{count} items of {item} bytes do not fit into the view's {length} bytes")
            span = (count - 1) * step + item if count else 0
            self.spanned += span
            if self.spanned > MAX_OVERLAP * self.binary_size:
                source.fail(f"accessors read the same bytes more than {MAX_OVERLAP} times")
            own: Tree = {"buffer": 0, "byteOffset": start + offset, "byteLength": span}
            if stride:
                own["byteStride"] = stride
            self.accessor_of[index, kind] = len(self.accessors)
            self.accessors.append(
                {
                    "bufferView": len(self.views),
                    "byteOffset": 0,
                    "componentType": component,
                    "count": count,
                    "type": kind,
                }
            )
            self.views.append(own)
        return self.accessor_of[index, kind]

    def _view(self, view: JsonNode) -> tuple[int, int, int]:
        """Return start, length and stride (0 if none) in bytes of a buffer view in the binary chunk."""
        buffers = self.root.array("buffers")
        buffer = buffers[view["buffer"].index(len(buffers))]
        if view["buffer"].integer() != 0 or "uri" in buffer:
            buffer.fail("geometry outside the file's own binary chunk can't be read", "Export it as one GLB file")
        start, length, stride = (
            _count_or(view, "byteOffset", 0),
            _count(view["byteLength"]),
            _count_or(view, "byteStride", 0),
        )
        if stride and not 4 <= stride <= MAX_STRIDE:
            view.fail(f"the stride must be 4 to {MAX_STRIDE} bytes, got {stride}")
        if start + length > self.binary_size:
            view.fail(f"the view claims bytes {start} to {start + length}, but the binary chunk has {self.binary_size}")
        return start, length, stride


def _transform(node: JsonNode) -> Tree:
    """Check the numbers of a node's own transform and return it."""
    if "matrix" in node:
        return {"matrix": node["matrix"].vector(16, MAX_SCALE).tolist()}
    kept: Tree = {}
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
