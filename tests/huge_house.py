"""Made ProcTHOR datasets with one room of very many objects."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

__all__ = ["add_huge_house"]

SPACING = 0.8
"""Metres between objects, which stand on a square grid."""


def add_huge_house(root: Path, name: str, objects: int) -> str:
    """Add a house of one square room of `objects` objects to a dataset made by `make_samples`; returns its scene id.

    The objects are the assets of the dataset's own database, one after the other.
    """
    database: dict[str, list[dict[str, Any]]] = json.loads((root / "asset-database.json").read_text())
    assets = [asset for kind, listed in sorted(database.items()) if not kind.startswith("Door") for asset in listed]
    across = math.ceil(math.sqrt(objects))
    side = round(SPACING * (across + 1), 3)
    corners = [(0.0, 0.0), (0.0, side), (side, side), (side, 0.0)]
    house = {
        "metadata": {"schema": "1.0.0", "warnings": {}},
        "rooms": [{"id": "room|2", "roomType": "LivingRoom", "floorPolygon": [_point(x, 0, z) for x, z in corners]}],
        "walls": [_wall(a, b) for a, b in zip(corners, corners[1:] + corners[:1], strict=True)],
        "doors": [],
        "windows": [],
        "objects": [_object(k, across, assets[k % len(assets)]) for k in range(objects)],
    }
    (root / f"{name}.json").write_text(json.dumps(house))
    return name


def _point(x: float, y: float, z: float) -> dict[str, float]:
    return {"x": round(x, 3), "y": round(y, 3), "z": round(z, 3)}


def _wall(a: tuple[float, float], b: tuple[float, float]) -> dict[str, Any]:
    corners = [_point(a[0], 0, a[1]), _point(b[0], 0, b[1]), _point(a[0], 3, a[1]), _point(b[0], 3, b[1])]
    return {"id": f"wall|2|{a[0]}|{a[1]}|{b[0]}|{b[1]}", "roomId": "room|2", "polygon": corners}


def _object(number: int, across: int, asset: dict[str, Any]) -> dict[str, Any]:
    row, column = divmod(number, across)
    return {
        "id": f"{asset['objectType']}|2|{number}",
        "assetId": asset["assetId"],
        "position": _point(SPACING * (column + 1), asset["boundingBox"]["y"] / 2, SPACING * (row + 1)),
        "rotation": _point(0, 90 * (number % 4), 0),
        "kinematic": True,
    }
