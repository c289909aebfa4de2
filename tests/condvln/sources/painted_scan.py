"""Small painted scans written by hand: quads with a texture or with colours of their corners, as GLB files."""

from __future__ import annotations

import io
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from condvln.formats.gltf_tree import packed_glb

HEADING = "HM3D Semantic Annotations"
SCAN = "00801-aB3xyZ01234"
NAME = SCAN.partition("-")[2]

Quad = tuple[Sequence[float], Sequence[float], Sequence[float]]
"""A corner and the two edges from it, in the scan's own frame: metres, z up."""


def box(low: Sequence[float], high: Sequence[float]) -> list[Quad]:
    """The six sides of an upright box."""
    (x0, y0, z0), (x, y, z) = low, np.subtract(high, low).tolist()
    sides = [
        ([x0, y0, z0], [x, 0, 0], [0, y, 0]),
        ([x0, y0, z0], [0, y, 0], [0, 0, z]),
        ([x0, y0, z0], [0, 0, z], [x, 0, 0]),
    ]
    far = [([x0, y0, z0 + z], [x, 0, 0], [0, y, 0]), ([x0 + x, y0, z0], [0, y, 0], [0, 0, z])]
    return [*sides, *far, ([x0, y0 + y, z0], [0, 0, z], [x, 0, 0])]


def channels(colour: int) -> list[int]:
    return [colour >> 16, colour >> 8 & 255, colour & 255]


def linear(colour: int) -> list[float]:
    """The colour's share of light by channel, by the inverse of sRGB's curve."""
    shares = [c / 255 for c in channels(colour)]
    return [s / 12.92 if s <= 0.04045 else ((s + 0.055) / 1.055) ** 2.4 for s in shares]


def glb(parts: Sequence[dict[str, Any]]) -> bytes:
    """A GLB file of one primitive for each part: ``quads`` with ``tints`` for each (floats, or bytes), or with a
    ``picture`` that each quad shows whole.
    """
    views: list[bytes] = []
    accessors: list[dict[str, Any]] = []
    root: dict[str, Any] = {
        "asset": {"version": "2.0"},
        "scene": 0,
        "scenes": [{"nodes": []}],
        "nodes": [],
        "meshes": [],
    }
    root |= {"images": [], "textures": [], "materials": []}

    def accessor(rows: Any, kind: str, component: int, **more: Any) -> int:
        views.append(np.ascontiguousarray(rows).tobytes())
        accessors.append(
            {"bufferView": len(views) - 1, "componentType": component, "count": len(rows), "type": kind, **more}
        )
        return len(accessors) - 1

    for part in parts:
        quads = np.array(part["quads"], np.float64)
        at, u, v = quads[:, 0], quads[:, 1], quads[:, 2]
        corners = np.stack([at, at + u, at + u + v, at + v], axis=1).reshape(-1, 3).astype("<f4")
        order = (np.array([0, 1, 2, 0, 2, 3]) + 4 * np.arange(len(quads))[:, None]).reshape(-1, 1).astype("<u4")
        attributes = {
            "POSITION": accessor(corners, "VEC3", 5126, min=corners.min(0).tolist(), max=corners.max(0).tolist())
        }
        primitive: dict[str, Any] = {"attributes": attributes, "indices": accessor(order, "SCALAR", 5125)}
        if "tints" in part:
            tints = np.repeat(np.array(part["tints"]), 4, axis=0)
            plain = tints.dtype.kind == "i"
            tints = np.concatenate([tints, np.full((len(tints), 1), 255 if plain else 1)], axis=1)
            attributes["COLOR_0"] = (
                accessor(tints.astype("u1"), "VEC4", 5121, normalized=True)
                if plain
                else accessor(tints.astype("<f4"), "VEC4", 5126)
            )
        if "picture" in part:
            places = np.tile(np.array([[0, 1], [1, 1], [1, 0], [0, 0]], "<f4"), (len(quads), 1))
            attributes["TEXCOORD_0"] = accessor(places, "VEC2", 5126)
            file = io.BytesIO()
            Image.fromarray(np.asarray(part["picture"], np.uint8)).save(file, "PNG")
            views.append(file.getvalue())
            number = len(root["images"])
            root["images"].append({"bufferView": len(views) - 1, "mimeType": "image/png"})
            root["textures"].append({"source": number})
            root["materials"].append({"pbrMetallicRoughness": {"baseColorTexture": {"index": number}}})
            primitive["material"] = number
        root["meshes"].append({"primitives": [primitive]})
        root["nodes"].append({"mesh": len(root["meshes"]) - 1})
        root["scenes"][0]["nodes"].append(len(root["nodes"]) - 1)
    binary, listed = b"", []
    for view in views:
        listed.append({"buffer": 0, "byteOffset": len(binary), "byteLength": len(view)})
        binary += view + b"\0" * (-len(view) % 4)
    root |= {"bufferViews": listed, "accessors": accessors, "buffers": [{"byteLength": len(binary)}]}
    text = json.dumps({key: value for key, value in root.items() if value}).encode()
    return packed_glb(text, binary)


def write(folder: Path, lines: Sequence[str], parts: Sequence[dict[str, Any]], split: str = "val") -> Path:
    """Write one scan; return its folder."""
    own = folder / split / SCAN
    own.mkdir(parents=True, exist_ok=True)
    (own / f"{NAME}.semantic.txt").write_text("\n".join([HEADING, *lines, ""]), encoding="utf-8")
    (own / f"{NAME}.semantic.glb").write_bytes(glb(parts))
    return own


def votes(folder: Path, proposals: Mapping[int, str]) -> None:
    rows = [f"{SCAN},{region},10,0, {kind}" for region, kind in proposals.items()]
    head = "Scene Name,Region #,Bathroom,Bedroom,Weighted Room Proposal"
    (folder / "Per_Scene_Region_Weighted_Votes.csv").write_text("\n".join([head, *rows, ""]))
