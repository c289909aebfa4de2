"""Habitat-Matterport 3D with semantics (HM3DSem): scans whose instances are painted on the mesh.

``<scan>.semantic.txt`` lists the instances, one a line after the heading: number, colour as six hexadecimal digits,
name in quotes, number of the region, −1 for none. ``<scan>.semantic.glb`` is the scan's mesh with these colours, z-up
in metres. Boxes, outlines and heights of regions are not in the release: they are taken from the paint. Types of
regions are the proposals in ``Per_Scene_Region_Weighted_Votes.csv`` of the release's statistics, where the file is in
the dataset's folder.
"""

from __future__ import annotations

import csv
import posixpath
import re
from collections import Counter, defaultdict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import ClassVar, Final

import numpy as np
import shapely
from numpy.typing import NDArray

from condvln.arrays import F64
from condvln.formats.csv_table import csv_columns
from condvln.formats.glb import MAX_GLB_BYTES
from condvln.labels import vocabulary
from condvln.scene import MeshPart, Room, Scene, SceneObject, SceneWarning, round_mm
from condvln.scene.boxes import placement
from condvln.scene.rotations import Z_UP_TO_HABITAT
from condvln.scene.scene import check_limits
from condvln.sources.family import FAMILIES
from condvln.sources.painted_mesh import Paint, read_paint
from condvln.sources.regions import in_rooms, levelled, made_room, typed_by_contents
from condvln.sources.scene_source import ScanSource
from condvln.sources.source import MAX_OBJECTS, UNKNOWN_LABEL, InputLedger
from schemas.errors import FormatError, MissingFileError

__all__ = ["Hm3dSource"]


HEADING: Final = "HM3D Semantic Annotations"
MAX_LIST_BYTES: Final = 64 << 20
MAX_VOTES_BYTES: Final = 64 << 20
LISTS: Final = ("*/*/*.semantic.txt", "*/*.semantic.txt")
"""Paths of the lists: ``<split>/<number>-<scan>/<scan>.semantic.txt``, or the folders of one split alone."""
FOLDERS: Final = {"train": "train", "val_unseen": "val", "test": "test"}
"""Folder in the release of the scans of each group of splits."""
REPEATED: Final = ("example", "minival")
"""Folders whose scans are also in others."""
VOTES: Final = "Per_Scene_Region_Weighted_Votes.csv"
VOTED: Final = ("Scene Name", "Region #", "Weighted Room Proposal")
UNTYPED: Final = "region"
"""Raw label of a region for which there is no proposal, or more than one."""
HALL: Final = "Hall/stairwell"
"""The proposal that does not tell a hallway from a staircase."""
TIE: Final = "Tie:"
"""Start of a proposal of several types."""
FLOOR: Final = "floor"
CEILING: Final = "ceiling"
STEPS: Final = "stairs"
NO_REGION: Final = -1

GAP: Final = 0.15
"""Half of the widest gap in metres that is closed in the outline of a region."""
EVEN: Final = 0.05
"""Metres by which corners of an outline may be off."""
_COLOUR: Final = re.compile(r"[0-9A-Fa-f]{6}")
_REMEDY: Final = "Take the file from its dataset again"


@dataclass(frozen=True, slots=True)
class _Instance:
    """A line of the list; `colour` is None if it can't be read."""

    number: int
    colour: int | None
    name: str
    region: int

    @property
    def object_id(self) -> str:
        """Name and number."""
        return f"{self.name}_{self.number}"


