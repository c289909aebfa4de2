"""Read the geometry of untrusted glTF files with trimesh.

The container and its JSON are checked against the actual bytes before trimesh decodes them, so that a false size in a
header can't cause a large allocation. Materials and textures are never decoded.
"""

from __future__ import annotations

import base64
import io
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final
from urllib.parse import unquote

import numpy as np
from numpy.typing import NDArray

from condvln.formats.dataset_root import DatasetRoot
from condvln.formats.gltf_tree import GLB_CHUNK, GLB_HEADER, CheckedTree, checked_tree
from condvln.formats.json_document import MAX_COORDINATE, JsonNode, parse_json
from schemas.errors import DeadlineError, FormatError

if TYPE_CHECKING:  # slow to import, and needed only to decode a file
    import trimesh

__all__ = [
    "MAX_GLB_BYTES",
    "GlbGeometry",
    "check_faces",
    "decoded",
    "glb_chunks",
    "glb_scene",
    "gltf_scene",
    "own_buffers",
    "read_glb",
]

MAX_GLB_BYTES: Final = 1 << 29
"""Size limit in bytes; more than twice the largest scan or asset of the sources."""

_REMEDY = "Take the file from its dataset again"
_NOT_OF_THE_FILE = (MemoryError, DeadlineError)
"""Exceptions that may occur in any library and are no evidence against the file."""


@dataclass(frozen=True, eq=False, slots=True)
class GlbGeometry:
    """All triangles of a file in its root frame, with node transforms applied in double precision.

    vertices : (n, 3) metres, equal ones merged
    faces : (m, 3), counter-clockwise seen from outside
    watertight : each edge belongs to two faces that traverse it in opposite directions
    """

    vertices: NDArray[np.float64]
    faces: NDArray[np.int32]
    watertight: bool


def read_glb(data: bytes, where: str) -> GlbGeometry:
    """Return the geometry of a GLB file's default scene.

    Raises
    ------
    FormatError : the file is truncated, inconsistent, malicious, in an extension that can't be read, without triangles,
        or too large
    """
    scene = glb_scene(data, where)
    return _joined([_part(scene, name) for name in sorted(scene.graph.nodes_geometry)], where)


def glb_scene(data: bytes, where: str) -> trimesh.Scene:
    """Return the default scene of a GLB file, geometry only, with its vertices and faces unchanged.

    Nodes are named `node0`, `node1`, … depth first, in the order of the file; the primitives of a mesh are children of
    its node, `node0_0`, …, in their order.

    Raises
    ------
    FormatError : as for `read_glb`
    """
    root, binary = glb_chunks(data, where)
    return decoded(checked_tree(root, own_buffers(root, binary)), where)


def gltf_scene(data: bytes, where: str, files: DatasetRoot) -> trimesh.Scene:
    """Return what `glb_scene` does of a ``.gltf`` file, whose buffers are files in or below its folder, or data URIs.

    Raises
    ------
    FormatError : as for `read_glb`, or a buffer is shorter than the file says, or has an address that is not read
    PathEscapeError : a buffer leads out of the folder
    MissingFileError : a buffer is not there
    """
    root = parse_json(data, where)
    buffers: list[bytes | None] = []
    for node in root.array("buffers"):
        uri, length = node["uri"].text(), node["byteLength"].integer()
        if uri.startswith("data:"):
            content = _data_of(node["uri"])
        elif ":" in uri:
            node["uri"].fail("a buffer at an address is not read", "Put the buffer beside the file")
        else:
            path = files.join("", unquote(uri), where=where, place=node["uri"].place)
            content = files.read(path, MAX_GLB_BYTES)
        if not 0 <= length <= len(content):
            node.fail(f"the file claims {length} bytes, but the buffer has {len(content)}")
        buffers.append(content[:length])
    return decoded(checked_tree(root, buffers), where)


def _data_of(uri: JsonNode) -> bytes:
    head, comma, text = uri.text().partition(",")
    if not comma or not head.endswith(";base64"):
        uri.fail("a data URI must be in base64")
    try:
        return base64.b64decode(text, validate=True)
    except ValueError as error:
        uri.fail(f"the data URI can't be decoded ({error})")


def decoded(tree: CheckedTree, where: str) -> trimesh.Scene:
    """Return a checked scene as trimesh decodes it. Its primitive k is the geometry ``p<k>``.

    Raises
    ------
    FormatError : it can't be decoded, or a face refers to a missing vertex
    """
    import trimesh

    try:
        scene = trimesh.load_scene(io.BytesIO(tree.to_glb()), file_type="glb", skip_materials=True, process=False)
        for number, claim in enumerate(tree.draco):
            mesh = scene.geometry[f"p{number}"]
            # trimesh leaves zeros where Draco's decoder fails.
            if claim is not None and not (np.any(mesh.vertices) and np.any(mesh.faces)):
                raise ValueError("the Draco data is damaged")
            if claim is not None:
                claim.check(mesh.vertices, mesh.faces)
            check_faces(mesh)
    except _NOT_OF_THE_FILE:
        raise
    except Exception as error:  # trimesh lets any exception of its parts through
        what = f"the geometry can't be decoded ({error!r:.120})"
        raise FormatError(what, where=where, remedy=_REMEDY) from None
    return scene


