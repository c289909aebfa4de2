"""Visibility of a scene's objects, and of its rooms' floors, from given positions.

An object counts as seen if it is recognised from one place: enough of its points are visible, and the rectangle of
azimuth × elevation around them is large enough. A floor counts as seen if enough of its points are, each from some
place.

An object's surface is tested at two sets of points: the 64 of `navigation.surface_samples`, from which observability is
published, and 64 of this package's own. The package's own points decide if they see much of an object, or almost
nothing of an object of which the published points see much; in between, where either set could be right, the published
points decide. "Much" is a share so large that two fair sets of points differ by as much once in a million tests
(`much`). The same holds of the rectangles: those of the published points decide, unless the own points make one that is
twice as large as needed, or many of them one of less than half. Corners join the own points here: the thin side of a
picture has one own point or none, since they are spread over the area.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import product
from typing import Final

import numpy as np
from numpy.typing import NDArray

from condvln.arrays import F64, Bools
from condvln.navigation.occluders import BoxOccluders, JoinedOccluders, MeshOccluders, Occluders
from condvln.navigation.surface_samples import box_samples, mesh_samples
from condvln.scene import Scene, SceneObject
from condvln.scene.scene import STRUCTURE, SceneGeometry
from condvln.verify.surfaces import boxes_of
from condvln.verify.words import words
from schemas.config import EpisodeConfig, PlacesConfig
from schemas.config.constants import (
    ABSENCE_METRES,
    FLOOR_LIFT,
    FRAME_HEADROOM,
    LEVEL_CAMERA,
    SEEABLE_IN_FRAME,
    SEEABLE_PLACES,
    SEEABLE_SHARE,
    TABLE_HEIGHT,
)

__all__ = ["Eyes", "Sight", "Sought", "absence_range", "evenly", "in_front", "in_range", "much", "rectangles"]


OWN_POINTS: Final = 64
"""Number of this package's own points on a surface, equal to the published number."""
ODDS: Final = 1e-6
"""Probability with which two fair sets of points differ by as much as counts as a contradiction."""
EYES_AT_ONCE: Final = 512
"""Number of eyes that are tested against one object's points at once."""
TURNS: Final = 8
"""Number of turns, at least, in which the eyes of a room are asked about an object's points."""
RAYS_AT_ONCE: Final = 1 << 17
"""Number of pending rays after which they are cast; some ten megabytes."""
EDGE: Final = 1e-9
"""Metres by which a point may lie outside the border of a view and still be inside, so that rounding decides about no
point that lies exactly on it.
"""

LARGE: Final = 2.0
"""Factor by which the rectangle around the own points must differ from the least one to contradict the published
points."""
MANY: Final = 16
"""Number of visible own points whose rectangle can contradict the published points by being small."""
ROUNDING: Final = 1e-6
"""Degrees by which rounding may change a side."""

Sought = tuple[str, str, float]
"""A target: ("thing", object id, 0) or ("floor", room id, metres up to which its points are visible)."""

_LEVEL: Final = tuple(math.tan(math.radians(angle / 2)) for angle in LEVEL_CAMERA)
_ANY_SLOPE: Final = 1e6
# Increments of the R2 sequence (Roberts 2018): powers of the inverse of the plastic number.
_R2: Final = (0.7548776662466927, 0.5698402909980532)
_SIGNS: Final = np.array(list(product((-1.0, 1.0), repeat=3)))
_QUADS: Final = np.array([[0, 1, 3, 2], [4, 5, 7, 6], [0, 1, 5, 4], [2, 3, 7, 6], [0, 2, 6, 4], [1, 3, 7, 5]])
_TRIANGLES: Final = np.concatenate([_QUADS[:, [0, 1, 2]], _QUADS[:, [0, 2, 3]]])


