"""Write layouts as Matterport3D scans: ``.house`` files, panoramas, connectivity, whole-scene GLBs and navmeshes.

The folders are those of the dataset's download (``<scan>/house_segmentations/<scan>.house`` with
``panorama_to_region.txt``, ``connectivity/<scan>_connectivity.json``, the two category tables), plus Habitat's
``<scan>/<scan>.glb`` (z-up) and ``<scan>/<scan>.navmesh``. Panoramas stand on both sides of doorways and
across the floor.

The ``.house`` file (ASCII 1.1) has all kinds of records, as the data organisation page of Matterport3D describes them
(Chang et al. 2017), checked against a real file: two kinds of records begin with P; object boxes are given by half
lengths along their axes, the longest first; ``region_index`` gives an object's room. Frame: (x, y, z) of the layout
becomes (x, −z, y).
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import networkx as nx
import numpy as np
import orjson
import shapely

from condvln.arrays import F64, Bools
from condvln.navigation.settings import NavMeshSettings
from condvln.samples.catalogue import native_labels
from condvln.samples.floor_mesh import convex_polygons, free_floor, navmesh_of, open_plan
from condvln.samples.gibson import version_1
from condvln.samples.layout import Door, Layout, Room
from condvln.samples.models import Z_UP
from condvln.samples.solid import layout_glb, piece_corners

__all__ = [
    "MPCAT40",
    "REGION_LABELS",
    "mp3d_files",
]


SPACING: Final = 1.8
"""Distance in metres between viewpoints on open floor."""

DOOR_STEP: Final = 0.45
"""Distance in metres of the viewpoints on both sides of a doorway."""

REACH: Final = 4.0
"""Largest distance in metres between two connected viewpoints."""

MARGIN: Final = 0.1
"""Least distance in metres of viewpoints from the edge of the free floor."""

Place = tuple[float, float]


@dataclass(frozen=True, eq=False)
class Viewpoints:
    """The positions (n, 2) of n viewpoints as (x, z), and the room of each. Two masks (n, n) say whether two viewpoints
    see each other, and whether the straight path between them is free.
    """

    places: F64
    rooms: tuple[str, ...]
    visible: Bools
    unobstructed: Bools


def viewpoints_of(layout: Layout) -> Viewpoints:
    """Return viewpoints on both sides of every doorway and across the floor. Any two of them are connected by a chain
    of straight free segments.
    """
    floor = free_floor(layout)
    shapely.prepare(floor)
    doors = _thinned(_before_doors(layout), DOOR_STEP / 2)
    places = _thinned(np.concatenate([doors, _grid(layout, floor)]), SPACING / 2, kept=len(doors))
    places = _bridged(places, floor)
    rooms = _rooms(layout, places)
    return Viewpoints(places, rooms, _joined(places, open_plan(layout)), _walks(places, floor))


def _walks(places: F64, floor: shapely.Geometry) -> Bools:
    near: Bools = np.linalg.norm(places[:, None] - places[None], axis=-1) <= REACH
    return _joined(places, floor) & near


def _bridged(places: F64, floor: shapely.Geometry) -> F64:
    """Return the viewpoints `places`, with new viewpoints added until all are connected. The new viewpoints are on
    shortest paths over the floor's convex polygons.
    """
    ways: nx.Graph[Place] = nx.Graph()
    vertices, polygons = convex_polygons(floor)
    shapes = [shapely.Polygon(vertices[polygon]) for polygon in polygons]
    for polygon, shape in zip(polygons, shapes, strict=True):
        middle = _rounded(np.array(shape.centroid.coords[0]))
        for a, b in zip(polygon, [*polygon[1:], polygon[0]], strict=True):
            edge = _rounded((vertices[a] + vertices[b]) / 2)
            ways.add_edge(middle, edge, length=float(np.linalg.norm(np.subtract(middle, edge))))
    for place in places:
        shape = min(shapes, key=lambda s: s.distance(shapely.Point(place)))
        middle = _rounded(np.array(shape.centroid.coords[0]))
        ways.add_edge(_rounded(place), middle, length=float(np.linalg.norm(place - middle)))
    while True:
        parts = list(nx.connected_components(nx.from_numpy_array(_walks(places, floor))))
        if len(parts) == 1:
            return places
        here = {_rounded(places[i]) for i in parts[0]}
        there = {_rounded(place) for place in places} - here
        lengths = nx.multi_source_dijkstra_path_length(ways, here, weight="length")
        paths = nx.multi_source_dijkstra_path(ways, here, weight="length")
        nearest = min(there, key=lambda place: (lengths[place], place))
        known = here | there
        places = np.concatenate([places, [step for step in paths[nearest] if step not in known]])


def _rounded(place: F64) -> Place:
    x, z = np.round(place, 4).tolist()
    return x + 0.0, z + 0.0


def _before_doors(layout: Layout) -> F64:
    places = []
    for door in layout.doors:
        x, z = door.center
        away = (0.0, DOOR_STEP) if door.along_x else (DOOR_STEP, 0.0)
        places += [(x - away[0], z - away[1]), (x + away[0], z + away[1])]
    return np.array(places)


def _grid(layout: Layout, floor: shapely.Geometry) -> F64:
    (x0, z0), (x1, z1) = layout.bounds
    xs, zs = np.arange(x0 + 0.6, x1, SPACING), np.arange(z0 + 0.6, z1, SPACING)
    grid = np.round(np.stack(np.meshgrid(xs, zs, indexing="ij"), axis=-1).reshape(-1, 2), 3)
    kept: F64 = grid[shapely.covers(floor.buffer(-MARGIN), shapely.points(grid))]
    return kept


def _thinned(places: F64, distance: float, kept: int = 0) -> F64:
    """Return `places` in order, without those nearer than `distance` to an earlier place. The first `kept` places are
    always included.
    """
    chosen: list[F64] = list(places[:kept])
    for place in places[kept:]:
        if all(np.linalg.norm(place - other) >= distance for other in chosen):
            chosen.append(place)
    return np.array(chosen)


def _joined(places: F64, area: shapely.Geometry) -> Bools:
    """Return a mask (n, n): whether two different viewpoints are connected by a straight line inside `area`."""
    n = len(places)
    pairs = np.stack(np.broadcast_arrays(places[:, None], places[None]), axis=2)
    joined: Bools = shapely.covers(area, shapely.linestrings(pairs.reshape(-1, 2, 2))).reshape(n, n)
    return joined & ~np.eye(n, dtype=bool)


def _rooms(layout: Layout, places: F64) -> tuple[str, ...]:
    inside = [shapely.covers(room.shape, shapely.points(places)) for room in layout.rooms]
    return tuple(layout.rooms[index].room_id for index in np.argmax(inside, axis=0))


REGION_LABELS: Final = {
    "kitchen": "k",
    "living room": "l",
    "bedroom": "b",
    "bathroom": "a",
    "dining room": "d",
    "office": "o",
    "laundry room": "j",
    "hallway": "h",
}
"""Matterport3D's letters of our room types."""

