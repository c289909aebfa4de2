"""Read a ProcTHOR house from its JSON: rooms, walls, doors, windows, objects; schema 1.0.0 and 0.0.1.

All coordinates are converted to Habitat's frame (Unity's z is mirrored); the file's are left-handed with +Z forward.
Sources of the conventions: ``ProceduralTools.cs`` of AI2-THOR (walls' first two points, wall-local openings, positions
as box centres) and ``upgrade_house_version.py`` of ProcTHOR (the older schema).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, Literal

import numpy as np
from numpy.typing import NDArray

from condvln.formats.json_document import JsonNode
from condvln.scene.frames import unity_point, unity_rotation

__all__ = ["House", "HouseObject", "HouseRoom", "HouseWall", "Opening", "read_house"]

F64 = NDArray[np.float64]

EXTERIOR: Final = "wall|exterior"
DOORFRAME: Final = "Doorframe"
MAX_ANGLE: Final = 1e6
MIN_WALL: Final = 1e-6
SCHEMAS: Final = ("0.0.1", "1.0.0")


@dataclass(frozen=True, eq=False, slots=True)
class HouseRoom:
    """A room: its id, the generator's room type, and its floor corners (n, 2) as (x, z) in metres."""

    room_id: str
    room_type: str
    polygon: F64
    node: JsonNode


@dataclass(frozen=True, eq=False, slots=True)
class HouseWall:
    """One face of a wall, as seen from the room that the face belongs to. It extends from `start` to `end`, both (2,)
    as (x, z), and in height from `bottom` to `top`; metres.

    exterior : it is the outer face (its room is then the one behind it)
    empty : it was removed, and the rooms on both sides form one space
    """

    wall_id: str
    room_id: str
    start: F64
    end: F64
    bottom: float
    top: float
    exterior: bool
    empty: bool


@dataclass(frozen=True, eq=False, slots=True)
class Opening:
    """A door or window in a wall. It extends from `start` to `end`, both (2,) as (x, z), and in height from `bottom` to
    `top`; metres.

    passable : a door frame without a leaf, or an open door
    """

    opening_id: str
    kind: Literal["door", "window"]
    rooms: tuple[str, str]
    wall_id: str
    start: F64
    end: F64
    bottom: float
    top: float
    passable: bool

    @property
    def exterior(self) -> bool:
        """Whether this opening leads out of the house."""
        return self.rooms[0] == self.rooms[1]


@dataclass(frozen=True, eq=False, slots=True)
class HouseObject:
    """An object: centre of its box (3,) in metres, rotation (3, 3), and the object it stands on or in, if any.

    openness : how far it is open, 0 to 1; None if the house does not say
    """

    object_id: str
    asset_id: str
    object_type: str | None
    parent_id: str | None
    position: F64
    rotation: F64
    kinematic: bool
    openness: float | None = None


@dataclass(frozen=True, eq=False, slots=True)
class House:
    """A whole house: its rooms, walls, openings and objects, each in file order. `warnings` : the generator's own
    warnings, by name.
    """

    rooms: tuple[HouseRoom, ...]
    walls: tuple[HouseWall, ...]
    openings: tuple[Opening, ...]
    objects: tuple[HouseObject, ...]
    warnings: tuple[tuple[str, str], ...]

    def passages(self) -> set[tuple[str, str]]:
        """Return all pairs of rooms that are connected by a passable door or a removed wall."""
        pairs = [o.rooms for o in self.openings if o.kind == "door" and o.passable and not o.exterior]
        sides: dict[str, list[str]] = {}
        for wall in self.walls:
            if wall.empty:
                sides.setdefault(wall.wall_id.split("|", 2)[-1], []).append(wall.room_id)
        pairs += [(a, b) for rooms in sides.values() for a in rooms for b in rooms if a != b]
        return {(min(pair), max(pair)) for pair in pairs}


def read_house(node: JsonNode) -> House:
    """Read a house from its JSON.

    Raises
    ------
    FormatError : a type is wrong, a key is missing, an id is repeated, or a door is in an unknown wall
    """
    metadata = node.get("metadata")
    schema = None if metadata is None else metadata.get("schema")
    if schema is not None and schema.text() not in SCHEMAS:
        schema.fail(f"schema {schema.text()!r} is not supported (only {' and '.join(SCHEMAS)})")
    rooms = tuple(_room(r) for r in node["rooms"].elements())
    walls = tuple(_wall(w) for w in node["walls"].elements())
    _unique(node, "rooms", [r.room_id for r in rooms])
    wall_of = {w.wall_id: w for w in walls}
    openings = [_opening(o, "door", wall_of) for o in node["doors"].elements()]
    openings += [_opening(o, "window", wall_of) for o in node["windows"].elements()]
    objects: list[HouseObject] = []
    for item in node["objects"].elements():
        _collect(item, None, objects)
    _unique(node, "objects", [o.object_id for o in objects])
    warnings = None if metadata is None else metadata.get("warnings")
    said = () if warnings is None else tuple((key, str(value.value)) for key, value in warnings.items())
    return House(rooms, walls, tuple(openings), tuple(objects), said)


