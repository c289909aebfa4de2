"""ProcTHOR: procedurally generated houses. Each is one JSON object: a whole file, one line of a file, or one entry of a
file that is a JSON list.

Habitat's form of ProcTHOR (``ai2thor-hab``): scene instances, whose rooms are only in the houses' own JSON.

A scene and its house are matched by name: ``ProcTHOR-Train-293`` is line 293 of ``train.jsonl``. The match is verified
by their objects, which must have the same positions: either in Unity's coordinates with z mirrored, or, as glTF
exporters write it, with x mirrored, which is rotated by 180°.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, ClassVar, Final, NoReturn

import numpy as np
import orjson
from scipy.spatial import cKDTree

from condvln.formats.json_document import parse_json
from condvln.formats.json_entries import entries, first_character
from condvln.formats.json_lines import MAX_LINE_BYTES, JsonLines
from condvln.kept import kept
from condvln.labels import vocabulary
from condvln.scene import OrientedBox, Room, Scene, SceneObject, SceneWarning, round_mm
from condvln.scene.boxes import with_box
from condvln.scene.scene import SceneGeometry
from condvln.sources.procthor_house import FILE_NAMES, Asset, AssetDatabase, House, HouseObject, read_house
from condvln.sources.procthor_solids import counter_parts, house_structure
from condvln.sources.regions import check_polygon, in_rooms, made_room
from condvln.sources.replicacad import Assembly, ReplicaCadSource
from condvln.sources.scene_source import Note, SceneChoice, Source, SourceOptions
from condvln.sources.solids import joined, object_boxes
from condvln.sources.source import UNKNOWN_LABEL, InputLedger
from schemas.errors import ConfigError, FormatError, InputError, MissingFileError

__all__ = ["ProcthorHabitatSource", "ProcthorSource"]

_NAME: Final = re.compile(r"^(?:.*/)?ProcTHOR-(?P<split>[A-Za-z]+)-(?P<number>0|[1-9][0-9]{0,8})$")

SAME_PLACE: Final = 0.25
"""Largest distance in metres between the centres of an object's box in the house and of its mesh in the scene."""

LEAST_SHARE: Final = 0.5
"""Least share of a house's objects that must be found in the scene; some of Habitat's have no mesh or another pivot."""


class ProcthorHabitatSource(ReplicaCadSource):
    """Scenes ``ProcTHOR-<Split>-<n>`` of a Habitat scene dataset; its other scenes have no houses and are left out."""

    family: ClassVar[str] = "procthor"

    def __init__(self, root: Path, options: SourceOptions, houses: Path) -> None:
        super().__init__(root, options)
        self._houses = ProcthorSource(houses, replace(options, choice=SceneChoice(), navmesh=None, regions=None))

    def listing(self) -> Iterator[tuple[str, Note]]:
        """See `Source.listing`."""
        for scene_id, note in super().listing():
            if _NAME.match(scene_id):
                yield scene_id, partial(self._note, scene_id, note)

    def _note(self, scene_id: str, note: Note, ledger: InputLedger) -> None:
        note(ledger)
        name, data = self._houses.record(_house_id(scene_id))
        ledger.record(f"houses/{name}", data)

    def _rooms(self, scene_id: str, assembly: Assembly, objects: Sequence[SceneObject]) -> tuple[Room, ...]:
        """Return the user's zones if there are any, else the house's rooms."""
        if any(room.annotation == "user" for room in assembly.regions):
            return assembly.regions
        house_id = _house_id(scene_id)
        house = self._houses.house(house_id)
        turn = _turn(house, objects)
        if turn is None:
            raise FormatError(
                f"the objects of house {house_id!r} are not where scene {scene_id!r} has them: the two do not match",
                where=self._houses.root,
                place=house_id,
                remedy="Use the houses of the same release as Habitat's scenes, one per line, in a file for each split",
            )
        return tuple(
            replace(room, polygon=None if room.polygon is None else room.polygon * turn + 0.0)
            for room in self._houses.rooms(house)
        )


def _house_id(scene_id: str) -> str:
    named = _NAME.match(scene_id)
    assert named is not None
    return f"{named['split'].lower()}-{named['number']}"


def _turn(house: House, objects: Sequence[SceneObject]) -> int | None:
    """Return 1 if the objects of house and scene are in the same places, −1 if they are in the same places after the
    house is turned by 180°, None otherwise.
    """
    if not house.objects or not objects:
        return 1
    tree = cKDTree(np.array([item.center for item in objects]))
    places = np.array([item.position for item in house.objects])
    shares = {}
    for turn in (1, -1):
        distance, _ = tree.query(places * [turn, 1, turn])
        shares[turn] = float((distance <= SAME_PLACE).mean())
    best = max(shares, key=lambda turn: shares[turn])
    return best if shares[best] >= LEAST_SHARE else None


