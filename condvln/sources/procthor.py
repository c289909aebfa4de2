"""ProcTHOR: procedurally generated houses. Each is one JSON document: a whole file, or one line of a file."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, ClassVar, Final, NoReturn

import numpy as np
import orjson

from condvln.formats.json_document import parse_json
from condvln.formats.json_lines import MAX_LINE_BYTES, JsonLines
from condvln.labels import vocabulary
from condvln.scene import OrientedBox, Room, Scene, SceneObject, SceneWarning, round_mm
from condvln.scene.boxes import aabb_of, box_corners, rounded_box
from condvln.scene.geometry import SceneGeometry
from condvln.sources.asset_database import FILE_NAMES, Asset, AssetDatabase
from condvln.sources.counters import counter_parts
from condvln.sources.input_ledger import InputLedger
from condvln.sources.procthor_house import House, HouseObject, read_house
from condvln.sources.procthor_solids import house_structure
from condvln.sources.regions import check_polygon, in_rooms, side_regions
from condvln.sources.scene_source import Note, SceneSource, SourceOptions
from condvln.sources.solids import Piece, joined, object_boxes
from condvln.sources.source import UNKNOWN_LABEL
from schemas.errors import ConfigError, InputError

__all__ = ["ProcthorSource"]

_FILE: Final = re.compile(r"^(?P<stem>.+?)(?P<suffix>\.jsonl|\.jsonl\.gz|\.json)$")
_LINE: Final = re.compile(r"^(?P<stem>.+)-(?P<number>0|[1-9][0-9]{0,8})$")
KEPT_STRUCTURE_BYTES: Final = 8 << 20
"""Bytes of floors and walls that are kept; those of a house take 50 to 100 kB."""

_HOUSE_KEYS: Final = (b'"rooms"', b'"walls"')
"""Keys that distinguish a house from other JSON in the same folder."""

_LINE_KEYS: Final = (*_HOUSE_KEYS, b'"doors"', b'"windows"', b'"proceduralParameters"')
"""Keys of which any one makes a line a house, so that a damaged line still counts as a house."""


class ProcthorSource(SceneSource):
    """Houses in the files of a folder and of its direct subfolders.

    Ids are ``<file>-<line, from 0>`` for files with one house per line, ``<file>`` for files of one house, with the
    subfolder in front if there is one. The asset database is in the root folder.
    """

    family: ClassVar[str] = "procthor"

    def __init__(self, root: Path, options: SourceOptions) -> None:
        super().__init__(root, options)
        self._open: dict[str, JsonLines] = {}
        self._database: tuple[tuple[int, int], AssetDatabase | InputError] | None = None
        self._house: tuple[tuple[str, bytes], tuple[object, ...], House] | None = None
        self._structures: dict[tuple[object, ...], Piece] = {}
        self._room_for_structures = KEPT_STRUCTURE_BYTES
        if not self._files() and not self._lost:
            raise ConfigError(
                "no houses (*.jsonl, *.jsonl.gz, *.json) are in this folder",
                where=root,
                remedy="Download ProcTHOR's houses, or set the source's 'root' to their folder",
            )

    def listing(self) -> Iterator[tuple[str, Note]]:
        """See `SceneSource.listing`. If a JSON Lines file can't be read to its end, the listing has a fault whose id is
        the file's name.

        Raises
        ------
        ConfigError : the asset database, without which no house can be read, is missing or malformed
        """
        try:
            self._assets()
        except InputError as error:
            raise ConfigError(error.what, where=error.where, place=error.place, remedy=error.remedy) from None
        for (stem, suffix), path in self._files().items():
            try:
                if suffix == ".json":
                    data = self.files.read(path, MAX_LINE_BYTES)
                    if all(key in data for key in _HOUSE_KEYS):
                        yield stem, partial(self._note, stem, path, data)
                    else:
                        # A truncated file may have been a house.
                        parse_json(data, str(self.root / path))
                        self.pass_over(path, "JSON that is not a house")
                    continue
                yield from self._houses_of_lines(stem, path)
            except InputError as error:
                yield stem, partial(_fail, error)

    def _houses_of_lines(self, stem: str, path: str) -> Iterator[tuple[str, Note]]:
        """Yield the id of each house in a file with one house per line, with a function that records the house's
        inputs. A file without any house is skipped if its first line is JSON.

        Raises
        ------
        InputError : the file can't be read, or holds neither houses nor other JSON
        """
        earlier: list[int] = []
        first, houses = b"", False
        for number, line in self._lines(path).lines():
            if not houses and not any(key in line for key in _LINE_KEYS):
                earlier.append(number)
                first = first or line
                continue
            if not houses:  # there is a house, so the earlier lines are damaged houses
                for broken in earlier:
                    yield f"{stem}-{broken}", partial(self._note_line, f"{stem}-{broken}", path, broken)
            houses = True
            yield f"{stem}-{number}", partial(self._note, f"{stem}-{number}", f"{path}#{number}", line)
        if not houses and earlier:
            parse_json(first, f"{self.root / path}#{earlier[0]}")
        if not houses:
            self.pass_over(path, f"none of its {len(earlier)} lines is a house" if earlier else "the file has no lines")

    def scene(self, scene_id: str) -> Scene:
        """Return one house; see `Source.read`."""
        house, ledger = self.house(scene_id), InputLedger()
        database = self._assets()
        rooms = self.rooms(house)
        if self.options.regions is not None:
            rooms = side_regions(self.options.regions, [scene_id], self.family, ledger) or rooms
        kinds = {o.object_id: database.asset(o.asset_id, ledger) for o in house.objects}
        objects = [self._object(o, kinds[o.object_id]) for o in house.objects]
        placed, lost = _with_parents_rooms(objects, house, rooms)
        warnings = {*lost, *_unknown_assets(house, kinds)}
        warnings |= {SceneWarning(_snake(name), "metadata.warnings", text) for name, text in house.warnings}
        unnamed = {o.room_id for o in placed if o.raw_label == UNKNOWN_LABEL}
        return Scene(
            family=self.family,
            scene_id=scene_id,
            root=self.root,
            # If some object has no label, no absence can be claimed.
            rooms=tuple(replace(r, complete=r.room_id not in unnamed) for r in sorted(rooms, key=lambda r: r.room_id)),
            objects=tuple(sorted(placed, key=lambda o: o.object_id)),
            shipped_navmeshes=self.shipped_navmeshes(scene_id, ledger),
            warnings=tuple(sorted(warnings, key=lambda w: (w.code, w.where, w.message))),
        )

    def geometry(self, scene: Scene) -> SceneGeometry:
        """Return floors, walls with holes for open doors and windows, and objects as boxes; see `Source.geometry`.

        There are no ceilings, since a navmesh would be built on them too.
        """
        return joined([self._structure(scene.scene_id), object_boxes(enumerate(scene.objects))], approximate=True)

    def _structure(self, scene_id: str) -> Piece:
        """Return floors and walls of a house. They are kept for later stages, as long as the house's file is the same
        and there is room for them.
        """
        key = self._signed(*self._place(scene_id))
        found = self._structures.get(key)
        if found is None:
            known = self._house
            house = known[2] if known is not None and known[1] == key else self.house(scene_id)
            whole = joined(house_structure(house, f"{self.root}: {scene_id}"), approximate=True)
            found = Piece(whole.vertices, whole.faces, whole.owner)
            size = found.vertices.nbytes + found.faces.nbytes + found.owner.nbytes
            if size <= self._room_for_structures:
                self._room_for_structures -= size
                self._structures[key] = found
        return found

    def house(self, scene_id: str) -> House:
        """Return the raw record of a house in Habitat's frame, including walls, doors and windows. The house that was
        asked for last is not parsed again, unless its file has changed.

        Raises
        ------
        InputError : as `read`
        """
        place = self._place(scene_id)
        signed = self._signed(*place)  # before it is read: if it changes meanwhile, it is read again
        record = self._record(*place)
        if self._house is None or self._house[0] != record:
            name, data = record
            self._house = (record, signed, read_house(parse_json(data, str(self.root / name))))
        return self._house[2]

    def record(self, scene_id: str) -> tuple[str, bytes]:
        """Return where a house is stored (path relative to the root, with ``#line`` in a file of lines), and its JSON.

        Raises
        ------
        InputError : the house does not exist, or its file can't be read
        """
        return self._record(*self._place(scene_id))

    def _record(self, path: str, number: int | None) -> tuple[str, bytes]:
        if number is None:
            return path, self.files.read(path, MAX_LINE_BYTES)
        return f"{path}#{number}", self._lines(path).line(number)

    def _signed(self, path: str, number: int | None) -> tuple[object, ...]:
        """Return a key of a place that changes with its file."""
        return path, number, *self.files.signature(path)

    def _place(self, scene_id: str) -> tuple[str, int | None]:
        """Return the file of a house, and its line in a file of lines."""
        files = self._files()
        if (scene_id, ".json") in files:
            return files[scene_id, ".json"], None
        named = _LINE.match(scene_id)
        for suffix in (".jsonl", ".jsonl.gz"):
            if named is not None and (named["stem"], suffix) in files:
                return files[named["stem"], suffix], int(named["number"])
        raise self.not_there(scene_id)

    def _files(self) -> dict[tuple[str, str], str]:
        """Return the path of every file that may hold houses, by (id without line number, suffix), sorted."""
        found: dict[tuple[str, str], str] = {}
        for path in self.matching("*.json*", "*/*.json*"):
            named = _FILE.match(path)
            if named is not None and path not in FILE_NAMES:
                found[named["stem"], named["suffix"]] = path
        return dict(sorted(found.items()))

    def _lines(self, path: str) -> JsonLines:
        if path not in self._open:
            self._open[path] = JsonLines(self.files, path)
        return self._open[path]

    def _assets(self) -> AssetDatabase:
        """Return the asset database, read again if its file has changed."""
        signature = next((s for s in map(self.files.signature, FILE_NAMES) if s != (0, 0)), (0, 0))
        if self._database is None or self._database[0] != signature:
            try:
                self._database = (signature, AssetDatabase(self.files))
            except InputError as error:
                self._database = (signature, error)
        if isinstance(self._database[1], InputError):
            raise self._database[1]
        return self._database[1]

    def _note_line(self, scene_id: str, path: str, number: int, ledger: InputLedger) -> None:
        self._note(scene_id, f"{path}#{number}", JsonLines(self.files, path).line(number), ledger)

    def _note(self, scene_id: str, name: str, data: bytes, ledger: InputLedger) -> None:
        """Record the inputs that a house is read from, without building the house."""
        ledger.record(name, data)
        database = self._assets()
        rooms, asset_ids = _rooms_and_assets(data, str(self.root / name))
        ledger.rooms, ledger.objects = rooms, len(asset_ids)
        for asset_id in set(asset_ids):
            database.asset(asset_id, ledger)
        if self.options.regions is not None:
            side_regions(self.options.regions, [scene_id], self.family, ledger)
        self.shipped_navmeshes(scene_id, ledger)

    def rooms(self, house: House) -> tuple[Room, ...]:
        """Return a house's rooms.

        Raises
        ------
        FormatError : the outline of a floor intersects itself
        """
        tops = {wall.room_id: 0.0 for wall in house.walls}
        for wall in house.walls:
            tops[wall.room_id] = max(tops[wall.room_id], wall.top)
        highest = max(tops.values(), default=0.0)
        return tuple(
            Room(
                room_id=room.room_id,
                raw_label=room.room_type,
                label=vocabulary.room_type(room.room_type, self.family),
                level=0,
                floor_y=0.0,
                ceiling_y=float(round_mm(tops.get(room.room_id, highest))),
                polygon=check_polygon(room.polygon, room.node["floorPolygon"]),
                annotation="dataset",
                complete=True,
            )
            for room in house.rooms
        )

    def _object(self, item: HouseObject, asset: Asset | None) -> SceneObject:
        """Return an object that is not assigned to a room yet. Its box is the asset's box, rotated, with its centre at
        the object's position.
        """
        raw = item.object_type or (None if asset is None else asset.object_type)
        if raw is None:
            prefix = item.object_id.split("|")[0]
            raw = prefix if prefix in vocabulary.raw_labels(self.family) else UNKNOWN_LABEL
        label = vocabulary.canonical(raw, self.family)
        centre = round_mm(item.position)
        receptacles = () if item.parent_id is None else (item.parent_id,)
        if asset is None or asset.size is None:
            return SceneObject(
                item.object_id,
                "",
                raw,
                label,
                centre,
                static=item.kinematic,
                receptacles=receptacles,
                openness=item.openness,
            )
        box = OrientedBox(item.position, asset.size / 2, item.rotation)
        aabb = round_mm(aabb_of(box_corners(box)))
        return SceneObject(
            object_id=item.object_id,
            room_id="",
            raw_label=raw,
            label=label,
            center=centre,
            aabb=aabb,
            obb=rounded_box(box),
            size=round_mm(aabb[1] - aabb[0]),
            radius=float(np.ceil(np.linalg.norm(asset.size) / 2 * 1000) / 1000),
            static=item.kinematic,
            parts=counter_parts(item.asset_id, item.position, asset.size, item.rotation),
            receptacles=receptacles,
            openness=item.openness,
        )


def _with_parents_rooms(
    objects: list[SceneObject], house: House, rooms: tuple[Room, ...]
) -> tuple[list[SceneObject], list[SceneWarning]]:
    """Return the objects with their rooms, and the warnings. An object on or in another object gets that other object's
    room.
    """
    parent_of = {o.object_id: o.parent_id for o in house.objects}
    placed, lost = in_rooms((o for o in objects if parent_of[o.object_id] is None), rooms)
    room_of = {o.object_id: o.room_id for o in placed}
    for item in objects:  # parents come before their children
        parent = parent_of[item.object_id]
        if parent is None:
            continue
        if parent in room_of:
            room_of[item.object_id] = room_of[parent]
            placed.append(replace(item, room_id=room_of[parent]))
        else:
            lost.append(SceneWarning("object_outside_rooms", item.object_id, f"it goes with {parent}: left out"))
    return placed, lost


def _unknown_assets(house: House, kinds: dict[str, Asset | None]) -> Iterator[SceneWarning]:
    unknown = Counter(o.asset_id for o in house.objects if kinds[o.object_id] is None)
    for asset_id, count in sorted(unknown.items()):
        yield SceneWarning("unknown_asset", asset_id, f"not in the asset database: extent of {count} unknown")


def _rooms_and_assets(data: bytes, where: str) -> tuple[int, list[str]]:
    """Return the number of rooms of a house, and the asset ids of all its objects. If reading just these values fails,
    the house is read in full.

    Raises
    ------
    FormatError : the house is malformed
    """
    try:
        document = orjson.loads(data)
        waiting: list[Any] = list(document["objects"])
        found: list[Any] = []
        while waiting:
            item = waiting.pop()
            found.append(item["assetId"])
            waiting.extend(item.get("children") or ())
        return len(document["rooms"]), [a for a in found if isinstance(a, str)]
    except (orjson.JSONDecodeError, KeyError, TypeError, AttributeError, RecursionError):
        house = read_house(parse_json(data, where))
        return len(house.rooms), [o.asset_id for o in house.objects]


def _fail(error: InputError, ledger: InputLedger) -> NoReturn:
    raise error


def _snake(name: str) -> str:
    return re.sub(r"(?<=[a-z0-9])(?=[A-Z])", "_", name).lower()
