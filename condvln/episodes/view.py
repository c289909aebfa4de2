"""Lines of sight in a scene: occluders, and the sample points at which its objects are looked for."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from condvln.labels import Vocabulary, vocabulary
from condvln.navigation.occluders import BoxOccluders, JoinedOccluders, MeshOccluders, Occluders
from condvln.navigation.sight import Look, SightTarget, View, in_view, visible_points, visible_to_each
from condvln.navigation.surface_samples import DEFAULT_SAMPLES, box_samples, mesh_samples
from condvln.scene import Scene, SceneObject
from condvln.scene.geometry import STRUCTURE, SceneGeometry
from schemas.config.constants import FRAME_HEADROOM

__all__ = ["SceneView"]

F64 = NDArray[np.float64]
Bools = NDArray[np.bool_]

_STRUCTURE_KIND: Final = "structure"

FIRST_LOOKS: Final = 8
"""Stride of the sample points that are tested first, before all of them."""

LOOK_TURNS: Final = 8
"""Number of turns in which the lines between eyes and sample points are tested where single lines do not matter."""

LOOKS_AT_ONCE: Final = 1 << 18
"""Number of such lines at once: tens of megabytes of temporaries."""


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

    def __init__(self, scene: Scene, geometry: SceneGeometry | None = None, words: Vocabulary = vocabulary) -> None:
        self._scene = scene
        self._box_numbers: dict[str, list[int]] = {}
        self._faces: dict[str, NDArray[np.int64]] = {}
        self._targets: dict[str, SightTarget] = {}
        self._geometry = geometry if geometry is not None and len(geometry.faces) else None
        self.approximate = self._geometry is None or self._geometry.approximate
        self.walls_known = not self.approximate or (
            self._geometry is not None and bool((self._geometry.owner == STRUCTURE).any())
        )
        self._occluders = self._made(self._geometry, words)

    def _made(self, geometry: SceneGeometry | None, words: Vocabulary) -> Occluders:
        if geometry is not None and not geometry.approximate:
            order = np.argsort(geometry.owner, kind="stable")
            owners, starts = np.unique(geometry.owner[order], return_index=True)
            for owner, faces in zip(owners, np.split(geometry.faces[order], starts[1:]), strict=True):
                if owner != STRUCTURE:
                    self._faces[self._scene.objects[owner].object_id] = faces
            return MeshOccluders(geometry.vertices, geometry.faces)
        boxes = self._boxes(words)
        if geometry is None:
            return boxes
        structure = geometry.faces[geometry.owner == STRUCTURE]
        return JoinedOccluders(MeshOccluders(geometry.vertices, structure), boxes) if len(structure) else boxes

    def _boxes(self, words: Vocabulary) -> BoxOccluders:
        """Return a solid box for every solid object; the box around a room's walls is left out."""
        found: list[tuple[F64, F64, F64]] = []
        headroom: list[float] = []
        for item in self._scene.objects:
            boxes = _boxes_of(item)
            if boxes and not _is_structure(item.label, words):
                self._box_numbers[item.object_id] = [len(found) + k for k in range(len(boxes))]
                found += boxes
                headroom += [FRAME_HEADROOM if words.is_frame(item.label) else 0.0] * len(boxes)
        centers, halves, rotations = zip(*found, strict=True) if found else ((), (), np.zeros((0, 3, 3)))
        return BoxOccluders(np.reshape(centers, (-1, 3)), np.reshape(halves, (-1, 3)), np.array(rotations), headroom)

    def target(self, object_id: str) -> SightTarget:
        """Return the sample points of an object: on its surface, else on its box, else its centre."""
        if object_id not in self._targets:
            self._targets[object_id] = self._target(self._scene.object_of[object_id])
        return self._targets[object_id]

    def denser_target(self, object_id: str, count: int) -> SightTarget:
        """Return a sight target for an object: `count` sample points on the object's surface, or `count` on each of its
        boxes if the surface is unknown.
        """
        return self._target(self._scene.object_of[object_id], count)

    def _target(self, item: SceneObject, count: int = DEFAULT_SAMPLES) -> SightTarget:
        faces = self._faces.get(item.object_id)
        if faces is not None and self._geometry is not None:
            return SightTarget(mesh_samples(self._geometry.vertices, faces, count))
        boxes = _boxes_of(item)
        samples = [box_samples(*box, count) for box in boxes] or [item.center[None]]
        numbers = self._box_numbers.get(item.object_id, [-1] * len(samples))
        return SightTarget(np.concatenate(samples), np.repeat(numbers, [len(points) for points in samples]))

    def seen(self, eyes: F64, target: SightTarget, view: View) -> Bools:
        """Return a mask (n, k): whether each of the k samples of a target is visible from each of the `eyes` (n, 3), in
        any direction.
        """
        return visible_points(self._occluders, eyes, target.samples, view, own=target.owners)

    def seen_by_each(self, looks: Sequence[Look]) -> Iterator[Bools]:
        """Yield for each look, in any direction, the mask (n, k) that `seen` returns."""
        begin = end = count = 0
        while begin < len(looks):
            while end < len(looks) and (end == begin or count < LOOKS_AT_ONCE):
                count += len(looks[end].eyes) * len(looks[end].target.samples)
                end += 1
            yield from visible_to_each(self._occluders, looks[begin:end])
            begin, count = end, 0

    def sighted(self, eyes: F64, targets: Sequence[SightTarget], view: View) -> Iterator[tuple[Bools, Bools]]:
        """Yield for each of the `targets` two masks: which of the `eyes` (n, 3) see any of its k samples (n,), and
        which of these samples are visible from any of the eyes (k,).

        Lines are tested in turns, evenly spread over eyes and samples; a line is left out if something is already seen
        from its eye, and its sample from another eye. The masks are those of `seen`, which tests all lines.
        """
        most = max(1, LOOKS_AT_ONCE // max(1, len(eyes)))
        begin = end = count = 0
        while begin < len(targets):
            while end < len(targets) and (end == begin or count + len(targets[end].samples) <= most):
                count += len(targets[end].samples)
                end += 1
            yield from self._sighted(eyes, targets[begin:end], view)
            begin, count = end, 0

    def _sighted(self, eyes: F64, targets: Sequence[SightTarget], view: View) -> Iterator[tuple[Bools, Bools]]:
        sizes = [len(target.samples) for target in targets]
        points = np.concatenate([target.samples for target in targets])
        own = np.concatenate([target.owners for target in targets])
        target_of = np.repeat(np.arange(len(targets)), sizes)
        left = in_view(eyes, points, view)
        by_eye, by_point = np.zeros((len(eyes), len(targets)), bool), np.zeros(len(points), bool)
        eye_of, point_of = np.nonzero(left)
        turns = ((eye_of + point_of) % LOOK_TURNS).astype(np.uint8)
        order, ends = np.argsort(turns, kind="stable"), np.cumsum(np.bincount(turns, minlength=LOOK_TURNS))
        for lines in np.split(order, ends[:-1]):
            eye, point = eye_of[lines], point_of[lines]
            wanted = ~(by_point[point] & by_eye[eye, target_of[point]])
            eye, point = eye[wanted], point[wanted]
            clear = ~self._occluders.hidden(eyes[eye], points[point], own[point])
            by_eye[eye[clear], target_of[point[clear]]] = True
            by_point[point[clear]] = True
        yield from zip(by_eye.T, np.split(by_point, np.cumsum(sizes)[:-1]), strict=True)

    def glimpsed(self, eyes: F64, object_id: str, view: View) -> Bools:
        """Return a mask (n,) of the `eyes` (n, 3) from which any sample point of an object is visible."""
        return self.glimpsed_each([eyes], [object_id], view)[0]

    def glimpsed_each(self, eyes: Sequence[F64], object_ids: Sequence[str], view: View) -> list[Bools]:
        """Return for each object a mask (n,) of its own eyes (n, 3) from which any of its sample points is visible, in
        any direction.

        A few samples are tested first, since they decide most cases.
        """
        seen = [np.zeros(len(places), dtype=bool) for places in eyes]
        for stride in (FIRST_LOOKS, 1):
            asked = [(mask, rows) for mask in seen if len(rows := np.flatnonzero(~mask))]
            looks = list[Look]()
            for places, name, mask in zip(eyes, object_ids, seen, strict=True):
                if not mask.all():
                    target = self.target(name)
                    part = SightTarget(target.samples[::stride], target.owners[::stride])
                    looks.append(Look(places[~mask], part, view))
            for (mask, rows), found in zip(asked, self.seen_by_each(looks), strict=True):
                mask[rows] = found.any(axis=1)
        return seen


def _boxes_of(item: SceneObject) -> list[tuple[F64, F64, F64]]:
    """Return the boxes of an object's parts, or its tightest known box, as (centre, half extents, axes); empty if the
    object has neither.
    """
    oriented = item.parts or (() if item.obb is None else (item.obb,))
    if oriented:
        return [(box.center, box.half_extents, box.rotation) for box in oriented]
    if item.box is None:
        return []
    low, high = item.box
    return [((low + high) / 2, np.maximum(high - low, 0.0) / 2, np.eye(3))]


def _is_structure(label: str, words: Vocabulary) -> bool:
    return label in words.labels and words.entry(label).kind == _STRUCTURE_KIND