_FILE: Final = re.compile(r"^(?P<stem>.+?)(?P<suffix>\.jsonl|\.jsonl\.gz|\.json)$")
_NUMBERED: Final = re.compile(r"^(?P<stem>.+)-(?P<number>0|[1-9][0-9]{0,8})$")
MAX_LIST_BYTES: Final = 256 << 20
"""Size limit in bytes of a list of houses, which is read as a whole; 3,000 houses."""
_HOUSE_KEYS: Final = (b'"rooms"', b'"walls"')
"""Keys that distinguish a house from other JSON in the same folder."""

_GENERATED: Final = b'"proceduralParameters"'
_LINE_KEYS: Final = (*_HOUSE_KEYS, b'"doors"', b'"windows"', _GENERATED)
"""Keys of which any one makes a line a house, so that a damaged line still counts as a house."""


class ProcthorSource(Source):
    """Houses in the files of a folder and of its direct subfolders.

    Ids are ``<file>-<line, from 0>`` for files with one house per line, ``<file>-<entry, from 0>`` for files that are a
    list, ``<file>`` for files of one house, with the subfolder in front if there is one. The asset database is in the
    root folder.
    """

    family: ClassVar[str] = "procthor"

    def __init__(self, root: Path, options: SourceOptions) -> None:
        super().__init__(root, options)
        self._list: tuple[tuple[object, ...], list[bytes], InputError | None] | None = None
        self._database: tuple[tuple[int, int], AssetDatabase | InputError] | None = None
        self._house: tuple[tuple[str, bytes], House] | None = None
        if not self._files() and not self._lost:
            raise ConfigError(
                "no houses (*.jsonl, *.jsonl.gz, *.json) are in this folder",
                where=root,
                remedy="Download ProcTHOR's houses, or set the source's 'root' to their folder",
            )

    def listing(self) -> Iterator[tuple[str, Note]]:
        """See `Source.listing`. If a JSON Lines file can't be read to its end, the listing has a fault whose id is
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
                if suffix != ".json":
                    yield from self._houses_of(stem, path, self._lines(path).lines())
                    if self._lines(path).trailing:
                        self.pass_over(f"{path}#end", "bytes after the end of the gzip data are ignored")
                    continue
                if first_character(self.files.path(path)) == "[":
                    houses, fault = self._entries(path)
                    yield from self._houses_of(stem, path, enumerate(houses))
                    if fault is not None:
                        raise fault
                    continue
                data = self.files.read(path, MAX_LIST_BYTES)
                if all(key in data for key in _HOUSE_KEYS) or _GENERATED in data:
                    yield stem, partial(self._note, stem, path, data)
                else:
                    # A truncated file may have been a house.
                    parse_json(data, str(self.root / path))
                    self.pass_over(path, "JSON that is not a house")
            except InputError as error:
                yield stem, partial(_fail, error)

    def _houses_of(self, stem: str, path: str, records: Iterable[tuple[int, bytes]]) -> Iterator[tuple[str, Note]]:
        """Yield the id of each house in a file with one house per record (a line, or an entry of a list), with a
        function that records the house's inputs. A file without any house is skipped if its first record is JSON.

        Raises
        ------
        InputError : the file can't be read, or holds neither houses nor other JSON
        """
        earlier: list[int] = []
        first, houses = b"", False
        for number, data in records:
            if not houses and not any(key in data for key in _LINE_KEYS):
                earlier.append(number)
                first = first or data
                continue
            if not houses:  # there is a house, so the earlier records are damaged houses
                for broken in earlier:
                    yield f"{stem}-{broken}", partial(self._note_again, f"{stem}-{broken}", path, broken)
            houses = True
            yield f"{stem}-{number}", partial(self._note, f"{stem}-{number}", f"{path}#{number}", data)
        if not houses and earlier:
            parse_json(first, f"{self.root / path}#{earlier[0]}")
        if not houses:
            noun = "entries" if path.endswith(".json") else "lines"
            why = f"none of its {len(earlier)} {noun} is a house" if earlier else f"the file has no {noun}"
            self.pass_over(path, why)

    def scene(self, scene_id: str) -> Scene:
        """Return one house; see `Source.read`."""
        house, ledger = self.house(scene_id), InputLedger()
        database = self._assets()
        rooms = self.drawn_rooms([scene_id], ledger) or self.rooms(house)
        kinds = {o.object_id: database.asset(o.asset_id, ledger) for o in house.objects}
        objects = [self._object(o, kinds[o.object_id]) for o in house.objects]
        placed, lost = _with_parents_rooms(objects, house, rooms)
        warnings = {*lost, *_assets_without_extent(house, kinds)}
        for name, text in house.warnings:
            code = re.sub(r"(?<=[a-z0-9])(?=[A-Z])", "_", name).lower()  # fooBar becomes foo_bar
            warnings.add(SceneWarning(code, "metadata.warnings", text))
        unnamed = {o.room_id for o in placed if o.raw_label == UNKNOWN_LABEL}
        # If some object has no label, no absence can be claimed.
        rooms = tuple(replace(r, complete=r.room_id not in unnamed) for r in rooms)
        return self.made(scene_id, rooms, placed, warnings, self.shipped_navmeshes(scene_id, ledger))

    def geometry(self, scene: Scene) -> SceneGeometry:
        """Return floors, walls with holes for open doors and windows, and objects as boxes; see `Source.geometry`.

        There are no ceilings, since a navmesh would be built on them too.
        """
        structure = house_structure(self.house(scene.scene_id), f"{self.root}: {scene.scene_id}")
        return joined([*structure, object_boxes(enumerate(scene.objects))], approximate=True)

    def house(self, scene_id: str) -> House:
        """Return the raw record of a house in Habitat's frame, including walls, doors and windows. The house that was
        asked for last is not parsed again, unless its file has changed.

        Raises
        ------
        InputError : as `read`
        """
        name, data = record = self.record(scene_id)
        if self._house is None or self._house[0] != record:
            self._house = record, read_house(parse_json(data, str(self.root / name)))
        return self._house[1]

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
        if not path.endswith(".json"):
            return f"{path}#{number}", self._lines(path).line(number)
        houses, fault = self._entries(path)
        if number < len(houses):
            return f"{path}#{number}", houses[number]
        raise fault or MissingFileError(
            f"the list has {len(houses)} houses, so none of number {number}",
            where=self.root / path,
            remedy="Correct the scene's id",
        )

    def _entries(self, path: str) -> tuple[list[bytes], InputError | None]:
        """Return the entries of a list of houses, and why no more of it can be read. The last list is kept until its
        file changes.
        """
        size, changed = self.files.signature(path)
        if self._list is None or self._list[0] != (path, size, changed):
            if size > MAX_LIST_BYTES:
                what = f"a list of houses is larger than {MAX_LIST_BYTES} bytes"
                raise FormatError(what, where=self.root / path, remedy="Write one house per line (*.jsonl) instead")
            houses: list[bytes] = []
            fault: InputError | None = None
            try:
                houses.extend(text.encode() for _, text in entries(self.files.path(path), scalars=True))
            except InputError as error:
                fault = error
            self._list = (path, size, changed), houses, fault
        return self._list[1:]

    def _place(self, scene_id: str) -> tuple[str, int | None]:
        """Return the file of a house, and its number in a file of several."""
        files = self._files()
        if (scene_id, ".json") in files:
            return files[scene_id, ".json"], None
        named = _NUMBERED.match(scene_id)
        for suffix in (".jsonl", ".jsonl.gz", ".json"):
            if named is not None and (named["stem"], suffix) in files:
                return files[named["stem"], suffix], int(named["number"])
        raise self.not_there(scene_id)

    def _files(self) -> dict[tuple[str, str], str]:
        """Return the path of every file that may hold houses, by (id without line number, suffix), sorted."""
        found: dict[tuple[str, str], str] = {}
        for path in self.matching("*.json*", "*/*.json*"):
            named = _FILE.match(path)
            if named is None:
                self.pass_over(path, "its name does not end in .json, .jsonl or .jsonl.gz")
            elif path not in FILE_NAMES:
                found[named["stem"], named["suffix"]] = path
        return dict(sorted(found.items()))

    @kept
    def _lines(self, path: str) -> JsonLines:
        return JsonLines(self.files, path)

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

    def _note_again(self, scene_id: str, path: str, number: int, ledger: InputLedger) -> None:
        self._note(scene_id, *self._record(path, number), ledger)

    def _note(self, scene_id: str, name: str, data: bytes, ledger: InputLedger) -> None:
        """Record the inputs that a house is read from, without building the house."""
        ledger.record(name, data)
        database = self._assets()
        rooms, asset_ids = _rooms_and_assets(data, str(self.root / name))
        ledger.rooms, ledger.objects = rooms, len(asset_ids)
        for asset_id in set(asset_ids):
            database.asset(asset_id, ledger)
        self.drawn_rooms([scene_id], ledger)
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
            made_room(
                self.family,
                room.room_id,
                room.room_type,
                (0.0, tops.get(room.room_id, highest)),
                check_polygon(room.polygon, room.node["floorPolygon"]),
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
        found = SceneObject(
            object_id=item.object_id,
            room_id="",
            raw_label=raw,
            label=vocabulary.canonical(raw, self.family),
            center=round_mm(item.position),
            static=item.kinematic,
            receptacles=() if item.parent_id is None else (item.parent_id,),
            openness=item.openness,
        )
        if asset is None or asset.size is None:
            return found
        parts = counter_parts(item.asset_id, item.position, asset.size, item.rotation)
        return replace(with_box(found, OrientedBox(item.position, asset.size / 2, item.rotation)), parts=parts)


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


def _assets_without_extent(house: House, kinds: dict[str, Asset | None]) -> Iterator[SceneWarning]:
    unknown = Counter(o.asset_id for o in house.objects if kinds[o.object_id] is None)
    for asset_id, count in sorted(unknown.items()):
        yield SceneWarning("unknown_asset", asset_id, f"not in the asset database: extent of {count} unknown")
    boxless = Counter(o.asset_id for o in house.objects if (kind := kinds[o.object_id]) and kind.size is None)
    for asset_id, count in sorted(boxless.items()):
        yield SceneWarning("no_box", asset_id, f"the asset database has no sound box of it: extent of {count} unknown")


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
