"""Gibson: buildings annotated by 3DSceneGraph, with Habitat's mesh and navmesh if they exist.

Boxes are axis-aligned in the mesh's z-up frame; ``floor_area`` in the files is a perimeter and is ignored.
"""

from __future__ import annotations

import re
from collections import Counter, defaultdict
from collections.abc import Collection, Mapping
from dataclasses import replace
from typing import ClassVar, Final

import numpy as np

from condvln.arrays import F64
from condvln.formats.json_document import JsonNode
from condvln.labels import vocabulary
from condvln.scene import Room, Scene, SceneObject, SceneWarning, round_mm
from condvln.scene.rotations import Z_UP_TO_HABITAT
from condvln.sources.regions import LEVEL_STEP, in_rooms, made_room
from condvln.sources.scene_graph import MAX_GRAPH_BYTES, read_npz, read_scn
from condvln.sources.scene_source import ScanSource
from condvln.sources.source import MAX_OBJECTS, InputLedger

__all__ = ["GibsonSource", "verified_twin"]


VERIFIED: Final = "verified"
AUTOMATED: Final = "automated"
LEVEL_ROOMS: Final = 3
"""Least number of rooms of a level for the median of their floors to be the height of the level."""
_FILE: Final = re.compile(r"^(?:(?P<folder>[^/]+)/)?(?:(?P<name>[^/]+)\.scn|3DSceneGraph_(?P<original>[^/]+)\.npz)$")


class GibsonSource(ScanSource):
    """Buildings in a folder and its direct subfolders.

    Ids are ``verified/<name>`` and ``automated/<name>`` in subfolders of these names, otherwise ``<name>``. If a
    building exists as ``.scn`` and as ``.npz``, the ``.scn`` is read. Automated annotation was not checked by people:
    its rooms are not complete, and text asks about them only if the source's ``absence`` is ``never``.
    """

    family: ClassVar[str] = "gibson"
    bytes_per_object: ClassVar[float] = 750.0
    objects_per_room: ClassVar[float] = 3.6

    nothing: ClassVar[tuple[str, str]] = (
        "buildings (*.scn or 3DSceneGraph_*.npz, here or in verified/ and automated/)",
        "Download 3DSceneGraph, or set the source's 'root' to its folder",
    )

    def scene(self, scene_id: str) -> Scene:
        """Return one building; see `Source.read`."""
        path = self.path_of(scene_id, self.scans())
        ledger = InputLedger()
        data, where = self.files.read(path, MAX_GRAPH_BYTES), str(self.root / path)
        document = read_scn(data, where) if path.endswith(".scn") else read_npz(data, where)
        complete = not scene_id.startswith(f"{AUTOMATED}/")
        room_of, left_out = _rooms(document, self.family, complete)
        off_level: list[SceneWarning] = []
        if not complete:
            nodes = document.array("rooms")
            named = {node["id"].integer() for node in nodes if node.get("floor_number") is not None}
            room_of, off_level = _with_floors_of_levels(room_of, named)
        rooms = tuple(room_of.values())
        if drawn := self.drawn_rooms(self.names(scene_id, path), ledger):
            rooms, room_of, left_out, off_level = drawn, {}, {}, []
        items, warnings = _objects(document, self.family, room_of, left_out)
        rooms = rooms or (_whole(items, self.family, complete),)
        placed, lost = in_rooms((o for o in items if not o.room_id), rooms)
        placed += [o for o in items if o.room_id]
        stage, navmeshes = self.beside(scene_id, path, ledger)
        said = [*warnings, *lost, *left_out.values(), *off_level]
        return self.made(scene_id, rooms, placed, said, navmeshes, stage)

    def folders(self, folder: str) -> list[str]:
        """Return the folder of the annotation and the root folder; see `ScanSource.folders`."""
        return [folder, ""]

    def scans(self) -> dict[str, str]:
        """Return the path of each building's annotation by scene id, sorted."""
        found: dict[str, str] = {}
        # Of several files of a building the last one counts: .scn before .npz, subfolders before the root.
        paths = self.matching("*.npz", "*/*.npz", "*.scn", "*/*.scn")
        for path in sorted(paths, key=lambda path: (path.endswith(".scn"), "/" in path, path)):
            named = _FILE.match(path)
            if named is not None:
                name, folder = named["name"] or named["original"], named["folder"] or ""
                kind = next((k for k in (VERIFIED, AUTOMATED) if k in folder.lower()), None)
                found[name if kind is None else f"{kind}/{name}"] = path
        return dict(sorted(found.items()))


def verified_twin(scene_id: str) -> str | None:
    """Return the scene id of the verified annotation of the same building; None if `scene_id` already names a verified
    annotation.
    """
    kind, _, name = scene_id.rpartition("/")
    return None if kind == VERIFIED else f"{VERIFIED}/{name}"


def _box(node: JsonNode) -> F64 | None:
    """Return the (2, 3) box in Habitat's frame, not rounded; None if the entry has no position or size, or a size is
    negative.
    """
    location, size = node.get("location"), node.get("size")
    if location is None or size is None:
        return None
    extent = size.vector(3)
    if not (extent >= 0).all():
        return None
    centre = Z_UP_TO_HABITAT @ location.vector(3)
    half = np.abs(Z_UP_TO_HABITAT @ extent) / 2
    return np.array([centre - half, centre + half])


