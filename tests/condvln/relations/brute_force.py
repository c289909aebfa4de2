"""The table of docs/predicates.md once more: plain loops over raw boxes, in exact fractions of millimetres."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from fractions import Fraction
from typing import NamedTuple

import shapely

from condvln.scene import OrientedBox, SceneObject


class Box(NamedTuple):
    """Whole millimetres; lo and hi are None where nothing is known."""

    name: str
    label: str
    at: tuple[int, int, int]
    lo: tuple[int, int, int] | None
    hi: tuple[int, int, int] | None
    sides: tuple[int, ...] | None
    oriented: bool
    parts: tuple[Box, ...] = ()
    named: tuple[str, ...] = ()
    opened: bool = False
    radius: int | None = None
    solids: tuple[tuple[shapely.Polygon, float, float], ...] = ()  # ground, bottom and top in millimetres

    @property
    def pieces(self) -> tuple[Box, ...]:
        return self.parts or (self,)


def box_of(item: SceneObject) -> Box:
    at = tuple(round(float(v) * 1000) for v in item.center)
    box = item.box
    lo = hi = sides = None
    if box is not None:
        lo, hi = (tuple(round(float(v) * 1000) for v in corner) for corner in box)
        sides = tuple(b - a for a, b in zip(lo, hi, strict=True))
    if item.obb is not None:
        sides = tuple(round(float(v) * 2 * 1000) for v in item.obb.half_extents)
    whole = Box(item.object_id, item.label, at, lo, hi, sides, item.obb is not None)
    return whole._replace(
        parts=tuple(whole._replace(at=at, lo=lo, hi=hi) for lo, hi, at in map(arm_of, item.parts)),
        named=item.receptacles or (),
        opened=item.openness is not None and item.openness >= 0.5,
        radius=None if item.radius is None else round(item.radius * 1000),
        solids=tuple(solids_of(item)),
    )


def solids_of(item: SceneObject) -> list[tuple[shapely.Polygon, float, float]]:
    """The oriented boxes of an object, upright all of them, as prisms."""
    found = []
    for part in item.parts or (() if item.obb is None else (item.obb,)):
        across, along = (part.rotation[:, k] * part.half_extents[k] * 1000 for k in (0, 2))
        ring = [part.center * 1000 + u * across + v * along for u, v in ((1, 1), (1, -1), (-1, -1), (-1, 1))]
        middle, half = part.center[1] * 1000, part.half_extents[1] * 1000
        found.append((shapely.Polygon([(p[0], p[2]) for p in ring]), middle - half, middle + half))
    if not found and item.box is not None:
        (x0, y0, z0), (x1, y1, z1) = (item.box * 1000).tolist()
        found.append((shapely.box(x0, z0, x1, z1), y0, y1))
    return found


def arm_of(part: OrientedBox) -> tuple[tuple[int, ...], tuple[int, ...], tuple[int, ...]]:
    """Corners and middle of the upright box around an oriented one, from its eight corners."""
    corners = []
    for signs in ((x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)):
        reach = [sum(part.rotation[k][m] * signs[m] * part.half_extents[m] for m in range(3)) for k in range(3)]
        corners.append([part.center[k] + reach[k] for k in range(3)])
    lo = tuple(round(min(float(c[k]) for c in corners) * 1000) for k in range(3))
    hi = tuple(round(max(float(c[k]) for c in corners) * 1000) for k in range(3))
    # Middles are rounded to millimetres, halves to even ones.
    return lo, hi, tuple(round(Fraction(a + b, 2)) for a, b in zip(lo, hi, strict=True))


def some(test: Callable[[Box, Box], int], a: Box, b: Box) -> int:
    """True of some piece of both, false of all."""
    found = [test(p, q) for p in a.pieces for q in b.pieces]
    return 1 if 1 in found else -1 if set(found) == {-1} else 0


def each(test: Callable[[Box, Box], int], a: Box, b: Box) -> int:
    """True, or false, of all pieces of both."""
    found = {test(p, q) for p in a.pieces for q in b.pieces}
    return found.pop() if len(found) == 1 else 0


def reached(a: Box, boxes: Sequence[Box]) -> set[str]:
    """Names of all that a is in or on as its source says, and of what that is in or on."""
    found: set[str] = set()
    ahead = list(a.named)
    while ahead:
        name = ahead.pop()
        if name not in found:
            found.add(name)
            ahead += [x for b in boxes if b.name == name for x in b.named]
    return found


def gap(a: Box, b: Box, axis: int) -> int:
    return max(a.lo[axis] - b.hi[axis], b.lo[axis] - a.hi[axis], 0)


def squared(a: Box, b: Box, axes: Sequence[int]) -> int:
    return sum(gap(a, b, k) ** 2 for k in axes)


def meet(a: Box, b: Box, axis: int) -> int:
    return max(0, min(a.hi[axis], b.hi[axis]) - max(a.lo[axis], b.lo[axis]))


def ground(a: Box) -> int:
    return (a.hi[0] - a.lo[0]) * (a.hi[2] - a.lo[2])


def verdict(true: bool, false: bool) -> int:
    assert not (true and false)
    return 1 if true else -1 if false else 0


def rests(a: Box, b: Box) -> bool:
    """Whether a may rest on b."""
    if a.name == b.name:
        return False
    if b.name in a.named:
        return True
    if a.lo is None or b.lo is None:
        return False
    for p in a.pieces:
        for q in b.pieces:
            if not squared(p, q, (0, 2)) and q.lo[1] + 30 < p.lo[1] < q.hi[1] + 150:
                return True
    return False


def carried(boxes: Sequence[Box]) -> set[tuple[str, str]]:
    """(upper, lower) of all that may carry each other, by Warshall's three loops."""
    found = {(a.name, b.name) for a in boxes for b in boxes if rests(a, b)}
    names = [b.name for b in boxes]
    for middle in names:
        for a in names:
            for b in names:
                if (a, middle) in found and (middle, b) in found:
                    found.add((a, b))
    return found


