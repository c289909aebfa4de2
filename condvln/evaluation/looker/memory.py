"""The looker agent's memory of objects: the positions of their surfaces, in its own frame. What it knows of the rooms
and objects that a text names, and how it answers the text's conditions.

Whether a relation holds is judged by what was seen of the objects: a score that is positive if the relation holds. The
limits are between those at which text uses a relation as true and as false (`Thresholds`), since an object is never
seen completely: distances can only shrink as more is seen.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from shapely import MultiPoint

from condvln.arrays import F64
from condvln.evaluation.looker.eyes import Look
from condvln.instructions.text_reading import Phrase, Place
from condvln.relations.decisions import OF_SOME_PIECE, TURNED, bounds_of, halfway
from condvln.relations.directions import BEARING_DEGREES, COMPASS
from condvln.relations.text import measured_by_boxes
from condvln.scene import RoomArrays, SceneObject, round_mm
from schemas.config import Thresholds
from schemas.program import BEARINGS, Predicate

__all__ = ["GRAIN", "Compared", "Memory", "Referents", "Thing", "gap", "holds", "ranked"]


GRAIN: Final = 0.05
"""Edge in metres of the voxels that store an object's surface."""
_SPAN: Final = 1 << 14
_MOST: Final = 600
"""Largest number of voxels of an object used for distances; larger objects are subsampled."""


