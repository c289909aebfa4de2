"""Rooms of AI2-THOR as triangles: the floor, walls where the metadata lets one know of them, and objects as boxes."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from condvln.formats.json_document import JsonNode
from condvln.scene import SceneObject
from condvln.scene.geometry import STRUCTURE, SceneGeometry
from condvln.sources.solids import SMALLEST, Hole, Piece, floor, joined, object_boxes, pierced_wall, upright_slabs
from condvln.sources.thor_metadata import floor_outline

__all__ = ["thor_geometry", "wall_outline"]

F64 = NDArray[np.float64]

WALL_THICKNESS: Final = 0.02
"""Metres of the walls along the border."""

WALL_HEIGHT: Final = 2.5
"""Metres of the walls along the border, where no object reaches higher; rooms of AI2-THOR are 2.5 m high or so."""

BELOW_WALLS: Final = 0.5
"""Metres that a floor may run on below a wall; 0.03 to 0.49 at 27 of the 28 walls of seven floor plans of iTHOR."""

AT_WALL: Final = 0.1
"""Metres within which a fitting that is built into a wall ends where the farthest object does."""

SURFACES: Final = frozenset({"Floor", "Ceiling", "Room", "Wall"})
"""Object types that are not objects in the room: their boxes hold the room, or are its walls."""

WINDOWS: Final = frozenset({"Window"})
"""Never a box: one window's may span two walls and the whole room between them."""

DOORS: Final = frozenset({"Door", "Doorway", "Doorframe"})
ALWAYS_OPEN: Final = frozenset({"Doorframe"})


def thor_geometry(
    document: JsonNode, items: Sequence[SceneObject], number: Mapping[str, int], fitted: bool
) -> SceneGeometry | None:
    """The surfaces of a scene of controller metadata; None where it has no floor.

    Parameters
    ----------
    items : all objects of the document
    number : owners by object id; walls, doors, and what is not in it are structure
    fitted : a single hand-built room, whose fittings tell where its walls stand; see `wall_outline`

    A door that stands open is cut out of the walls that it stands in; a closed one is a box. No ceiling is drawn, as a
    navmesh would be built on it.
    """
    outline = floor_outline(document)
    if outline is None or not (np.ptp(outline, axis=0) >= SMALLEST).all():
        return None
    nodes = {node["objectId"].text(): node for node in document["objects"].elements()}
    open_doors = [o for o in items if o.raw_label in DOORS and _is_open(o.raw_label, nodes[o.object_id])]
    passages = np.array([o.box for o in open_doors]).reshape(-1, 2, 3)
    standing = [o for o in items if o.raw_label not in SURFACES | WINDOWS and o not in open_doors]
    fittings = [o for o in standing if fitted and o.static and _built_in(o.raw_label, nodes[o.object_id])]
    corners = wall_outline(outline, standing, fittings)
    top = max([WALL_HEIGHT, *(float(o.box[1, 1]) for o in standing if o.box is not None)])
    border = upright_slabs(
        corners, np.roll(corners, -1, axis=0), np.zeros(len(corners)), np.full(len(corners), top), WALL_THICKNESS
    )
    walls = (_wall(o, passages) for o in items if o.raw_label == "Wall")
    numbered = ((STRUCTURE if o.raw_label in DOORS else number.get(o.object_id, STRUCTURE), o) for o in standing)
    pieces = [floor(corners, 0.0), border, *(w for w in walls if w is not None), object_boxes(numbered)]
    return joined(pieces, approximate=True)


def wall_outline(outline: F64, standing: Sequence[SceneObject], fittings: Sequence[SceneObject]) -> F64:
    """(4, 2) corners (x, z) of the walls around a room whose floor has these corners.

    A floor runs on below the walls of the hand-built rooms, and what is built in there (fittings have no asset) reaches
    up to them. So where there are fittings, each wall stands where the objects end, if that is within `BELOW_WALLS` of
    the floor's end or a fitting ends there too: floor that is really there may be lost so, but nobody walks into a
    wall. Where there are no fittings the floor is taken at its word.
    """
    low, high = outline.min(axis=0), outline.max(axis=0)
    if fittings:
        ends, fitted = _ends(standing), _ends(fittings)
        for axis in (0, 1):
            if 0 < ends[0, axis] - low[axis] <= BELOW_WALLS or _both(fitted[0, axis], ends[0, axis], low[axis]):
                low[axis] = ends[0, axis]
            if 0 < high[axis] - ends[1, axis] <= BELOW_WALLS or _both(-fitted[1, axis], -ends[1, axis], -high[axis]):
                high[axis] = ends[1, axis]
    if not (high - low >= SMALLEST).all():
        return outline  # nothing stands on this floor
    return np.array([[low[0], low[1]], [low[0], high[1]], [high[0], high[1]], [high[0], low[1]]])


def _both(fitted: float, end: float, border: float) -> bool:
    """Do the objects end inside of the border, and a fitting with them?"""
    return border < end and fitted - end <= AT_WALL


def _ends(items: Sequence[SceneObject]) -> F64:
    """(2, 2) least and greatest (x, z) of some objects' boxes."""
    boxes = np.array([o.box for o in items if o.box is not None])[:, :, [0, 2]]
    return np.array([boxes[:, 0].min(axis=0), boxes[:, 1].max(axis=0)])


def _is_open(kind: str, node: JsonNode) -> bool:
    stands = node.get("isOpen")
    return kind in ALWAYS_OPEN or (stands is not None and stands.boolean())


def _built_in(kind: str, node: JsonNode) -> bool:
    asset = node.get("assetId")
    return kind not in DOORS and asset is not None and asset.text() == ""


def _wall(item: SceneObject, passages: F64) -> Piece | None:
    """A wall that the metadata has as an object: its box along its longer side, with the open doors in it cut out."""
    box = item.box
    if box is None:
        return None
    ground = box[:, [0, 2]]
    size = ground[1] - ground[0]
    axis = int(size[1] > size[0])
    if size[axis] < SMALLEST:
        return None
    middle = ground.mean(axis=0)
    start, end = middle.copy(), middle.copy()
    start[axis], end[axis] = ground[:, axis]
    holes = list(_holes(box, axis, passages))
    return pierced_wall(start, end, box[0, 1], box[1, 1], max(float(size[1 - axis]), SMALLEST), holes)


def _holes(box: F64, axis: int, passages: F64) -> Iterator[Hole]:
    """The holes that open doors (n, 2, 3) make in the box of a wall along x (`axis` 0) or z (1)."""
    meets = ((passages[:, 0] <= box[1]) & (passages[:, 1] >= box[0])).all(axis=1)
    for door in passages[meets]:
        near, far = door[:, 2 * axis] - box[0, 2 * axis]
        yield Hole(float(near), float(far), float(door[0, 1]), float(door[1, 1]))