STRUCTURE: Final = (("wall", 1), ("floor", 2), ("ceiling", 17))
"""Structure that is annotated as objects in every region, with its mpcat40 index."""

MPCAT40: Final = (
    "void", "wall", "floor", "chair", "door", "table", "picture", "cabinet",
    "cushion", "window", "sofa", "bed", "curtain", "chest_of_drawers", "plant", "sink",
    "stairs", "ceiling", "toilet", "stool", "towel", "mirror", "tv_monitor", "shower",
    "column", "bathtub", "counter", "fireplace", "lighting", "beam", "railing", "shelving",
    "blinds", "gym_equipment", "seating", "board_panel", "furniture", "appliances", "clothes", "objects",
    "misc", "unlabeled",
)  # fmt: skip
"""Matterport3D's coarse categories, by index."""

CAMERA_HEIGHT: Final = 1.5
"""Height in metres of a panorama above the floor."""

SURFACE: Final = 0.02
"""Thickness in metres of the boxes of structure."""

INTRINSICS: Final = (1073.5, 0.0, 640.0, 0.0, 1073.5, 512.0, 0.0, 0.0, 1.0)
IMAGE_SIZE: Final = (1280, 1024)
"""Camera matrix by rows, and image size in pixels."""

UNLABELLED_HALF: Final = np.array([0.4, 0.5, 0.4])
"""Half extents in metres of the one object without a category; real houses have such objects."""

