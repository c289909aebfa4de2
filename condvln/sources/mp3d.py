"""Matterport3D: scans of buildings with regions and oriented object boxes, in Habitat's or the original folder
structure.
"""

from __future__ import annotations

import posixpath
from collections.abc import Iterator
from functools import partial
from pathlib import Path, PurePosixPath
from typing import ClassVar, Final

import numpy as np
import shapely

from condvln.formats.dataset_root import DatasetRoot
from condvln.labels import vocabulary
from condvln.scene import MeshPart, OrientedBox, Room, Scene, SceneObject, SceneWarning, round_mm
from condvln.scene.boxes import aabb_of, box_corners, placement, rounded_box
from condvln.scene.frames import Z_UP_TO_HABITAT
from condvln.scene.geometry import SceneGeometry
from condvln.scene.limits import check_limits
from condvln.sources.house_file import HouseFile, HouseObject, HouseRegion, read_house_file
from condvln.sources.input_ledger import InputLedger
from condvln.sources.mesh_geometry import scan_geometry
from condvln.sources.regions import in_rooms, side_regions, typed_by_contents
from condvln.sources.scene_source import Note, SceneSource, SourceOptions
from condvln.sources.slices import joined_slices
from condvln.sources.source import UNKNOWN_LABEL
from schemas.errors import ConfigError, FormatError

__all__ = ["Mp3dSource"]

MAX_HOUSE_BYTES: Final = 512 << 20
LAYOUTS: Final = tuple(
    f"{scans}*/{inside}*.house" for scans in ("", "scans/", "v1/scans/") for inside in ("", "house_segmentations/")
)
"""Path of ``<scan>.house``: Habitat's ``<scan>/``, or the original ``[v1/scans/]<scan>/house_segmentations/``."""
GRAPHS: Final = "connectivity"
"""Folder of the dataset with ``<scan>_connectivity.json``."""
MAX_GRAPH_BYTES: Final = 64 << 20
AXIS_TOLERANCE: Final = 1e-3


