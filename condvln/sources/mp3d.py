"""Matterport3D: scans of buildings with regions and oriented object boxes, in Habitat's or the original folder
structure.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path, PurePosixPath
from typing import ClassVar, Final

import networkx as nx
import numpy as np
import shapely
from numpy.typing import NDArray

from condvln.arrays import F64
from condvln.formats.dataset_root import DatasetRoot
from condvln.labels import vocabulary
from condvln.scene import OrientedBox, Room, Scene, SceneObject, SceneWarning, round_mm
from condvln.scene.boxes import box_corners, rounded_box, with_box
from condvln.scene.rotations import Z_UP_TO_HABITAT
from condvln.scene.scene import check_limits
from condvln.sources.house_file import HouseFile, HouseObject, HouseRegion, read_house_file
from condvln.sources.regions import in_rooms, made_room, typed_by_contents
from condvln.sources.scene_source import ScanSource
from condvln.sources.source import UNKNOWN_LABEL, InputLedger
from schemas.errors import FormatError

__all__ = [
    "COVER",
    "GAP",
    "Mp3dSource",
    "joined_slices",
]

MAX_HOUSE_BYTES: Final = 512 << 20
LAYOUTS: Final = tuple(
    f"{scans}*/{inside}*.house" for scans in ("", "scans/", "v1/scans/") for inside in ("", "house_segmentations/")
)
"""Path of ``<scan>.house``: Habitat's ``<scan>/``, or the original ``[v1/scans/]<scan>/house_segmentations/``."""
GRAPHS: Final = "connectivity"
"""Folder of the dataset with ``<scan>_connectivity.json``."""
MAX_GRAPH_BYTES: Final = 64 << 20
AXIS_TOLERANCE: Final = 1e-3


class Mp3dSource(ScanSource):
    """Matterport3D scans, by their ids.

    An object's room is the region stated in the file, not the one that contains its centre: a fifth of the centres lie
    in no region or in another one. Slices of one object, cut at a region's border, are merged (see `slices`).
    ``<scan>.glb`` and ``<scan>.navmesh`` are used if they are in the scan's folder.
    """

    family: ClassVar[str] = "mp3d"
    bytes_per_object: ClassVar[float] = 11_000.0
    objects_per_room: ClassVar[float] = 25.0

    nothing: ClassVar[tuple[str, str]] = (
        "scans (<scan>/<scan>.house or <scan>/house_segmentations/<scan>.house)",
        "Download Matterport3D (you must accept its terms), or correct the source's 'root'",
    )

    def scene(self, scene_id: str) -> Scene:
        """Return one scan; see `Source.read`."""
        house, path = self._house(scene_id)
        ledger = InputLedger()
        room_of = {region.index: _room(region, self.family, str(self.root / path)) for region in house.regions}
        rooms = tuple(room_of.values())
        items, warnings = _objects(house, room_of, self.family)
        # Slices are searched pair by pair, so limits are checked first.
        check_limits(Scene(self.family, scene_id, self.root, rooms, tuple(items)), self.options.limits)
        items, cut = joined_slices(items, {room.room_id: room for room in rooms}, vocabulary.nameless)
        warnings += cut
        if drawn := self.drawn_rooms([scene_id], ledger):
            rooms = drawn
            items, warnings = in_rooms(items, drawn)
        rooms = typed_by_contents(rooms, items)
        stage, navmeshes = self.beside(scene_id, path, ledger)
        return self.made(scene_id, rooms, items, warnings, navmeshes, stage)

    def house(self, scene_id: str) -> HouseFile:
        """Return the raw record of a scan, including panoramas, portals and categories, in the file's frame.

        Raises
        ------
        InputError : as `read`
        """
        return self._house(scene_id)[0]

    def _house(self, scene_id: str) -> tuple[HouseFile, str]:
        path = self.path_of(scene_id, self.scans())
        return read_house_file(self.files.read(path, MAX_HOUSE_BYTES), str(self.root / path)), path

    def note(self, scene_id: str, path: str, ledger: InputLedger) -> None:
        """See `FileSource.note`."""
        super().note(scene_id, path, ledger)
        graph = self.connectivity(scene_id)
        if graph is not None:
            ledger.record(f"{GRAPHS}/{graph.name}", DatasetRoot(graph.parent).read(graph.name, MAX_GRAPH_BYTES))

    def connectivity(self, scene_id: str) -> Path | None:
        """See `Source.connectivity`. Also None if the scan has a mesh or a navmesh."""
        path = self.scans().get(scene_id)
        if path is None:
            return None
        stage, navmeshes = self.beside(scene_id, path, InputLedger())
        if stage or any(self.files.has(navmesh) for navmesh in navmeshes):
            return None
        graph = (self.options.connectivity or self.root / GRAPHS) / f"{scene_id}_connectivity.json"
        return graph if graph.is_file() else None

    def folders(self, folder: str) -> list[str]:
        """Return the scan's folder and that of its ``.house`` file; see `ScanSource.folders`."""
        return [folder.removesuffix("/house_segmentations"), folder]

    def scans(self) -> dict[str, str]:
        """Return the path of each scan's ``.house``, sorted; if a scan is present in several folder structures, the
        first structure counts.
        """
        found: dict[str, str] = {}
        paths = [PurePosixPath(path) for path in self.matching(*LAYOUTS)]
        for layout in LAYOUTS:
            depth = len(PurePosixPath(layout).parts)
            for path in paths:
                if path.stem in path.parts and len(path.parts) == depth and path.match(layout):
                    found.setdefault(path.stem, path.as_posix())
        return dict(sorted(found.items()))