SHUT_ONES = {"dresser", "refrigerator", "cabinet"}
OPEN_ONES = {"trash can", "basket", "sink", "bowl", "vase"}
"""Labels of the made rooms that are containers."""


def said(a: Box, b: Box) -> str:
    """What its source says of a and b: that a is "on" b, or "in" it, or neither."""
    if b.name not in a.named or a.name == b.name:
        return ""
    if a.lo is None or b.lo is None:
        return "in" if b.label in SHUT_ONES else "on"
    longest = [max(top - low for low, top in zip(box.lo, box.hi, strict=True)) for box in (a, b)]
    if longest[0] > 2 * longest[1]:
        return ""
    if b.label in SHUT_ONES:
        return "in" if a.lo[1] <= b.hi[1] - 50 else "on"
    return "in" if b.label in OPEN_ONES and _inside(a, b) == 1 else "on"


def on(a: Box, b: Box, boxes: Sequence[Box]) -> int:
    by_boxes = some(_on, a, b)
    if said(a, b) == "on":
        return 0 if by_boxes == -1 else 1
    elsewhere = any(said(a, c) for c in boxes) and b.name not in reached(a, boxes)
    return -1 if by_boxes == 0 and elsewhere else by_boxes


def _on(a: Box, b: Box) -> int:
    if a.lo is None or b.lo is None:
        return 0
    step = a.lo[1] - b.hi[1]
    mostly = ground(a) > 0 and 2 * meet(a, b, 0) * meet(a, b, 2) >= ground(a)
    true = -30 <= step <= 30 and mostly and ground(b) > ground(a) and a.at[1] > b.at[1]
    return verdict(true, squared(a, b, (0, 2)) > 0 or step >= 150)


