"""Surfaces of AI2-THOR rooms: the floor, walls as far as the metadata determines them, and objects as boxes."""

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
"""Thickness in metres of the walls along the border."""

WALL_HEIGHT: Final = 2.5
"""Height in metres of the walls along the border, unless an object is higher; AI2-THOR's rooms are about 2.5 m high."""

BELOW_WALLS: Final = 0.5
"""Largest width in metres of floor below a wall; 0.03 to 0.49 at 27 of the 28 walls of seven floor plans of iTHOR."""

AT_WALL: Final = 0.1
"""Tolerance in metres between the ends of a built-in fitting and of the outermost object."""

SURFACES: Final = frozenset({"Floor", "Ceiling", "Room", "Wall"})
"""Object types that are not objects in the room: their boxes contain the room, or are its walls."""

WINDOWS: Final = frozenset({"Window"})
"""Object types that never become a box: one window's box may span two walls and the whole room between them."""

DOORS: Final = frozenset({"Door", "Doorway", "Doorframe"})
ALWAYS_OPEN: Final = frozenset({"Doorframe"})


def thor_geometry(
    document: JsonNode, items: Sequence[SceneObject], number: Mapping[str, int], fitted: bool
) -> SceneGeometry | None:
    """Return the surfaces of a scene from controller metadata; None if the metadata has no floor.

    Parameters
    ----------
    items : all objects of the document
    number : owner index by object id; walls, doors, and objects not in it are structure
    fitted : whether it is a single hand-built room, whose fittings show where its walls are; see `wall_outline`

    An open door is cut out of its walls; a closed one is a box. There is no ceiling, since a navmesh would be built on
    it.
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
    """Return the (4, 2) corners (x, z) of the walls around a room whose floor has the corners `outline`.

    In hand-built rooms the floor continues below the walls, and built-in fittings (objects without an asset) end at the
    walls. So if there are fittings, each wall is placed where the objects end, provided that this is within
    `BELOW_WALLS` of the floor's end or a fitting ends there too. This may cut off some real floor, but no agent can
    walk into a wall. Without fittings the walls are at the ends of the floor.
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
        return outline  # there is no object on this floor
    return np.array([[low[0], low[1]], [low[0], high[1]], [high[0], high[1]], [high[0], low[1]]])


def _both(fitted: float, end: float, border: float) -> bool:
    """Return whether the objects on a floor begin inside the floor's border, and a fitting begins at about the same
    place as the objects. All three are positions along an axis that points into the room: `fitted` of the fitting,
    `end` of the objects, `border` of the floor.
    """
    return border < end and fitted - end <= AT_WALL


def _ends(items: Sequence[SceneObject]) -> F64:
    """Return the minimum and the maximum (x, z) over the boxes of some objects, (2, 2)."""
    boxes = np.array([o.box for o in items if o.box is not None])[:, :, [0, 2]]
    return np.array([boxes[:, 0].min(axis=0), boxes[:, 1].max(axis=0)])


def _is_open(kind: str, node: JsonNode) -> bool:
    stands = node.get("isOpen")
    return kind in ALWAYS_OPEN or (stands is not None and stands.boolean())


def _built_in(kind: str, node: JsonNode) -> bool:
    asset = node.get("assetId")
    return kind not in DOORS and asset is not None and asset.text() == ""


def _wall(item: SceneObject, passages: F64) -> Piece | None:
    """Return the surface of a wall that the metadata lists as an object: the wall's box, with holes for open doors."""
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
    """Yield the holes that open doors cut into a wall. `passages` (n, 2, 3) are the doors' boxes; the wall's box
    extends along x (`axis` 0) or z (1).
    """
    meets = ((passages[:, 0] <= box[1]) & (passages[:, 1] >= box[0])).all(axis=1)
    for door in passages[meets]:
        near, far = door[:, 2 * axis] - box[0, 2 * axis]
        yield Hole(float(near), float(far), float(door[0, 1]), float(door[1, 1]))