class Hm3dSource(ScanSource):
    """The annotated scans of HM3D, by their folders in the release: ``val/00800-TEEsavR23oF``, also where the dataset's
    folder is that of one split.

    The box of an instance is that of its largest connected piece of paint; a smaller piece elsewhere is named by a
    warning. Parts of the building have no box. An instance without paint is left out, and its region does not count as
    completely annotated.
    """

    family: ClassVar[str] = "hm3d"

    nothing: ClassVar[tuple[str, str]] = (
        "annotated scans (<split>/<number>-<scan>/<scan>.semantic.txt)",
        "Download HM3D with its semantic annotations (you must accept its terms), or correct the source's 'root'",
    )

    def scene(self, scene_id: str) -> Scene:
        """Return one scan; see `Source.read`."""
        path = self.path_of(scene_id, self.scans())
        ledger = InputLedger()
        instances = self._instances(path)
        numbers, said = _colours(instances, str(self.root / path))
        mesh = self._painted(path)
        paint = read_paint(
            self.files.read(mesh, MAX_GLB_BYTES), str(self.root / mesh), placement(Z_UP_TO_HABITAT), numbers
        )
        if paint.unnamed > 0:
            message = f"{paint.unnamed:.1%} of the mesh's area has a colour that is not in the list"
            said.append(SceneWarning("unpainted_area", mesh, message))
        items, unseen = _objects(instances, paint, self.family)
        said += unseen
        if drawn := self.drawn_rooms(self.names(scene_id, path), ledger):
            items, lost = in_rooms(items, drawn)
            rooms = drawn
        else:
            rooms = self._rooms(scene_id, instances, items, paint, ledger)
            known = {room.room_id for room in rooms}
            placed, lost = in_rooms([item for item in items if item.room_id not in known], rooms)
            items = [item for item in items if item.room_id in known] + placed
            rooms = typed_by_contents(rooms, items)
        check_limits(Scene(self.family, scene_id, self.root, rooms, tuple(items)), self.options.limits)
        stage, navmeshes = self.beside(scene_id, path, ledger)
        return self.made(scene_id, rooms, items, [*said, *lost], navmeshes, stage)

    def note(self, scene_id: str, path: str, ledger: InputLedger) -> None:
        """See `FileSource.note`."""
        super().note(scene_id, path, ledger)
        ledger.file(self._painted(path))
        self._proposals(scene_id, ledger)
        instances = self._instances(path)
        ledger.objects = len(instances)
        ledger.rooms = len({one.region for one in instances} - {NO_REGION})

    def scans(self) -> dict[str, str]:
        """Return the path of each scan's list, sorted by scene id. Of a scan that is in several folders, that of its
        split counts.
        """
        found: dict[str, str] = {}
        paths = [path for path in self.matching(*LISTS) if posixpath.basename(posixpath.dirname(path))]
        for path in sorted(paths, key=lambda path: (path.split("/")[0] in REPEATED, path)):
            folder = posixpath.dirname(path)
            name = posixpath.basename(folder)
            if name.partition("-")[2] == _scan(path) and name not in map(posixpath.basename, found):
                found[folder if folder != name else _in_release(name)] = path
        return dict(sorted(found.items()))

    def _painted(self, path: str) -> str:
        mesh = _mesh_of(path)
        if not self.files.has(mesh):
            raise MissingFileError(
                "the scan has no painted mesh",
                where=self.root / mesh,
                remedy="Download the semantic annotations of HM3D again; lists and meshes are in one archive",
            )
        return mesh

    def _instances(self, path: str) -> list[_Instance]:
        return _read_list(self.files.read(path, MAX_LIST_BYTES), str(self.root / path))

    def names(self, scene_id: str, path: str) -> list[str]:
        """Return the names of the scan in the release and of its files; see `FileSource.names`."""
        return [posixpath.basename(scene_id), _scan(path)]

    def beside(self, scene_id: str, path: str, ledger: InputLedger) -> tuple[tuple[MeshPart, ...], tuple[str, ...]]:
        """Return the scan's mesh and the possible paths of its navmesh. Where the mesh with photographs is not there,
        the painted one has the same faces.
        """
        bare = f"{posixpath.dirname(path)}/{_scan(path)}"
        meshes = [f"{bare}.basis.glb", f"{bare}.glb", _mesh_of(path)]
        return self.scan_files(_scan(path), meshes, [f"{bare}.basis.navmesh", f"{bare}.navmesh"], ledger)

    def _proposals(self, scene_id: str, ledger: InputLedger) -> Mapping[int, str]:
        """Return the proposed type of each region that has one."""
        if not self.files.has(VOTES):
            return {}
        data = self.files.read(VOTES, MAX_VOTES_BYTES)
        own = _read_votes(data, str(self.root / VOTES)).get(posixpath.basename(scene_id), {})
        ledger.entry(VOTES, posixpath.basename(scene_id), {str(region): kind for region, kind in own.items()})
        return own

    def _rooms(
        self,
        scene_id: str,
        instances: Sequence[_Instance],
        items: Iterable[SceneObject],
        paint: Paint,
        ledger: InputLedger,
    ) -> tuple[Room, ...]:
        """Return the regions whose paint covers some ground."""
        proposals = self._proposals(scene_id, ledger)
        labels = {item.object_id: item.label for item in items}
        members: defaultdict[int, list[int]] = defaultdict(list)
        for place, one in enumerate(instances):
            members[one.region].append(place)
        rooms = []
        for region in sorted(members.keys() - {NO_REGION}):
            held = {place: labels.get(instances[place].object_id) for place in members[region]}
            room = _room(region, proposals.get(region, UNTYPED), held, paint, self.family)
            if room is not None:
                rooms.append(room)
        return levelled(tuple(rooms))


