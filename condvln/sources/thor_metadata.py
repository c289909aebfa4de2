"""Read AI2-THOR's controller metadata: the objects of a scene as reported by the simulator, in Habitat's frame."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from condvln.formats.json_document import JsonNode
from condvln.labels import vocabulary
from condvln.scene import OrientedBox, SceneObject, round_mm
from condvln.scene.boxes import rounded_box
from condvln.scene.frames import UNITY_TO_HABITAT
from condvln.sources.source import MAX_OBJECTS

__all__ = ["MAX_METADATA_BYTES", "floor_outline", "read_objects", "scene_name"]

F64 = NDArray[np.float64]

MAX_METADATA_BYTES: Final = 256 << 20

# Corners of an oriented box in the simulator's order: the first, its neighbours along each axis, and the opposite one.
_FIRST, _NEIGHBOURS, _OPPOSITE = 0, (1, 3, 4), 6
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
    movable objects have oriented boxes.

    Raises
    ------
    FormatError : a type is wrong, a key is missing, or an id is repeated
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
        box = _box(node)
        pickable, movable = node.get("pickupable"), node.get("moveable")
        aabb = round_mm(box)
        found[own] = SceneObject(
            object_id=own,
            room_id="",
            raw_label=raw,
            label=vocabulary.canonical(raw, family),
            center=round_mm(box.mean(axis=0)),
            aabb=aabb,
            obb=_oriented(node),
            size=round_mm(aabb[1] - aabb[0]),
            radius=float(np.ceil(np.linalg.norm(box[1] - box[0]) / 2 * 1000) / 1000),
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
    boxes = [_box(node) for node in document["objects"].entries() if node["objectType"].text() == "Floor"]
    if not boxes:
        return None
    both = np.concatenate(boxes)[:, [0, 2]]
    (x0, z0), (x1, z1) = both.min(axis=0), both.max(axis=0)
    return round_mm([[x0, z0], [x0, z1], [x1, z1], [x1, z0]])


def _box(node: JsonNode) -> F64:
    """Return the (2, 3) axis-aligned box in Habitat's frame, not rounded."""
    bounds = node["axisAlignedBoundingBox"]
    centre, size = (np.array([bounds[key][c].number() for c in "xyz"]) for key in ("center", "size"))
    if not (size >= 0).all():
        bounds["size"].fail("a size is negative")
    centre = UNITY_TO_HABITAT @ centre
    return np.array([centre - size / 2, centre + size / 2])


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
