"""Houses made by hand, as ProcTHOR writes them."""

from __future__ import annotations

import gzip
import json
from pathlib import Path
from typing import Any

from condvln.formats.json_document import parse_json
from condvln.sources.procthor import ProcthorSource
from condvln.sources.procthor_house import House, Opening, read_house
from condvln.sources.registry import open_source

House_ = dict[str, Any]


def xyz(x: float, y: float, z: float) -> dict[str, float]:
    return {"x": x, "y": y, "z": z}


def floor(x0: float, z0: float, x1: float, z1: float) -> list[dict[str, float]]:
    """Corners clockwise in Unity's (x, z), as the generator has them."""
    return [xyz(x0, 0, z0), xyz(x0, 0, z1), xyz(x1, 0, z1), xyz(x1, 0, z0)]


def wall(name: str, room: str, a: tuple[float, float], b: tuple[float, float], *, top_first: bool = False) -> House_:
    low, high = [xyz(a[0], 0, a[1]), xyz(b[0], 0, b[1])], [xyz(a[0], 3, a[1]), xyz(b[0], 3, b[1])]
    return {"id": name, "roomId": room, "polygon": high + low if top_first else low + high}


def house() -> House_:
    """A kitchen (x 0–4) and a bedroom (x 4–8), z 0–3, a doorway between them at z 1–2."""
    return {
        "metadata": {"schema": "1.0.0", "warnings": {}},
        "rooms": [
            {"id": "room|2", "roomType": "Kitchen", "floorPolygon": floor(0, 0, 4, 3)},
            {"id": "room|3", "roomType": "Bedroom", "floorPolygon": floor(4, 0, 8, 3)},
        ],
        "walls": [
            wall("wall|2|4.00|0.00|4.00|3.00", "room|2", (4, 3), (4, 0)),
            wall("wall|3|4.00|0.00|4.00|3.00", "room|3", (4, 0), (4, 3)),
            wall("wall|exterior|0.00|0.00|4.00|0.00", "room|2", (0, 0), (4, 0), top_first=True),
        ],
        "doors": [
            {
                "id": "door|2|3", "room0": "room|2", "room1": "room|3",
                "wall0": "wall|2|4.00|0.00|4.00|3.00", "wall1": "wall|3|4.00|0.00|4.00|3.00",
                "assetId": "Doorway_5", "assetPosition": xyz(1.5, 1, 0),
                "holePolygon": [xyz(0.5, 0, 0), xyz(1.5, 2, 0)], "openable": True, "openness": 1,
            }
        ],
        "windows": [
            {
                "id": "window|2|0", "room0": "room|2", "room1": "room|2",
                "wall0": "wall|exterior|0.00|0.00|4.00|0.00", "wall1": "wall|exterior|0.00|0.00|4.00|0.00",
                "assetId": "Window_1", "assetPosition": xyz(2, 1.5, 0),
                "holePolygon": [xyz(1, 1, 0), xyz(3, 2, 0)],
            }
        ],
        "objects": [
            {
                "id": "2|0", "assetId": "Table_1", "position": xyz(2, 0.4, 1), "rotation": xyz(0, 90, 0),
                "kinematic": True,
                "children": [
                    {"id": "2|0|0", "assetId": "Mug_1", "position": xyz(2, 0.85, 1), "rotation": xyz(0, 0, 0),
                     "kinematic": False}
                ],
            },
            {"id": "3|1", "assetId": "Bat_1", "position": xyz(6, 1, 2), "rotation": xyz(270, 30, 0)},
        ],
    }  # fmt: skip


DATABASE = {
    "DiningTable": [{"assetId": "Table_1", "objectType": "DiningTable", "boundingBox": xyz(1.6, 0.8, 1.0)}],
    "Mug": [{"assetId": "Mug_1", "objectType": "Mug", "boundingBox": xyz(0.1, 0.1, 0.1)}],
    "BaseballBat": [{"assetId": "Bat_1", "objectType": "BaseballBat", "boundingBox": xyz(0.06, 0.8, 0.04)}],
}


def write(root: Path, *houses: House_, name: str = "train.jsonl") -> ProcthorSource:
    data = "\n".join(map(json.dumps, houses)).encode() + b"\n"
    (root / name).write_bytes(gzip.compress(data) if name.endswith(".gz") else data)
    source = open_source("procthor", root)
    assert isinstance(source, ProcthorSource)
    return source


def parsed(document: House_) -> House:
    return read_house(parse_json(json.dumps(document).encode(), "h.json"))


def leads_out(opening: Opening) -> bool:
    """Whether an opening leads out of its house."""
    return opening.rooms[0] == opening.rooms[1]


def passages_of(house: House) -> set[tuple[str, str]]:
    """All pairs of rooms that are connected by a passable door or a removed wall."""
    pairs = [o.rooms for o in house.openings if o.kind == "door" and o.passable and not leads_out(o)]
    sides: dict[str, list[str]] = {}
    for wall in house.walls:
        if wall.empty:
            sides.setdefault(wall.wall_id.split("|", 2)[-1], []).append(wall.room_id)
    pairs += [(a, b) for rooms in sides.values() for a in rooms for b in rooms if a != b]
    return {(min(pair), max(pair)) for pair in pairs}
