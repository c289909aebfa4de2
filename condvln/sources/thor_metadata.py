"""Read AI2-THOR's controller metadata: the objects of a scene as reported by the simulator, in Habitat's frame, and the
room's surfaces (floor, walls as far as the metadata determines them, objects as boxes).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Final

import numpy as np

from condvln.arrays import F64
from condvln.formats.json_document import JsonNode
from condvln.labels import vocabulary
from condvln.scene import OrientedBox, SceneObject, round_mm
from condvln.scene.boxes import rounded_box
from condvln.scene.rotations import UNITY_TO_HABITAT
from condvln.scene.scene import STRUCTURE, SceneGeometry
from condvln.sources.solids import SMALLEST, Hole, Piece, floor, joined, object_boxes, pierced_wall, upright_slabs
from condvln.sources.source import MAX_OBJECTS

__all__ = [
    "MAX_METADATA_BYTES",
    "floor_outline",
    "read_objects",
    "scene_name",
    "thor_geometry",
    "wall_outline",
]


MAX_METADATA_BYTES: Final = 256 << 20

# Corners of an oriented box in the simulator's order: the first, its neighbours along each axis, and the opposite one.
_FIRST, _NEIGHBOURS, _OPPOSITE = 0, (1, 3, 4), 6
BUILDING: Final = frozenset({"Door", "Doorframe", "Doorway", "Floor", "Wall"})
"""Types without which nobody knows where an agent can walk."""
BOX_TOLERANCE: Final = 0.01
"""Tolerance in metres of eight corners as a box; the simulator's are float32 and at most a millimetre off."""


def scene_name(document: JsonNode) -> str:
    """Return the scene's name (``FloorPlan207``), without the suffix ``_physics`` that the simulator adds to some
    names.
    """
    return document["sceneName"].text().removesuffix("_physics")


def read_objects(document: JsonNode, family: str) -> list[SceneObject]:
    """Return all objects, without rooms.

    Positions are the centres of the axis-aligned boxes, since ``position`` is a pivot and usually elsewhere. Only
    movable objects have oriented boxes. The extent of an object whose size is negative is unknown.

    Raises
    ------
    FormatError : a type is wrong, a key is missing, an id is repeated, or a part of the building has a negative size
    """
    found: dict[str, SceneObject] = {}
    for node in document["objects"].entries():
        own, raw = node["objectId"].text(), node["objectType"].text()
        if not own.strip():
            node["objectId"].fail("the id is empty")
        if own in found:
            node.fail(f"two objects have the id {own!r}")
        if len(found) == MAX_OBJECTS:
            node.fail(f"more than {MAX_OBJECTS} objects")
        centre, box = _centre(node), _box(node)
        pickable, movable = node.get("pickupable"), node.get("moveable")
        if box is None and raw in BUILDING:
            node["axisAlignedBoundingBox"]["size"].fail("a size is negative")
        found[own] = SceneObject(
            object_id=own,
            room_id="",
            raw_label=raw,
            label=vocabulary.canonical(raw, family),
            center=round_mm(centre if box is None else box.mean(axis=0)),
            aabb=None if box is None else round_mm(box),
            obb=None if box is None else _oriented(node),
            radius=None if box is None else float(np.ceil(np.linalg.norm(box[1] - box[0]) / 2 * 1000) / 1000),
            receptacles=_receptacles(node),
            openness=_openness(node),
            static=not any(flag is not None and flag.boolean() for flag in (pickable, movable)),
        )
    return list(found.values())


def _receptacles(node: JsonNode) -> tuple[str, ...] | None:
    """Return the ids of the receptacles that an object is in or on; None if the metadata has no such key."""
    if "parentReceptacles" not in node:
        return None
    said = node.get("parentReceptacles")
    return () if said is None else tuple(entry.text() for entry in said.elements())


def _openness(node: JsonNode) -> float | None:
    """Return how far an object is open: 1 for a receptacle that can't be shut, 0 if `isOpen` is false; None if unknown.

    ``visible`` depends on the camera and is not used.
    """
    openable, is_open, share = (node.get(key) for key in ("openable", "isOpen", "openness"))
    if openable is None:
        return None
    if not openable.boolean():
        holds = node.get("receptacle")
        return 1.0 if holds is not None and holds.boolean() else None
    if is_open is None:
        return None if share is None else share.number()
    if not is_open.boolean():
        return 0.0
    return 1.0 if share is None else share.number()


