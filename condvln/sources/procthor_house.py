"""Read a ProcTHOR house from its JSON (rooms, walls, doors, windows, objects; schema 1.0.0 and 0.0.1), and the boxes of
its assets from the asset database.

All coordinates are converted to Habitat's frame (Unity's z is mirrored); the file's are left-handed with +Z forward.
Sources of the conventions: ``ProceduralTools.cs`` of AI2-THOR (walls' first two points, wall-local openings, positions
as box centres) and ``upgrade_house_version.py`` of ProcTHOR (the older schema).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, Literal

import numpy as np
from numpy.typing import NDArray

from condvln.arrays import F64
from condvln.formats.dataset_root import DatasetRoot
from condvln.formats.json_document import JsonNode, parse_json
from condvln.scene.rotations import UNITY_TO_HABITAT, unity_rotation
from condvln.sources.source import InputLedger
from schemas.errors import MissingFileError

__all__ = [
    "Asset",
    "AssetDatabase",
    "House",
    "HouseObject",
    "HouseRoom",
    "HouseWall",
    "Opening",
    "read_house",
]


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

    empty : it was removed, and the rooms on both sides form one space
    """

    wall_id: str
    room_id: str
    start: F64
    end: F64
    bottom: float
    top: float
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


def read_house(node: JsonNode) -> House:
    """Read a house from its JSON.

    Raises
    ------
    FormatError : the schema is another one, a type is wrong, a key is missing, an id is repeated, or a door is in an
        unknown wall
    """
    metadata = node.get("metadata")
    schema = None if metadata is None else metadata.get("schema")
    if schema is not None and schema.text() not in SCHEMAS:
        schema.fail(
            f"houses of schema {schema.text()!r} are not read, only those of {' and '.join(SCHEMAS)}",
            "Leave it out under the source's 'exclude'; houses of several floors have this schema",
        )
    rooms = tuple(_room(r) for r in node["rooms"].elements())
    walls = tuple(_wall(w) for w in node["walls"].elements())
    _unique(node, "rooms", [r.room_id for r in rooms])
    wall_of = {w.wall_id: w for w in walls}
    openings = [_opening(o, "door", wall_of) for o in _list(node, "doors")]
    openings += [_opening(o, "window", wall_of) for o in _list(node, "windows")]
    objects: list[HouseObject] = []
    for item in _list(node, "objects"):
        _collect(item, None, objects)
    _unique(node, "objects", [o.object_id for o in objects])
    warnings = None if metadata is None else metadata.get("warnings")
    said = () if warnings is None else tuple((key, str(value.value)) for key, value in warnings.items())
    return House(rooms, walls, tuple(openings), tuple(objects), said)


def _list(node: JsonNode, key: str) -> list[JsonNode]:
    """Return the elements of a required member; none if it is null."""
    return [] if node[key].value is None else node[key].elements()


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
    return np.asarray(UNITY_TO_HABITAT @ np.array([node[c].number() for c in "xyz"]))


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
    return Opening(
        opening_id=_identifier(node),
        kind=kind,
        rooms=_rooms_beside(node),
        wall_id=wall.wall_id,
        start=wall.start + along * low["x"].number(),
        end=wall.start + along * high["x"].number(),
        bottom=wall.bottom + low["y"].number(),
        top=wall.bottom + high["y"].number(),
        passable=kind == "door" and _is_passable(node),
    )


def _rooms_beside(node: JsonNode) -> tuple[str, str]:
    """Return the rooms on both sides of an opening. Outdoors counts as the room itself, whether the file repeats the
    room's id or has null in its place.
    """
    rooms = [side.text() for side in (node.get("room0"), node.get("room1")) if side is not None]
    if not rooms:
        node.fail("it names no room")
    return rooms[0], rooms[-1]


def _is_passable(node: JsonNode) -> bool:
    """Return whether an agent can walk through a door. As in AI2-THOR, a door is shut if the file does not say that it
    is open: in ``openness``, or in ``open`` of older files. A frame has no leaf.
    """
    openness, is_open = node.get("openness"), node.get("open")
    if node["assetId"].text().startswith(DOORFRAME):
        return True
    if openness is not None:
        return openness.number() > 0
    return is_open is not None and is_open.boolean()


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


FILE_NAMES: Final = ("asset-database.json", "databases/asset-database.json")
MAX_DATABASE_BYTES: Final = 256 << 20


@dataclass(frozen=True, eq=False, slots=True)
class Asset:
    """An asset: its object type, and the full size (3,) of its box in metres. `size` is None if the database has no
    box, or one of negative size.
    """

    asset_id: str
    object_type: str
    size: NDArray[np.float64] | None


class AssetDatabase:
    """The assets of the database, by id.

    Raises
    ------
    MissingFileError : the database does not exist
    FormatError : it is malformed
    """

    def __init__(self, root: DatasetRoot) -> None:
        self.path = next((name for name in FILE_NAMES if root.has(name)), FILE_NAMES[0])
        file = root.folder / self.path
        if not root.has(self.path):
            raise MissingFileError(
                "the asset database does not exist",
                where=file,
                remedy="Put ProcTHOR's asset-database.json (allenai/procthor, procthor/databases) beside the houses",
            )
        document = parse_json(root.read(self.path, MAX_DATABASE_BYTES), str(file))
        self._assets: dict[str, Asset] = {}
        for kind, assets in document.items():
            for node in assets.elements():
                own, box = node["assetId"].text(), node.get("boundingBox")
                if own in self._assets:
                    node.fail(f"two assets have the id {own!r}")
                size = None if box is None else np.array([box[c].number() for c in "xyz"])
                if size is not None and not (size >= 0).all():
                    size = None  # the extent of this one asset is unknown
                own_kind = node.get("objectType")
                self._assets[own] = Asset(own, kind if own_kind is None else own_kind.text(), size)

    def asset(self, asset_id: str, ledger: InputLedger) -> Asset | None:
        """Return an asset; None if the database does not have it, as for assets from Objaverse."""
        found = self._assets.get(asset_id)
        said = None if found is None else [found.object_type, None if found.size is None else found.size.tolist()]
        ledger.entry(self.path, asset_id, said)
        return found