def check_faces(mesh: trimesh.Trimesh) -> None:
    """Raise an IndexError if a face refers to a missing vertex, or an attribute has not one entry for each vertex."""
    count, faces = len(mesh.vertices), mesh.faces
    if faces.size and not (faces.min() >= 0 and faces.max() < count):
        raise IndexError(f"a face refers to vertex {int(faces.max())}, but there are {count}")
    for name, rows in mesh.vertex_attributes.items():
        if len(rows) != count:
            raise IndexError(f"the attribute {name} has {len(rows)} entries, but there are {count} vertices")


def _part(scene: trimesh.Scene, node: str) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Return the vertices, in the root frame, and the faces of the mesh of one node."""
    matrix, name = scene.graph[node]
    mesh = scene.geometry[name]
    with np.errstate(invalid="ignore", over="ignore"):  # non-finite vertices are rejected after all parts are collected
        vertices = np.asarray(mesh.vertices, dtype=np.float64) @ matrix[:3, :3].T + matrix[:3, 3]
    faces = np.asarray(mesh.faces, dtype=np.int64)
    # A mirroring transform reverses the winding of triangles.
    return vertices, faces[:, ::-1] if np.linalg.det(matrix[:3, :3]) < 0 else faces


def _joined(parts: list[tuple[NDArray[np.float64], NDArray[np.int64]]], where: str) -> GlbGeometry:
    vertices = np.concatenate([v for v, _ in parts])
    starts = np.cumsum([0, *(len(v) for v, _ in parts[:-1])])
    faces = np.concatenate([f + start for (_, f), start in zip(parts, starts, strict=True)])
    used = np.flatnonzero(np.bincount(faces.reshape(-1), minlength=len(vertices)))
    if not (np.abs(vertices[used]) <= MAX_COORDINATE).all():
        raise FormatError(f"a vertex is NaN, infinite or beyond ±{MAX_COORDINATE:g} m", where=where, remedy=_REMEDY)
    # Vertices are duplicated where normals differ; merging equal ones shows which edges coincide.
    points = vertices[used] + 0.0
    merged, back = np.unique(points, axis=0, return_inverse=True)
    place = np.zeros(len(vertices), dtype=np.int64)
    place[used] = back.reshape(-1)
    faces = place[faces]
    faces = faces[(faces[:, 0] != faces[:, 1]) & (faces[:, 1] != faces[:, 2]) & (faces[:, 2] != faces[:, 0])]
    return GlbGeometry(merged, faces.astype(np.int32), _watertight(faces, len(merged)))


def _watertight(faces: NDArray[np.int64], n: int) -> bool:
    """Return whether a mesh is watertight: each directed edge occurs exactly once, and so does the reverse of each
    edge.
    """
    if not len(faces):
        return False
    start = faces[:, [0, 1, 2]].ravel()
    end = faces[:, [1, 2, 0]].ravel()
    there, back = np.sort(start * n + end), np.sort(end * n + start)
    return bool((there[1:] != there[:-1]).all() and (there == back).all())


def own_buffers(root: JsonNode, binary: bytes) -> list[bytes | None]:
    """Return the content of a GLB file's buffers: its binary chunk, and None for all that are outside the file."""
    buffers = root.array("buffers")
    return [binary if number == 0 and "uri" not in node else None for number, node in enumerate(buffers)]


def glb_chunks(data: bytes, where: str) -> tuple[JsonNode, bytes]:
    """Return the JSON tree and the binary chunk (empty if there is none) of a GLB file. Bytes after the length in the
    header, and NUL after the JSON, are ignored.

    Raises
    ------
    FormatError : the file is not GLB version 2, is truncated, or has invalid JSON
    """

    def fail(what: str, offset: int) -> FormatError:
        return FormatError(what, where=where, place=f"byte {offset}", remedy=_REMEDY)

    if len(data) < GLB_HEADER.size + GLB_CHUNK.size:
        raise fail(f"the file has {len(data)} bytes, but a GLB file has at least {GLB_HEADER.size + GLB_CHUNK.size}", 0)
    magic, version, length = GLB_HEADER.unpack_from(data)
    if magic != b"glTF" or version != 2:
        raise fail("not a GLB file of version 2", 0)
    if length > len(data):
        raise fail(f"the header claims {length} bytes, but the file has {len(data)}", 8)
    chunks: dict[bytes, bytes] = {}
    offset = GLB_HEADER.size
    while offset < length:
        if offset + GLB_CHUNK.size > length:
            raise fail("the file ends inside a chunk header", offset)
        size, kind = GLB_CHUNK.unpack_from(data, offset)
        offset += GLB_CHUNK.size
        if offset + size > length:
            raise fail(f"a chunk claims {size} bytes, but {length - offset} are left", offset)
        if not chunks and kind != b"JSON":
            raise fail("the first chunk is not JSON", offset)
        chunks.setdefault(kind, data[offset : offset + size])
        offset += size
    if b"JSON" not in chunks:
        raise fail("there is no JSON chunk", GLB_HEADER.size)
    return parse_json(chunks[b"JSON"].rstrip(b"\0"), where), chunks.get(b"BIN\0", b"")
