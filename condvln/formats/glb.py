"""Read the geometry of untrusted binary glTF files.

The container and its JSON are checked against the actual bytes before trimesh decodes them, so that a false size in a
header can't cause a large allocation. Materials and textures are never decoded.
"""

from __future__ import annotations

import io
import json
import struct
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from numpy.typing import NDArray

from condvln.formats.distinct_points import distinct_points
from condvln.formats.gltf_tree import geometry_tree
from condvln.formats.json_document import MAX_COORDINATE, JsonNode, parse_json
from schemas.errors import DeadlineError, FormatError

if TYPE_CHECKING:  # slow to import, and needed only to decode a file
    import trimesh

__all__ = ["MAX_GLB_BYTES", "GlbGeometry", "glb_chunks", "glb_scene", "read_glb"]

MAX_GLB_BYTES: Final = 1 << 29
"""Size limit in bytes; more than twice the largest scan or asset of the sources."""

_HEADER = struct.Struct("<4sII")
_CHUNK = struct.Struct("<I4s")
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
    FormatError : the file is truncated, inconsistent, malicious, compressed, without triangles, or too large
    """
    scene = glb_scene(data, where)
    try:
        parts = [_part(scene, name) for name in sorted(scene.graph.nodes_geometry)]
    except _NOT_OF_THE_FILE:
        raise
    except Exception as error:  # trimesh lets any exception of its parts through
        raise _undecodable(error, where) from None
    return _joined(parts, where)


def glb_scene(data: bytes, where: str) -> trimesh.Scene:
    """Return the default scene of a GLB file, geometry only, with its vertices and faces unchanged.

    Nodes are named `node0`, `node1`, … depth first, in the order of the file; the primitives of a mesh are children of
    its node, `node0_…`, in their order.

    Raises
    ------
    FormatError : as for `read_glb`
    """
    import trimesh

    root, binary = glb_chunks(data, where)
    tree = geometry_tree(root, len(binary))
    try:
        return trimesh.load_scene(
            io.BytesIO(_packed(tree, binary)), file_type="glb", skip_materials=True, process=False
        )
    except _NOT_OF_THE_FILE:
        raise
    except Exception as error:  # trimesh lets any exception of its parts through
        raise _undecodable(error, where) from None


def _undecodable(error: Exception, where: str) -> FormatError:
    return FormatError(f"the geometry can't be decoded ({error!r:.120})", where=where, remedy=_REMEDY)


def _part(scene: trimesh.Scene, node: str) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Return the vertices, in the root frame, and the faces of the mesh of one node."""
    matrix, name = scene.graph[node]
    mesh = scene.geometry[name]
    with np.errstate(invalid="ignore", over="ignore"):  # non-finite vertices are rejected after all parts are collected
        vertices = np.asarray(mesh.vertices, dtype=np.float64) @ matrix[:3, :3].T + matrix[:3, 3]
    faces = np.asarray(mesh.faces, dtype=np.int64)
    if faces.size and not (faces.min() >= 0 and faces.max() < len(vertices)):
        raise IndexError("a face refers to a missing vertex")
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
    first, back = distinct_points(points)
    merged = points[first]
    place = np.zeros(len(vertices), dtype=np.int64)
    place[used] = back
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


def glb_chunks(data: bytes, where: str) -> tuple[JsonNode, bytes]:
    """Return the JSON tree and the binary chunk (empty if there is none) of a GLB file.

    Raises
    ------
    FormatError : the file is not GLB version 2, is truncated, or has invalid JSON
    """

    def fail(what: str, offset: int) -> FormatError:
        return FormatError(what, where=where, place=f"byte {offset}", remedy=_REMEDY)

    if len(data) < _HEADER.size + _CHUNK.size:
        raise fail(f"the file has {len(data)} bytes, but a GLB file has at least {_HEADER.size + _CHUNK.size}", 0)
    magic, version, length = _HEADER.unpack_from(data)
    if magic != b"glTF" or version != 2:
        raise fail("not a GLB file of version 2", 0)
    if length != len(data):
        raise fail(f"the header claims {length} bytes, but the file has {len(data)}", 8)
    chunks: dict[bytes, bytes] = {}
    offset = _HEADER.size
    while offset < len(data):
        if offset + _CHUNK.size > len(data):
            raise fail("the file ends inside a chunk header", offset)
        size, kind = _CHUNK.unpack_from(data, offset)
        offset += _CHUNK.size
        if offset + size > len(data):
            raise fail(f"a chunk claims {size} bytes, but {len(data) - offset} are left", offset)
        if not chunks and kind != b"JSON":
            raise fail("the first chunk is not JSON", offset)
        chunks.setdefault(kind, data[offset : offset + size])
        offset += size
    return parse_json(chunks[b"JSON"], where), chunks.get(b"BIN\0", b"")


def _packed(tree: dict[str, Any], binary: bytes) -> bytes:
    """Return the bytes of a GLB file that has the reduced `tree` and only those bytes of `binary` that the tree's
    buffer views use. Textures are left out.
    """
    views, pieces, size = [], [], 0
    for view in tree["bufferViews"]:
        piece = binary[view["byteOffset"] : view["byteOffset"] + view["byteLength"]]
        views.append({**view, "byteOffset": size})
        pieces.append(piece + b"\0" * (-len(piece) % 4))
        size += len(pieces[-1])
    tree = {**tree, "bufferViews": views, "buffers": [{"byteLength": size}]}
    binary = b"".join(pieces)
    text = json.dumps(tree).encode()
    text += b" " * (-len(text) % 4)
    body = _CHUNK.pack(len(text), b"JSON") + text + _CHUNK.pack(len(binary), b"BIN\0") + binary
    return _HEADER.pack(b"glTF", 2, _HEADER.size + len(body)) + body
