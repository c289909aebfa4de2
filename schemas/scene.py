"""The serialized form of a scene, the same for all source families. In memory, a scene is held as arrays
(``condvln.scene``).
"""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from schemas.base import Document, Finite, Vec3, VersionedDocument

__all__ = [
    "Box",
    "MeshPart",
    "NavmeshChoice",
    "ObjectRecord",
    "OrientedBox",
    "RoomRecord",
    "SceneRecord",
    "SceneWarning",
]

Geometry = Literal["mesh", "obb", "aabb", "size", "radius", "none"]


class Box(Document):
    """Axis-aligned box in metres, Habitat frame."""

    min: Vec3
    max: Vec3


class OrientedBox(Document):
    """Oriented box: centre, half extents along its own axes, rotation as quaternion ``[x, y, z, w]``."""

    center: Vec3
    half_extents: Vec3
    rotation: tuple[Finite, Finite, Finite, Finite]


class MeshPart(Document):
    """A mesh file of an object, and the row-major 4×4 transform from the file's frame to the scene's."""

    path: str = Field(description="path relative to the dataset root, '/'-separated")
    transform: Annotated[tuple[Finite, ...], Field(min_length=16, max_length=16)]


class ObjectRecord(Document):
    """One object; unknown geometry is null."""

    object_id: str
    room_id: str
    raw_label: str
    label: str = Field(description="canonical label")
    center: Vec3
    aabb: Box | None = None
    obb: OrientedBox | None = None
    size: Vec3 | None = None
    radius: Finite | None = None
    geometry: Geometry = "none"
    mesh: tuple[MeshPart, ...] = ()
    static: bool = True
    parts: tuple[OrientedBox, ...] = Field(
        (), description="boxes that make up the object, where one box does not fit its shape"
    )
    receptacles: tuple[str, ...] | None = Field(
        None, description="ids of the objects that this one is in or on, according to the source"
    )
    openness: Finite | None = Field(None, description="how far the object is open, 0 to 1, according to the source")
    parent: str | None = Field(None, description="id of the object that contains this one")
    support: str | None = Field(None, description="id of the object that this one rests on")
    hidden: bool = Field(False, description="whether a container around the object is closed")


class RoomRecord(Document):
    """One room, or the whole scene where its source knows no rooms."""

    room_id: str
    raw_label: str
    label: str
    level: int = 0
    floor_y: Finite
    ceiling_y: Finite
    polygon: tuple[tuple[Finite, Finite], ...] | None = Field(None, description="(x, z) corners, implicitly closed")
    annotation: Literal["dataset", "user", "scene"] = Field(
        description="who outlined the room; 'scene' = the whole scene is one room"
    )
    complete: bool = Field(description="whether the room is annotated completely enough to say what is absent")
    asked: bool = Field(
        True,
        description="whether conditions may be asked about this room; if the room is not complete, only about "
        "things that are there",
    )


class NavmeshChoice(Document):
    """The navmesh on which episodes of this scene are placed."""

    path: str
    sha256: str
    built: bool
    fits: bool = Field(description="whether the navmesh's settings match the configured agent")
    agent_radius: Finite
    agent_height: Finite
    agent_max_climb: Finite
    agent_max_slope: Finite


class SceneWarning(Document):
    """Something in the source that was missing or odd, and how it was handled."""

    code: str
    where: str
    message: str


class SceneRecord(VersionedDocument):
    """A whole scene."""

    family: str
    scene_id: str
    rooms: tuple[RoomRecord, ...]
    objects: tuple[ObjectRecord, ...]
    navmesh: NavmeshChoice | None = None
    stage: tuple[MeshPart, ...] = ()
    warnings: tuple[SceneWarning, ...] = ()
