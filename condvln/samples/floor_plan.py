"""Seeded floor plans of two to eight rooms: cells, their room types, and the doors between them.

Small apartments are divided recursively by area; larger ones have two rows of rooms along a hallway, part of which may
belong to an adjacent room (which is then L-shaped). Plans with a room that is too narrow, or that can only be reached
through a bathroom, are rejected and drawn again.
"""

from __future__ import annotations

import random
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Final, NamedTuple

import shapely
import yaml

from condvln.own_tables import own_text

__all__ = ["MAX_ROOMS", "MIN_ROOMS", "SHARED", "FloorPlan", "PlanDoor", "Rect", "draw_floor_plan", "metres"]


def metres(millimetres: float) -> float:
    """Return millimetres as metres, correctly rounded."""
    return millimetres / 1000


class Rect(NamedTuple):
    """A rectangle over (x, z) in millimetres, given by its lower and upper corner."""

    x0: int
    z0: int
    x1: int
    z1: int

    @property
    def width(self) -> int:
        """Extent along x."""
        return self.x1 - self.x0

    @property
    def depth(self) -> int:
        """Extent along z."""
        return self.z1 - self.z0

    @property
    def area(self) -> int:
        """Area in square millimetres."""
        return self.width * self.depth

    def grown(self, by: int) -> Rect:
        """Return the rectangle with every side moved outwards by `by` (inwards if negative)."""
        return Rect(self.x0 - by, self.z0 - by, self.x1 + by, self.z1 + by)

    def overlap(self, other: Rect) -> int:
        """Return the area of the intersection in square millimetres; 0 if the rectangles only touch."""
        width = min(self.x1, other.x1) - max(self.x0, other.x0)
        depth = min(self.z1, other.z1) - max(self.z0, other.z0)
        return width * depth if width > 0 and depth > 0 else 0

    def moved(self, dx: int, dz: int) -> Rect:
        """Return the rectangle moved by (dx, dz)."""
        return Rect(self.x0 + dx, self.z0 + dz, self.x1 + dx, self.z1 + dz)

    def transposed(self) -> Rect:
        """Return the rectangle with x and z exchanged."""
        return Rect(self.z0, self.x0, self.z1, self.x1)

    def mirrored(self) -> Rect:
        """Return the rectangle with x negated."""
        return Rect(-self.x1, self.z0, -self.x0, self.z1)

    @property
    def polygon(self) -> shapely.Polygon:
        """The rectangle as a polygon over (x, z), in millimetres."""
        return shapely.box(self.x0, self.z0, self.x1, self.z1)


MIN_ROOMS: Final = 2
MAX_ROOMS: Final = 8

GRID: Final = 50
"""Grid in millimetres on which walls are placed."""

DOOR_WIDTHS: Final = (900, 950, 1000)
"""Width in millimetres of an ordinary doorway."""

OPENING_WIDTHS: Final = (1200, 1400, 1600)
"""Width in millimetres of a wide opening between two living areas."""

DOOR_CORNER_MARGIN: Final = 250
"""Least distance in millimetres between an opening and the ends of its wall."""


class RoomKind(NamedTuple):
    """The allowed size of rooms of one type. `area` is the minimum and maximum area in square metres, `side` the
    minimum length of the shorter side in millimetres.
    """

    area: tuple[float, float]
    side: int


MAX_ASPECT: Final = 2.3
"""Largest ratio of longest to shortest side of any cell but a hallway."""

SHARED: Final = frozenset({"hallway", "living room", "dining room", "kitchen"})
"""Room types that may be passed through; all others are dead ends, except a bedroom with its own bathroom."""

WIDE: Final = frozenset({"living room", "dining room", "kitchen"})
"""Room types between which the opening may be wide."""

EXTRA_DOOR_CHANCE: Final = 0.45
"""Probability of one more door between two shared rooms that are already connected, which creates a loop."""

CUT_TRIES: Final = 400
"""Largest number of attempts for one list of rooms before it counts as impossible."""


class Rooms(NamedTuple):
    """What apartments may be made of: the size of rooms by type, and the possible room types by number of rooms."""

    kinds: Mapping[str, RoomKind]
    programmes: Mapping[int, list[list[str]]]