def under(a: Box, b: Box, floor: int) -> int:
    return some(lambda p, q: _under(p, q, floor), a, b)


def _under(a: Box, b: Box, floor: int) -> int:
    if a.lo is None or b.lo is None:
        return 0
    mostly = ground(a) > 0 and 10 * meet(a, b, 0) * meet(a, b, 2) >= 8 * ground(a)
    return verdict(a.lo[1] - floor <= 100 and a.hi[1] <= b.lo[1] and mostly, squared(a, b, (0, 2)) >= 300 * 300)


def inside(a: Box, b: Box) -> int:
    if not (b.label in OPEN_ONES or (b.label in SHUT_ONES and b.opened)):
        return 0
    by_boxes = some(_inside, a, b)
    if said(a, b) == "in":
        return 0 if by_boxes == -1 else 1
    return by_boxes


def _inside(a: Box, b: Box) -> int:
    if a.lo is None or b.lo is None:
        return 0
    volume = ground(a) * (a.hi[1] - a.lo[1])
    shared = meet(a, b, 0) * meet(a, b, 1) * meet(a, b, 2)
    return verdict(volume > 0 and 10 * shared >= 8 * volume, squared(a, b, (0, 1, 2)) > 0)


def has(a: Box, b: Box) -> bool:
    """Whether b carries a, or is around most of it, with nothing in between."""
    if a.name == b.name:
        return False
    if b.name in a.named:
        return True
    if a.lo is None or b.lo is None:
        return False
    for p in a.pieces:
        for q in b.pieces:
            over = 4 * meet(p, q, 0) * meet(p, q, 2) >= ground(p) > 0
            if over and p.lo[1] < q.hi[1] + 150 and (p.lo[1] > q.lo[1] + 30 or p.lo[1] >= q.hi[1] - 30):
                return True
    return mostly_in(a, b)


def mostly_in(a: Box, b: Box) -> bool:
    if a.lo is None or b.lo is None:
        return False
    return any(
        2 * meet(p, q, 0) * meet(p, q, 1) * meet(p, q, 2) > ground(p) * (p.hi[1] - p.lo[1]) > 0
        for p in a.pieces
        for q in b.pieces
    )


def held(boxes: Sequence[Box]) -> set[tuple[str, str]]:
    """(thing, holder) of all that hold each other, by Warshall's three loops."""
    found = {(a.name, b.name) for a in boxes for b in boxes if has(a, b)}
    names = [b.name for b in boxes]
    for middle in names:
        for a in names:
            for b in names:
                if (a, middle) in found and (middle, b) in found:
                    found.add((a, b))
    return found


def put_away(a: Box, boxes: Sequence[Box]) -> bool:
    holders = [b for b in boxes if b.name != a.name and b.label in OPEN_ONES | SHUT_ONES]
    return any(said(a, b) == "in" or mostly_in(a, b) for b in holders)


def grouped(a: Box, b: Box, boxes: Sequence[Box]) -> bool:
    """Both stand within 25 cm of a rug, or within 1.5 m of a coffee table."""
    for c in boxes:
        reach = {"rug": 250, "coffee table": 1500}.get(c.label)
        if reach is None or c.lo is None or c.name in (a.name, b.name):
            continue
        if squared(a, c, (0, 2)) <= reach**2 and squared(b, c, (0, 2)) <= reach**2:
            return True
    return False


