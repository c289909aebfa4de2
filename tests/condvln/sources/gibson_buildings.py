"""Buildings made by hand, in both of the formats that Gibson has them in."""

from __future__ import annotations

import io
import json
from pathlib import Path
from typing import Any

import numpy as np

from condvln.sources.registry import open_source
from condvln.sources.scene_source import Source

Document = dict[str, Any]


def building() -> Document:
    """Two storeys of one room each and an object in each, another without a room; z is up."""
    return {
        "objects": [
            {"id": 1, "class_": "bed", "location": [1, 2, 0.5], "size": [2, 1.5, 1], "parent_room": 1,
             "material": ["fabric", None], "floor_area": 7.0, "tactile_texture": None},
            {"id": 2, "class_": "dining table", "location": [1, 2, 3.5], "size": [1, 1, 1], "parent_room": 2},
            {"id": 3, "class_": "vase", "location": [0.5, 2.5, 3.6], "size": [0.2, 0.2, 0.4], "parent_room": None},
        ],
        "rooms": [
            {"id": 1, "scene_category": "bedroom", "location": [1, 2, 1.25], "size": [4, 6, 2.5], "floor_number": "A"},
            {"id": 2, "scene_category": "dining_room", "location": [1, 2, 4.25], "size": [4, 6, 2.5],
             "floor_number": "B"},
        ],
    }  # fmt: skip


def as_npz(document: Document) -> bytes:
    """The same building as 3DSceneGraph has it: one dictionary of dictionaries, arrays for vectors."""

    def entry(fields: Document) -> Document:
        return {k: np.array(v) if k in ("location", "size") else v for k, v in fields.items()}

    graph = {
        "building": {"id": 67, "name": "Made", "voxel_centers": np.zeros((50, 3))},
        "object": {e["id"]: entry(e) for e in document["objects"]},
        "room": {e["id"]: entry(e) for e in document["rooms"]},
        "camera": {},
        "panorama": None,
    }
    buffer = io.BytesIO()
    np.savez_compressed(buffer, output=np.array(graph, dtype=object))
    return buffer.getvalue()


def write(root: Path, document: Document, path: str = "verified/Made.scn") -> Source:
    file = root / path
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_bytes(json.dumps(document).encode() if path.endswith(".scn") else as_npz(document))
    return open_source("gibson", root)