def _in_release(name: str) -> str:
    """Return the folder of a scan below that of its split, where its number tells the split. Agents look for the scan's
    mesh there.
    """
    group = FAMILIES["hm3d"].official_split(name)
    return name if group is None else f"{FOLDERS[group]}/{name}"


def _scan(path: str) -> str:
    """Return the name of a scan from the path of its list."""
    return posixpath.basename(path).removesuffix(".semantic.txt")


def _mesh_of(path: str) -> str:
    return f"{path.removesuffix('.txt')}.glb"


def _read_list(data: bytes, where: str) -> list[_Instance]:
    """Return the instances of a list.

    Raises
    ------
    FormatError : the list has another heading, is not text in UTF-8, or a line is malformed. A colour that can't be
        read is no error: one line of the release has a single letter in its place.
    """

    def fail(what: str, line: int) -> FormatError:
        return FormatError(what, where=where, place=f"line {line}", remedy=_REMEDY)

    try:
        lines = data.decode("utf-8-sig").splitlines()
    except UnicodeDecodeError as error:
        raise FormatError(f"not text in UTF-8 ({error.reason})", where=where, remedy=_REMEDY) from None
    if not lines or not lines[0].startswith(HEADING):
        raise fail(f"the first line is not {HEADING!r}", 1)
    found: list[_Instance] = []
    try:
        for number, row in enumerate(csv.reader(lines[1:], strict=True), start=2):
            if not "".join(row).strip():
                continue
            if len(row) != 4:
                raise fail(f"{len(row)} fields, not number, colour, name and region", number)
            own, colour, name, region = (cell.strip() for cell in row)
            if not own.isascii() or not own.isdigit() or not re.fullmatch(r"-?[0-9]{1,9}", region) or len(own) > 9:
                raise fail("the number of the instance or of its region is none", number)
            known = _COLOUR.fullmatch(colour)
            found.append(
                _Instance(
                    int(own), int(colour, 16) if known else None, name or UNKNOWN_LABEL, max(int(region), NO_REGION)
                )
            )
    except csv.Error as error:
        raise FormatError(f"not a list of comma-separated values: {error}", where=where, remedy=_REMEDY) from None
    if len(found) > MAX_OBJECTS:
        raise FormatError(f"more than {MAX_OBJECTS} instances", where=where, remedy=_REMEDY)
    twice = [number for number, times in Counter(one.number for one in found).items() if times > 1]
    if twice:
        raise FormatError(f"two instances have the number {min(twice)}", where=where, remedy=_REMEDY)
    return found


def _colours(instances: Sequence[_Instance], where: str) -> tuple[dict[int, int], list[SceneWarning]]:
    """Return the place in the list of each colour's instance, and warnings of instances that can't be told apart."""
    of_colour: defaultdict[int, list[int]] = defaultdict(list)
    said = []
    for place, one in enumerate(instances):
        if one.colour is None:
            said.append(SceneWarning("unreadable_colour", one.object_id, "its colour is not six hexadecimal digits"))
        else:
            of_colour[one.colour].append(place)
    for colour, places in of_colour.items():
        if len(places) > 1:
            for place in places:
                said.append(
                    SceneWarning("shared_colour", instances[place].object_id, f"others have its colour {colour:06X}")
                )
    return {colour: places[0] for colour, places in of_colour.items() if len(places) == 1}, said


