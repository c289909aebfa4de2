"""``make_layout``: generate a seeded apartment, from floor plan to the smallest object; ``make_samples``: write whole
datasets of them, so that everything runs without a download.
"""

from __future__ import annotations

import os
import random
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import shapely

from condvln.formats.streams import atomic_path
from condvln.samples.boxes import boxes_files
from condvln.samples.floor_mesh import free_floor
from condvln.samples.floor_plan import MAX_ROOMS, MIN_ROOMS, FloorPlan, PlanDoor, Rect, draw_floor_plan, metres
from condvln.samples.furnishing import furnish
from condvln.samples.gibson import gibson_files
from condvln.samples.hm3d import hm3d_files
from condvln.samples.hssd import hssd_files
from condvln.samples.layout import Door, Furniture, Layout, Room
from condvln.samples.mp3d import mp3d_files
from condvln.samples.procthor import HOUSES, SCENES, ai2thor_hab_files, procthor_files
from condvln.samples.replicacad import replicacad_files
from condvln.samples.room_space import DOOR_DEPTH, HALF_WALL, DoorZone, Piece, RoomSpace
from condvln.samples.thor_metadata import ithor_files, robothor_files
from condvln.seeding import stable_hash
from schemas.errors import UsageError

__all__ = [
    "FAMILIES",
    "FORMS",
    "SampleReport",
    "make_layout",
    "make_layouts",
    "make_samples",
]


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
    for door in plan.doors:
        ends = [(metres(v), metres(door.at)) for v in (door.middle - door.width // 2, door.middle + door.width // 2)]
        start, end = ends if door.along_x else [(b, a) for a, b in ends]
        doors.append(Door((names[door.a], names[door.b]), start, end, metres(DOOR_HEIGHT)))
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


Writer = Callable[[Mapping[str, Layout]], Iterator[tuple[str, bytes]]]

FAMILIES: Final[dict[str, Writer]] = {
    write.__name__.removesuffix("_files"): write
    for write in (
        *(boxes_files, gibson_files, hm3d_files, hssd_files, ithor_files),
        *(mp3d_files, procthor_files, replicacad_files, robothor_files),
    )
}
"""Writers by source family: from layouts by scene name to files by path."""

HABITAT_PROCTHOR: Final = "ai2thor-hab"
FORMS: Final[dict[str, Writer]] = {**FAMILIES, HABITAT_PROCTHOR: ai2thor_hab_files}
"""Writers of everything that can be generated: the families, and Habitat's form of ProcTHOR, which is of family
procthor.
"""

SEED_BITS: Final = 63


@dataclass(frozen=True, slots=True)
class SampleReport:
    """What was written: the scenes' names, and the total numbers of rooms, objects, files and bytes.

    family : the source family that reads the files
    parts : folders to enter under ``sources`` in a configuration, by key, such as ``root``
    """

    folder: Path
    family: str
    parts: Mapping[str, Path]
    scenes: tuple[str, ...]
    rooms: int
    objects: int
    files: int
    bytes: int


def make_layouts(scenes: int, seed: int) -> dict[str, Layout]:
    """Return layouts by scene name, ``made_000`` and so on. Scene k of a seed is the same for any number of scenes and
    any family.
    """
    return {
        f"made_{k:03d}": make_layout(stable_hash("sample", seed, k) >> (256 - SEED_BITS), _n_rooms(seed, k))
        for k in range(scenes)
    }


def make_samples(
    folder: str | os.PathLike[str], family: str = "replicacad", scenes: int = 12, seed: int = 0
) -> SampleReport:
    """Write `scenes` generated apartments to `folder` in the native format of `family`, which is any key of `FORMS`: a
    source family or ``ai2thor-hab``.

    The bytes depend only on (family, scenes, seed). A folder that already holds the same files is unchanged.

    Raises
    ------
    UsageError : the family is unknown, `scenes` is below 1, or the folder holds other files
    """
    if family not in FORMS:
        known = ", ".join(sorted(FORMS))
        raise UsageError(
            f"no samples can be made for the family {family!r}", place="family", remedy=f"Choose one of: {known}."
        )
    if scenes < 1:
        raise UsageError(
            f"the number of scenes must be positive, got {scenes}", place="scenes", remedy="Ask for at least one."
        )
    root, layouts = Path(folder), make_layouts(scenes, seed)
    files = {root / path: content for path, content in FORMS[family](layouts)}
    # Nothing is written before all existing files were checked.
    there = {file for file in files if file.exists()}
    for file in sorted(there):
        if not file.is_file() or file.read_bytes() != files[file]:
            raise UsageError("the folder holds another dataset", where=file, remedy="Give an empty or a new folder.")
    for file, content in files.items():
        if file not in there:
            with atomic_path(file, durable=False) as part:
                part.write_bytes(content)
    joined = family == HABITAT_PROCTHOR
    return SampleReport(
        folder=root,
        family="procthor" if joined else family,
        parts={"root": root / SCENES, "houses": root / HOUSES} if joined else {"root": root},
        scenes=tuple(layouts),
        rooms=sum(len(layout.rooms) for layout in layouts.values()),
        objects=sum(len(layout.furniture) for layout in layouts.values()),
        files=len(files),
        bytes=sum(map(len, files.values())),
    )


def _n_rooms(seed: int, k: int) -> int:
    """Return the number of rooms of scene k. In each block of seven scenes (0–6, 7–13, …), every number from two to
    eight occurs once, in random order.
    """
    sizes = list(range(MIN_ROOMS, MAX_ROOMS + 1))
    random.Random(f"sizes/{seed}/{k // len(sizes)}").shuffle(sizes)
    return sizes[k % len(sizes)]
