"""``make_layout``: generate a seeded apartment, from floor plan to the smallest object."""

from __future__ import annotations

import random
from typing import Final

import shapely

from condvln.samples.floor_plan import MAX_ROOMS, MIN_ROOMS, FloorPlan, PlanDoor, draw_floor_plan
from condvln.samples.free_floor import free_floor
from condvln.samples.furnishing import furnish
from condvln.samples.layout import Door, Furniture, Layout, Room
from condvln.samples.rect import Rect, metres
from condvln.samples.room_space import DOOR_DEPTH, HALF_WALL, DoorZone, Piece, RoomSpace
from schemas.errors import UsageError

__all__ = ["make_layout"]

CEILINGS: Final = (2500, 2600, 2700, 2800)
"""Possible ceiling heights in millimetres."""

DOOR_HEIGHT: Final = 2050
"""Height of an opening in millimetres."""

ROOM_TRIES: Final = 8
"""Largest number of attempts to furnish one room before the whole plan is drawn again."""


def make_layout(seed: int, n_rooms: int | None = None) -> Layout:
    """Generate a whole apartment; equal arguments give the same apartment on every machine.

    Parameters
    ----------
    seed : any integer
    n_rooms : 2 to 8; drawn from the seed if None

    Returns
    -------
    A layout whose free floor is connected for an agent of radius 0.1 m, with 5 to 12 objects per room, none
    overlapping.

    Raises
    ------
    UsageError : `n_rooms` is out of range.
    """
    if n_rooms is not None and not MIN_ROOMS <= n_rooms <= MAX_ROOMS:
        raise UsageError(
            f"the number of rooms is out of range: {n_rooms}",
            place="n_rooms",
            remedy=f"Ask for {MIN_ROOMS} to {MAX_ROOMS} rooms.",
        )
    attempt = 0
    while True:
        # Seeding with text uses SHA-512, so there is no hash randomisation, and the draws of one part do not affect
        # others.
        rng = random.Random(f"apartment/{seed}/{n_rooms}/{attempt}")
        plan = draw_floor_plan(rng, n_rooms or rng.randint(MIN_ROOMS, MAX_ROOMS))
        spaces = _furnished(f"{seed}/{attempt}", plan)
        if spaces is not None:
            layout = _layout(seed, rng.choice(CEILINGS), plan, spaces)
            if free_floor(layout).geom_type == "Polygon":
                return layout
        attempt += 1


def _furnished(seed: str, plan: FloorPlan) -> list[RoomSpace] | None:
    spaces = []
    for index, room in enumerate(plan.rooms):
        doors = tuple(_door_zone(door, plan, index) for door in plan.doors if index in (door.a, door.b))
        for attempt in range(ROOM_TRIES):
            space = RoomSpace(room.label, shapely.Polygon(room.corners), doors)
            if furnish(random.Random(f"room/{seed}/{index}/{attempt}"), space):
                spaces.append(space)
                break
        else:
            return None
    return spaces


def _door_zone(door: PlanDoor, plan: FloorPlan, room: int) -> DoorZone:
    """Return the part of the floor in front of `door` that lies in the room with index `room`."""
    half = door.width // 2
    sides = []
    for sign in (-1, 1):
        near, far = door.at, door.at + sign * (HALF_WALL + DOOR_DEPTH)
        low, high = min(near, far), max(near, far)
        reach = door.at + sign * (HALF_WALL + DOOR_DEPTH // 2)
        if door.along_x:
            sides.append((Rect(door.middle - half, low, door.middle + half, high), (door.middle, reach)))
        else:
            sides.append((Rect(low, door.middle - half, high, door.middle + half), (reach, door.middle)))
    rect, point = max(sides, key=lambda side: sum(side[0].overlap(rect) for rect in plan.rooms[room].rects))
    return DoorZone(rect, point)


def _layout(seed: int, ceiling: int, plan: FloorPlan, spaces: list[RoomSpace]) -> Layout:
    names: list[str] = []
    for cell in plan.rooms:
        same = sum(other.label == cell.label for other in plan.rooms[: len(names)])
        names.append(f"{cell.label.replace(' ', '_')}_{same}")
    rooms = tuple(
        Room(name, cell.label, tuple((metres(x), metres(z)) for x, z in cell.corners))
        for name, cell in zip(names, plan.rooms, strict=True)
    )
    doors = []
    for number, door in enumerate(plan.doors):
        ends = [(metres(v), metres(door.at)) for v in (door.middle - door.width // 2, door.middle + door.width // 2)]
        start, end = ends if door.along_x else [(b, a) for a, b in ends]
        doors.append(Door(f"door_{number}", (names[door.a], names[door.b]), start, end, metres(DOOR_HEIGHT)))
    furniture: list[Furniture] = []
    for name, space in zip(names, spaces, strict=True):
        ids = [f"{piece.kind.kind}_{len(furniture) + i:03d}" for i, piece in enumerate(space.pieces)]
        furniture += [_furniture(name, piece, ids, i) for i, piece in enumerate(space.pieces)]
    return Layout(seed, metres(ceiling), rooms, tuple(doors), tuple(furniture))


def _furniture(room_id: str, piece: Piece, ids: list[str], index: int) -> Furniture:
    width, height, depth = piece.size
    return Furniture(
        object_id=ids[index],
        kind=piece.kind.kind,
        variant=piece.variant,
        label=piece.kind.label,
        room_id=room_id,
        center=(metres(piece.x), metres(piece.bottom + height // 2), metres(piece.z)),
        size=(metres(width), metres(height), metres(depth)),
        yaw=piece.yaw,
        parent=None if piece.parent is None else ids[piece.parent],
    )
