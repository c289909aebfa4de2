"""Floor plans of iTHOR and RoboTHOR made by hand."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from condvln.sources.registry import open_source
from condvln.sources.scene_source import Source

Document = dict[str, Any]


def xyz(x: float, y: float, z: float) -> dict[str, float]:
    return {"x": x, "y": y, "z": z}


def thing(
    name: str, kind: str, centre: tuple[float, float, float], size: tuple[float, float, float], **more: Any
) -> Any:
    return {
        "objectId": name,
        "objectType": kind,
        "assetId": "",
        "position": xyz(99, 99, 99),
        "rotation": xyz(0, 0, 0),
        "pickupable": False,
        "moveable": False,
        "axisAlignedBoundingBox": {"center": xyz(*centre), "size": xyz(*size), "cornerPoints": []},
        "objectOrientedBoundingBox": None,
        **more,
    }


def corner_points(centre: np.ndarray, edges: np.ndarray) -> list[list[float]]:
    """Eight corners in the simulator's order: x, then z, round the bottom, then the same on top."""
    signs = [(-1, -1, -1), (1, -1, -1), (1, -1, 1), (-1, -1, 1), (-1, 1, -1), (1, 1, -1), (1, 1, 1), (-1, 1, 1)]
    return [(centre + np.array(s) @ edges / 2).tolist() for s in signs]


def plan(name: str = "FloorPlan207") -> Document:
    return {
        "sceneName": name,
        "objects": [
            thing("Floor|+00.00", "Floor", (1, -0.1, 2), (4, 0.2, 6)),
            thing("Sofa|+01.00", "Sofa", (1, 0.4, 3), (2, 0.8, 1), moveable=True, assetId="Sofa_1"),
            thing("Window|+01.00", "Window", (1, 1.5, 5), (1, 1, 0.1)),
        ],
    }


def apartment(name: str) -> Document:
    """RoboTHOR's form: panels as objects, one of them aslant."""
    aslant = corner_points(np.array([1.0, 1.0, 2.0]), np.array([[1.4, 0, 1.4], [0, 2, 0], [-0.05, 0, 0.05]]))
    box = {"objectOrientedBoundingBox": {"cornerPoints": aslant}}
    walls = [
        thing("Wall|+00.00", "Wall", (1, 1, -1), (4, 2, 0.1)),
        thing("Wall|+01.00", "Wall", (1, 1, 2), (1.5, 2, 1.5), **box),
    ]
    return plan(name) | {"objects": [*plan()["objects"], *walls]}


def write(root: Path, document: Document, path: str = "FloorPlan207.json", family: str = "ithor") -> Source:
    (root / path).write_text(json.dumps(document))
    return open_source(family, root)