def _room(region: HouseRegion, family: str, where: str) -> Room:
    corners = round_mm(np.column_stack([region.corners[:, 0], -region.corners[:, 1]]))
    polygon = shapely.Polygon(corners)
    if not polygon.is_valid or not polygon.area > 0:
        # Traced outlines sometimes intersect themselves slightly.
        corrected = shapely.make_valid(polygon)
        parts = [p for p in shapely.get_parts(corrected) if p.geom_type == "Polygon"]
        if not parts:
            raise FormatError(
                f"the floor of region {region.index} has no area",
                where=where,
                place="record S",
                remedy="Take the file from its dataset again",
            )
        largest = max(parts, key=lambda p: float(p.area))
        corners = round_mm(np.array(largest.exterior.coords)[:-1])
    heights = region.floor, region.floor + region.height
    return made_room(family, f"region_{region.index}", region.label, heights, corners, level=region.level)


def _objects(house: HouseFile, room_of: dict[int, Room], family: str) -> tuple[list[SceneObject], list[SceneWarning]]:
    items: list[SceneObject] = []
    warnings: list[SceneWarning] = []
    for entry in house.objects:
        raw = house.categories.get(entry.category, UNKNOWN_LABEL)
        object_id = f"{raw}_{entry.index}"
        if entry.category == -1:
            warnings.append(SceneWarning("unlabelled_object", object_id, "its category is -1"))
        if entry.region == -1:
            warnings.append(SceneWarning("object_outside_rooms", object_id, "its region is -1: left out"))
            continue
        sized = bool((entry.half_lengths >= 0).all())
        box = _box(entry) if sized else None
        if box is None:
            why = "its axes are not a frame" if sized else "a half length is negative"
            warnings.append(SceneWarning("no_box", object_id, f"{why}: extent unknown"))
        item = SceneObject(
            object_id=object_id,
            room_id=room_of[entry.region].room_id,
            raw_label=raw,
            label=vocabulary.canonical(raw, family),
            center=round_mm(Z_UP_TO_HABITAT @ entry.centre),
            radius=float(np.ceil(np.linalg.norm(entry.half_lengths) * 1000) / 1000) if sized else None,
        )
        items.append(item if box is None else with_box(item, box))
    return items, warnings


def _box(entry: HouseObject) -> OrientedBox | None:
    """Return the oriented box in Habitat's frame; None if its axes are not orthogonal."""
    if not np.allclose(entry.axes.T @ entry.axes, np.eye(3), atol=AXIS_TOLERANCE):
        return None
    return OrientedBox(Z_UP_TO_HABITAT @ entry.centre, entry.half_lengths, Z_UP_TO_HABITAT @ entry.axes)


GAP: Final = 0.05
"""Largest distance in metres between the boxes of two slices, and from a slice to the other one's region."""

COVER: Final = 0.6
"""Least share of the smaller cross-section that the other one covers."""


