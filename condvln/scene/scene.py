"""The Scene in memory: rooms and objects as plain frozen records over numpy arrays, its surfaces, limits and colours.

Frame: Habitat's (metres, +Y up, −Z north). Positions are rounded to 1 mm when a record is made, and all later steps
use the rounded values, so that stored data gives the same results again.
"""

from __future__ import annotations

import hashlib
import re
from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from functools import cached_property, lru_cache
from pathlib import Path
from typing import Final, Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from condvln.arrays import F64
from schemas.config import LimitsConfig
from schemas.errors import LimitError

__all__ = [
    "EVERYTHING_SEEN",
    "FLOOR_COLOUR",
    "MILLIMETRE_DECIMALS",
    "STRUCTURE",
    "WALL_COLOUR",
    "Colour",
    "MeshPart",
    "NavmeshFile",
    "OrientedBox",
    "Room",
    "RoomArrays",
    "Scene",
    "SceneGeometry",
    "SceneObject",
    "SceneWarning",
    "Sightings",
    "check_limits",
    "label_colour",
    "layout_of",
    "round_mm",
]

MILLIMETRE_DECIMALS: Final = 3
"""Decimals kept of a position in metres."""


def round_mm(values: ArrayLike) -> F64:
    """Return positions in metres rounded to 1 mm; −0 becomes 0, so that equal positions have equal bytes."""
    rounded: F64 = np.asarray(
        np.round(np.asarray(values, dtype=np.float64), MILLIMETRE_DECIMALS) + 0.0, dtype=np.float64
    )
    return rounded


class OrientedBox(NamedTuple):
    """An oriented box: center (3,), half_extents (3,) in metres; rotation (3, 3) with the box's axes as columns."""

    center: F64
    half_extents: F64
    rotation: F64


@dataclass(frozen=True, eq=False, slots=True)
class MeshPart:
    """A mesh file, relative to the dataset root, and the (4, 4) transform from its own frame to the scene's."""

    path: str
    transform: F64


@dataclass(frozen=True, slots=True)
class SceneWarning:
    """A warning about something missing or odd in the source: a `code` for the kind of problem, where the problem is,
    and how it was handled.
    """

    code: str
    where: str
    message: str


@dataclass(frozen=True, eq=False, slots=True)
class SceneObject:
    """One object of a scene. Fields that describe its extent are None where they are unknown.

    center (3,); aabb (2, 3) as [min, max]; radius of a bounding sphere; all in metres.
    parts : oriented boxes that make up the object where one box is not its shape (a counter with a corner)
    receptacles : ids of the objects that it is in or on, as its source states; None if the source states none
    openness : how far it is open, 0 to 1, as its source states; 1 for a receptacle that can't be shut; None if unknown
    parent, support, hidden : what contains it, what it rests on, and whether it is inside a shut container; set by
        `condvln.scene.containment.with_containment`
    """

    object_id: str
    room_id: str
    raw_label: str
    label: str
    center: F64
    aabb: F64 | None = None
    obb: OrientedBox | None = None
    radius: float | None = None
    mesh: tuple[MeshPart, ...] = ()
    static: bool = True
    parts: tuple[OrientedBox, ...] = ()
    receptacles: tuple[str, ...] | None = None
    openness: float | None = None
    parent: str | None = None
    support: str | None = None
    hidden: bool = False

    @property
    def box(self) -> F64 | None:
        """The axis-aligned box (2, 3) in metres: `aabb`."""
        return self.aabb

    @property
    def solids(self) -> tuple[OrientedBox, ...]:
        """The boxes that stand for the object: its parts, otherwise its oriented box, otherwise its upright one."""
        if self.parts:
            return self.parts
        if self.obb is not None:
            return (self.obb,)
        if self.aabb is None:
            return ()
        low, high = self.aabb
        return (OrientedBox((low + high) / 2, (high - low) / 2, np.eye(3)),)

    @property
    def size(self) -> F64 | None:
        """The full extents (3,) of the axis-aligned box, in metres."""
        return None if self.aabb is None else round_mm(self.aabb[1] - self.aabb[0])

    @property
    def geometry(self) -> Literal["mesh", "obb", "aabb", "radius", "none"]:
        """The kind of the best known geometry of this object."""
        if self.mesh:
            return "mesh"
        if self.obb is not None:
            return "obb"
        if self.aabb is not None:
            return "aabb"
        return "radius" if self.radius is not None else "none"


