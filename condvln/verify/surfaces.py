"""Distances between the surfaces of two objects, measured with FCL pair by pair."""

from __future__ import annotations

import math
from collections import OrderedDict
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, Final

import fcl
import numpy as np
import trimesh
from numpy.typing import NDArray

from condvln.scene import SceneObject
from condvln.scene.meshes import shared_library

__all__ = ["Shapes", "SurfaceGauge"]

F64 = NDArray[np.float64]
I64 = NDArray[np.int64]

KEPT_TRIANGLES: Final = 1_500_000
"""Number of triangles whose FCL hierarchies are kept for the next scene: about 300 MB, four times ReplicaCAD."""

ORTHOGONAL: Final = 1e-9
"""Largest dot product of two unit axes of a transform that still counts as a rotation."""

_IDENTITY: Final = np.eye(3)
_CUBE: Final = trimesh.creation.box(extents=np.ones(3))
_CORNERS_OF_CUBE: Final[F64] = np.array(_CUBE.vertices)
_FACES_OF_CUBE: Final[I64] = np.array(_CUBE.faces)


@dataclass(frozen=True, eq=False)
class _Shape:
    """m triangles in their own frame. `corners` (m, 3) has the first corner of each, `bounds` (2, 3) encloses them all,
    and `solid` tells whether they enclose an interior.
    """

    vertices: F64
    faces: I64
    model: Any
    corners: F64
    bounds: F64
    solid: bool

    @cached_property
    def mesh(self) -> trimesh.Trimesh:
        """The triangles as a mesh. Few shapes are asked whether they contain a point."""
        return trimesh.Trimesh(self.vertices, self.faces, process=False)


@dataclass(frozen=True, eq=False)
class _Part:
    """A shape that is placed in the scene by a rotation (3, 3) and a translation (3,). `bounds` (2, 3) enclose the
    placed shape, perhaps not tightly.
    """

    shape: _Shape
    rotation: F64
    translation: F64
    bounds: F64
    collision: Any

    def to_own(self, points: F64) -> F64:
        """Transform points (n, 3) from the scene's frame to the shape's."""
        moved: F64 = (points - self.translation) @ self.rotation
        return moved

    def to_scene(self, points: F64) -> F64:
        """Transform points (n, 3) from the shape's frame to the scene's."""
        moved: F64 = points @ self.rotation.T + self.translation
        return moved


class Shapes:
    """The FCL models of the meshes under one dataset root. All scenes share the models, since building one is
    expensive.
    """

    def __init__(self, root: Path) -> None:
        self._library = shared_library(root)
        self._kept: OrderedDict[tuple[str, bytes], _Shape] = OrderedDict()

    def parts(self, item: SceneObject) -> list[_Part]:
        """Return an object's meshes, else its oriented box, else its axis-aligned box; empty if its extent is
        unknown.
        """
        parts = [self._placed(part.path, part.transform) for part in item.mesh]
        parts = [part for part in parts if len(part.shape.corners)]
        if parts or (item.obb is None and item.box is None):
            return parts
        if item.parts:
            return [_placed(_cuboid(2 * p.half_extents), p.rotation, p.center) for p in item.parts]
        if item.obb is not None:
            extents, centre, rotation = 2 * item.obb.half_extents, item.obb.center, item.obb.rotation
        else:
            assert item.box is not None
            extents, centre, rotation = item.box[1] - item.box[0], item.box.mean(axis=0), _IDENTITY
        # FCL's own box-box distance is wrong if centres share a coordinate; twelve triangles are right.
        return [_placed(_cuboid(extents), rotation, centre)]

    def _placed(self, path: str, transform: F64) -> _Part:
        """Return a mesh file placed by a transform. Scale and shear are applied to the triangles; rotation and
        translation are kept apart.
        """
        linear = transform[:3, :3]
        scale = np.sqrt((linear * linear).sum(axis=0))
        rotation = linear / scale if (scale > 0).all() else _IDENTITY
        if np.abs(rotation.T @ rotation - _IDENTITY).max() > ORTHOGONAL or _is_mirrored(rotation):
            rotation = _IDENTITY
        own = rotation.T @ linear
        # The scales of several instances of one model differ only in the last bits.
        own = np.round(own, 12) + 0.0
        key = (path, own.tobytes())
        shape = self._kept.get(key)
        if shape is None:
            known = self._library.geometry(path)
            shape = _shape(known.vertices @ own.T, known.faces.astype(np.int64), known.watertight)
            self._kept[key] = shape
            while len(self._kept) > 1 and sum(len(kept.corners) for kept in self._kept.values()) > KEPT_TRIANGLES:
                self._kept.popitem(last=False)
        self._kept.move_to_end(key)
        return _placed(shape, rotation, transform[:3, 3])


