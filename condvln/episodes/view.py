"""Lines of sight in a scene: occluders, and the sample points at which its objects are looked for."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from condvln.arrays import F64, Bools
from condvln.kept import kept
from condvln.labels import vocabulary
from condvln.navigation.occluders import BoxOccluders, JoinedOccluders, MeshOccluders, Occluders
from condvln.navigation.sight import Recognition, SightTarget, View, in_view, visible_extent, visible_points
from condvln.navigation.surface_samples import DEFAULT_SAMPLES, box_samples, mesh_samples
from condvln.scene import OrientedBox, Scene, SceneObject
from condvln.scene.scene import STRUCTURE, SceneGeometry
from schemas.config.constants import FRAME_HEADROOM

__all__ = ["SceneView"]


class SceneView:
    """The occluders and sight targets of one scene.

    If the surfaces are exact, they alone occlude. If they are boxes, structure (walls, floors) occludes with its
    triangles and each object with its box. An object's box never occludes the objects inside it, because boxes of
    neighbouring objects overlap and a shelf's box contains the things on it. The box of a frame
    (``Vocabulary.is_frame``: shelves, tables) does not occlude the things on top of it either. If no surface is known,
    only boxes occlude: walls do not.

    Parameters
    ----------
    geometry : the scene's surfaces; None if the dataset has none

    Attributes
    ----------
    approximate : boxes are used in place of surfaces; recorded with all derived results
    walls_known : walls occlude
    """

    def __init__(self, scene: Scene, geometry: SceneGeometry | None = None) -> None:
        self._scene = scene
        self._box_numbers: dict[str, list[int]] = {}
        self._faces: dict[str, NDArray[np.int64]] = {}
        self._geometry = geometry if geometry is not None and len(geometry.faces) else None
        self.approximate = self._geometry is None or self._geometry.approximate
        self.walls_known = not self.approximate or (
            self._geometry is not None and bool((self._geometry.owner == STRUCTURE).any())
        )
        self._occluders = self._made(self._geometry)

    def _made(self, geometry: SceneGeometry | None) -> Occluders:
        if geometry is not None and not geometry.approximate:
            order = np.argsort(geometry.owner, kind="stable")
            owners, starts = np.unique(geometry.owner[order], return_index=True)
            for owner, faces in zip(owners, np.split(geometry.faces[order], starts[1:]), strict=True):
                if owner != STRUCTURE:
                    self._faces[self._scene.objects[owner].object_id] = faces
            return MeshOccluders(geometry.vertices, geometry.faces)
        boxes = self._boxes()
        if geometry is None:
            return boxes
        structure = geometry.faces[geometry.owner == STRUCTURE]
        return JoinedOccluders(MeshOccluders(geometry.vertices, structure), boxes) if len(structure) else boxes

    def _boxes(self) -> BoxOccluders:
        """Return a solid box for every solid object; the box around a room's walls is left out."""
        found: list[OrientedBox] = []
        headroom: list[float] = []
        for item in self._scene.objects:
            boxes = item.solids
            if boxes and not vocabulary.is_structure(item.label):
                self._box_numbers[item.object_id] = [len(found) + k for k in range(len(boxes))]
                found += boxes
                headroom += [FRAME_HEADROOM if vocabulary.is_frame(item.label) else 0.0] * len(boxes)
        centers, halves, rotations = zip(*found, strict=True) if found else ((), (), np.zeros((0, 3, 3)))
        return BoxOccluders(np.reshape(centers, (-1, 3)), np.reshape(halves, (-1, 3)), np.array(rotations), headroom)

    @kept
    def target(self, object_id: str) -> SightTarget:
        """Return the sample points of an object: on its surface, else on its box, else its centre."""
        return self._target(self._scene.object_of[object_id])

    def denser_target(self, object_id: str, count: int) -> SightTarget:
        """Return a sight target for an object: `count` sample points on the object's surface, or `count` on each of its
        boxes if the surface is unknown.
        """
        return self._target(self._scene.object_of[object_id], count)

    def _target(self, item: SceneObject, count: int = DEFAULT_SAMPLES) -> SightTarget:
        faces = self._faces.get(item.object_id)
        if faces is not None and self._geometry is not None:
            return SightTarget(mesh_samples(self._geometry.vertices, faces, count))
        samples = [box_samples(*box, count) for box in item.solids] or [item.center[None]]
        numbers = self._box_numbers.get(item.object_id, [-1] * len(samples))
        return SightTarget(np.concatenate(samples), np.repeat(numbers, [len(points) for points in samples]))

    def seen(self, eyes: F64, target: SightTarget, view: View) -> Bools:
        """Return a mask (n, k): whether each of the k samples of a target is visible from each of the `eyes` (n, 3), in
        any direction.
        """
        return visible_points(self._occluders, eyes, target.samples, view, own=target.owners)

    def recognised(self, eyes: F64, object_id: str, rule: Recognition) -> Bools:
        """Return a mask (n,) of the `eyes` (n, 3) from which an object is recognised, in any direction."""
        return self.degrees(eyes, object_id, rule) > 0

    def degrees(self, eyes: F64, object_id: str, rule: Recognition) -> F64:
        """Return the shorter side (n,) of an object's rectangle in degrees (:func:`visible_extent`); 0 for eyes that
        don't recognise the object.

        Rays are cast from those eyes only that would recognise it if nothing were in the way.
        """
        target = self.target(object_id)
        near = in_view(eyes, target.samples, rule.view)
        able = np.flatnonzero(rule.holds(near, visible_extent(eyes, target.samples, near)))
        found = np.zeros(len(eyes))
        if len(able):
            visible = self.seen(eyes[able], target, rule.view)
            extent = visible_extent(eyes[able], target.samples, visible)
            found[able] = np.where(rule.holds(visible, extent), extent[:, 0], 0.0)
        return found