def _unique(node: JsonNode, key: str, ids: list[str]) -> None:
    seen: set[str] = set()
    for own in ids:
        if own in seen:
            node[key].fail(f"two of the {key} have the id {own!r}")
        seen.add(own)


def _identifier(node: JsonNode) -> str:
    own = node["id"].text()
    if not own.strip():
        node["id"].fail("the id is empty")
    return own


def _point(node: JsonNode) -> F64:
    """Return the position of a JSON object {x, y, z} in Habitat's frame."""
    return unity_point(node["x"].number(), node["y"].number(), node["z"].number())


def _room(node: JsonNode) -> HouseRoom:
    corners = node["floorPolygon"].elements()
    if len(corners) < 3:
        node["floorPolygon"].fail("a floor has at least three corners")
    polygon = np.array([_point(c)[[0, 2]] for c in corners])
    return HouseRoom(_identifier(node), node["roomType"].text(), polygon, node)


def _wall(node: JsonNode) -> HouseWall:
    corners = [_point(c) for c in node["polygon"].elements()]
    if len(corners) < 2:
        node["polygon"].fail("a wall has at least two corners")
    # The lower two corners, in file order: interior walls list them first, exterior ones last.
    low = sorted(corners, key=lambda c: float(c[1]))[:2]
    empty = node.get("empty")
    own = _identifier(node)
    return HouseWall(
        wall_id=own,
        room_id=node["roomId"].text(),
        start=low[0][[0, 2]],
        end=low[1][[0, 2]],
        bottom=float(low[0][1]),
        top=max(float(c[1]) for c in corners),
        exterior=own.startswith(EXTERIOR),
        empty=empty is not None and empty.boolean(),
    )


def _opening(node: JsonNode, kind: Literal["door", "window"], wall_of: dict[str, HouseWall]) -> Opening:
    wall = wall_of.get(node["wall0"].text())
    if wall is None:
        node["wall0"].fail(f"there is no wall {node['wall0'].text()!r}")
    if "holePolygon" in node:
        corners = node["holePolygon"].elements()
        if len(corners) != 2:
            node["holePolygon"].fail("two corners are expected")
        low, high = corners
    else:
        low, high = node["boundingBox"]["min"], node["boundingBox"]["max"]
    along = wall.end - wall.start
    length = float(np.linalg.norm(along))
    if length < MIN_WALL:
        node["wall0"].fail("the wall has no length")
    along = along / length
    openness, asset = node.get("openness"), node["assetId"].text()
    # The older schema has no openness; its doors between rooms are open.
    is_open = openness is None if openness is None else openness.number() > 0
    return Opening(
        opening_id=_identifier(node),
        kind=kind,
        rooms=(node["room0"].text(), node["room1"].text()),
        wall_id=wall.wall_id,
        start=wall.start + along * low["x"].number(),
        end=wall.start + along * high["x"].number(),
        bottom=wall.bottom + low["y"].number(),
        top=wall.bottom + high["y"].number(),
        passable=kind == "door" and (asset.startswith(DOORFRAME) or is_open),
    )


def _collect(node: JsonNode, parent: str | None, into: list[HouseObject]) -> None:
    """Add an object, and everything on or in it, to the list `into`."""
    own, rotation, kinematic = _identifier(node), node.get("rotation"), node.get("kinematic")
    kind, openness = node.get("objectType"), node.get("openness")
    degrees = [0.0, 0.0, 0.0] if rotation is None else [rotation[c].number(MAX_ANGLE) for c in "xyz"]
    into.append(
        HouseObject(
            object_id=own,
            asset_id=node["assetId"].text(),
            object_type=None if kind is None else kind.text(),
            parent_id=parent,
            position=_point(node["position"]),
            rotation=unity_rotation(degrees),
            kinematic=kinematic is not None and kinematic.boolean(),
            openness=None if openness is None else openness.number(),
        )
    )
    for child in node.array("children"):
        _collect(child, own, into)