Record = Sequence[object]


def categories() -> list[tuple[str, int]]:
    """Return (raw category, mpcat40 index) of everything that may be annotated; the list is the same in every house."""
    return [*STRUCTURE, *sorted({(native.mp3d, native.mpcat40) for native in native_labels().values()})]


def scan_point(x: float, y: float, z: float) -> list[float]:
    """Return a point of the layout in the scan's frame."""
    return [x, -z, y]


def _box(low: F64, high: F64) -> list[float]:
    """Return the lower and then the upper corner of a box in the scan's frame, as six numbers."""
    return [*scan_point(low[0], low[1], high[2]), *scan_point(high[0], high[1], low[2])]


def _text(value: object) -> str:
    # Six significant digits, as in the originals.
    return f"{value + 0.0:.6g}" if isinstance(value, float) else str(value)


def house_text(name: str, layout: Layout, views: Viewpoints, ids: list[str]) -> bytes:
    """Return the bytes of the ``.house`` file, with its records in the order of real files. `ids` are the panorama ids
    of the viewpoints.
    """
    number = {room.room_id: i for i, room in enumerate(layout.rooms)}
    regions, surfaces, vertices = _regions(layout)
    panoramas, images = _panoramas(views, ids, number)
    portals = [_portal(i, door, number) for i, door in enumerate(layout.doors)]
    listed = [
        ["C", i, i + 1, raw.replace(" ", "#"), index, MPCAT40[index], 0, 0, 0, 0, 0]
        for i, (raw, index) in enumerate(categories())
    ]
    objects, segments = _objects(layout, number)
    counted = (images, panoramas, vertices, surfaces, segments, objects, listed, regions, portals)
    (x0, z0), (x1, z1) = layout.bounds
    whole = _box(np.array([x0, 0.0, z0]), np.array([x1, layout.ceiling, z1]))
    middle = scan_point((x0 + x1) / 2, 0.0, (z0 + z1) / 2)
    head: list[Record] = [
        ["ASCII", "1.1"],
        ["H", name, "-", *(len(part) for part in counted), 1, 0, 0, 0, 0, 0, *whole, 0, 0, 0, 0, 0],
        ["L", 0, len(layout.rooms), "-", *middle, *whole, 0, 0, 0, 0, 0],
    ]
    records = [*head, *regions, *portals, *surfaces, *vertices, *panoramas, *images, *listed, *objects, *segments]
    return "".join(" ".join(map(_text, record)) + "\n" for record in records).encode()


def _regions(layout: Layout) -> tuple[list[Record], list[Record], list[Record]]:
    """Return the R records of the regions, the S records of their floors, and the V records of the floors' corners."""
    regions: list[Record] = []
    surfaces: list[Record] = []
    vertices: list[Record] = []
    for i, room in enumerate(layout.rooms):
        flat, box = _region_box(room, layout.ceiling)
        center = [(flat[0] + flat[3]) / 2, (flat[1] + flat[4]) / 2, 0.0]
        regions.append(["R", i, 0, 0, 0, REGION_LABELS[room.label], *center, *box, layout.ceiling, 0, 0, 0, 0])
        surfaces.append(["S", i, i, 0, "F", *center, 0, 0, 1, *flat, 0, 0, 0, 0, 0])
        for corner in _outline(room):
            vertices.append(["V", len(vertices), i, "F", *corner, 0, 0, 1, 0, 0, 0])
    return regions, surfaces, vertices