@dataclass(frozen=True, eq=False, slots=True)
class Room:
    """One room, or the whole scene if the source has no rooms (`annotation` is then ``scene``).

    polygon : (n, 2) corners (x, z) in metres, implicitly closed
    complete : absence may be claimed in it, except of what its unnamed or hidden objects may be
    asked : text may ask conditions about it; only positive ones if it is not complete
    """

    room_id: str
    raw_label: str
    label: str
    level: int
    floor_y: float
    ceiling_y: float
    polygon: F64 | None
    annotation: Literal["dataset", "user", "scene"]
    complete: bool
    asked: bool = True


@dataclass(frozen=True, slots=True)
class NavmeshFile:
    """The navmesh chosen for a scene: `path` is relative to the dataset root, `fits` tells whether it was built for the
    agent's size.
    """

    path: str
    sha256: str
    built: bool
    fits: bool
    agent_radius: float
    agent_height: float
    agent_max_climb: float
    agent_max_slope: float


@dataclass(frozen=True, eq=False)
class RoomArrays:
    """The objects of one room as arrays, sorted by object id; NaN where unknown.

    centers : (n, 3) metres
    aabb_min, aabb_max : (n, 3) metres
    radius : (n,) metres
    hidden : (n,) inside something shut
    floor_y : height of the room's floor in metres; NaN if unknown
    """

    room_id: str
    object_ids: tuple[str, ...]
    labels: tuple[str, ...]
    centers: F64
    aabb_min: F64
    aabb_max: F64
    radius: F64
    hidden: NDArray[np.bool_]
    objects: tuple[SceneObject, ...] = field(repr=False)
    floor_y: float = float("nan")

    def __len__(self) -> int:
        return len(self.object_ids)

    @classmethod
    def of(cls, room_id: str, objects: Iterable[SceneObject], floor_y: float = float("nan")) -> RoomArrays:
        """Return arrays of `objects`, sorted by id so that the order of pairs does not depend on the file."""
        ordered = tuple(sorted(objects, key=lambda o: o.object_id))
        n = len(ordered)
        unknown = np.full((2, 3), np.nan)
        boxes = np.array([unknown if o.box is None else o.box for o in ordered], dtype=np.float64).reshape(n, 2, 3)
        return cls(
            room_id=room_id,
            object_ids=tuple(o.object_id for o in ordered),
            labels=tuple(o.label for o in ordered),
            centers=np.array([o.center for o in ordered], dtype=np.float64).reshape(n, 3),
            aabb_min=boxes[:, 0],
            aabb_max=boxes[:, 1],
            radius=np.array([np.nan if o.radius is None else o.radius for o in ordered], dtype=np.float64),
            hidden=np.array([o.hidden for o in ordered], dtype=np.bool_),
            objects=ordered,
            floor_y=floor_y,
        )


@dataclass(frozen=True, eq=False)
class Scene:
    """A whole scene in Habitat's frame.

    root : folder of the dataset; all paths of the scene are relative to it
    navmesh : the navmesh that episodes are placed on, once chosen
    shipped_navmeshes : candidate files of the scene's navmesh, in order of preference; they need not exist
    """

    family: str
    scene_id: str
    root: Path
    rooms: tuple[Room, ...]
    objects: tuple[SceneObject, ...]
    navmesh: NavmeshFile | None = None
    shipped_navmeshes: tuple[str, ...] = ()
    stage: tuple[MeshPart, ...] = ()
    warnings: tuple[SceneWarning, ...] = ()

    def __repr__(self) -> str:
        return f"Scene({self.family}/{self.scene_id}: {len(self.rooms)} rooms, {len(self.objects)} objects)"

    @cached_property
    def room_of(self) -> dict[str, Room]:
        """Rooms by id."""
        return {room.room_id: room for room in self.rooms}

    @cached_property
    def object_of(self) -> dict[str, SceneObject]:
        """Objects by id."""
        return {o.object_id: o for o in self.objects}

    @property
    def single_room(self) -> bool:
        """Whether the scene counts as one room, which decides the success distance."""
        return len(self.rooms) == 1

    def arrays(self, room_id: str) -> RoomArrays:
        """Return the objects of one room as arrays."""
        held = (o for o in self.objects if o.room_id == room_id)
        return RoomArrays.of(room_id, held, self.room_of[room_id].floor_y if room_id in self.room_of else float("nan"))


STRUCTURE = -1
"""Owner of a triangle that belongs to no object: floor, wall, door, or a scan that is a single mesh."""


