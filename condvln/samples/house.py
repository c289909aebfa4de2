"""Write a Matterport3D ``.house`` file (ASCII 1.1) for a layout, with all kinds of records.

Record formats follow the data organisation page of Matterport3D (Chang et al. 2017), checked against a real file: two
kinds of records begin with P; object boxes are given by half lengths along their axes, the longest first;
``region_index`` gives an object's room. Frame: (x, y, z) of the layout becomes (x, −z, y).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from condvln.samples.layout import Door, Layout, Room
from condvln.samples.native_labels import native_labels
from condvln.samples.solid import piece_corners
from condvln.samples.viewpoints import Viewpoints

__all__ = ["CAMERA_HEIGHT", "MPCAT40", "REGION_LABELS", "categories", "house_text", "pose", "scan_point"]

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

F64 = NDArray[np.float64]
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