def _objects(instances: Sequence[_Instance], paint: Paint, family: str) -> tuple[list[SceneObject], list[SceneWarning]]:
    """Return the instances that have paint, those of no region without a room."""
    areas = np.bincount(paint.body, weights=paint.area)
    first = np.unique(paint.body, return_index=True)[1]
    bodies: defaultdict[int, list[int]] = defaultdict(list)
    for body, cell in enumerate(first):
        bodies[int(paint.instance[cell])].append(body)
    # Cells by body, so that a body is one slice.
    order = np.argsort(paint.body, kind="stable")
    starts = np.concatenate([[0], np.cumsum(np.bincount(paint.body))])
    items: list[SceneObject] = []
    said: list[SceneWarning] = []
    for place, one in enumerate(instances):
        if place not in bodies:
            said.append(SceneWarning("object_without_place", one.object_id, "nothing has its colour: left out"))
            continue
        body = max(bodies[place], key=lambda body: (areas[body], -body))
        label = vocabulary.canonical(one.name, family)
        building = vocabulary.is_structure(label)
        if len(bodies[place]) > 1 and not building:
            share = float(areas[body] / areas[bodies[place]].sum())
            message = f"it is in {len(bodies[place])} pieces: its box is that of the largest, {share:.0%} of its area"
            said.append(SceneWarning("object_in_pieces", one.object_id, message))
        if one.region == NO_REGION:
            message = "the file names no room for it: it is placed by its centre"
            said.append(SceneWarning("no_parent_room", one.object_id, message))
        cells = order[starts[body] : starts[body + 1]]
        box = round_mm([paint.low[cells].min(axis=0), paint.high[cells].max(axis=0)])
        items.append(
            SceneObject(
                object_id=one.object_id,
                room_id="" if one.region == NO_REGION else _room_id(one.region),
                raw_label=one.name,
                label=label,
                center=round_mm((box[0] + box[1]) / 2),
                # The paint of a wall may go round a room, so that a box would fill the room.
                aabb=None if building else box,
                radius=float(np.ceil(np.linalg.norm(box[1] - box[0]) / 2 * 1000) / 1000),
            )
        )
    return items, said


def _room_id(region: int) -> str:
    return f"region_{region}"


def _room(region: int, proposal: str, held: Mapping[int, str | None], paint: Paint, family: str) -> Room | None:
    """Return a region as a room; None if its paint covers no ground.

    Its outline is that of its floor and ceiling together, since furniture hides the floor; of all its paint if it has
    neither.

    held : label of each instance of the region, by place in the list; None for those without paint
    """

    def cells(label: str | None = None) -> NDArray[np.intp]:
        own = [place for place, found in held.items() if found is not None and label in (None, found)]
        return np.flatnonzero(np.isin(paint.instance, own))

    everything, floor, ceiling = cells(), cells(FLOOR), cells(CEILING)
    outline = _outline(paint, np.concatenate([floor, ceiling]))
    if outline is None:
        outline = _outline(paint, everything)
    if outline is None:
        return None
    bottom, top = float(paint.low[everything, 1].min()), float(paint.high[everything, 1].max())
    floor_y = _median(paint.high[floor, 1], paint.area[floor]) if len(floor) else bottom
    ceiling_y = _median(paint.low[ceiling, 1], paint.area[ceiling]) if len(ceiling) else top
    # The proposal does not tell them apart, and a stairwell is no hallway.
    untold = proposal.startswith(TIE) or (proposal == HALL and STEPS in held.values())
    heights = floor_y, ceiling_y if ceiling_y > floor_y else max(top, floor_y)
    named = UNTYPED if untold else proposal
    room = made_room(family, _room_id(region), named, heights, outline, complete=None not in held.values())
    return replace(room, raw_label=proposal)


def _median(heights: F64, areas: F64) -> float:
    """Return the height below which half of the area lies."""
    order = np.argsort(heights, kind="stable")
    sums = np.cumsum(areas[order])
    return float(heights[order][np.searchsorted(sums, sums[-1] / 2)])


def _outline(paint: Paint, cells: NDArray[np.intp]) -> F64 | None:
    """Return the corners (n, 2) of the ground below painted cells, without gaps and holes; None if there is none."""
    low, high = paint.low[cells][:, [0, 2]], paint.high[cells][:, [0, 2]]
    covered = shapely.union_all(shapely.box(low[:, 0], low[:, 1], high[:, 0], high[:, 1]))
    closed = covered.buffer(GAP, join_style="mitre").buffer(-GAP, join_style="mitre")
    parts = [part for part in shapely.get_parts(closed) if part.geom_type == "Polygon" and part.area > 0]
    if not parts:
        return None
    largest = max(parts, key=lambda part: float(part.area))
    corners = round_mm(np.array(shapely.Polygon(largest.exterior).simplify(EVEN).exterior.coords)[:-1])
    outline = shapely.Polygon(corners)
    return corners if outline.is_valid and outline.area > 0 else None


@lru_cache(maxsize=2)
def _read_votes(data: bytes, where: str) -> Mapping[str, Mapping[int, str]]:
    """Return the proposed types by scan folder and region.

    Raises
    ------
    FormatError : the table is not text in UTF-8, or lacks a column
    """
    found: defaultdict[str, dict[int, str]] = defaultdict(dict)
    for scan, region, kind in csv_columns(data, VOTED, where):
        if re.fullmatch(r"[0-9]{1,9}", region) and kind:
            found[scan][int(region)] = kind
    return found