class Mp3dSource(SceneSource):
    """Matterport3D scans, by their ids.

    An object's room is the region stated in the file, not the one that contains its centre: a fifth of the centres lie
    in no region or in another one. Slices of one object, cut at a region's border, are merged (see `slices`).
    ``<scan>.glb`` and ``<scan>.navmesh`` are used if they are in the scan's folder.
    """

    family: ClassVar[str] = "mp3d"
    bytes_per_object: ClassVar[float] = 11_000.0
    objects_per_room: ClassVar[float] = 25.0

    def __init__(self, root: Path, options: SourceOptions) -> None:
        super().__init__(root, options)
        if not self._scans():
            raise ConfigError(
                "no scans (<scan>/<scan>.house or <scan>/house_segmentations/<scan>.house) are in this folder",
                where=root,
                remedy="Download Matterport3D (you must accept its terms), or correct the source's 'root'",
            )

    def listing(self) -> Iterator[tuple[str, Note]]:
        """See `SceneSource.listing`."""
        for scene_id, path in self._scans().items():
            yield scene_id, partial(self._note, scene_id, path)

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
        if self.options.regions is not None:
            drawn = side_regions(self.options.regions, [scene_id], self.family, ledger)
            if drawn:
                rooms = drawn
                items, warnings = in_rooms(items, drawn)
        rooms = typed_by_contents(rooms, items)
        stage, navmeshes = self._beside(scene_id, path, ledger)
        return Scene(
            family=self.family,
            scene_id=scene_id,
            root=self.root,
            rooms=tuple(sorted(rooms, key=lambda r: r.room_id)),
            objects=tuple(sorted(items, key=lambda o: o.object_id)),
            shipped_navmeshes=navmeshes,
            stage=stage,
            warnings=tuple(sorted(set(warnings), key=lambda w: (w.code, w.where, w.message))),
        )

    def geometry(self, scene: Scene) -> SceneGeometry | None:
        """Return the scan's mesh; see `Source.geometry`. None if the file is missing: no walls are generated."""
        return scan_geometry(self.files, scene)

    def house(self, scene_id: str) -> HouseFile:
        """Return the raw record of a scan, including panoramas, portals and categories, in the file's frame.

        Raises
        ------
        InputError : as `read`
        """
        return self._house(scene_id)[0]

    def _house(self, scene_id: str) -> tuple[HouseFile, str]:
        path = self._scans().get(scene_id)
        if path is None:
            raise self.not_there(scene_id)
        return read_house_file(self.files.read(path, MAX_HOUSE_BYTES), str(self.root / path)), path

    def _note(self, scene_id: str, path: str, ledger: InputLedger) -> None:
        ledger.file(path)
        if self.options.regions is not None:
            side_regions(self.options.regions, [scene_id], self.family, ledger)
        self._beside(scene_id, path, ledger)
        graph = self.connectivity(scene_id)
        if graph is not None:
            ledger.record(f"{GRAPHS}/{graph.name}", DatasetRoot(graph.parent).read(graph.name, MAX_GRAPH_BYTES))

    def connectivity(self, scene_id: str) -> Path | None:
        """See `SceneSource.connectivity`. Also None if the scan has a mesh or a navmesh."""
        path = self._scans().get(scene_id)
        if path is None:
            return None
        stage, navmeshes = self._beside(scene_id, path, InputLedger())
        if stage or any(self.files.has(navmesh) for navmesh in navmeshes):
            return None
        graph = (self.options.connectivity or self.root / GRAPHS) / f"{scene_id}_connectivity.json"
        return graph if graph.is_file() else None

    def _beside(self, scene_id: str, path: str, ledger: InputLedger) -> tuple[tuple[MeshPart, ...], tuple[str, ...]]:
        """Return the scan's mesh and the possible paths of its navmesh. Both are looked for in the scan's folder and
        beside its ``.house`` file.
        """
        folder = posixpath.dirname(path)
        folders = list(dict.fromkeys([folder.removesuffix("/house_segmentations"), folder]))
        mesh = next((m for m in (f"{f}/{scene_id}.glb" for f in folders) if self.files.has(m)), None)
        stage: tuple[MeshPart, ...] = ()
        if mesh is not None:
            ledger.file(mesh)
            stage = (MeshPart(mesh, placement(Z_UP_TO_HABITAT)),)
        own = [f"{f}/{scene_id}.navmesh" for f in folders]
        return stage, self.shipped_navmeshes(scene_id, ledger, own)

    def _scans(self) -> dict[str, str]:
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
    return Room(
        room_id=f"region_{region.index}",
        raw_label=region.label,
        label=vocabulary.room_type(region.label, family),
        level=region.level,
        floor_y=float(round_mm(region.floor)),
        ceiling_y=float(round_mm(region.floor + region.height)),
        polygon=corners,
        annotation="dataset",
        complete=True,
    )


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
        box = _box(entry)
        if box is None:
            warnings.append(SceneWarning("no_box", object_id, "its axes are not a frame: extent unknown"))
        aabb = None if box is None else round_mm(aabb_of(box_corners(box)))
        items.append(
            SceneObject(
                object_id=object_id,
                room_id=room_of[entry.region].room_id,
                raw_label=raw,
                label=vocabulary.canonical(raw, family),
                center=round_mm(Z_UP_TO_HABITAT @ entry.centre),
                aabb=aabb,
                obb=None if box is None else rounded_box(box),
                size=None if aabb is None else round_mm(aabb[1] - aabb[0]),
                radius=float(np.ceil(np.linalg.norm(entry.half_lengths) * 1000) / 1000),
            )
        )
    return items, warnings


def _box(entry: HouseObject) -> OrientedBox | None:
    """Return the oriented box in Habitat's frame; None if its axes are not orthogonal."""
    if not np.allclose(entry.axes.T @ entry.axes, np.eye(3), atol=AXIS_TOLERANCE):
        return None
    return OrientedBox(Z_UP_TO_HABITAT @ entry.centre, entry.half_lengths, Z_UP_TO_HABITAT @ entry.axes)