def _rooms(document: JsonNode, family: str, complete: bool) -> tuple[dict[int, Room], dict[int, SceneWarning]]:
    """Return the rooms, and warnings of those that are left out because they have no box; both by the numbers that the
    file gives them.

    Raises
    ------
    FormatError : a room is malformed, two have the same number, or none has a box
    """
    nodes = document.array("rooms")
    floors = [floor.text() for node in nodes if (floor := node.get("floor_number")) is not None]
    level_of = {letter: level for level, letter in enumerate(sorted(set(floors)))}
    rooms: dict[int, Room] = {}
    left_out: dict[int, SceneWarning] = {}
    for node in nodes:
        number, box = node["id"].integer(), _box(node)
        if number in rooms or number in left_out:
            node.fail(f"two rooms have the id {number}")
        raw, floor = node["scene_category"].text(), node.get("floor_number")
        if box is None:
            left_out[number] = SceneWarning("room_without_box", f"{raw}_{number}", f"{_no_box(node)}: left out")
            continue
        (x0, y0, z0), (x1, y1, z1) = round_mm(box).tolist()
        rooms[number] = made_room(
            family,
            f"{raw}_{number}",
            raw,
            (y0, y1),
            np.array([[x0, z0], [x0, z1], [x1, z1], [x1, z0]]),
            level=0 if floor is None else level_of[floor.text()],
            complete=complete,
            asked=complete,
        )
    if left_out and not rooms:
        document["rooms"].fail("no room has a box")
    return rooms, left_out


def _no_box(node: JsonNode) -> str:
    """Return why an entry has no box."""
    missing = [key for key in ("location", "size") if node.get(key) is None]
    return f"it has no {' and no '.join(missing)}" if missing else "its size is negative"


def _with_floors_of_levels(
    rooms: Mapping[int, Room], named: Collection[int]
) -> tuple[dict[int, Room], list[SceneWarning]]:
    """Return the rooms, each floor at the height of its level, and a warning for each floor that is off this height.

    A box that no person checked may reach far below the floor. Nobody could stand in such a room, since its floor is
    not on the navmesh. So a floor that is more than `LEVEL_STEP` from the median floor of its level gets this height.

    A level has a height if it has at least `LEVEL_ROOMS` rooms, and more than half of their floors are within
    `LEVEL_STEP` of it: otherwise rooms of two storeys may share a level, and their median lies between the two. A box
    that ends below this height is left as it is, because the room would have no height.

    named : numbers of the rooms whose level the file names; the others are left as they are
    """
    found, warnings = dict(rooms), []
    of_level: defaultdict[int, list[int]] = defaultdict(list)
    for number in rooms:
        if number in named:
            of_level[rooms[number].level].append(number)
    for numbers in of_level.values():
        floors = np.array([rooms[number].floor_y for number in numbers])
        usual = float(round_mm(float(np.median(floors))))
        off = np.abs(floors - usual) > LEVEL_STEP
        if len(numbers) < LEVEL_ROOMS or 2 * int(off.sum()) >= len(numbers):
            continue
        for number in (number for number, is_off in zip(numbers, off, strict=True) if is_off):
            room = rooms[number]
            if room.ceiling_y > usual:
                found[number] = replace(room, floor_y=usual)
                message = (
                    f"its box begins at {room.floor_y:g} m: its floor is set to {usual:g} m, as in its level's rooms"
                )
            else:
                message = f"its box ends at {room.ceiling_y:g} m, below the floor of its level's rooms, {usual:g} m"
            warnings.append(SceneWarning("room_off_level", room.room_id, message))
    return found, warnings


def _objects(
    document: JsonNode, family: str, room_of: Mapping[int, Room], left_out: Collection[int]
) -> tuple[list[SceneObject], list[SceneWarning]]:
    """Return the objects, each in the room that the file names; without a room where the file names none, or one of the
    rooms that are `left_out`.
    """
    items: list[SceneObject] = []
    warnings: list[SceneWarning] = []
    seen: Counter[int] = Counter()
    for node in document["objects"].entries():
        number, raw = node["id"].integer(), node["class_"].text()
        seen[number] += 1
        if seen[number] > 1:
            node.fail(f"two objects have the id {number}")
        if len(seen) > MAX_OBJECTS:
            node.fail(f"more than {MAX_OBJECTS} objects")
        object_id = f"{raw}_{number}"
        location, box, parent = node.get("location"), _box(node), node.get("parent_room")
        if location is None:
            warnings.append(SceneWarning("object_without_place", object_id, "it has no location: left out"))
            continue
        if box is None and node.get("size") is not None:
            warnings.append(SceneWarning("no_box", object_id, "its size is negative: extent unknown"))
        room = None if parent is None else room_of.get(parent.integer())
        if parent is None or (room is None and parent.integer() in left_out):
            warnings.append(
                SceneWarning("no_parent_room", object_id, "the file names no room for it: it is placed by its centre")
            )
        elif room is None and room_of:
            parent.fail(f"there is no room {parent.value}")
        items.append(
            SceneObject(
                object_id=object_id,
                room_id="" if room is None else room.room_id,
                raw_label=raw,
                label=vocabulary.canonical(raw, family),
                center=round_mm(Z_UP_TO_HABITAT @ location.vector(3)),
                aabb=None if box is None else round_mm(box),
                radius=None if box is None else float(np.ceil(np.linalg.norm(box[1] - box[0]) / 2 * 1000) / 1000),
            )
        )
    return items, warnings


def _whole(items: list[SceneObject], family: str, complete: bool) -> Room:
    """Return the one room of a building without annotated rooms."""
    ends = [y for o in items for y in (o.center[1:2] if o.aabb is None else o.aabb[:, 1])]
    heights = float(min(ends, default=0.0)), float(max(ends, default=0.0))
    room = made_room(family, "building", "apartment", heights, None, annotation="scene", complete=complete)
    return replace(room, raw_label="building", asked=complete)