@cache
def known_rooms() -> Rooms:
    """Return what ``floor_plans.yaml`` says."""
    found = yaml.safe_load(own_text("condvln.samples", "floor_plans.yaml"))
    kinds = {label: RoomKind(tuple(kind["area"]), kind["side"]) for label, kind in found["kinds"].items()}
    # Equal labels are one object: what pickle writes of a Gibson building depends on it.
    programmes = {n: [[*map(sys.intern, one)] for one in several] for n, several in found["programmes"].items()}
    return Rooms(kinds, programmes)


@dataclass(frozen=True, slots=True)
class PlanRoom:
    """A cell of a floor plan: a room type and one or two rectangles, in mm. The rectangles extend to the middle of the
    walls.
    """

    label: str
    rects: tuple[Rect, ...]

    @property
    def corners(self) -> tuple[tuple[int, int], ...]:
        """Corners (x, z) of the union of the rectangles, in the order in which the shoelace sum is positive, beginning
        with the lowest (x, z).
        """
        union = shapely.union_all([rect.polygon for rect in self.rects]).simplify(0)
        ring = shapely.geometry.polygon.orient(union, 1.0).exterior.coords[:-1]
        corners = [(round(x), round(z)) for x, z in ring]
        first = corners.index(min(corners))
        return tuple(corners[first:] + corners[:first])


class PlanDoor(NamedTuple):
    """An opening between the cells `a` and `b`; lengths are in mm. The wall that contains the opening is at x = `at`,
    or at z = `at` if `along_x`; `middle` is the other coordinate of the opening's centre.
    """

    a: int
    b: int
    along_x: bool
    at: int
    middle: int
    width: int


@dataclass(frozen=True, slots=True)
class FloorPlan:
    """The cells and doors of an apartment, in millimetres."""

    rooms: tuple[PlanRoom, ...]
    doors: tuple[PlanDoor, ...]


class _Wall(NamedTuple):
    a: int
    b: int
    along_x: bool
    at: int
    low: int
    high: int


def draw_floor_plan(rng: random.Random, n_rooms: int) -> FloorPlan:
    """Draw a floor plan of `n_rooms` rooms (2 to 8), rotated and mirrored at random, near the origin."""
    while True:
        programme = rng.choice(known_rooms().programmes[n_rooms])
        cells = _corridor_cells(rng, programme) if "hallway" in programme else _cut_cells(rng, programme)
        if cells is None:
            continue
        placed = _placed(rng, cells)
        doors = _doors(rng, placed)
        if doors is not None:
            return FloorPlan(placed, doors)


def _snapped(value: float) -> int:
    return round(value / GRID) * GRID


def _area(rng: random.Random, label: str) -> float:
    return rng.uniform(*known_rooms().kinds[label].area) * 1e6


def _fits(room: PlanRoom) -> bool:
    kind = known_rooms().kinds[room.label]
    main = max(room.rects, key=lambda rect: rect.area)
    short, long = sorted((main.width, main.depth))
    return short >= kind.side and (room.label == "hallway" or long <= MAX_ASPECT * short)


def _cut_cells(rng: random.Random, programme: Sequence[str]) -> list[PlanRoom] | None:
    """Return the rooms made by dividing one rectangle recursively across its longer side, in proportion to the rooms'
    areas. Return None if a room does not fit.
    """
    for _ in range(CUT_TRIES):
        labels = rng.sample(programme, len(programme))
        areas = [_area(rng, label) for label in labels]
        aspect = rng.uniform(0.75, 1.3)
        width = _snapped((sum(areas) * aspect) ** 0.5)
        cells: list[PlanRoom] = []
        pending = [(Rect(0, 0, width, _snapped(sum(areas) / width)), list(zip(labels, areas, strict=True)))]
        while pending:
            rect, group = pending.pop()
            if len(group) == 1:
                cells.append(PlanRoom(group[0][0], (rect,)))
                continue
            at = min(
                range(1, len(group)), key=lambda i: abs(sum(a for _, a in group[:i]) - sum(a for _, a in group[i:]))
            )
            share = sum(a for _, a in group[:at]) / sum(a for _, a in group)
            if rect.width >= rect.depth:
                cut = rect.x0 + _snapped(rect.width * share)
                halves = Rect(rect.x0, rect.z0, cut, rect.z1), Rect(cut, rect.z0, rect.x1, rect.z1)
            else:
                cut = rect.z0 + _snapped(rect.depth * share)
                halves = Rect(rect.x0, rect.z0, rect.x1, cut), Rect(rect.x0, cut, rect.x1, rect.z1)
            pending += [(halves[0], group[:at]), (halves[1], group[at:])]
        if all(_fits(cell) for cell in cells):
            return cells
    return None


