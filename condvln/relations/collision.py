"""Distances between the surfaces of bodies, by FCL (Pan, Chitta and Manocha, 2012): the one module that imports it.

A body is a set of triangles in its own frame, with FCL's hierarchy of bounding volumes over them, and its pose. Boxes
enter as triangles too: FCL's distance of two primitive boxes is wrong by up to 0.8 m where centres share a coordinate.
"""

from __future__ import annotations

from collections import OrderedDict
from dataclasses import dataclass
from typing import Any, Final

import fcl
import numpy as np
from numpy.typing import NDArray

from condvln.arrays import F64
from condvln.formats.glb import GlbGeometry
from condvln.scene import OrientedBox
from condvln.scene.boxes import corners
from condvln.sources.solids import BOX_FACES

__all__ = ["CollisionBody", "asset_body", "body_of", "box_body"]

Faces = NDArray[np.integer[Any]]

KEPT_TRIANGLES: Final = 1_500_000
"""Number of triangles of assets whose hierarchies are kept for the next scene: about 300 MB, four times ReplicaCAD."""

OFF_PLANE: Final = 1e-5 * np.array([1.0, np.sqrt(2.0), np.sqrt(3.0)]) / np.sqrt(6.0)
"""Metres, 0.01 mm in all. FCL reports distance 0 for a few pairs of triangles that lie apart in one plane. Once one of
the bodies is moved out of the plane by this vector, the distance is right, and the 0.01 mm is far below the millimetre
that is published.
"""

TOUCHING: Final = 2e-5
"""Metres at most between surfaces that touch, after one of them was moved by `OFF_PLANE`."""

_kept: OrderedDict[GlbGeometry, Any] = OrderedDict()


@dataclass(frozen=True, eq=False, slots=True)
class CollisionBody:
    """Triangles at a place in the scene: FCL's model, rotation (3, 3), translation (3,) in metres."""

    model: Any
    rotation: F64
    translation: F64

    def distance(self, other: CollisionBody) -> float:
        """Return the distance in metres between the surfaces of two bodies; 0 where they touch or intersect."""
        found = self._distance(other, np.zeros(3))
        if found > 0.0:
            return found
        found = self._distance(other, OFF_PLANE)
        return found if found > TOUCHING else 0.0

    def _distance(self, other: CollisionBody, moved: F64) -> float:
        """Return FCL's distance to the other body, which is moved by a vector (3,)."""
        ours = fcl.CollisionObject(self.model, fcl.Transform(self.rotation, self.translation))
        theirs = fcl.CollisionObject(other.model, fcl.Transform(other.rotation, other.translation + moved))
        return float(fcl.distance(ours, theirs, fcl.DistanceRequest(), fcl.DistanceResult()))


def body_of(vertices: F64, faces: Faces) -> CollisionBody:
    """Return the body of triangles in the scene's frame: vertices (n, 3) metres, faces (m, 3), m ≥ 1."""
    return CollisionBody(_model(vertices, faces), np.eye(3), np.zeros(3))


def asset_body(asset: GlbGeometry, pose: F64) -> CollisionBody:
    """Return the body of an asset at a rigid pose (4, 4). All scenes of a process share the asset's hierarchy."""
    if asset not in _kept:
        _kept[asset] = _model(asset.vertices, asset.faces)
        while len(_kept) > 1 and sum(len(other.faces) for other in _kept) > KEPT_TRIANGLES:
            _kept.popitem(last=False)
    _kept.move_to_end(asset)
    return CollisionBody(_kept[asset], pose[:3, :3], pose[:3, 3])


def box_body(box: OrientedBox) -> CollisionBody:
    """Return the body of a box. A flat one has no triangles without area, which FCL would measure wrongly."""
    own = corners([-box.half_extents, box.half_extents])
    a, b, c = (own[BOX_FACES[:, k]] for k in range(3))
    has_area = np.cross(b - a, c - a).any(axis=1)
    faces = BOX_FACES[has_area] if has_area.any() else BOX_FACES
    return CollisionBody(_model(own, faces), box.rotation, box.center)


def _model(vertices: F64, faces: Faces) -> Any:
    model = fcl.BVHModel()
    model.beginModel(len(faces), len(vertices))
    model.addSubModel(vertices, faces.astype(np.int64))
    model.endModel()
    return model
