"""Surfaces of scenes: their meshes in place, or generated floors, walls with openings, and objects as boxes."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np
import shapely
from numpy.typing import ArrayLike, NDArray

from condvln.arrays import F64, I64
from condvln.formats.dataset_root import DatasetRoot
from condvln.formats.glb import MAX_GLB_BYTES
from condvln.formats.triangles import glb_triangles
from condvln.scene import Scene, SceneObject
from condvln.scene.boxes import box_corners, corners
from condvln.scene.meshes import MeshLibrary, WorldMesh
from condvln.scene.scene import STRUCTURE, SceneGeometry
from schemas.config.constants import UNKNOWN_EXTENT

__all__ = [
    "SMALLEST",
    "Hole",
    "Piece",
    "assembled_geometry",
    "boxes",
    "floor",
    "joined",
    "object_boxes",
    "pierced_wall",
    "scan_geometry",
    "upright_slabs",
    "without_holes",
]


BOX_FACES: Final = np.array(
    [
        [0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5],
        [0, 4, 5], [0, 5, 1], [2, 3, 7], [2, 7, 6],
        [0, 2, 6], [0, 6, 4], [1, 5, 7], [1, 7, 3],
    ]
)  # fmt: skip
"""(12, 3) triangles over eight corners (bit 2 is x, bit 1 y, bit 0 z), counter-clockwise seen from outside."""


SMALLEST: Final = 1e-3
"""Least width and height in metres of a piece of wall; smaller pieces are dropped."""


class Hole(NamedTuple):
    """A hole in a wall: its range along the wall, and its range of heights, in metres."""

    near: float
    far: float
    low: float
    high: float


@dataclass(frozen=True, eq=False, slots=True)
class Piece:
    """Some triangles of a scene; fields as in `SceneGeometry`."""

    vertices: F64
    faces: I64
    owner: I64


def joined(pieces: Iterable[Piece], approximate: bool) -> SceneGeometry:
    """Return the scene geometry of all pieces, concatenated in order; `approximate` is as in `SceneGeometry`."""
    parts = [Piece(np.zeros((0, 3)), np.zeros((0, 3), np.int64), np.zeros(0, np.int64)), *pieces]
    starts = np.cumsum([0, *(len(p.vertices) for p in parts[:-1])])
    return SceneGeometry(
        vertices=np.concatenate([p.vertices for p in parts]),
        faces=np.concatenate([p.faces + start for p, start in zip(parts, starts, strict=True)]),
        owner=np.concatenate([p.owner for p in parts]),
        approximate=approximate,
    )


def boxes(eights: ArrayLike, owners: Sequence[int] | I64) -> Piece:
    """Return n boxes of 12 triangles each. `eights` (n, 8, 3) are the boxes' corners in the order of `corners`, and
    `owners` (n,) their owners.
    """
    points = np.asarray(eights, dtype=np.float64).reshape(-1, 8, 3)
    faces = BOX_FACES[None] + 8 * np.arange(len(points))[:, None, None]
    return Piece(points.reshape(-1, 3), faces.reshape(-1, 3), np.repeat(np.asarray(owners, dtype=np.int64), 12))


def object_boxes(objects: Iterable[tuple[int, SceneObject]]) -> Piece:
    """Return boxes for all objects, given as (number, object): the object's parts, else its oriented box, else its
    axis-aligned box.

    An object of unknown extent that has no support becomes a cube of `UNKNOWN_EXTENT`, so that no path leads through
    it.
    """
    eights: list[F64] = []
    owners: list[int] = []
    for number, item in objects:
        own = [box_corners(box) for box in item.solids]
        if not own and item.parent is None and item.support is None:
            own = [corners([item.center - UNKNOWN_EXTENT / 2, item.center + UNKNOWN_EXTENT / 2])]
        eights += own
        owners += [number] * len(own)
    return boxes(eights, owners)


def floor(polygon: F64, y: float) -> Piece:
    """Return a level floor inside a simple polygon (n, 2) of (x, z) at height `y`, facing up."""
    cut = shapely.constrained_delaunay_triangles(shapely.normalize(shapely.Polygon(polygon)))
    rings = np.array([shapely.get_coordinates(part)[:3] for part in shapely.get_parts(cut)]).reshape(-1, 3, 2)
    # The order of the triangles must also depend on the polygon only.
    rings = rings[np.lexsort(rings.reshape(len(rings), -1).T[::-1])]
    first, second = rings[:, 1] - rings[:, 0], rings[:, 2] - rings[:, 0]
    downwards = first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0] > 0
    rings[downwards] = rings[downwards][:, ::-1]
    corner = rings.reshape(-1, 2)
    points = np.column_stack([corner[:, 0], np.full(len(corner), y), corner[:, 1]])
    return Piece(points, np.arange(len(points)).reshape(-1, 3), np.full(len(rings), STRUCTURE))


def upright_slabs(starts: ArrayLike, ends: ArrayLike, bottoms: ArrayLike, tops: ArrayLike, thickness: float) -> Piece:
    """Return n upright boxes along the lines from `starts` to `ends`, both (n, 2) as (x, z). `bottoms` and `tops` (n,)
    are their heights.
    """
    start, end = (np.asarray(p, dtype=np.float64).reshape(-1, 2) for p in (starts, ends))
    low, high = (np.asarray(y, dtype=np.float64).reshape(-1) for y in (bottoms, tops))
    along = end - start
    length = np.linalg.norm(along, axis=1, keepdims=True)
    across = np.column_stack([-along[:, 1], along[:, 0]]) / length * (thickness / 2)
    eight = np.empty((len(start), 8, 3))
    for number in range(8):
        far, up, side = number >> 2 & 1, number >> 1 & 1, number & 1
        ground = (end if far else start) + (across if side else -across)
        eight[:, number, 0], eight[:, number, 2] = ground.T
        eight[:, number, 1] = high if up else low
    return boxes(eight, np.full(len(start), STRUCTURE))


def pierced_wall(start: F64, end: F64, bottom: float, top: float, thickness: float, holes: Sequence[Hole]) -> Piece:
    """Return a wall with its holes left out. It stands on the line from `start` to `end`, both (2,) as (x, z), with
    half of its thickness on each side.
    """
    length = float(np.linalg.norm(end - start))
    rest = np.array(without_holes(Hole(0.0, length, bottom, top), holes)).reshape(-1, 4)
    along = (end - start) / length
    starts, ends = (start + rest[:, [k]] * along for k in (0, 1))
    return upright_slabs(starts, ends, rest[:, 2], rest[:, 3], thickness)


def without_holes(wall: Hole, holes: Sequence[Hole]) -> list[Hole]:
    """Return the rectangles of a wall outside its holes: full strips between holes, and the parts above and below
    them.
    """
    ends = sorted({wall.near, wall.far, *(min(max(x, wall.near), wall.far) for hole in holes for x in hole[:2])})
    rest: list[Hole] = []
    begun = wall.near
    for far in ends[1:]:
        if far - begun < SMALLEST:
            continue  # two ends that should coincide
        middle = (begun + far) / 2
        solid_y = wall.low
        for hole in sorted((h for h in holes if h.near < middle < h.far), key=lambda h: h.low):
            under_y = min(hole.low, wall.high)
            if under_y - solid_y >= SMALLEST:
                rest.append(Hole(begun, far, solid_y, under_y))
            solid_y = max(solid_y, hole.high)
        if wall.high - solid_y >= SMALLEST:
            rest.append(Hole(begun, far, solid_y, wall.high))
        begun = far
    return rest


def scan_geometry(files: DatasetRoot, scene: Scene) -> SceneGeometry | None:
    """Return the triangles of a scene that is one scan, in the order and float32 precision of Habitat's navmesh
    builder.

    No triangle is assigned to an object. None if the scan's mesh is missing.

    Raises
    ------
    InputError : the mesh can't be read
    """
    if not scene.stage:
        return None
    scans = [
        glb_triangles(files.read(part.path, MAX_GLB_BYTES), str(files.folder / part.path), part.transform)
        for part in scene.stage
    ]
    return joined([_piece(vertices, faces, STRUCTURE) for vertices, faces in scans], approximate=False)


def assembled_geometry(meshes: MeshLibrary, scene: Scene) -> SceneGeometry | None:
    """Return the triangles of the stage, followed by those of each object that has a mesh.

    None if the stage is missing, since floor and walls are then unknown.

    Raises
    ------
    InputError : a mesh can't be read
    """
    if not scene.stage:
        return None
    pieces = [_of_mesh(meshes.placed(part), STRUCTURE) for part in scene.stage]
    for number, item in enumerate(scene.objects):
        mesh = meshes.world_mesh(item)
        if mesh is not None:
            pieces.append(_of_mesh(mesh, number))
    return joined(pieces, approximate=False)


def _of_mesh(mesh: WorldMesh, owner: int) -> Piece:
    return _piece(mesh.vertices, mesh.faces, owner)


def _piece(vertices: NDArray[np.floating], faces: NDArray[np.integer], owner: int) -> Piece:
    return Piece(vertices.astype(np.float64), faces.astype(np.int64), np.full(len(faces), owner, np.int64))
