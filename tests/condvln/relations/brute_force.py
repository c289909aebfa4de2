"""DESIGN's table of what text may say, once more: plain loops over raw boxes, in exact fractions of millimetres."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from fractions import Fraction
from typing import NamedTuple

from condvln.scene import SceneObject


class Box(NamedTuple):
    """Whole millimetres; lo and hi are None where nothing is known."""

    name: str
    label: str
    at: tuple[int, int, int]
    lo: tuple[int, int, int] | None
    hi: tuple[int, int, int] | None
    sides: tuple[int, ...] | None
    oriented: bool


def box_of(item: SceneObject) -> Box:
    at = tuple(round(float(v) * 1000) for v in item.center)
    box = item.box
    lo = hi = sides = None
    if box is not None:
        lo, hi = (tuple(round(float(v) * 1000) for v in corner) for corner in box)
        sides = tuple(b - a for a, b in zip(lo, hi, strict=True))
    if item.obb is not None:
        sides = tuple(round(float(v) * 2 * 1000) for v in item.obb.half_extents)
    return Box(item.object_id, item.label, at, lo, hi, sides, item.obb is not None)


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
    if a.lo is None or b.lo is None or a.name == b.name or squared(a, b, (0, 2)):
        return False
    return a.lo[1] > b.lo[1] + 30 and a.lo[1] < b.hi[1] + 150


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


def on(a: Box, b: Box) -> int:
    if a.lo is None or b.lo is None:
        return 0
    step = a.lo[1] - b.hi[1]
    mostly = ground(a) > 0 and 2 * meet(a, b, 0) * meet(a, b, 2) >= ground(a)
    true = -30 <= step <= 30 and mostly and ground(b) > ground(a) and a.at[1] > b.at[1]
    return verdict(true, squared(a, b, (0, 2)) > 0 or step >= 150)


def under(a: Box, b: Box, floor: int) -> int:
    if a.lo is None or b.lo is None:
        return 0
    mostly = ground(a) > 0 and 10 * meet(a, b, 0) * meet(a, b, 2) >= 8 * ground(a)
    return verdict(a.lo[1] - floor <= 100 and a.hi[1] <= b.lo[1] and mostly, squared(a, b, (0, 2)) >= 300 * 300)


def inside(a: Box, b: Box, containers: set[str]) -> int:
    if a.lo is None or b.lo is None or b.label not in containers:
        return 0
    volume = ground(a) * (a.hi[1] - a.lo[1])
    shared = meet(a, b, 0) * meet(a, b, 1) * meet(a, b, 2)
    return verdict(volume > 0 and 10 * shared >= 8 * volume, squared(a, b, (0, 1, 2)) > 0)


def above(a: Box, b: Box) -> int:
    if a.lo is None or b.lo is None:
        return 0
    rise = a.at[1] - b.at[1]
    away = (a.at[0] - b.at[0]) ** 2 + (a.at[2] - b.at[2]) ** 2
    smaller = min(ground(a), ground(b))
    over = smaller > 0 and 5 * meet(a, b, 0) * meet(a, b, 2) >= smaller
    free = not rests(a, b)
    true = free and rise >= 450 and away <= 420 * 420 and over and a.lo[1] - b.hi[1] >= 100
    return verdict(true, free and (rise <= 150 or squared(a, b, (0, 2)) >= 300 * 300))


def higher(a: Box, b: Box, floor: int, chain: set[tuple[str, str]]) -> int:
    if a.lo is None or b.lo is None or (a.name, b.name) in chain or (b.name, a.name) in chain:
        return 0
    if a.lo[1] - floor < 300 or b.lo[1] - floor < 300:
        return 0
    rise, tops = a.at[1] - b.at[1], a.hi[1] - b.hi[1]
    return verdict(rise >= 450 and tops >= 150, rise <= 150 and tops <= 50)


def between(a: Box, b: Box, c: Box, floor: int) -> int:
    if b.lo is None or c.lo is None:
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
    return verdict(true, part < Fraction(1, 10) or part > Fraction(9, 10) or off >= 800 * 800)


def closest(a: Box, b: Box, rivals: Sequence[Box]) -> int:
    if a.lo is None or b.lo is None or not rivals or b in rivals:
        return 0
    own = squared(a, b, (0, 1, 2)) ** 0.5
    far = [r.lo is not None and _clearly(squared(r, b, (0, 1, 2)) ** 0.5, own) for r in rivals]
    near = [r.lo is not None and _clearly(own, squared(r, b, (0, 1, 2)) ** 0.5) for r in rivals]
    return verdict(all(far), any(near))


def _clearly(far: float, near: float) -> bool:
    return 2 * far >= 3 * near and far >= near + 500


def bigger(a: Box, rivals: Sequence[Box], rivals_of: Callable[[Box], Sequence[Box]]) -> int:
    if len(rivals) != 1 or rivals[0].label != a.label or len(rivals_of(rivals[0])) != 1:
        return 0
    (b,) = rivals
    if a.sides is None or b.sides is None or a.oriented != b.oriented or 0 in a.sides or 0 in b.sides:
        return 0
    one, other = (s[0] * s[1] * s[2] for s in (a.sides, b.sides))
    face, other_face = (sorted(s)[1] * sorted(s)[2] for s in (a.sides, b.sides))
    return verdict(2 * one >= 3 * other and face > other_face, 2 * other >= 3 * one and other_face > face)