class Eyes:
    """The places (n, 3) from which targets are looked for together. `name` and `keys` identify them and each of them,
    and are made once for all targets.
    """

    __slots__ = ("keys", "name", "places")

    def __init__(self, places: F64) -> None:
        self.places = places
        self.name = places.tobytes()
        size = places.itemsize * 3
        self.keys = [self.name[at : at + size] for at in range(0, len(self.name), size)]


@dataclass(frozen=True, eq=False, slots=True)
class _Points:
    """The sample points of one target.

    points : (k, 3); the first `own` of them are this package's own samples, corners of the target follow, and from
        index `published` on the published samples
    boxes : (k,) index of the occluding box that each point lies on, -1 for none
    least : share of the points that must be visible
    sides : least shorter and longer side in degrees of the rectangle around the visible points; None for a floor
    """

    points: F64
    own: int
    published: int
    boxes: NDArray[np.int64]
    least: float
    sides: tuple[float, float] | None = None

    def is_covered(self, seen: Bools) -> bool:
        """Return whether enough of a floor is visible. `seen` (n, k) tells which of its points each eye sees."""
        return bool(_share(np.asarray(seen.any(axis=0))) >= self.least)

    def recognised(self, seen: Bools, eyes: F64) -> Bools:
        """Return for each of the eyes (n, 3) whether it recognises the target. `seen` (n, k) tells which of its points
        it sees.
        """
        assert self.sides is not None, "a floor is not recognised"
        least = np.array(self.sides) - ROUNDING
        theirs = np.count_nonzero(seen[:, self.published :], axis=1) / (len(self.points) - self.published)
        if not self.own:
            published = rectangles(eyes, self.points, seen)
            return np.asarray((published >= least).all(axis=1) & (theirs >= self.least))
        count = np.count_nonzero(seen[:, : self.own], axis=1)
        ours, enough = count / self.own, much(self.least, self.own)
        # Who sees little by either set recognises nothing, whatever the rectangles are.
        able = np.flatnonzero((theirs >= self.least) | (ours >= enough))
        found = np.zeros(len(eyes), dtype=bool)
        if not len(able):
            return found
        seen, eyes, theirs, count, ours = seen[able], eyes[able], theirs[able], count[able], ours[able]
        published = rectangles(eyes, self.points[self.published :], seen[:, self.published :])
        own = rectangles(eyes, self.points[: self.published], seen[:, : self.published])
        small = (count >= MANY) & (own * LARGE < least).any(axis=1)
        large = (theirs >= self.least) & ((theirs < enough) | (ours >= self.least)) & ~small
        large &= (published >= least).all(axis=1)
        found[able] = large | ((ours >= enough) & (own >= LARGE * least).all(axis=1))
        return found

    def refuted(self, seen: Bools) -> Bools:
        """Return for each eye whether it sees much of a target by the published points and next to nothing of it by
        this package's own. `seen` (n, k) tells which of the points it sees.
        """
        if not self.own:
            return np.zeros(len(seen), dtype=bool)
        ours, theirs = seen[:, : self.own].mean(axis=1), seen[:, self.published :].mean(axis=1)
        return np.asarray((theirs >= much(self.least, self.own)) & (ours < self.least))

    def degrees(self, seen: Bools, eyes: F64) -> F64:
        """Return the shorter side in degrees (n,) of the rectangle around the published points; 0 where they are not
        recognised.
        """
        if self.sides is None or not len(eyes):
            return np.zeros(len(eyes))
        seen = seen[:, self.published :]
        able = np.flatnonzero(np.count_nonzero(seen, axis=1) >= self.least * (len(self.points) - self.published))
        published = rectangles(eyes[able], self.points[self.published :], seen[able])
        found = np.zeros(len(eyes))
        found[able] = np.where((published >= np.array(self.sides) - ROUNDING).all(axis=1), published[:, 0], 0.0)
        return found