def _panoramas(views: Viewpoints, ids: list[str], number: Mapping[str, int]) -> tuple[list[Record], list[Record]]:
    """Return the panorama records (P), and one image record (I) for each panorama."""
    panoramas: list[Record] = []
    images: list[Record] = []
    for i, (pano, place) in enumerate(zip(ids, views.places.tolist(), strict=True)):
        spot = scan_point(place[0], CAMERA_HEIGHT, place[1])
        panoramas.append(["P", pano, i, number[views.rooms[i]], 0, *spot, 0, 0, 0, 0, 0])
        images.append(["I", i, i, pano, 0, 0, *pose(spot), *INTRINSICS, *IMAGE_SIZE, *spot, 0, 0, 0, 0, 0])
    return panoramas, images


def pose(spot: list[float]) -> list[float]:
    """Return the 4 × 4 camera-to-world matrix of a camera at `spot`, row by row. Camera axes: x right, y down, z
    forward; the camera looks along +y.
    """
    return [1.0, 0.0, 0.0, spot[0], 0.0, 0.0, 1.0, spot[1], 0.0, -1.0, 0.0, spot[2], 0.0, 0.0, 0.0, 1.0]


def _outline(room: Room) -> list[list[float]]:
    """Return the floor corners, counter-clockwise in the scan's frame."""
    return [scan_point(x, 0.0, z) for x, z in reversed(room.polygon)]


def _region_box(room: Room, ceiling: float) -> tuple[list[float], list[float]]:
    """Return two boxes of a region: its floor, and the whole prism from floor to ceiling."""
    x0, z0, x1, z1 = room.shape.bounds
    low, high = np.array([x0, 0.0, z0]), np.array([x1, ceiling, z1])
    return _box(low, high * [1, 0, 1]), _box(low, high)


def _portal(index: int, door: Door, number: Mapping[str, int]) -> Record:
    (x0, z0), (x1, z1) = door.start, door.end
    box = _box(np.array([x0, 0.0, z0]), np.array([x1, door.height, z1]))
    return ["P", index, *(number[room] for room in door.rooms), "-", *box, 0, 0, 0, 0]


def _objects(layout: Layout, number: Mapping[str, int]) -> tuple[list[Record], list[Record]]:
    """Return the object (O) and segment (E) records of a ``.house`` file. Objects are the furniture, a wall, the floor
    and the ceiling of each region, and one object without a label; segments are their parts.
    """
    index_of = {raw: i for i, (raw, _) in enumerate(categories())}
    objects: list[Record] = []
    segments: list[Record] = []

    def add(region: int, category: int, center: F64, axes: F64, half: F64, parts: list[F64]) -> None:
        # The longest axis comes first, whichever it is; the third follows from the first two.
        order = np.argsort(-half, kind="stable")
        middle = scan_point(*center.tolist())
        directions = [c for axis in order[:2] for c in scan_point(*axes[:, axis].tolist())]
        place = [*middle, *directions, *half[order].tolist()]
        objects.append(["O", len(objects), region, category, *place, 0, 0, 0, 0, 0, 0, 0, 0])
        for corners in parts:
            low, high = corners.min(axis=0), corners.max(axis=0)
            spot = scan_point(*((low + high) / 2).tolist())
            ident = region * 1_000_000 + len(segments)
            area = float(np.prod(high[[0, 2]] - low[[0, 2]]))
            segments.append(["E", len(segments), len(objects) - 1, ident, area, *spot, *_box(low, high), 0, 0, 0, 0, 0])

    for piece in layout.furniture:
        category = index_of[native_labels()[piece.label].mp3d]
        half = np.array(piece.size) / 2
        add(number[piece.room_id], category, np.array(piece.center), piece.yaw.matrix, half, list(piece_corners(piece)))
    for room in layout.rooms:
        for (raw, _), (low, high) in zip(STRUCTURE, _structure(room, layout.ceiling), strict=True):
            add(
                number[room.room_id],
                index_of[raw],
                (low + high) / 2,
                np.eye(3),
                (high - low) / 2,
                [np.stack([low, high])],
            )
    x, z = layout.rooms[0].shape.representative_point().coords[0]
    add(0, -1, np.array([x, UNLABELLED_HALF[1], z]), np.eye(3), UNLABELLED_HALF, [])
    return objects, segments


