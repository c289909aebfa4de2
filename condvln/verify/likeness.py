"""Doubts that boxes alone can't settle: two boxes may be one object, an unlabelled object may have a certain label, a
table may pass for a counter, an object may have fallen over; in scans, an object may lie in two rooms, or be a piece of
one that an annotation has cut at the border of two regions.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Container, Iterable, Mapping, Sequence
from typing import Final

import numpy as np
import shapely

from condvln.scene import Room, Scene, SceneObject
from condvln.verify.containment import FROM_SCANS
from condvln.verify.surroundings import Thing, footprint_gap, shared_sides
from condvln.verify.words import Bounds, Words
from schemas.config.constants import (
    BORDER_SHARE,
    COUNTER_HEIGHT,
    COUNTER_LENGTH,
    DOUBLE_CENTRES,
    DOUBLE_FOOTPRINT,
    DOUBLE_GAP,
    FALLEN_DEGREES,
    FALLEN_OFF_FLOOR,
    FALLEN_SUNK,
    LIKE_HEIGHT,
    LIKE_SIZE,
    PART_INSIDE,
    SCREEN_TO_KEYBOARD,
    SEAT_LENGTH,
    SEAT_LONGEST,
    SEAT_RATIO,
    SIDE_TABLE_LENGTH,
    THIN_GAP,
    THIN_SHARE,
    TWIN_HEIGHT,
)

__all__ = [
    "astride_rooms",
    "has_fallen",
    "is_odd_sized",
    "is_part",
    "left_apart",
    "looks_like",
    "may_be_one",
    "may_be_twins",
    "may_be_two",
    "passes_for_a_counter",
    "passes_for_a_side_table",
    "passes_for_another_screen",
]


def may_be_one(one: Thing, other: Thing, family: str) -> bool:
    """Return whether the boxes of two objects in a scan may belong to one object, by position and shape alone. The
    caller compares the labels.
    """
    if family not in FROM_SCANS:
        return False
    if math.dist(one.centre, other.centre) <= 1000.0 * DOUBLE_CENTRES:
        return True
    if one.box is None or other.box is None:
        return False
    smaller = min(math.prod(one.ground_sides()), math.prod(other.ground_sides()))
    x, _, z = shared_sides(one, other)
    air = max(one.box[0][1] - other.box[1][1], other.box[0][1] - one.box[1][1])
    if smaller > 0 and x * z >= DOUBLE_FOOTPRINT * smaller and air <= 1000.0 * DOUBLE_GAP:
        return True
    thin, thick = sorted(min(thing.ground_sides()) for thing in (one, other))
    return 0 < thin <= THIN_SHARE * thick and air < 0 and footprint_gap(one, other) <= 1000.0 * THIN_GAP


def may_be_twins(one: Thing, other: Thing, family: str) -> bool:
    """Return whether two objects of a scan have the same label and about the same height. The smaller may then be as
    large as the other in reality, but scanned only in part.
    """
    if family not in FROM_SCANS or one.label != other.label or one.box is None or other.box is None:
        return False
    low, high = sorted(thing.box[1][1] - thing.box[0][1] for thing in (one, other) if thing.box is not None)
    return high <= TWIN_HEIGHT * low


def may_be_two(seat: Thing, seats: Container[str], family: str) -> bool:
    """Return whether the box of a chair in a scan is long enough for two chairs."""
    if family not in FROM_SCANS or seat.label not in seats or seat.box is None:
        return False
    short, long = sorted(seat.ground_sides())
    if long >= 1000.0 * SEAT_LONGEST:
        return True
    return long >= 1000.0 * SEAT_LENGTH and long >= SEAT_RATIO * short


def passes_for_another_screen(
    screen: Thing, things: Iterable[Thing], screens: Container[str], desktop: Container[str], family: str
) -> bool:
    """Return whether a television of a scan may be a computer monitor: it is taller than wide, or a keyboard or mouse
    is close to it.
    """
    if family not in FROM_SCANS or screen.label not in screens or screen.box is None:
        return False
    if screen.box[1][1] - screen.box[0][1] > max(screen.ground_sides()):
        return True
    before = (thing for thing in things if thing.label in desktop and thing.box is not None)
    return any(footprint_gap(screen, thing) <= 1000.0 * SCREEN_TO_KEYBOARD for thing in before)


def is_odd_sized(thing: Thing, sizes: Mapping[str, Bounds], family: str) -> bool:
    """Return whether an object in a scan has a size or a shape that `sizes` does not allow for its label."""
    bounds = sizes.get(thing.label)
    if family not in FROM_SCANS or bounds is None or not thing.sides():
        return False
    thinnest, *_, longest = thing.sides()
    if longest < round(bounds["least"] * 1000.0) or longest > round(bounds["most"] * 1000.0):
        return True
    if thinnest > bounds["thickness"] * 1000.0:
        return True
    if thing.box is None:
        return False
    height, (short, long) = thing.box[1][1] - thing.box[0][1], sorted(thing.ground_sides())
    if height < bounds["low"] * 1000.0 or height > bounds["high"] * 1000.0:
        return True
    return long > bounds["ratio"] * short or height < bounds["upright"] * long


def is_part(thing: Thing, things: Iterable[Thing], parts: Container[str], named: Container[str]) -> bool:
    """Return whether an object is a shelf or drawer that lies mostly inside a larger piece of other furniture."""
    if thing.label not in parts or thing.box is None:
        return False
    volume = thing.volume()
    for other in things:
        if other.box is None or other.label in parts or other.label not in named or other.volume() <= volume:
            continue
        if volume and math.prod(shared_sides(thing, other)) >= PART_INSIDE * volume:
            return True
    return False


def passes_for_a_side_table(table: Thing, tables: Container[str]) -> bool:
    """Return whether a table is short enough to be called a side table."""
    return table.label in tables and table.box is not None and max(table.ground_sides()) <= 1000.0 * SIDE_TABLE_LENGTH


def looks_like(nameless: Thing, named: Thing) -> bool:
    """Return whether an unlabelled object has about the same side lengths as a labelled one, and its bottom at about
    the same height.
    """
    if nameless.box is None or named.box is None:
        return False
    for one, other in zip(_sides(nameless), _sides(named), strict=True):
        if max(one, other) > LIKE_SIZE * min(one, other):
            return False
    return abs(nameless.box[0][1] - named.box[0][1]) <= 1000.0 * LIKE_HEIGHT


def passes_for_a_counter(table: Thing, worktops: Iterable[str], things: Sequence[Thing], floor: float) -> bool:
    """Return whether a long table is as high as a counter and, if the room has counters, as large as one of them."""
    if table.label not in worktops or table.box is None or math.isnan(floor):
        return False
    if table.box[1][1] - round(floor * 1000.0) < 1000.0 * COUNTER_HEIGHT:
        return False
    if max(table.ground_sides()) < 1000.0 * COUNTER_LENGTH:
        return False
    counters = [thing for thing in things if thing.label == "counter"]
    areas = [math.prod(thing.ground_sides()) for thing in counters if thing.box is not None]
    if not areas:
        return not counters
    return math.prod(table.ground_sides()) >= min(areas)


def has_fallen(thing: Thing, floor: float) -> bool:
    """Return whether an object has fallen: it lies on the floor although its model stands upright, or it extends far
    below the floor.
    """
    if len(thing.item.mesh) != 1 or thing.box is None or math.isnan(floor):
        return False
    lift = round((thing.box[0][1] / 1000.0 - floor) * 1000.0)
    if lift < -1000.0 * FALLEN_SUNK:
        return True
    up = thing.item.mesh[0].transform[:3, :3] @ np.array([0.0, 1.0, 0.0])
    tilt = math.degrees(math.atan2(math.hypot(float(up[0]), float(up[2])), float(up[1])))
    return tilt > FALLEN_DEGREES and lift <= 1000.0 * FALLEN_OFF_FLOOR


def _sides(thing: Thing) -> tuple[int, int, int]:
    """Return the shorter and the longer side of the footprint, and the height, in millimetres."""
    assert thing.box is not None
    short, long = sorted(thing.ground_sides())
    return short, long, thing.box[1][1] - thing.box[0][1]


def astride_rooms(
    scene: Scene, label_of: Callable[[SceneObject], str], meaning: Words
) -> list[tuple[SceneObject, frozenset[str]]]:
    """Return (object, ids of the other rooms) for each object whose footprint extends into the outlines of other rooms
    at the same height. Fixed objects, and objects that text never names, are left out.
    """
    if scene.family not in FROM_SCANS:
        return []
    outlines = [(room, shapely.Polygon(room.polygon).buffer(0.0)) for room in scene.rooms if room.polygon is not None]
    found = []
    for item in scene.objects:
        label = label_of(item)
        if item.box is None or label not in meaning.nouns or label in meaning.roles["fixed"]:
            continue
        (x0, bottom, z0), (x1, top, z1) = item.box.tolist()
        ground = shapely.box(x0, z0, x1, z1)
        others = {
            room.room_id
            for room, outline in outlines
            if room.room_id != item.room_id
            and not (bottom >= room.ceiling_y or top <= room.floor_y)
            and ground.area > 0.0
            and ground.intersection(outline).area / ground.area >= BORDER_SHARE - 1e-9
        }
        if others:
            found.append((item, frozenset(others)))
    return found


TOUCHING: Final = 0.02
"""Largest distance in metres between the boxes of two pieces, and from a piece to the other's region."""
SAME_SECTION: Final = 0.8
"""Least share of the smaller cross-section that the other one covers."""
CUT_FAMILIES: Final = ("mp3d",)
"""Families that are annotated region by region."""