def floor_outline(document: JsonNode) -> F64 | None:
    """Return the (4, 2) corners (x, z) of the box around all objects of type Floor; None if there are none."""
    floors = [_box(node) for node in document["objects"].entries() if node["objectType"].text() == "Floor"]
    boxes = [box for box in floors if box is not None]
    if not boxes:
        return None
    both = np.concatenate(boxes)[:, [0, 2]]
    (x0, z0), (x1, z1) = both.min(axis=0), both.max(axis=0)
    return round_mm([[x0, z0], [x0, z1], [x1, z1], [x1, z0]])


def _centre(node: JsonNode) -> F64:
    """Return the (3,) centre of the axis-aligned box in Habitat's frame, not rounded."""
    centre = node["axisAlignedBoundingBox"]["center"]
    return np.asarray(UNITY_TO_HABITAT @ np.array([centre[c].number() for c in "xyz"]))


def _box(node: JsonNode) -> F64 | None:
    """Return the (2, 3) axis-aligned box in Habitat's frame, not rounded; None if a size is negative."""
    centre, sizes = _centre(node), node["axisAlignedBoundingBox"]["size"]
    size = np.array([sizes[c].number() for c in "xyz"])
    return np.array([centre - size / 2, centre + size / 2]) if (size >= 0).all() else None


def _oriented(node: JsonNode) -> OrientedBox | None:
    """Return the oriented box that the object's eight corners form; None if the metadata has no corners, or they form
    no box.
    """
    bounds = node.get("objectOrientedBoundingBox")
    if bounds is None:
        return None
    points = bounds["cornerPoints"].elements()
    if len(points) != 8:
        bounds["cornerPoints"].fail(f"eight corners are expected, not {len(points)}")
    corners = np.array([p.vector(3) for p in points]) @ UNITY_TO_HABITAT
    edges = corners[list(_NEIGHBOURS)] - corners[_FIRST]
    lengths = np.linalg.norm(edges, axis=1)
    if np.abs(corners[_FIRST] + edges.sum(axis=0) - corners[_OPPOSITE]).max() > BOX_TOLERANCE or not lengths.max() > 0:
        return None
    axes = _axes(edges, lengths)
    if axes is None:
        return None
    return rounded_box(OrientedBox(corners.mean(axis=0), lengths / 2, axes))


def _axes(edges: F64, lengths: F64) -> F64 | None:
    """Return the (3, 3) right-handed rotation with the edges' directions as columns; None if they are not
    orthogonal.
    """
    order = np.argsort(-lengths)
    first = edges[order[0]] / lengths[order[0]]
    # A flat box has an edge without direction: any direction orthogonal to the others will do.
    flat = lengths[order[1]] < BOX_TOLERANCE / 10
    second = np.cross(first, np.eye(3)[np.argmin(abs(first))]) if flat else edges[order[1]]
    if abs(float(second @ first)) > BOX_TOLERANCE * max(1.0, float(np.linalg.norm(second))):
        return None
    second = second - (second @ first) * first
    second = second / np.linalg.norm(second)
    axes = np.zeros((3, 3))
    axes[:, order[0]], axes[:, order[1]], axes[:, order[2]] = first, second, np.cross(first, second)
    third = edges[order[2]]
    if float(np.linalg.norm(np.cross(third, axes[:, order[2]]))) > BOX_TOLERANCE:
        return None
    if np.linalg.det(axes) < 0:
        axes[:, order[2]] *= -1
    return axes


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
    passages = np.array([o.box for o in open_doors if o.box is not None]).reshape(-1, 2, 3)
    standing = [o for o in items if o.raw_label not in SURFACES | WINDOWS and o not in open_doors]
    fittings = [
        o for o in standing if fitted and o.static and o.box is not None and _built_in(o.raw_label, nodes[o.object_id])
    ]
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
    boxes = np.array([o.box for o in items if o.box is not None]).reshape(-1, 2, 3)[:, :, [0, 2]]
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