@dataclass(eq=False, slots=True)
class Thing:
    """An object: its label, the number of its room, and the seen part of its surface.

    nearest : least horizontal distance in metres from which it was seen; seen : step at which it was last seen
    """

    number: int
    label: str
    room: int
    cubes: NDArray[np.int64]
    nearest: float
    seen: int
    _points: F64 | None = field(default=None, repr=False)

    @property
    def points(self) -> F64:
        """Centres (n, 3) of the object's surface voxels in metres: x, height above the agent's feet at the start, z."""
        if self._points is None:
            keys = self.cubes
            keys = keys[:: max(1, -(-len(keys) // _MOST))] if len(keys) > 4 * _MOST else keys
            axes = np.stack([keys // (_SPAN * _SPAN), keys // _SPAN % _SPAN, keys % _SPAN], axis=1)
            self._points = np.asarray((axes - _SPAN // 2 + 0.5) * GRAIN, np.float64)
        return self._points

    @property
    def box(self) -> F64:
        """[min, max] (2, 3) of the seen points, in metres."""
        points = self.points
        return np.array([points.min(axis=0) - GRAIN / 2, points.max(axis=0) + GRAIN / 2])

    @property
    def middle(self) -> F64:
        """Centre (3,) of the box of the seen points, in metres."""
        return np.asarray(self.box.mean(axis=0), np.float64)


class Memory:
    """All objects seen so far, by number, in the order in which they were first seen.

    span : number of steps after which an object is forgotten if not seen again; None for never
    """

    def __init__(self, span: int | None = None) -> None:
        self._things: dict[int, Thing] = {}
        self._span = span
        self.rooms: dict[int, str] = {}

    def __iter__(self) -> Iterator[Thing]:
        return iter(self._things.values())

    def add(self, look: Look, place: F64, heading: float, step: int) -> None:
        """Add a view from a position (3,) with a heading in radians counter-clockwise from −z."""
        self.rooms.update(look.rooms)
        right, up, ahead = look.points.T
        c, s = math.cos(heading), math.sin(heading)
        x, z = place[0] + c * right - s * ahead, place[2] - s * right - c * ahead
        cubes = np.floor(np.stack([x, up + place[1], z]) / GRAIN).astype(np.int64) + _SPAN // 2
        keys = (cubes[0] * _SPAN + cubes[1]) * _SPAN + cubes[2]
        numbers, rank = np.unique(look.owner, return_inverse=True)
        nearest = np.full(len(numbers), np.inf)
        np.minimum.at(nearest, rank, np.hypot(right, ahead))
        # Sorted by object, then by cube; each cube of an object once.
        owned = np.sort(rank * _SPAN**3 + keys)
        owned = owned[np.diff(owned, prepend=-1) > 0]
        ends = np.searchsorted(owned, (np.arange(len(numbers)) + 1) * _SPAN**3).tolist()
        start = 0
        for k, (number, end, distance) in enumerate(zip(numbers.tolist(), ends, nearest.tolist(), strict=True)):
            label, room = look.things[number]
            found, start = owned[start:end] - k * _SPAN**3, end
            known = self._things.get(number)
            if known is None:
                self._things[number] = Thing(number, label, room, found, distance, step)
                continue
            at = np.searchsorted(known.cubes, found)
            new = known.cubes[np.minimum(at, len(known.cubes) - 1)] != found
            if new.any():
                known.cubes, known._points = np.insert(known.cubes, at[new], found[new]), None
            known.nearest, known.seen = min(known.nearest, distance), step
        if self._span is not None:
            self._things = {k: one for k, one in self._things.items() if step - one.seen <= self._span}


BY_SURFACES: Final = OF_SOME_PIECE | {"between"}
"""Relations that may become true when more is seen of the same things."""
APART: Final = 1.5
"""Distance in metres between what is seen of two things at which neither touches or is near the other."""


class Referents:
    """The rooms and objects in the agent's memory that phrases of the text may mean.

    Parameters
    ----------
    north : direction of north in degrees, None if the text does not tell
    close : metres from which a thing must have been seen to be judged

    Attributes
    ----------
    start_room : number of the room of the start, -1 before the first view
    """

    def __init__(self, memory: Memory, north: float | None, close: float) -> None:
        self.memory = memory
        self.start_room = -1
        self._north, self._close = north, close
        self._t = Thresholds()

    def rooms(self, phrase: Phrase) -> set[int] | None:
        """Return the numbers of the known rooms that a phrase may mean; None if it may mean every room."""
        if phrase.room is None:
            at_start = phrase.qualifier is not None and phrase.qualifier[0] in BEARINGS
            return {self.start_room} if at_start and self.start_room >= 0 else None
        return self._rooms_of(phrase.room)

    def _rooms_of(self, place: Place) -> set[int]:
        rooms = {number for number, label in self.memory.rooms.items() if label == place.label}
        if place.anchor is not None:
            held = {thing.room for thing in self.memory if thing.label == place.anchor}
            rooms = rooms & held or rooms
        return rooms

    def room_is_sure(self, phrase: Phrase) -> bool:
        """Return whether it is certain which room a phrase means. A phrase may tell the room by an object in it; then
        that object must have been seen in a room of the type that the phrase names.
        """
        place = phrase.room
        if place is None or place.anchor is None:
            return True
        return any(
            thing.label == place.anchor and self.memory.rooms.get(thing.room) == place.label for thing in self.memory
        )

    def known(self, label: str, rooms: set[int] | None) -> list[Thing]:
        """Return the known objects with a label in some rooms; in any room if `rooms` is None."""
        return [thing for thing in self.memory if thing.label == label and (rooms is None or thing.room in rooms)]

    def anchors(self, labels: Sequence[str], rooms: set[int] | None) -> tuple[Thing, ...] | None:
        """Return, for each label, the known object of which most was seen; None if no object is known for one of the
        labels.
        """
        found: list[Thing] = []
        for label in labels:
            known = [thing for thing in self.known(label, rooms) if thing not in found]
            if not known:
                return None
            found.append(max(known, key=lambda thing: len(thing.cubes)))
        return tuple(found)

    def is_close(self, thing: Thing) -> bool:
        """Return whether an object was seen from near enough to be judged."""
        return thing.nearest <= self._close

    def lacks(self, phrase: Phrase) -> bool:
        """Return whether a thing that a condition takes for granted, such as "the lamp" in "if the lamp is near the
        bed", has not been seen from near enough to be judged.
        """
        if not phrase.definite:
            return False
        labels = (phrase.label, *(phrase.qualifier[1] if phrase.qualifier else ()))
        rooms = self.rooms(phrase)
        return any(not any(map(self.is_close, self.known(label, rooms))) for label in labels)

    def scores(self, phrase: Phrase, things: Sequence[Thing], anchors: Sequence[Thing]) -> list[tuple[float, Thing]]:
        """Return the objects that are not anchors themselves, each with a number that is positive if the relation of
        `phrase` holds for it.
        """
        assert phrase.qualifier is not None
        predicate = phrase.qualifier[0]
        return [(holds(predicate, thing, anchors, self._north, self._t), thing) for thing in things
                if thing not in anchors]  # fmt: skip

    def judge(self, phrase: Phrase) -> tuple[bool | None, bool]:
        """Return two answers to the condition in `phrase`: the certain one (None if what was seen so far is not
        enough), and the one to give if nothing more can be seen.
        """
        rooms = self.rooms(phrase)
        things = self.known(phrase.label, rooms)
        if phrase.qualifier is None:
            return (True, True) if things and rooms is not None and self.room_is_sure(phrase) else (None, bool(things))
        predicate, labels = phrase.qualifier
        if predicate in BEARINGS:
            if not things:
                return None, False
            best = max(score for score, _ in self.scores(phrase, things, ()))
            return (best > 0 if self.is_close(things[0]) else None), best > 0
        anchors = self.anchors(labels, rooms)
        if anchors is None or not things:
            return None, False
        scores = [score for score, _ in self.scores(phrase, things, anchors)]
        if not scores:
            return None, False
        sure = all(self.is_close(thing) for thing in (*anchors, *things)) and self.room_is_sure(phrase)
        if max(scores) > 0:
            return (True if sure else None), True
        # More of the same things may be seen, but not so much more.
        settled = predicate not in BY_SURFACES or min(gap(thing, anchors[0]) for thing in things) > APART
        return (False if sure and settled and phrase.definite else None), False


Compared: Final = ("closest to", "bigger", "smaller")
"""Relations that compare an object with others of its label."""

TOUCH: Final = 0.1
"""Distance in metres below which surfaces seen from one side count as touching."""


def gap(one: Thing, other: Thing) -> float:
    """Return the least distance in metres between the seen points of two objects."""
    return float(cKDTree(other.points).query(one.points)[0].min())


def holds(predicate: Predicate, thing: Thing, anchors: Sequence[Thing], north: float | None, t: Thresholds) -> float:
    """Return a score that is positive if `predicate` holds between an object and its anchors. `predicate` must not be a
    relation of `Compared`.

    north : agent's heading at the start in degrees clockwise from north; None if the text does not state it
    """
    if predicate in BEARING_DEGREES:
        return 45.0 - abs(_turn(_bearing(thing.middle[[0, 2]]) - BEARING_DEGREES[predicate]))
    anchor = anchors[0]
    if predicate == "near":
        return halfway(predicate, t) - gap(thing, anchor)
    if predicate == "far from":
        return gap(thing, anchor) - halfway(predicate, t)
    if predicate in COMPASS:
        away = _centre(thing, north) - _centre(anchor, north)
        wanted = 90.0 - 45.0 * COMPASS.index(predicate)
        return halfway(predicate, t) - abs(_turn(_bearing(away) + (north or 0.0) - wanted))
    if predicate == "between":
        return _between(thing, anchors[0], anchors[1], t)
    if predicate == "in":
        return _inside(thing, anchor) - halfway(predicate, t)
    if predicate == "on":
        return _on(thing, anchor, t)
    if predicate == "under":
        return _covered(thing, anchor) - halfway(predicate, t) if thing.box[1, 1] <= anchor.box[1, 1] + TOUCH else -1.0
    rise = float(thing.middle[1] - anchor.middle[1])
    if predicate in ("higher than", "lower than"):
        return (rise if predicate == "higher than" else -rise) - halfway(predicate, t)
    if predicate not in ("above", "below"):
        return _by_boxes(predicate, thing, anchor, t)
    if predicate == "below":
        thing, anchor, rise = anchor, thing, -rise
    apart = float(np.hypot(*(thing.middle - anchor.middle)[[0, 2]]))
    return min(
        rise - halfway(predicate, t),
        t.over_horizontal + 0.25 - apart,
        _covered(thing, anchor) - 0.05,
        -_on(thing, anchor, t),
    )


def _by_boxes(predicate: Predicate, thing: Thing, anchor: Thing, t: Thresholds) -> float:
    """Return the score of a predicate that has no measure of its own here: by what the boxes of the seen parts have to
    spare to the bounds at which text uses it as true.
    """
    pair = (anchor, thing) if predicate in TURNED else (thing, anchor)
    boxes = [round_mm(one.box) for one in pair]
    seen = [SceneObject(f"{k}", "", "", "", round_mm(box.mean(axis=0)), aabb=box) for k, box in enumerate(boxes)]
    measured = measured_by_boxes(RoomArrays.of("", seen), t)
    spare = []
    for quantity, bound, _ in bounds_of(predicate, t):
        value = float(measured[quantity][0, 1])
        if bound is not None and not math.isnan(value):
            operator, limit = bound
            spare.append(
                limit - abs(value) if operator == "±" else limit - value if operator in "≤<" else value - limit
            )
    return min(spare, default=-1.0)


def ranked(predicate: Predicate, things: Sequence[Thing], anchors: Sequence[Thing]) -> list[Thing]:
    """Sort objects of one label by a relation of `Compared`, such as "bigger". The relation holds for the first object
    of the result.
    """
    if predicate == "closest to":
        return sorted(things, key=lambda thing: gap(thing, anchors[0]))
    sign = -1.0 if predicate == "bigger" else 1.0
    return sorted(things, key=lambda thing: sign * float(np.prod(np.ptp(thing.box, axis=0))))


def _centre(thing: Thing, north: float | None) -> F64:
    """Return the centre (2,) on the ground of the object's bounding box, which is aligned with the compass if north is
    known.
    """
    angle = math.radians(north or 0.0)
    turn = np.array([[math.cos(angle), -math.sin(angle)], [math.sin(angle), math.cos(angle)]])
    flat = thing.points[:, [0, 2]] @ turn.T
    return np.asarray((flat.min(axis=0) + flat.max(axis=0)) / 2 @ turn, np.float64)


def _bearing(away: F64) -> float:
    """Return the direction of the vector `away` (x, z) in degrees clockwise from the agent's heading at the start."""
    return math.degrees(math.atan2(away[0], -away[1]))


def _turn(degrees: float) -> float:
    return (degrees + 180.0) % 360.0 - 180.0


def _between(thing: Thing, one: Thing, other: Thing, t: Thresholds) -> float:
    a, b, p = (x.middle[[0, 2]] for x in (one, other, thing))
    along = b - a
    length = float(np.hypot(*along))
    if length < TOUCH:
        return -1.0
    share = float((p - a) @ along) / length**2
    aside = abs(float(along[0] * (p - a)[1] - along[1] * (p - a)[0])) / length
    along_line = 0.5 - halfway("between", t) - abs(share - 0.5)
    return min(along_line, halfway("beside the line", t) - aside, t.between_length - length + TOUCH)


def _covered(thing: Thing, anchor: Thing) -> float:
    """Return the share of `thing`'s footprint that overlaps the footprint of `anchor`. Footprints are the convex hulls
    of the seen points.
    """
    own = MultiPoint(thing.points[:, [0, 2]]).convex_hull.buffer(GRAIN / 2)
    return float(own.intersection(MultiPoint(anchor.points[:, [0, 2]]).convex_hull.buffer(GRAIN)).area / own.area)


def _inside(thing: Thing, anchor: Thing) -> float:
    """Return the share of the thing's points within the anchor's box."""
    low, high = anchor.box + np.array([[-TOUCH / 2], [TOUCH / 2]])
    points = thing.points
    return float(((points >= low) & (points <= high)).all(axis=1).mean())


def _on(thing: Thing, anchor: Thing, t: Thresholds) -> float:
    """Return the score of "on". It is positive if `thing` lies over the anchor's footprint, and the bottom of `thing`
    is at the anchor's top or lower. It may be lower than the top, since headboards and arm rests are higher than what a
    bed or sofa carries.

    Text never denies a true "on".
    """
    if thing.middle[1] <= anchor.box[0, 1] + TOUCH:
        return -1.0
    return min(_covered(thing, anchor) - halfway("on", t), float(anchor.box[1, 1] - thing.box[0, 1]) + TOUCH)