@dataclass(frozen=True, eq=False)
class SceneGeometry:
    """Triangles in Habitat's frame (metres, +Y up).

    vertices : (n, 3)
    faces : (m, 3) indices of vertices, counter-clockwise seen from outside
    owner : (m,) index into the scene's ``objects`` of each face's object, `STRUCTURE` if it has none
    approximate : boxes and generated walls replace surfaces; recorded with all derived results
    """

    vertices: NDArray[np.float64]
    faces: NDArray[np.int64]
    owner: NDArray[np.int64]
    approximate: bool


def check_limits(scene: Scene, limits: LimitsConfig) -> None:
    """Compare a scene's counts with the limits.

    Raises
    ------
    LimitError : a count exceeds its limit; the message names the room, both numbers and the key to change
    """
    _at_most(limits, "objects_per_scene", len(scene.objects), "objects", scene)
    _at_most(limits, "rooms_per_scene", len(scene.rooms), "rooms", scene)
    for room in scene.rooms:
        if room.polygon is not None:
            _at_most(limits, "corners_per_room", len(room.polygon), "corners of its outline", scene, room.room_id)
    counts = Counter(item.room_id for item in scene.objects)
    for room_id, count in sorted(counts.items(), key=lambda entry: (-entry[1], entry[0])):
        _at_most(limits, "objects_per_room", count, "objects", scene, room_id)
    pairs = sum(count * count for count in counts.values())
    _at_most(limits, "pairs_per_scene", pairs, "pairs of objects that share a room", scene)


def _at_most(limits: LimitsConfig, key: str, count: int, what: str, scene: Scene, room_id: str = "") -> None:
    limit: int = getattr(limits, key)
    if count <= limit:
        return
    raise LimitError(
        f"{count} {what}, and limits.{key} is {limit}",
        where=f"{scene.family}/{scene.scene_id}",
        place=f"room {room_id!r}" if room_id else "",
        remedy=f"Raise limits.{key} if this machine has the memory, or exclude the scene",
    )


# ReplicaCAD has 21 variants of each of its layouts (Szot et al. 2021), RoboTHOR five of each apartment (Deitke et al.
# 2020).
_STAGING: Final = re.compile(r"(v\d+_sc\d+)_staging_\d+|(FloorPlan_(?:Train|Val|Test)\d+)_\d+(?:_physics)?")


@lru_cache(maxsize=1024)
def layout_of(scene_id: str) -> str:
    """Return the name of a scene's layout; empty if the scene is not known to be one of several variants."""
    found = _STAGING.fullmatch(scene_id)
    return "" if found is None else found[1] or found[2]


@dataclass(frozen=True, slots=True)
class Sightings:
    """Ids of objects that certainly or perhaps can't be seen from where an agent can stand. All other objects can be
    seen.

    unseen : certainly not visible; they do not make a word ambiguous
    doubtful : perhaps visible; text uses no word that might mean them
    degrees : by id of what is recognised from somewhere, how large it appears there (`SceneView.degrees`)
    """

    unseen: frozenset[str] = frozenset()
    doubtful: frozenset[str] = frozenset()
    degrees: Mapping[str, float] = field(default_factory=dict, hash=False)

    def hidden(self, arrays: RoomArrays) -> NDArray[np.bool_]:
        """Return whether each object of a room can't be seen, (n,) bool. This includes objects in shut containers."""
        return np.asarray(arrays.hidden | np.array([name in self.unseen for name in arrays.object_ids], dtype=bool))

    def in_doubt(self, arrays: RoomArrays) -> NDArray[np.bool_]:
        """Return whether each object of a room is in `doubtful` and not in a shut container, (n,) bool."""
        return np.asarray(~arrays.hidden & np.array([name in self.doubtful for name in arrays.object_ids], dtype=bool))


EVERYTHING_SEEN: Final = Sightings()
"""Every object is visible, except inside shut containers."""


Colour = tuple[float, float, float]
"""Red, green and blue in [0, 1]."""

FLOOR_COLOUR: Final[Colour] = (0.62, 0.55, 0.47)
WALL_COLOUR: Final[Colour] = (0.88, 0.87, 0.84)
PALE: Final = 0.35
"""Least brightness of an object's colour; hue and saturation follow from its label."""


def label_colour(label: str) -> Colour:
    """Return the colour of a label."""
    red, green, blue = (PALE + (1 - PALE) * b / 255 for b in hashlib.sha256(label.encode()).digest()[:3])
    return round(red, 3), round(green, 3), round(blue, 3)