class SurfaceGauge:
    """The surface distances in one scene, each measured once."""

    def __init__(self, shapes: Shapes) -> None:
        self._shapes = shapes
        self._parts: dict[str, list[_Part]] = {}
        self._distances: dict[tuple[str, str], float | None] = {}

    def millimetres(self, one: SceneObject, other: SceneObject) -> float | None:
        """Return the distance between the surfaces of two objects in whole millimetres: 0 if they touch or one contains
        the other, None if it is unknown.
        """
        first, second = sorted((one, other), key=lambda item: item.object_id)
        key = (first.object_id, second.object_id)
        if key not in self._distances:
            self._distances[key] = _between(self._of(first), self._of(second))
        return self._distances[key]

    def _of(self, item: SceneObject) -> list[_Part]:
        if item.object_id not in self._parts:
            self._parts[item.object_id] = self._shapes.parts(item)
        return self._parts[item.object_id]


def _cuboid(extents: F64) -> _Shape:
    """Return a box around the origin."""
    return _shape(_CORNERS_OF_CUBE * extents, _FACES_OF_CUBE, True)


def _shape(vertices: F64, faces: I64, solid: bool) -> _Shape:
    if not len(faces):
        return _Shape(vertices, faces, None, np.zeros((0, 3)), np.zeros((2, 3)), solid)
    triangles = vertices[faces]
    model = fcl.BVHModel()
    model.beginModel(len(faces), len(vertices))
    model.addSubModel(vertices, faces)
    model.endModel()
    bounds = np.array([triangles.min(axis=(0, 1)), triangles.max(axis=(0, 1))])
    return _Shape(vertices, faces, model, triangles[:, 0].copy(), bounds, solid)


def _is_mirrored(matrix: F64) -> bool:
    """Return whether a matrix (3, 3) turns right-handed axes into left-handed ones."""
    (a, b, c), (d, e, f), (g, h, i) = matrix.tolist()
    return bool(a * (e * i - f * h) + b * (f * g - d * i) + c * (d * h - e * g) < 0)


def _placed(shape: _Shape, rotation: F64, translation: F64) -> _Part:
    low, high = shape.bounds
    centre, reach = rotation @ (low + high) / 2 + translation, np.abs(rotation) @ (high - low) / 2
    collision = None if shape.model is None else fcl.CollisionObject(shape.model, fcl.Transform(rotation, translation))
    return _Part(shape, rotation, translation, np.array([centre - reach, centre + reach]), collision)


def _between(first: list[_Part], second: list[_Part]) -> float | None:
    if not first or not second:
        return None
    apart = [(_least(one, other), one, other) for one in first for other in second]
    distance = np.inf
    for bound, one, other in sorted(apart, key=lambda pair: pair[0]):
        if bound > distance:
            break
        found = fcl.distance(one.collision, other.collision, fcl.DistanceRequest(), fcl.DistanceResult())
        distance = min(distance, float(found))
    if distance <= 0.0 or _holds(first, second) or _holds(second, first):
        return 0.0
    return float(np.rint(distance * 1000.0))


def _least(one: _Part, other: _Part) -> float:
    """Return a lower bound in metres of the distance between two parts."""
    (low, high), (its_low, its_high) = one.bounds.tolist(), other.bounds.tolist()
    return math.hypot(*[max(low[k] - its_high[k], its_low[k] - high[k], 0.0) for k in range(3)])


def _holds(outer: list[_Part], inner: list[_Part]) -> bool:
    """Return whether some part of `inner` lies inside some part of `outer`. The surfaces of the two bodies must not
    touch, which is not checked here.
    """
    return all(part.shape.solid for part in outer) and any(_contains(one, other) for one in outer for other in inner)


def _contains(outer: _Part, inner: _Part) -> bool:
    if _least(outer, inner) > 0.0:
        return False
    low, high = outer.shape.bounds
    # One corner per triangle covers every connected piece of the surface; each piece is entirely inside or outside.
    points = outer.to_own(inner.to_scene(inner.shape.corners))
    points = points[((points >= low) & (points <= high)).all(axis=1)]
    return bool(len(points)) and bool(outer.shape.mesh.contains(points).any())
