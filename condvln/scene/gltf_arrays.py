"""The accessors, triangles and node transforms of a glTF part as arrays."""

from __future__ import annotations

import math
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from condvln.formats.glb_part import Accessor, GlbPart, Primitive
from condvln.scene.boxes import placement
from condvln.scene.quaternions import to_matrix

__all__ = ["accessor_rows", "attribute_rows", "coordinates_of", "primitive_triangles", "world_transforms"]

_NUMBERS: Final = {5121: np.uint8, 5123: np.uint16, 5125: np.uint32, 5126: np.float32}
_WIDTHS: Final = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4}
_STRIP: Final = 5
_TRANSFORM: Final = "KHR_texture_transform"

F64 = NDArray[np.float64]


def accessor_rows(own: Accessor) -> NDArray[Any]:
    """Return the numbers of an accessor as (count, width); normalized integers are scaled to [0, 1]."""
    dtype = np.dtype(_NUMBERS[own.component])
    rows = np.frombuffer(own.data, dtype.newbyteorder("<")).reshape(own.count, _WIDTHS[own.kind])
    return rows / (256**dtype.itemsize - 1) if own.normalized else rows


def attribute_rows(part: GlbPart, own: Primitive, name: str) -> NDArray[Any] | None:
    """Return the numbers of a vertex attribute as (count, width); None if the primitive has no such attribute."""
    at = own.attributes.get(name)
    return None if at is None else accessor_rows(part.accessors[at])


def primitive_triangles(part: GlbPart, own: Primitive) -> NDArray[np.int64]:
    """Return the triangles (n, 3) of a primitive as indices of its vertices."""
    count = part.accessors[own.attributes["POSITION"]].count
    order = np.arange(count) if own.indices is None else accessor_rows(part.accessors[own.indices])[:, 0]
    rows = _strip(order) if own.mode == _STRIP else order[: len(order) // 3 * 3].reshape(-1, 3)
    return np.asarray(rows, dtype=np.int64)


def _strip(order: NDArray[Any]) -> NDArray[Any]:
    """Return the triangles of a strip; the winding of every second one is reversed."""
    rows = np.column_stack([order[:-2], order[1:-1], order[2:]])
    rows[1::2] = rows[1::2][:, [1, 0, 2]]
    return rows


def world_transforms(part: GlbPart) -> list[F64]:
    """Return for each node the (4, 4) transform from its frame to the root's. In `part.nodes`, parents come before
    their children.
    """
    world = [_local(node.transform) for node in part.nodes]
    for number, node in enumerate(part.nodes):
        for child in node.children:
            world[child] = world[number] @ world[child]
    return world


def _local(transform: dict[str, list[float]]) -> F64:
    if "matrix" in transform:
        matrix: F64 = np.array(transform["matrix"], np.float64).reshape(4, 4).T
        return matrix
    rotation = to_matrix(transform["rotation"]) if "rotation" in transform else None
    return placement(rotation, transform.get("translation"), transform.get("scale"))


def coordinates_of(slot: dict[str, Any]) -> tuple[str, F64]:
    """Return the attribute with the texture coordinates that a material's texture uses, and the (3, 3) transform of
    these coordinates (``KHR_texture_transform``).
    """
    moved = slot.get("extensions", {}).get(_TRANSFORM, {})
    return f"TEXCOORD_{moved.get('texCoord', slot.get('texCoord', 0))}", _moved(moved)


def _moved(transform: dict[str, Any]) -> F64:
    """Return the (3, 3) matrix of KHR_texture_transform: scale, then rotate counter-clockwise in the image, then
    translate.
    """
    angle = float(transform.get("rotation", 0.0))
    cosine, sine = math.cos(angle), math.sin(angle)
    across, down = transform.get("scale", (1.0, 1.0))
    matrix = np.eye(3)
    matrix[:2, :2] = np.array([[cosine, sine], [-sine, cosine]]) @ np.diag([across, down])
    matrix[:2, 2] = transform.get("offset", (0.0, 0.0))
    return matrix