def left_apart(scene: Scene) -> frozenset[str]:
    """Return the ids of all objects that look like a piece of a larger object whose other pieces are in other regions
    of the same level.

    An object that the source has merged (warning ``object_cut``) is larger than its pieces, and is not compared again.
    """
    if scene.family not in CUT_FAMILIES:
        return frozenset()
    joined = {warning.where for warning in scene.warnings if warning.code == "object_cut"}
    things = [item for item in scene.objects if item.aabb is not None and item.object_id not in joined]
    found: set[str] = set()
    for k, one in enumerate(things):
        for other in things[k + 1 :]:
            if one.raw_label != other.raw_label or one.room_id == other.room_id:
                continue
            rooms = scene.room_of.get(one.room_id), scene.room_of.get(other.room_id)
            if rooms[0] is None or rooms[1] is None or rooms[0].level != rooms[1].level:
                continue
            if _continues(one, other) and _reaches(one, rooms[1]) and _reaches(other, rooms[0]):
                found |= {one.object_id, other.object_id}
    return frozenset(found)


def _continues(one: SceneObject, other: SceneObject) -> bool:
    """Return whether two boxes touch and one continues the other with the same cross-section."""
    assert one.aabb is not None
    assert other.aabb is not None
    shared = [float(min(one.aabb[1][k], other.aabb[1][k]) - max(one.aabb[0][k], other.aabb[0][k])) for k in range(3)]
    if min(shared) < -TOUCHING - 1e-9:
        return False
    across = 2 if shared[0] <= shared[2] else 0
    for k in (1, across):
        smaller = min(float(item.aabb[1][k] - item.aabb[0][k]) for item in (one, other))  # type: ignore[index]
        if max(shared[k], 0.0) < SAME_SECTION * max(smaller, 0.001):
            return False
    return True


def _reaches(item: SceneObject, region: Room) -> bool:
    assert item.aabb is not None
    if region.polygon is None:
        return False
    (x0, _, z0), (x1, _, z1) = item.aabb.tolist()
    return bool(shapely.box(x0, z0, x1, z1).distance(shapely.Polygon(region.polygon)) <= TOUCHING)