class _Lines:
    """The lines of sight to one target: which of its points (k,) are visible from an eye, by the eye's key, and whether
    the target is seen from eyes together, by their name.
    """

    def __init__(self) -> None:
        self.seen: dict[bytes, Bools] = {}
        self.together: dict[bytes, bool] = {}

    def of(self, keys: Iterable[bytes]) -> Bools:
        """Return the lines of sight (n, k) from eyes that are known."""
        seen = self.seen
        return np.array([seen[key] for key in keys])


@dataclass(frozen=True, eq=False, slots=True)
class _Look:
    """The pending visibility tests of one target from eyes (n, 3), with a cache key for each eye."""

    sought: Sought
    keys: list[bytes]
    eyes: F64
    where: _Points


class Sight:
    """Lines of sight in one scene; each (place, target) is computed once.

    Exact surfaces occlude what is behind them. If boxes replace them, walls and floors occlude with their triangles and
    every object with a solid box. If no surface is known, only objects occlude.

    Parameters
    ----------
    geometry : the scene's surfaces, None if its dataset has none
    is_structure : returns whether an object is structure (wall, floor), whose box is not solid
    is_frame : returns whether an object is a frame (shelf, table), whose box does not hide what is on it
    floor : points (n, 3) of a room's floor, by its id

    Attributes
    ----------
    approximate : whether boxes replace surfaces; walls : whether walls occlude
    places : what an agent sees
    """

    def __init__(
        self,
        scene: Scene,
        geometry: SceneGeometry | None,
        is_structure: Callable[[SceneObject], bool],
        is_frame: Callable[[SceneObject], bool],
        floor: Callable[[str], F64],
        places: PlacesConfig,
        rules: EpisodeConfig,
    ) -> None:
        self._scene, self._floor, self._rules, self.places = scene, floor, rules, places
        self._is_frame = is_frame
        self._sides = (places.seen_degrees.short, places.seen_degrees.long)
        self._reach = places.sight_range
        known = None if geometry is None or not len(geometry.faces) else geometry
        self.approximate = known is None or known.approximate
        self.walls = known is not None and (not known.approximate or STRUCTURE in known.owner)
        self._geometry = None if self.approximate else known
        self._numbers = {item.object_id: number for number, item in enumerate(scene.objects)}
        self._boxes: dict[str, list[int]] = {}
        self._hiding = self._hiders(known, is_structure)
        self._points: dict[tuple[bool, str], _Points | None] = {}
        self._lines: dict[Sought, _Lines] = {}

    def _hiders(self, known: SceneGeometry | None, is_structure: Callable[[SceneObject], bool]) -> Occluders:
        if known is not None and not known.approximate:
            return MeshOccluders(known.vertices, known.faces)
        bodies = [item for item in self._scene.objects if not is_structure(item)]
        solid = [(item.object_id, box) for item in bodies for box in boxes_of(item)]
        self._boxes = {}
        for number, (name, _) in enumerate(solid):
            self._boxes.setdefault(name, []).append(number)
        middles, halves, axes = (np.array([box[k] for _, box in solid]) for k in range(3))
        open_above = {item.object_id for item in bodies if self._is_frame(item)}
        above = [FRAME_HEADROOM * (name in open_above) for name, _ in solid]
        boxes = BoxOccluders(middles.reshape(-1, 3), halves.reshape(-1, 3), axes.reshape(-1, 3, 3), above)
        walls = () if known is None else known.faces[known.owner == STRUCTURE]
        return (
            boxes if known is None or not len(walls) else JoinedOccluders(MeshOccluders(known.vertices, walls), boxes)
        )

    def look(self, wanted: Iterable[tuple[Sought, Eyes]]) -> None:
        """Cast the lines of sight of all `wanted` pairs of a target and eyes together, and find out whether each target
        is seen from its eyes. What is known is not asked again.
        """
        asked: dict[Sought, dict[bytes, Eyes]] = {}
        for sought, eyes in wanted:
            asked.setdefault(sought, {})[eyes.name] = eyes
        for sought, of in asked.items():
            known = self._lines.setdefault(sought, _Lines()).together
            asked[sought] = {name: eyes for name, eyes in of.items() if name not in known}
        self._cast_missing((sought, list(of.values())) for sought, of in asked.items())
        for sought, of in asked.items():
            where = self._where(sought)
            if where is not None and of:
                lines = self._lines[sought]
                for name, eyes in of.items():
                    lines.together[name] = self._is_known(where, lines.of(eyes.keys), eyes.places)

    def _is_known(self, where: _Points, seen: Bools, eyes: F64) -> bool:
        """Return whether a target is seen from the eyes (n, 3) together, each of which sees some of its points."""
        if where.sides is None:
            return where.is_covered(seen)
        some = seen.any(axis=1)
        return bool(some.any() and where.recognised(seen[some], eyes[some]).any())

    def degrees(self, sought: Sought, eyes: Eyes) -> float:
        """Return how large an object appears from the best of the eyes: the shorter side in degrees of the rectangle
        around its published points; 0 if none recognises it.
        """
        where = self._where(sought)
        if where is None or not len(eyes.places):
            return 0.0
        self._cast_missing([(sought, [eyes])])
        return float(where.degrees(self._lines[sought].of(eyes.keys), eyes.places).max(initial=0.0))

    def is_sure(self, sought: Sought, eyes: Eyes) -> bool:
        """Return whether enough of the eyes recognise an object by a level camera, and see enough of it together, for
        the generator to look no further. `degrees` must have been asked before.
        """
        where = self._where(sought)
        if where is None or not len(eyes.places):
            return False
        seen = self._lines[sought].of(eyes.keys)
        least = max(min(SEEABLE_PLACES, len(eyes.places)), SEEABLE_IN_FRAME * len(eyes.places))
        several = np.count_nonzero(where.degrees(seen, eyes.places)) >= least
        return bool(several and _share(np.asarray(seen[:, where.published :].any(axis=0))) >= SEEABLE_SHARE)

    def _cast_missing(self, wanted: Iterable[tuple[Sought, Iterable[Eyes]]]) -> None:
        """Cast all lines of sight that are not known."""
        places: dict[Sought, dict[bytes, F64]] = {}
        for sought, together in wanted:
            known = self._lines.setdefault(sought, _Lines()).seen
            new = places[sought] = {}
            for its in together:
                for key, place in zip(its.keys, its.places, strict=True):
                    if key not in known:
                        new[key] = place
        looks: list[_Look] = []
        waiting = 0
        for sought, of in places.items():
            where = self._where(sought)
            if where is None or not of:
                continue
            keys, eyes = list(of), np.array(list(of.values()))
            for at in range(0, len(keys), EYES_AT_ONCE):
                part = slice(at, at + EYES_AT_ONCE)
                looks.append(_Look(sought, keys[part], eyes[part], where))
                waiting += len(looks[-1].keys) * len(where.points)
                if waiting > RAYS_AT_ONCE:
                    self._cast(looks)
                    looks, waiting = [], 0
        self._cast(looks)

    def _cast(self, looks: Sequence[_Look]) -> None:
        """Test which points of each of `looks` are in range and not occluded, and store the results in the cache."""
        if not looks:
            return
        seen = [in_range(look.eyes, look.where.points, *self._limits(look.sought)) for look in looks]
        lines = [np.nonzero(mask) for mask in seen]
        begin = np.concatenate([look.eyes[eye] for look, (eye, _) in zip(looks, lines, strict=True)])
        end = np.concatenate([look.where.points[point] for look, (_, point) in zip(looks, lines, strict=True)])
        boxes = np.concatenate([look.where.boxes[point] for look, (_, point) in zip(looks, lines, strict=True)])
        free = ~self._hiding.hidden(begin, end, boxes)
        parts = np.split(free, np.cumsum([len(eye) for eye, _ in lines])[:-1])
        for look, mask, line, part in zip(looks, seen, lines, parts, strict=True):
            mask[line] = part
            self._lines[look.sought].seen.update(zip(look.keys, mask, strict=True))

    def _limits(self, sought: Sought) -> tuple[float, float]:
        """Return the range in metres and the greatest slope of the lines of sight to a target."""
        kind, _, metres = sought
        return (metres if kind == "floor" else self._reach), (math.inf if kind == "floor" else _LEVEL[1])

    def floor(self, room_id: str) -> F64:
        """Return points (n, 3) on a room's floor."""
        return self._floor(room_id)

    def surface(self, object_id: str, count: int) -> F64:
        """Return points (count, 3) on an object's surface, chosen independently of the generator's; the object's centre
        if its extent is unknown.
        """
        item = self._scene.object_of[object_id]
        triangles = self._triangles(item)
        return item.center[None] if triangles is None else evenly(triangles, count)

    def met(self, things: Sequence[tuple[str, F64]], eyes: F64, enough: Sequence[float]) -> list[bool]:
        """Return for each object, given by its id and points (k, 3) on it, whether `enough` of its points are visible
        from any of the eyes (n, 3), at any distance.
        """
        turns = max(TURNS, -(-len(eyes) // EYES_AT_ONCE))
        most = max(RAYS_AT_ONCE * turns // max(len(eyes), 1), 1)
        found: list[bool] = []
        while len(found) < len(things):
            first, points = len(found), 0
            for _, its in things[first:]:
                points += len(its)
                if points > most and len(found) > first:
                    break
                found.append(False)
            part = slice(first, len(found))
            found[part] = self._met(things[part], eyes, np.array(enough[part]), turns)
        return found

    def _met(self, things: Sequence[tuple[str, F64]], eyes: F64, enough: F64, turns: int) -> list[bool]:
        points = np.concatenate([its for _, its in things])
        own = np.concatenate([self._own_boxes(name, its) for name, its in things])
        of = np.repeat(np.arange(len(things)), [len(its) for _, its in things])
        seen = np.zeros(len(points), dtype=bool)
        missing = enough > 0
        for turn in range(min(turns, len(eyes))):  # each with eyes all over the room
            left = np.flatnonzero(~seen & missing[of])
            if not len(left):
                break
            part = eyes[turn::turns]
            point, eye = np.repeat(left, len(part)), np.tile(part, (len(left), 1))
            seen[point[~self._hiding.hidden(eye, points[point], own[point])]] = True
            missing = np.bincount(of[seen], minlength=len(things)) < enough
        return [not few for few in missing]

    def is_seen(self, sought: Sought, eyes: Eyes, yaw: float | None = None) -> bool:
        """Return whether a target is seen from the eyes together. If `yaw` is given, there must be only one eye, and it
        looks in the direction `yaw`. `look` must have been asked before.
        """
        where = self._where(sought)
        if where is None:
            return False
        lines = self._lines[sought]
        if yaw is None:
            return lines.together[eyes.name]
        facing = in_front(eyes.places, where.points, np.array([yaw]), self._reach, *_LEVEL)
        return self._is_known(where, lines.seen[eyes.keys[0]] & facing, eyes.places)

    def first_frame(self, sought: Sought, eyes: F64, yaws: F64) -> int | None:
        """Return the number of the first of n frames by which a target is seen, None if there is none. Frames are those
        of the level camera at `eyes` (n, 3) that look in the directions `yaws` (n,). An object must be recognised in
        one frame by its published points, not refuted by this package's own. A floor is seen in several together.
        """
        where = self._where(sought)
        if where is None:
            return None
        shown = in_front(eyes, where.points, yaws, self._limits(sought)[0], *_LEVEL)
        if where.sides is None:
            seen = np.logical_or.accumulate(self._free(where, eyes, shown), axis=0)
            known = np.count_nonzero(seen, axis=1) >= where.least * len(where.points)
        else:
            known = where.degrees(shown, eyes) > 0  # what is hidden makes nothing larger
            published = shown & (np.arange(len(where.points)) >= where.published)
            known[known] = where.degrees(self._free(where, eyes[known], published[known]), eyes[known]) > 0
            eyes = eyes[known]
            known[known] = ~where.refuted(self._free(where, eyes, shown[known]))
        return int(known.argmax()) if known.any() else None

    def is_ahead(self, sought: Sought, eye: F64, yaw: float, degrees: float) -> bool:
        """Return whether part of a target lies within an angle of the direction of an eye (3,), hidden or not."""
        where = self._where(sought)
        if where is None:
            return False
        aside = math.tan(math.radians(degrees))
        return bool(in_front(eye[None], where.points, np.array([yaw]), self._reach, aside, _ANY_SLOPE).any())

    def _free(self, where: _Points, eyes: F64, shown: Bools) -> Bools:
        """Return which of the points that are `shown` (n, k) to the eyes (n, 3) nothing hides. Where an agent turns,
        several eyes in turn are one place.
        """
        if not len(eyes):
            return shown
        begins = np.append(True, (eyes[1:] != eyes[:-1]).any(axis=1))
        free = np.logical_or.reduceat(shown, np.flatnonzero(begins))
        eye, point = np.nonzero(free)
        free[eye, point] = ~self._hiding.hidden(eyes[begins][eye], where.points[point], where.boxes[point])
        seen: Bools = free[np.cumsum(begins) - 1] & shown
        return seen

    def shares(self, sought: Sought, eyes: Eyes) -> list[float]:
        """Return the visible share of each of a target's sets of points from all eyes: first of the points that this
        package chose itself, if there are any, then of the published points. `look` must have been asked before.
        """
        where = self._where(sought)
        if where is None:
            return []
        seen: Bools = np.any(self._lines[sought].of(eyes.keys), axis=0)
        parts = (seen[: where.own], seen[where.published :])
        return [round(_share(part), 3) for part in parts if len(part)]

    def _where(self, sought: Sought) -> _Points | None:
        """Return the sample points of a target; None if the target is not in the scene."""
        kind, name, _ = sought
        key = (kind == "floor", name)
        if key not in self._points:
            self._points[key] = self._of_floor(name) if kind == "floor" else self._of_thing(name)
        return self._points[key]

    def _of_floor(self, room_id: str) -> _Points | None:
        points = self._floor(room_id) if room_id in self._scene.room_of else np.empty((0, 3))
        outside = np.full(len(points), -1)
        return _Points(points, 0, 0, outside, self._rules.floor_seen) if len(points) else None

    def _of_thing(self, object_id: str) -> _Points | None:
        item = self._scene.object_of.get(object_id)
        if item is None:
            return None
        known, least = self._geometry, self._rules.object_seen
        triangles, faces = self._triangles(item), self._faces(item)
        if triangles is None:
            points = item.center[None]
            return _Points(points, 0, 0, self._own_boxes(object_id, points), least, self._sides)
        ours = np.concatenate([evenly(triangles), _corners(item, triangles)])
        if known is not None and len(faces):
            published = mesh_samples(known.vertices, faces)
            lie_on = self._own_boxes(object_id, published)
        else:
            # A point where boxes of an object meet lies on the box that it was chosen from.
            parts = [box_samples(*box) for box in boxes_of(item)]
            numbers = self._boxes.get(object_id, [-1] * len(parts))
            published, lie_on = np.concatenate(parts), np.repeat(numbers, [len(part) for part in parts])
        boxes = np.concatenate([self._own_boxes(object_id, ours), lie_on])
        return _Points(np.concatenate([ours, published]), OWN_POINTS, len(ours), boxes, least, self._sides)

    def _own_boxes(self, object_id: str, points: F64) -> NDArray[np.int64]:
        """Return for each of an object's points (k, 3) the index of the object's box that the point lies on. Of several
        boxes, the nearest counts; the index is -1 for an object without boxes.
        """
        numbers = np.array(self._boxes.get(object_id, [-1]), dtype=np.int64)
        if len(numbers) == 1:
            return np.full(len(points), numbers[0])
        away = [
            np.linalg.norm(np.maximum(np.abs((points - middle) @ axes) - half, 0.0), axis=1)
            for middle, half, axes in boxes_of(self._scene.object_of[object_id])
        ]
        nearest: NDArray[np.int64] = numbers[np.argmin(np.round(away, 6), axis=0)]
        return nearest

    def _faces(self, item: SceneObject) -> NDArray[np.int64]:
        """Return the faces (m, 3) of an object's own surface; empty if no exact surface is known."""
        known = self._geometry
        return (
            np.empty((0, 3), np.int64) if known is None else known.faces[known.owner == self._numbers[item.object_id]]
        )

    def _triangles(self, item: SceneObject) -> F64 | None:
        """Return triangles (m, 3, 3) of an object's surface, or of its boxes; None if its extent is unknown."""
        faces, boxes = self._faces(item), boxes_of(item)
        if self._geometry is not None and len(faces):
            surface: F64 = self._geometry.vertices[faces]
            return surface
        if not boxes:
            return None
        return np.concatenate([(middle + (_SIGNS * half) @ axes.T)[_TRIANGLES] for middle, half, axes in boxes])


def absence_range(label: str, places: PlacesConfig) -> float:
    """Return up to how many metres a floor is looked at to know that nothing with a label is on it: at that distance a
    usual one is recognised. This is found out for each of the possible distances from the angles to the edges of the
    thing.
    """
    long, short, lies = words().usual(label)
    least = [math.radians(side) for side in (places.seen_degrees.short, places.seen_degrees.long)]
    below = places.eye_height - {"floor": FLOOR_LIFT, "table": TABLE_HEIGHT}.get(lies, 0.0)
    found = 0.0
    for metres in ABSENCE_METRES:
        spans = [2 * math.atan2(side / 2, metres) for side in (short, long)]
        if lies:
            ahead = math.sqrt(max(metres * metres - below * below, 0.0))
            spans[0] = min(spans[0], math.atan2(below, ahead - short / 2) - math.atan2(below, ahead + short / 2))
        if metres <= places.sight_range and all(span >= side for span, side in zip(spans, least, strict=True)):
            found = metres
    return found


def in_range(eyes: F64, points: F64, reach: float, slope: float) -> Bools:
    """Return which of the points (k, 3) are at most `reach` metres from each eye (n, 3), on a line of sight whose
    height is at most `slope` of its length on the ground; (n, k).
    """
    x, y, z = points.T[:, None] - eyes.T[:, :, None]
    found: Bools = x * x + y * y + z * z <= (reach + EDGE) ** 2
    return found if math.isinf(slope) else found & (np.abs(y) <= np.hypot(x, z) * slope + EDGE)


def in_front(eyes: F64, points: F64, yaws: F64, reach: float, aside: float, above: float) -> Bools:
    """Return which points (k, 3) are at most `reach` metres from each eye (n, 3) and in its field of view; (n, k).

    yaws : (n,) radians counter-clockwise from −z; aside, above : tangents of half the angles of view
    """
    x, y, z = points.T[:, None] - eyes.T[:, :, None]
    sine, cosine = np.sin(yaws)[:, None], np.cos(yaws)[:, None]
    ahead, across = -x * sine - z * cosine, x * cosine - z * sine
    near = x * x + y * y + z * z <= (reach + EDGE) ** 2
    found: Bools = near & (np.abs(across) <= ahead * aside + EDGE) & (np.abs(y) <= ahead * above + EDGE)
    return found


def rectangles(eyes: F64, points: F64, seen: Bools) -> F64:
    """Return the shorter and the longer side (n, 2), in degrees, of the rectangle of azimuth × elevation around the
    points (k, 3) that each eye (n, 3) sees, by the mask (n, k); 0 where it sees none.
    """
    away = np.where(seen[..., None], points - eyes[:, None], np.nan)
    some = seen.any(axis=1)
    sides = np.zeros((len(eyes), 2))
    if some.any():
        away = away[some]
        with np.errstate(invalid="ignore", divide="ignore"):
            up = np.degrees(np.arcsin(away[..., 1] / np.linalg.norm(away, axis=-1)))
        sides[some, 1] = np.nanmax(up, axis=1) - np.nanmin(up, axis=1)
        # Sorted, with what is hidden at the end. The widest empty sector lies outside.
        bearing = np.sort(np.degrees(np.angle(-away[..., 2] + 1j * away[..., 0])), axis=1)
        last = np.nanmax(bearing, axis=1)
        empty = 360.0 - (last - bearing[:, 0])
        if bearing.shape[1] > 1:
            empty = np.fmax(empty, np.fmax.reduce(np.diff(bearing, axis=1), axis=1))
        # A sector is narrower on the parallels above and below the horizon.
        sides[some, 0] = (360.0 - empty) * np.cos(np.radians(np.nanmin(np.abs(up), axis=1)))
    sides.sort(axis=1)
    return sides


def _share(seen: Bools) -> float:
    return float(np.count_nonzero(seen)) / len(seen)


def evenly(triangles: F64, count: int = OWN_POINTS) -> F64:
    """Return points (count, 3) spread evenly over the area of triangles (m, 3, 3); equal triangles give equal points.

    Within triangles they follow the R2 sequence (Roberts 2018), mapped from the square to a triangle by the root map.
    """
    share, root, part = _spread(count)
    first, along, across = triangles[:, 0], triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]
    upto = np.cumsum(np.linalg.norm(np.cross(along, across), axis=1))
    if not upto[-1]:  # the triangles are lines or points
        upto = np.arange(1.0, len(triangles) + 1)
    face = np.minimum(np.searchsorted(upto, share * upto[-1], side="right"), len(triangles) - 1)
    points: F64 = first[face] + root[:, None] * ((1 - part)[:, None] * along[face] + part[:, None] * across[face])
    return points


def _corners(item: SceneObject, triangles: F64) -> F64:
    """Return the vertices (8, 3) of an object's triangles (m, 3, 3) that lie farthest to the corners of its box."""
    axes = np.eye(3) if item.obb is None else item.obb.rotation
    vertices: F64 = triangles.reshape(-1, 3)
    corners: F64 = vertices[np.argmax(vertices @ axes @ _SIGNS.T, axis=0)]
    return corners


@lru_cache(maxsize=16)
def _spread(count: int) -> tuple[F64, F64, F64]:
    """Return for each of `count` points its share of the area (n,), and where in its triangle it lies, (n,) each."""
    number = np.arange(count)
    u, v = (np.asarray((number + 1) * step % 1.0, np.float64) for step in _R2)
    root: F64 = np.sqrt(u)
    return (number + 0.5) / count, root, v


@lru_cache(maxsize=16)
def much(least: float, count: int) -> float:
    """Return the visible share from which one set of `count` points contradicts another: both sets lie on the same
    surface, and the visible share of the other set is below `least`.

    If both sets were random points on the same surface, such a pair would occur with a probability of at most `ODDS`;
    both sets are spread more evenly than random ones. A result above 1 means that no share is a contradiction.
    """
    few = math.ceil(least * count)
    shown = np.arange(1, 1000)[:, None] / 1000.0
    hits = np.arange(count + 1)
    ways = np.array([math.comb(count, int(hit)) for hit in hits], dtype=np.float64)
    chance = ways * shown**hits * (1.0 - shown) ** (count - hits)
    under = chance[:, :few].sum(axis=1)
    over = chance[:, ::-1].cumsum(axis=1)[:, ::-1]
    both = (under[:, None] * over).max(axis=0)
    sure = np.flatnonzero(both <= ODDS)
    return float(sure[0] / count) if len(sure) else 2.0
