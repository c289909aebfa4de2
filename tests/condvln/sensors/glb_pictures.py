"""GLB files of textured squares, written by hand so that every field of a material is under the test's control."""

from __future__ import annotations

import io
import json
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from condvln.formats.gltf_tree import packed_glb


def encoded(pixels: NDArray[np.uint8], kind: str = "PNG") -> bytes:
    """An image (h, w, 3) as a file."""
    stream = io.BytesIO()
    Image.fromarray(pixels).save(stream, kind, lossless=True) if kind == "WEBP" else Image.fromarray(pixels).save(
        stream, kind
    )
    return stream.getvalue()


def square_glb(
    image: bytes | None = None,
    mime: str = "image/png",
    *,
    slot: Mapping[str, Any] | None = None,
    texture: Mapping[str, Any] | None = None,
    sampler: Mapping[str, Any] | None = None,
    factor: list[float] | None = None,
    colours: NDArray[Any] | None = None,
    places: NDArray[np.float32] | None = None,
    node: Mapping[str, Any] | None = None,
    strip: bool = False,
) -> bytes:
    """A square from (−1, −1, 0) to (1, 1, 0) seen from +Z; the image's upper left corner is at (−1, 1, 0)."""
    points = np.array([[-1, -1, 0], [1, -1, 0], [-1, 1, 0], [1, 1, 0]], np.float32)
    own_places = np.array([[0, 1], [1, 1], [0, 0], [1, 0]], np.float32) if places is None else places
    order = np.array([0, 1, 2, 3] if strip else [0, 1, 2, 2, 1, 3], np.uint16)
    pieces = [points.tobytes(), own_places.tobytes(), order.tobytes()]
    accessors: list[dict[str, Any]] = [
        {"bufferView": 0, "componentType": 5126, "count": 4, "type": "VEC3"},
        {"bufferView": 1, "componentType": 5126, "count": 4, "type": "VEC2"},
        {"bufferView": 2, "componentType": 5123, "count": len(order), "type": "SCALAR"},
    ]
    attributes = {"POSITION": 0, "TEXCOORD_0": 1}
    if colours is not None:
        kinds = {"float32": 5126, "uint8": 5121, "uint16": 5123}
        accessors.append(
            {
                "bufferView": len(pieces),
                "componentType": kinds[colours.dtype.name],
                "count": 4,
                "type": f"VEC{colours.shape[1]}",
                "normalized": colours.dtype.name != "float32",
            }
        )
        attributes["COLOR_0"] = 3
        pieces.append(colours.tobytes())
    shine: dict[str, Any] = {} if factor is None else {"baseColorFactor": factor}
    tree: dict[str, Any] = {"asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": [0]}]}
    if image is not None:
        shine["baseColorTexture"] = {"index": 0, **(slot or {})}
        tree["textures"] = [{"sampler": 0, **(texture or {"source": 0})}]
        tree["samplers"] = [dict(sampler or {})]
        tree["images"] = [{"bufferView": len(pieces), "mimeType": mime}]
        pieces.append(image)
    tree["materials"] = [{"pbrMetallicRoughness": shine}]
    tree["nodes"] = [{"mesh": 0, **(node or {})}]
    primitive = {"attributes": attributes, "indices": 2, "material": 0, "mode": 5 if strip else 4}
    tree["meshes"] = [{"primitives": [primitive]}]
    tree["accessors"] = accessors
    views, binary = [], b""
    for piece in pieces:
        views.append({"buffer": 0, "byteOffset": len(binary), "byteLength": len(piece)})
        binary += piece + b"\0" * (-len(piece) % 4)
    tree["bufferViews"], tree["buffers"] = views, [{"byteLength": len(binary)}]
    text = json.dumps(tree).encode()
    return packed_glb(text, binary)