def _corridor_cells(rng: random.Random, programme: Sequence[str]) -> list[PlanRoom] | None:
    """Return two rows of rooms with a hallway between them; None if a room does not fit."""
    others = [label for label in programme if label != "hallway"]
    for _ in range(CUT_TRIES):
        hall = _snapped(rng.uniform(1500, 1900))
        depths = [_snapped(rng.uniform(3200, 4500)) for _ in range(2)]
        rows: tuple[list[tuple[str, float]], list[tuple[str, float]]] = ([], [])
        for label in rng.sample(others, len(others)):
            emptier = min((0, 1), key=lambda r: sum(w for _, w in rows[r]))
            rows[emptier].append((label, _area(rng, label) / depths[emptier]))
        sums = [sum(w for _, w in row) for row in rows]
        if not 0.8 < sums[0] / max(sums[1], 1.0) < 1.25:
            continue
        length = _snapped((sums[0] + sums[1]) / 2)
        cells = []
        for row, depth, z0 in zip(rows, depths, (0, depths[0] + hall), strict=True):
            x = 0
            widths = [_snapped(w * length / sum(w for _, w in row)) for _, w in row]
            widths[-1] = length - sum(widths[:-1])
            for (label, _), width in zip(row, widths, strict=True):
                cells.append(PlanRoom(label, (Rect(x, z0, x + width, z0 + depth),)))
                x += width
        strip = Rect(0, depths[0], length, depths[0] + hall)
        cells = _shorten_hallway(rng, cells, strip)
        if all(_fits(cell) for cell in cells):
            return cells
    return None


def _shorten_hallway(rng: random.Random, cells: list[PlanRoom], strip: Rect) -> list[PlanRoom]:
    """Return the cells with the hallway added. A living room, dining room or kitchen at the hallway's east end may take
    a part of the hallway and become L-shaped.
    """
    ends = [i for i, cell in enumerate(cells) if cell.rects[0].x1 == strip.x1 and cell.label in WIDE]
    taken = None
    if ends and rng.random() < 0.6:
        taker = rng.choice(ends)
        width = cells[taker].rects[0].width
        length = _snapped(width * rng.uniform(0.4, 0.7))
        if strip.width - length >= 3000:
            taken = strip.x1 - length
            piece = Rect(taken, strip.z0, strip.x1, strip.z1)
            cells = [*cells]
            cells[taker] = PlanRoom(cells[taker].label, (cells[taker].rects[0], piece))
    return [*cells, PlanRoom("hallway", (Rect(strip.x0, strip.z0, taken or strip.x1, strip.z1),))]


def _placed(rng: random.Random, cells: Sequence[PlanRoom]) -> tuple[PlanRoom, ...]:
    """Rotate and mirror the plan at random and put its centre within 3 m of the origin."""
    transpose, mirror = rng.random() < 0.5, rng.random() < 0.5
    turned = []
    for cell in cells:
        rects = cell.rects
        if transpose:
            rects = tuple(rect.transposed() for rect in rects)
        if mirror:
            rects = tuple(rect.mirrored() for rect in rects)
        turned.append((cell.label, rects))
    every = [rect for _, rects in turned for rect in rects]
    middle_x = (min(r.x0 for r in every) + max(r.x1 for r in every)) / 2
    middle_z = (min(r.z0 for r in every) + max(r.z1 for r in every)) / 2
    dx, dz = (_snapped(rng.uniform(-3000, 3000) - middle) for middle in (middle_x, middle_z))
    return tuple(PlanRoom(label, tuple(rect.moved(dx, dz) for rect in rects)) for label, rects in turned)