def near(a: Box, b: Box, boxes: Sequence[Box], holders: set[tuple[str, str]]) -> int | None:
    """None where the surfaces are within a millimetre of the threshold, where rounding decides."""
    if (a.name, b.name) in holders or (b.name, a.name) in holders:
        return 0
    if a.lo is None or b.lo is None:
        if a.radius is None or b.radius is None:
            return 0
        return -1 if math.hypot(a.at[0] - b.at[0], a.at[2] - b.at[2]) - a.radius - b.radius >= 2250 else 0
    if all(squared(p, q, (0, 2)) >= 2250 * 2250 for p in a.pieces for q in b.pieces):
        return 0 if grouped(a, b, boxes) else -1
    close = any(squared(p, q, (0, 1, 2)) <= 500 * 500 and gap(p, q, 1) <= 250 for p in a.pieces for q in b.pieces)
    if not close or put_away(a, boxes) or put_away(b, boxes):
        return 0
    surface = min(
        math.hypot(p.distance(q), max(low - top, bottom - high, 0.0))
        for p, low, high in a.solids
        for q, bottom, top in b.solids
    )
    return None if abs(surface - 500) <= 1 else int(surface < 500)


def above(a: Box, b: Box, chain: set[tuple[str, str]]) -> int:
    return 0 if (a.name, b.name) in chain else some(_above, a, b)


def _above(a: Box, b: Box) -> int:
    if a.lo is None or b.lo is None:
        return 0
    rise = a.at[1] - b.at[1]
    away = (a.at[0] - b.at[0]) ** 2 + (a.at[2] - b.at[2]) ** 2
    smaller = min(ground(a), ground(b))
    over = smaller > 0 and 5 * meet(a, b, 0) * meet(a, b, 2) >= smaller
    true = rise >= 450 and away <= 420 * 420 and over and a.lo[1] - b.hi[1] >= 100
    return verdict(true, rise <= 150 or squared(a, b, (0, 2)) >= 300 * 300)


def higher(a: Box, b: Box, floor: int, chain: set[tuple[str, str]]) -> int:
    if (a.name, b.name) in chain or (b.name, a.name) in chain:
        return 0
    return each(lambda p, q: _higher(p, q, floor), a, b)


def _higher(a: Box, b: Box, floor: int) -> int:
    if a.lo is None or b.lo is None:
        return 0
    if a.lo[1] - floor < 300 or b.lo[1] - floor < 300:
        return 0
    rise, tops = a.at[1] - b.at[1], a.hi[1] - b.hi[1]
    return verdict(rise >= 450 and tops >= 150, rise <= -50 and tops <= -50)


def between(a: Box, b: Box, c: Box, floor: int) -> int:
    if b.lo is None or c.lo is None or a.parts or b.parts or c.parts:
        return 0
    x, z = c.at[0] - b.at[0], c.at[2] - b.at[2]
    u, v = a.at[0] - b.at[0], a.at[2] - b.at[2]
    line = x * x + z * z
    for anchor in (b, c):
        if max(anchor.hi[0] - anchor.lo[0], anchor.hi[2] - anchor.lo[2]) < 500:
            return 0
    if not 0 < line <= 4000 * 4000:
        return 0
    part = Fraction(u * x + v * z, line)
    off = Fraction((u * z - v * x) ** 2, line)
    true = (
        a.lo is not None
        and a.lo[1] - floor <= 100
        and not meet(a, b, 0) * meet(a, b, 2)
        and not meet(a, c, 0) * meet(a, c, 2)
        and Fraction(3, 10) <= part <= Fraction(7, 10)
        and off <= 400 * 400
    )
    for way, across in ((0, 2), (2, 0)):
        # A step from the one anchor to the other, straight through the middle of the thing.
        if all(anchor.lo[across] <= a.at[across] <= anchor.hi[across] for anchor in (b, c)):
            near, far = sorted((b, c), key=lambda anchor: anchor.at[way])
            if near.hi[way] <= a.at[way] <= far.lo[way]:
                return verdict(true, False)
    return verdict(true, part < Fraction(1, 10) or part > Fraction(9, 10) or off >= 800 * 800)


def closest(a: Box, b: Box, rivals: Sequence[Box]) -> int:
    if a.lo is None or b.lo is None or a.label not in [r.label for r in rivals] or b in rivals:
        return 0
    own = apart(a, b)
    far = [r.lo is not None and _clearly(apart(r, b), own) for r in rivals]
    near = [r.lo is not None and _clearly(own, apart(r, b)) for r in rivals]
    return verdict(all(far), any(near))