def joined_slices(
    objects: Sequence[SceneObject], rooms: Mapping[str, Room], kept_apart: frozenset[str] = frozenset()
) -> tuple[list[SceneObject], list[SceneWarning]]:
    """Merge the slices of each cut object into one object. Return all objects in the given order, and a warning for
    each merged object.

    Matterport's annotators labelled the scan region by region, so a refrigerator on a border is one object in each
    region that it extends into. Two objects are slices of one if all of the following hold:

    * they have the same category, and stand in different regions of one level;
    * their boxes touch or overlap: no more than ``GAP`` apart;
    * seen along the way from one to the other, the smaller is covered by the other to at least ``COVER``: a cut leaves
      the same cross-section on both sides, while separate objects side by side rarely do;
    * both reach the border: each box comes within ``GAP`` of the other's region.

    Chains of slices are merged too. The merged object is in the region that contains most of its volume.

    Parameters
    ----------
    objects : with their rooms and boxes; objects without a box are unchanged
    kept_apart : labels that are never merged, because they continue across regions or name no single object: walls,
        "unknown"
    """
    of_label: defaultdict[str, list[int]] = defaultdict(list)
    for k, item in enumerate(objects):
        if item.aabb is not None and item.label not in kept_apart and rooms[item.room_id].polygon is not None:
            of_label[item.raw_label].append(k)
    floors = {name: shapely.Polygon(room.polygon) for name, room in rooms.items() if room.polygon is not None}
    whole = nx.empty_graph(len(objects))
    for members in of_label.values():
        boxes = np.array([objects[k].aabb for k in members])
        for at, i in enumerate(members):
            for j in np.flatnonzero(_fit(boxes[at], boxes[at + 1 :])) + at + 1:
                one, other = objects[i], objects[members[j]]
                same_level = rooms[one.room_id].level == rooms[other.room_id].level
                if one.room_id != other.room_id and same_level and _at_the_border(one, other, floors):
                    whole.add_edge(i, members[j])
    found: list[SceneObject] = []
    said: list[SceneWarning] = []
    for members in map(sorted, nx.connected_components(whole)):
        if len(members) == 1:
            found.append(objects[members[0]])
            continue
        item = _joined([objects[k] for k in members])
        found.append(item)
        others = ", ".join(sorted(objects[k].object_id for k in members if objects[k].object_id != item.object_id))
        said.append(SceneWarning("object_cut", item.object_id, f"put together with its slices {others}"))
    return found, said


def _fit(box: F64, others: F64) -> NDArray[np.bool_]:
    """Return a mask (n,): whether each of `others` (n, 2, 3) fits `box` (2, 3). Two boxes fit if they touch, and one of
    the two touching faces nearly covers the other.
    """
    shared = np.minimum(box[1], others[:, 1]) - np.maximum(box[0], others[:, 0])  # below zero where they are apart
    # They are side by side on the ground, along the horizontal axis on which they overlap least.
    along_x = shared[:, 0] <= shared[:, 2]
    smaller = np.minimum(np.maximum(box[1] - box[0], 1e-3), np.maximum(others[:, 1] - others[:, 0], 1e-3))
    covered = np.maximum(shared, 0.0) / smaller
    across = np.where(along_x, covered[:, 2], covered[:, 0])
    return np.asarray((shared.min(axis=1) >= -GAP) & (np.minimum(covered[:, 1], across) >= COVER))


def _at_the_border(one: SceneObject, other: SceneObject, floors: Mapping[str, shapely.Polygon]) -> bool:
    """Return whether each of two objects is within `GAP` of the region that the other object is in."""
    return all(_shadow(item).distance(floors[region.room_id]) <= GAP for item, region in ((one, other), (other, one)))


def _shadow(item: SceneObject) -> shapely.Polygon:
    assert item.aabb is not None
    (x0, _, z0), (x1, _, z1) = item.aabb
    return shapely.box(x0, z0, x1, z1)


def _joined(slices: Sequence[SceneObject]) -> SceneObject:
    """Merge several objects into one with the id and axes of the largest, in the region with most of its volume."""
    volume: defaultdict[str, float] = defaultdict(float)
    for item in slices:
        volume[item.room_id] += _volume(item)
    room_id = min(volume, key=lambda name: (-volume[name], name))
    largest = min(slices, key=lambda item: (-_volume(item), item.object_id))
    aabbs = np.array([item.aabb for item in slices])
    aabb = round_mm(np.array([aabbs[:, 0].min(axis=0), aabbs[:, 1].max(axis=0)]))
    box = None
    if largest.obb is not None:
        axes = largest.obb.rotation
        corners = np.concatenate([box_corners(box) for item in slices for box in item.solids]) @ axes
        low, high = corners.min(axis=0), corners.max(axis=0)
        box = rounded_box(OrientedBox(axes @ ((low + high) / 2), (high - low) / 2, axes))
    half = (aabb[1] - aabb[0]) / 2 if box is None else box.half_extents
    return replace(
        largest,
        room_id=room_id,
        center=round_mm(aabb.mean(axis=0) if box is None else box.center),
        aabb=aabb,
        obb=box,
        radius=float(np.ceil(np.linalg.norm(half) * 1000) / 1000),
    )


def _volume(item: SceneObject) -> float:
    assert item.aabb is not None
    if item.obb is not None:
        return float(np.prod(item.obb.half_extents)) * 8.0
    return float(np.prod(item.aabb[1] - item.aabb[0]))