def _walls(rooms: Sequence[PlanRoom]) -> list[_Wall]:
    """Return, for each pair of adjacent cells, the longest wall that they share."""
    walls = []
    for b in range(len(rooms)):
        for a in range(b):
            shared = [
                wall for p in rooms[a].rects for q in rooms[b].rects if (wall := _shared_side(a, b, p, q)) is not None
            ]
            if shared:
                walls.append(max(shared, key=lambda wall: wall.high - wall.low))
    return walls


def _shared_side(a: int, b: int, p: Rect, q: Rect) -> _Wall | None:
    low, high = max(p.z0, q.z0), min(p.z1, q.z1)
    if high > low and (p.x1 == q.x0 or q.x1 == p.x0):
        return _Wall(a, b, False, q.x0 if p.x1 == q.x0 else p.x0, low, high)
    low, high = max(p.x0, q.x0), min(p.x1, q.x1)
    if high > low and (p.z1 == q.z0 or q.z1 == p.z0):
        return _Wall(a, b, True, q.z0 if p.z1 == q.z0 else p.z0, low, high)
    return None


def _reluctance(one: str, other: str) -> float:
    """Return the cost of a door between rooms of two types. The doors of a plan form the spanning tree of least total
    cost.
    """
    pair = {one, other}
    if "hallway" in pair:
        return 1.0
    if pair <= SHARED:
        return 1.2
    if pair == {"bedroom", "bathroom"}:
        return 2.2
    if pair & SHARED:
        return 3.5 if pair == {"kitchen", "bathroom"} else 2.0
    return 9.0


def _doors(rng: random.Random, rooms: Sequence[PlanRoom]) -> tuple[PlanDoor, ...] | None:
    """Return doors that connect all cells; None if no suitable doors are found. A private room must not lead to any
    further room, except that a bedroom may lead to one bathroom of its own.
    """
    room_for_door = max(DOOR_WIDTHS) + 2 * DOOR_CORNER_MARGIN
    walls = [wall for wall in _walls(rooms) if wall.high - wall.low >= room_for_door]
    ranked = sorted(
        (_reluctance(rooms[w.a].label, rooms[w.b].label) + rng.uniform(0, 0.8), index) for index, w in enumerate(walls)
    )
    group = list(range(len(rooms)))
    chosen, spare = [], []
    for _, index in ranked:
        wall = walls[index]
        if group[wall.a] == group[wall.b]:
            spare.append(wall)
            continue
        old, new = group[wall.a], group[wall.b]
        group = [new if g == old else g for g in group]
        chosen.append(wall)
    if len(set(group)) > 1 or not _private_enough(rooms, chosen):
        return None
    for wall in spare:
        if {rooms[wall.a].label, rooms[wall.b].label} <= SHARED and rng.random() < EXTRA_DOOR_CHANCE:
            chosen.append(wall)
    return tuple(_door(rng, wall, rooms) for wall in sorted(chosen))


def _private_enough(rooms: Sequence[PlanRoom], walls: Sequence[_Wall]) -> bool:
    for index, room in enumerate(rooms):
        if room.label in SHARED:
            continue
        neighbours = [rooms[w.b if w.a == index else w.a].label for w in walls if index in (w.a, w.b)]
        own_bathroom = room.label == "bedroom" and neighbours.count("bathroom") == 1
        if len(neighbours) > 1 + own_bathroom:
            return False
    return True


def _door(rng: random.Random, wall: _Wall, rooms: Sequence[PlanRoom]) -> PlanDoor:
    room = wall.high - wall.low - 2 * DOOR_CORNER_MARGIN
    wide = {rooms[wall.a].label, rooms[wall.b].label} <= WIDE
    widths = [w for w in (OPENING_WIDTHS if wide else DOOR_WIDTHS) if w <= room] or [min(DOOR_WIDTHS)]
    width = rng.choice(widths)
    low = wall.low + DOOR_CORNER_MARGIN + width // 2
    high = wall.high - DOOR_CORNER_MARGIN - width // 2
    # Doors are usually near a corner, which leaves the rest of the wall to furniture.
    middle = rng.choice((low, high)) if rng.random() < 0.6 else low + _snapped(rng.uniform(0, high - low))
    return PlanDoor(wall.a, wall.b, wall.along_x, wall.at, min(middle, high), width)