def _structure(room: Room, ceiling: float) -> list[tuple[F64, F64]]:
    """Return the boxes of one wall, the floor and the ceiling of a room."""
    x0, z0, x1, z1 = room.shape.bounds
    spans = ((z0, 0.0, z0 + SURFACE, ceiling), (z0, -SURFACE, z1, 0.0), (z0, ceiling, z1, ceiling + SURFACE))
    return [(np.array([x0, y0, za]), np.array([x1, y1, zb])) for za, y0, zb, y1 in spans]


MAPPING_HEADER: Final = (
    "index", "raw_category", "category", "count", "nyuId", "nyu40id", "eigen13id",
    "nyuClass", "nyu40class", "eigen13class", "ModelNet40", "ModelNet10", "ShapeNetCore55", "synsetoffset",
    "wnsynsetid", "wnsynsetkey", "mpcat40index", "mpcat40",
)  # fmt: skip


def mp3d_files(layouts: Mapping[str, Layout]) -> Iterator[tuple[str, bytes]]:
    """Yield all files of the dataset as (path relative to its root, bytes)."""
    rows = [_mapping_row(i, name, index) for i, (name, index) in enumerate(categories(), start=1)]
    yield "category_mapping.tsv", _table([MAPPING_HEADER, *rows])
    yield "mpcat40.tsv", _table([["mpcat40index", "mpcat40"], *([str(i), name] for i, name in enumerate(MPCAT40))])
    for name, layout in layouts.items():
        views = viewpoints_of(layout)
        ids = [hashlib.sha256(f"{name}/{i}".encode()).hexdigest()[:32] for i in range(len(views.places))]
        segmentations = f"{name}/house_segmentations"
        yield f"{segmentations}/{name}.house", house_text(name, layout, views, ids)
        yield f"{segmentations}/panorama_to_region.txt", _panorama_regions(layout, views, ids)
        yield f"connectivity/{name}_connectivity.json", orjson.dumps(_connectivity(views, ids))
        yield f"{name}/{name}.glb", layout_glb(layout, Z_UP)
        yield f"{name}/{name}.navmesh", version_1(navmesh_of(layout, NavMeshSettings())).to_bytes()


def _mapping_row(number: int, name: str, index: int) -> list[str]:
    filled = {"index": str(number), "raw_category": name, "category": name, "count": "1"}
    filled |= {"mpcat40index": str(index), "mpcat40": MPCAT40[index]}
    return [filled.get(column, "") for column in MAPPING_HEADER]


def _table(rows: Sequence[Sequence[str]]) -> bytes:
    return "".join("\t".join(row) + "\n" for row in rows).encode()


def _panorama_regions(layout: Layout, views: Viewpoints, ids: list[str]) -> bytes:
    order = [room.room_id for room in layout.rooms]
    lines = [
        f"{i} {pano} {order.index(room)} {REGION_LABELS[layout.room_of[room].label]}\n"
        for i, (pano, room) in enumerate(zip(ids, views.rooms, strict=True))
    ]
    return "".join(lines).encode()


def _connectivity(views: Viewpoints, ids: list[str]) -> list[dict[str, Any]]:
    return [
        {
            "image_id": pano,
            "pose": pose(scan_point(place[0], CAMERA_HEIGHT, place[1])),
            "included": True,
            "visible": views.visible[i].tolist(),
            "unobstructed": views.unobstructed[i].tolist(),
            "height": CAMERA_HEIGHT,
        }
        for i, (pano, place) in enumerate(zip(ids, views.places.tolist(), strict=True))
    ]