def apart(a: Box, b: Box) -> float:
    return min(squared(p, q, (0, 1, 2)) for p in a.pieces for q in b.pieces) ** 0.5


def _clearly(far: float, near: float) -> bool:
    return 2 * far >= 3 * near and far >= near + 500


def bigger(a: Box, rivals: Sequence[Box], rivals_of: Callable[[Box], Sequence[Box]]) -> int:
    if len(rivals) != 1 or rivals[0].label != a.label or len(rivals_of(rivals[0])) != 1:
        return 0
    (b,) = rivals
    if (
        a.parts
        or b.parts
        or a.sides is None
        or b.sides is None
        or a.oriented != b.oriented
        or 0 in a.sides
        or 0 in b.sides
    ):
        return 0
    one, other = (s[0] * s[1] * s[2] for s in (a.sides, b.sides))
    face, other_face = (sorted(s)[1] * sorted(s)[2] for s in (a.sides, b.sides))
    # Of upright boxes the second extent is the height.
    flat = [sorted((s[0], s[2])) for s in (a.sides, b.sides)]
    taller, deeper, longer = (
        (p, q) for p, q in ((a.sides[1], b.sides[1]), (flat[0][0], flat[1][0]), (flat[0][1], flat[1][1]))
    )
    no_less = all(100 * q <= 105 * p for p, q in (taller, deeper, longer))
    no_more = all(100 * p <= 105 * q for p, q in (taller, deeper, longer))
    return verdict(
        2 * one >= 3 * other and face > other_face and no_less, 2 * other >= 3 * one and other_face > face and no_more
    )


NORTH = {"east of": (1, 0), "north-west of": (-1, 1), "south of": (0, -1)}
"""(east, north) of some sectors."""


def beside(a: Box, b: Box, predicate: str, loose: int = 45, whole: bool = True) -> int:
    """Of centres alone unless `whole`."""
    return each(lambda p, q: _beside(p, q, NORTH[predicate], loose, whole), a, b)


def _beside(a: Box, b: Box, towards: tuple[int, int], loose: int, whole: bool) -> int:
    east, north, up = a.at[0] - b.at[0], b.at[2] - a.at[2], a.at[1] - b.at[1]
    ground_way = math.hypot(east, north)
    for one, other in ((a, b), (b, a)):
        if other.lo is not None and all(other.lo[k] <= one.at[k] <= other.hi[k] for k in (0, 2)):
            return 0
    if not ground_way:
        return 0
    ways = [(east, north)]
    for one, other, sign in ((a, b, 1), (b, a, -1)):
        if other.lo is not None and whole:
            near = [min(max(one.at[k], other.lo[k]), other.hi[k]) for k in (0, 2)]
            ways.append((sign * (one.at[0] - near[0]), sign * (near[1] - one.at[2])))
    off, *edges = (
        abs(math.remainder(math.atan2(y, x) - math.atan2(towards[1], towards[0]), 2 * math.pi)) for x, y in ways
    )
    edges = [off, *edges]
    level = abs(up) < ground_way * math.tan(math.radians(22.5))
    true = off <= math.radians(15) and max(edges) <= math.radians(27) and level and ground_way >= 500
    return verdict(true, min(edges) > math.radians(loose))


def beside_it(a: Box, b: Box) -> bool:
    """Whether a is so near to b that nobody calls it away from b."""
    return any(squared(p, q, (0, 1, 2)) <= 500 * 500 for p in a.pieces for q in b.pieces)


def far(a: Box, b: Box) -> int:
    found = [squared(p, q, (0, 1, 2)) for p in a.pieces for q in b.pieces]
    return verdict(min(found) >= 3450**2, any(x <= 2550**2 for x in found))
