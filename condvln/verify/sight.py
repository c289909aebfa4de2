"""Visibility of a scene's objects, and of its rooms' floors, from given positions.

An object's surface is tested at two sets of points: the 64 of `navigation.surface_samples`, from which observability is
published, and 64 of this package's own. The package's own points decide if they see much of an object, or almost
nothing of an object of which the published points see much; in between, where either set could be right, the published
points decide. "Much" is a share so large that two fair sets of points differ by as much once in a million tests
(`much`).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import product
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from condvln.navigation.occluders import BoxOccluders, JoinedOccluders, MeshOccluders, Occluders
from condvln.navigation.sight import View, in_view
from condvln.navigation.surface_samples import box_samples, mesh_samples
from condvln.scene import Scene, SceneObject
from condvln.scene.geometry import STRUCTURE, SceneGeometry
from condvln.verify.kernels.looking import in_front, in_range, spread
from schemas.config import EpisodeConfig, PlacesConfig
from schemas.config.constants import FIRST_VIEW_DEGREES, FRAME_HEADROOM

__all__ = ["Eyes", "Sight", "Sought", "evenly", "much"]

F64 = NDArray[np.float64]
Bools = NDArray[np.bool_]

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
LINES_KEPT: Final = 1 << 24
"""Number of lines of sight whose results `Sight.is_faced` keeps for later walks; some forty megabytes."""

Sought = tuple[str, str]
"""A target: ("thing", object id) or ("floor", room id)."""

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

    points : (k, 3); the first `own` of them are this package's own samples
    boxes : (k,) index of the occluding box that each point lies on, -1 for none
    least : share of the points that must be visible
    """

    points: F64
    own: int
    boxes: NDArray[np.int64]
    least: float

    def is_seen(self, seen: Bools) -> bool:
        """Return whether the target counts as seen. `seen` (k,) tells which of the target's points are visible."""
        return bool(self._is_enough(_share(seen[: self.own]) if self.own else 0.0, _share(seen[self.own :])))

    def are_seen(self, seen: Bools) -> list[bool]:
        """Return for each line of `seen` (n, k) whether the target counts as seen; see `is_seen`."""
        own = np.count_nonzero(seen[:, : self.own], axis=1) / max(self.own, 1)
        published = np.count_nonzero(seen[:, self.own :], axis=1) / (len(self.points) - self.own)
        found: list[bool] = self._is_enough(own, published).tolist()
        return found

    def _is_enough(self, ours: Any, published: Any) -> Any:
        """Return whether the visible shares of the two sets of points, numbers or arrays, are enough: this package's
        own points decide if many of them are visible, or almost none although many of the published ones are.
        """
        if not self.own:
            return published >= self.least
        enough = much(self.least, self.own)
        return (ours >= enough) | ((published >= self.least) & ((published < enough) | (ours >= self.least)))


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
        self._scene, self._floor, self._rules = scene, floor, rules
        self._is_frame = is_frame
        self._reach, self._slope = places.sight_range, math.tan(math.radians(FIRST_VIEW_DEGREES / 2))
        known = None if geometry is None or not len(geometry.faces) else geometry
        self.approximate = known is None or known.approximate
        self.walls = known is not None and (not known.approximate or STRUCTURE in known.owner)
        self._geometry = None if self.approximate else known
        self._numbers = {item.object_id: number for number, item in enumerate(scene.objects)}
        self._boxes: dict[str, list[int]] = {}
        self._hiding = self._hiders(known, is_structure)
        self._points: dict[Sought, _Points | None] = {}
        self._lines: dict[Sought, _Lines] = {}
        self._kept = 0

    def _hiders(self, known: SceneGeometry | None, is_structure: Callable[[SceneObject], bool]) -> Occluders:
        if known is not None and not known.approximate:
            return MeshOccluders(known.vertices, known.faces)
        bodies = [item for item in self._scene.objects if not is_structure(item)]
        solid = [(item.object_id, box) for item in bodies for box in _boxes(item)]
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
                rows = lines.of(key for eyes in of.values() for key in eyes.keys)
                sizes = np.array([len(eyes.keys) for eyes in of.values()])
                seen = np.logical_or.reduceat(rows, np.cumsum(sizes) - sizes)
                lines.together.update(zip(of, where.are_seen(seen), strict=True))

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
        eyes = np.concatenate([look.eyes for look in looks])
        points = np.concatenate([look.where.points for look in looks])
        boxes = np.concatenate([look.where.boxes for look in looks])
        sizes = np.array([(len(look.keys), len(look.where.points)) for look in looks])
        slopes = np.array([self._slope if look.sought[0] == "thing" else np.inf for look in looks])
        eye_ends, point_ends = np.cumsum(sizes, axis=0).T.copy()
        pair, eye, point = in_range(eyes, points, eye_ends, point_ends, slopes, self._reach)
        seen = np.zeros(int(sizes.prod(axis=1).sum()), dtype=bool)
        seen[pair] = ~self._hiding.hidden(eyes[eye], points[point], boxes[point])
        at = 0
        for look in looks:
            rows = seen[at : at + len(look.keys) * len(look.where.points)].reshape(len(look.keys), -1)
            at += rows.size
            self._kept += rows.size
            self._lines[look.sought].seen.update(zip(look.keys, rows, strict=True))

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
            ends = np.cumsum(np.bincount(of[left], minlength=len(things)))
            eye_ends, anyhow = len(part) * np.arange(1, len(things) + 1), np.full(len(things), np.inf)
            _, eye, point = in_range(np.tile(part, (len(things), 1)), points[left], eye_ends, ends, anyhow, np.inf)
            point = left[point]
            seen[point[~self._hiding.hidden(part[eye % len(part)], points[point], own[point])]] = True
            missing = np.bincount(of[seen], minlength=len(things)) < enough
        return [not few for few in missing]

    def is_seen(self, sought: Sought, eyes: Eyes, yaw: float | None = None) -> bool:
        """Return whether enough points of a target are visible; a point counts if any of the eyes sees it. If `yaw` is
        given, there must be only one eye, and it looks in the direction `yaw`. `look` must have been asked before.
        """
        where = self._where(sought)
        if where is None:
            return False
        lines = self._lines[sought]
        if yaw is None:
            return lines.together[eyes.name]
        turned = float(np.sin(yaw)), float(np.cos(yaw))
        facing = in_front(eyes.places[0], where.points, *turned, self._reach, self._slope, self._slope)
        return where.is_seen(lines.seen[eyes.keys[0]] & facing)

    def is_faced(self, sought: Sought, eyes: F64, headings: F64, angle: float) -> bool:
        """Return whether enough points of a target are visible on a walk. A point counts if it is visible from any of
        the eyes (n, 3), within a horizontal angle of `angle` degrees around the heading there (n,).

        Walks of a scene may be many: after `LINES_KEPT` lines of sight, the results of earlier calls, and of `look`,
        are forgotten.
        """
        where = self._where(sought)
        if where is None:
            return False
        facing = in_view(eyes, where.points, View(range=self._reach, horizontal_fov=angle), headings)
        some = np.flatnonzero(facing.any(axis=1))
        if not len(some):
            return False
        if self._kept > LINES_KEPT:
            self._lines.clear()
            self._kept = 0
        turned = Eyes(eyes[some])
        self._cast_missing([(sought, [turned])])
        seen: Bools = np.any(self._lines[sought].of(turned.keys) & facing[some], axis=0)
        return where.is_seen(seen)

    def shares(self, sought: Sought, eyes: Eyes) -> list[float]:
        """Return the visible share of each of a target's sets of points: first of the points that this package chose
        itself, if there are any, then of the published points. `look` must have been asked before.
        """
        where = self._where(sought)
        if where is None:
            return []
        seen: Bools = np.any(self._lines[sought].of(eyes.keys), axis=0)
        parts = (seen[: where.own], seen[where.own :])
        return [round(_share(part), 3) for part in parts if len(part)]

    def _where(self, sought: Sought) -> _Points | None:
        """Return the sample points of a target; None if the target is not in the scene."""
        if sought not in self._points:
            kind, name = sought
            self._points[sought] = self._of_thing(name) if kind == "thing" else self._of_floor(name)
        return self._points[sought]

    def _of_floor(self, room_id: str) -> _Points | None:
        points = self._floor(room_id) if room_id in self._scene.room_of else np.empty((0, 3))
        outside = np.full(len(points), -1)
        return _Points(points, 0, outside, self._rules.floor_seen) if len(points) else None

    def _of_thing(self, object_id: str) -> _Points | None:
        item = self._scene.object_of.get(object_id)
        if item is None:
            return None
        known, least = self._geometry, self._rules.object_seen
        triangles, faces = self._triangles(item), self._faces(item)
        if triangles is None:
            points = item.center[None]
            return _Points(points, 0, self._own_boxes(object_id, points), least)
        ours = evenly(triangles)
        if known is not None and len(faces):
            published = mesh_samples(known.vertices, faces)
            lie_on = self._own_boxes(object_id, published)
        else:
            # A point where boxes of an object meet lies on the box that it was chosen from.
            parts = [box_samples(*box) for box in _boxes(item)]
            numbers = self._boxes.get(object_id, [-1] * len(parts))
            published, lie_on = np.concatenate(parts), np.repeat(numbers, [len(part) for part in parts])
        boxes = np.concatenate([self._own_boxes(object_id, ours), lie_on])
        return _Points(np.concatenate([ours, published]), len(ours), boxes, least)

    def _own_boxes(self, object_id: str, points: F64) -> NDArray[np.int64]:
        """Return for each of an object's points (k, 3) the index of the object's box that the point lies on. Of several
        boxes, the nearest counts; the index is -1 for an object without boxes.
        """
        numbers = np.array(self._boxes.get(object_id, [-1]), dtype=np.int64)
        if len(numbers) == 1:
            return np.full(len(points), numbers[0])
        away = [
            np.linalg.norm(np.maximum(np.abs((points - middle) @ axes) - half, 0.0), axis=1)
            for middle, half, axes in _boxes(self._scene.object_of[object_id])
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
        faces, boxes = self._faces(item), _boxes(item)
        if self._geometry is not None and len(faces):
            surface: F64 = self._geometry.vertices[faces]
            return surface
        if not boxes:
            return None
        return np.concatenate([(middle + (_SIGNS * half) @ axes.T)[_TRIANGLES] for middle, half, axes in boxes])


def _share(seen: Bools) -> float:
    return float(np.count_nonzero(seen)) / len(seen)


def evenly(triangles: F64, count: int = OWN_POINTS) -> F64:
    """Return points (count, 3) spread evenly over the area of triangles (m, 3, 3); equal triangles give equal points.

    Within triangles they follow the R2 sequence (Roberts 2018), mapped from the square to a triangle by the root map.
    """
    return spread(np.ascontiguousarray(triangles, np.float64), *_spread(count))


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


def _boxes(item: SceneObject) -> list[tuple[F64, F64, F64]]:
    """Return (centre, half extents, axes as columns) of each of an object's boxes: the boxes of its parts or, if it has
    no parts, its tightest known box; empty if no box is known.
    """
    if item.parts:
        return [(part.center, part.half_extents, part.rotation) for part in item.parts]
    if item.obb is not None:
        return [(item.obb.center, item.obb.half_extents, item.obb.rotation)]
    box = item.box
    if box is None:
        return []
    return [((box[0] + box[1]) / 2, np.maximum(box[1] - box[0], 0.0) / 2, np.eye(3))]
