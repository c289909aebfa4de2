"""Furnish a room by the recipe of its type (``recipes.yaml``).

A step of a recipe names a kind of position: against a wall, in a corner, around a table, on top of another piece. Each
is a generator of candidates in random order; the room decides which of them fit. Millimetres.
"""

from __future__ import annotations

import random
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cache
from typing import Any, Final

import yaml

from condvln.own_tables import own_text
from condvln.samples.catalogue import VARIANTS, Kind, catalogue
from condvln.samples.layout import Yaw
from condvln.samples.room_space import HANG_GAP, WALL_GAP, Edge, Piece, RoomSpace

__all__ = [
    "MAX_OBJECTS",
    "MIN_OBJECTS",
    "ROW",
    "SPOTS",
    "furnish",
    "recipes",
]


STEP: Final = 10
"""Grid of positions."""

TRIES: Final = 24
"""Largest number of candidates tried for one piece."""

TURNED: Final = (Yaw(24, 7), Yaw(24, -7), Yaw(20, 15), Yaw(20, -15))
"""Free angles: ±16.26° and ±36.87°."""

TURN_CHANCE: Final = 0.3
"""Probability that a piece that may have a free angle gets one."""

TOP_MARGIN: Final = 20
"""Distance of a small object from the edge of its support."""

HIGHEST_TOP: Final = 1300
"""Largest height of a supporting surface."""

DESK_GAPS: Final = (40, 60, 100)
TALK_GAPS: Final = (900, 1200, 1500, 1800)
"""Distances of a seat from its desk, and from the sofa that it faces."""

SEAT_WIDTH: Final = 620
"""Length of a table's side that one chair takes."""

Spot = Callable[[random.Random, RoomSpace, Kind, int, "Piece | None"], Iterator[Piece]]
"""A generator of candidates from (rng, room, kind, variant, anchor)."""


def _pick(rng: random.Random, low: int, high: int) -> int:
    """Return `low` plus a random multiple of STEP, at most `high`."""
    return low + STEP * rng.randint(0, max(0, (high - low) // STEP))


def _walls(rng: random.Random, room: RoomSpace, width: int) -> list[Edge]:
    """Return the walls with space for a piece `width` millimetres wide, in random order, longer walls usually first."""
    usable = [edge for edge in room.edges if edge.length >= width + 2 * WALL_GAP]
    return sorted(usable, key=lambda edge: -edge.length * rng.uniform(0.2, 1.0))


def _against(edge: Edge, kind: Kind, variant: int, along: int, gap: int = WALL_GAP, bottom: int = 0) -> Piece:
    x, z = edge.point(along, gap + kind.sizes[variant][2] // 2)
    return Piece(kind, variant, x, z, bottom, edge.yaw, against=edge)


def along_wall(rng: random.Random, room: RoomSpace, kind: Kind, variant: int, anchor: Piece | None) -> Iterator[Piece]:
    """Yield positions with the back to a wall: first at both ends of the wall, then anywhere along it."""
    width = kind.sizes[variant][0]
    for edge in _walls(rng, room, width):
        low, high = WALL_GAP + width // 2, edge.length - WALL_GAP - width // 2
        ends = rng.sample((low, high), 2)
        for along in (*ends, *(_pick(rng, low, high) for _ in range(TRIES // 4))):
            yield _against(edge, kind, variant, along)


def wall_middle(rng: random.Random, room: RoomSpace, kind: Kind, variant: int, anchor: Piece | None) -> Iterator[Piece]:
    """Yield positions with the back to a wall, near the wall's middle: for beds and sofas."""
    width = kind.sizes[variant][0]
    walls = _walls(rng, room, width)
    for spread in (0, 200, 500, 900):
        for edge in walls:
            along = edge.length // 2 // STEP * STEP + STEP * rng.randint(-spread // STEP, spread // STEP)
            yield _against(edge, kind, variant, along)
    yield from along_wall(rng, room, kind, variant, anchor)


def opposite(rng: random.Random, room: RoomSpace, kind: Kind, variant: int, anchor: Piece | None) -> Iterator[Piece]:
    """Yield positions against a wall that the anchor faces, as directly in front of the anchor as possible."""
    if anchor is None or not anchor.yaw.square:
        return
    fx, fz = anchor.facing
    width = kind.sizes[variant][0]
    for edge in room.edges:
        if edge.normal == (-fx, -fz) and edge.length >= width + 2 * WALL_GAP:
            low, high = WALL_GAP + width // 2, edge.length - WALL_GAP - width // 2
            goal = (anchor.x - edge.x) * edge.dx + (anchor.z - edge.z) * edge.dz
            for spread in (0, 0, 200, 200, 500, 500, 900, 900, 1500, 1500):
                along = goal + STEP * rng.randint(-spread // STEP, spread // STEP)
                yield _against(edge, kind, variant, min(max(along, low), high))


def corner(rng: random.Random, room: RoomSpace, kind: Kind, variant: int, anchor: Piece | None) -> Iterator[Piece]:
    """Yield positions in a corner of the room."""
    corners = list(room.corners)
    for one, other in rng.sample(corners, len(corners)):
        for _ in range(3):
            piece = Piece(kind, variant, 0, 0, 0, _maybe_turned(rng, kind, rng.choice((one.yaw, other.yaw))))
            gap = 2 * STEP * rng.randint(1, 5)
            rect = piece.rect
            (ax, az), (bx, bz) = one.normal, other.normal
            x = other.x + (ax + bx) * (gap + rect.width // 2)
            z = other.z + (az + bz) * (gap + rect.depth // 2)
            yield replace(piece, x=x, z=z)


def centre(rng: random.Random, room: RoomSpace, kind: Kind, variant: int, anchor: Piece | None) -> Iterator[Piece]:
    """Yield positions near the middle of the room."""
    x0, z0, x1, z1 = (round(v) for v in room.inner.bounds)
    along_x = x1 - x0 > z1 - z0
    for spread in (0, 0, 300, 300, 600, 600, 900, 900, 900, 1200, 1200, 1200):
        yaw = Yaw() if along_x == (rng.random() < 0.85) else Yaw(0, 25)
        x, z = (v // 2 // STEP * STEP + STEP * rng.randint(-spread // STEP, spread // STEP) for v in (x0 + x1, z0 + z1))
        yield Piece(kind, variant, x, z, 0, yaw)


def anywhere(rng: random.Random, room: RoomSpace, kind: Kind, variant: int, anchor: Piece | None) -> Iterator[Piece]:
    """Yield positions anywhere on the floor, mostly near a wall."""
    walls = _walls(rng, room, kind.sizes[variant][0])
    for _ in range(TRIES):
        if not walls:
            return
        piece = Piece(kind, variant, 0, 0, 0, _maybe_turned(rng, kind, rng.choice((Yaw(), Yaw(0, 25)))))
        edge = rng.choice(walls)
        half = max(piece.rect.width, piece.rect.depth) // 2
        x, z = edge.point(_pick(rng, half, edge.length - half), half + 2 * STEP * rng.randint(1, 6))
        yield replace(piece, x=x, z=z)


def beside(rng: random.Random, room: RoomSpace, kind: Kind, variant: int, anchor: Piece | None) -> Iterator[Piece]:
    """Yield positions beside the anchor, at the same wall and with the back in line with the anchor's back."""
    if anchor is None or not anchor.yaw.square:
        return
    width, _, depth = kind.sizes[variant]
    for side in rng.sample((-1, 1), 2):
        for gap in (40, 80, 160, 260):
            x, z = anchor.yaw.apply(side * (anchor.size[0] // 2 + gap + width // 2), depth // 2 - anchor.size[2] // 2)
            yield Piece(kind, variant, anchor.x + round(x), anchor.z + round(z), 0, anchor.yaw, against=anchor.against)


def before(rng: random.Random, room: RoomSpace, kind: Kind, variant: int, anchor: Piece | None) -> Iterator[Piece]:
    """Yield positions in front of the anchor with the same orientation: coffee table before a sofa, bench before a
    bed.
    """
    yield from _before(rng, kind, variant, anchor, Yaw(), gaps=(300, 340, 400, 460, 520))


def facing(rng: random.Random, room: RoomSpace, kind: Kind, variant: int, anchor: Piece | None) -> Iterator[Piece]:
    """Yield positions in front of the anchor, facing it: a chair at a desk, a stool before the sofa."""
    at_desk = anchor is not None and anchor.kind.kind == "desk"
    yield from _before(rng, kind, variant, anchor, Yaw(-25, 0), gaps=DESK_GAPS if at_desk else TALK_GAPS)


def _before(
    rng: random.Random, kind: Kind, variant: int, anchor: Piece | None, turn: Yaw, gaps: tuple[int, ...]
) -> Iterator[Piece]:
    if anchor is None or not anchor.yaw.square:
        return
    spread = max(0, anchor.size[0] // 2 - kind.sizes[variant][0] // 2) // 2
    for gap in gaps:
        for shift in (0, *(STEP * rng.randint(-spread // STEP, spread // STEP) for _ in range(3))):
            yaw = _maybe_turned(rng, kind, anchor.yaw.turned(turn))
            piece = Piece(kind, variant, 0, 0, 0, yaw, soft=True)
            reach = piece.rect.depth if anchor.facing[1] else piece.rect.width
            x, z = anchor.yaw.apply(shift, anchor.size[2] // 2 + gap + reach // 2)
            yield replace(piece, x=anchor.x + round(x), z=anchor.z + round(z))


def around(rng: random.Random, room: RoomSpace, kind: Kind, variant: int, anchor: Piece | None) -> Iterator[Piece]:
    """Yield positions of seats that face a table: opposite sides first, then the ends."""
    if anchor is None or not anchor.yaw.square:
        return
    width, _, depth = anchor.size
    seats = []
    for span, reach, turns in ((width, depth, (Yaw(), Yaw(-25, 0))), (depth, width, (Yaw(0, 25), Yaw(0, -25)))):
        count = max(1, span // SEAT_WIDTH) if reach >= 700 else 0
        for seat in range(count):
            shift = (2 * seat + 1 - count) * span // (2 * count) // STEP * STEP
            seats += [(turn, shift, reach // 2) for turn in turns]
    for turn, shift, reach in seats:
        outward = anchor.yaw.turned(turn)
        yaw = _maybe_turned(rng, kind, outward.turned(Yaw(-25, 0)), chance=0.12)
        piece = Piece(kind, variant, 0, 0, 0, yaw, soft=True)
        own = piece.rect.depth if outward.sine25 == 0 else piece.rect.width
        x, z = outward.apply(shift, reach + own // 2 + 20 * rng.randint(1, 5))
        yield replace(piece, x=anchor.x + round(x), z=anchor.z + round(z))


def hung(rng: random.Random, room: RoomSpace, kind: Kind, variant: int, anchor: Piece | None) -> Iterator[Piece]:
    """Yield positions on a wall, at or slightly above the height at which this kind of piece hangs."""
    assert kind.hang is not None
    width = kind.sizes[variant][0]
    for edge in _walls(rng, room, width):
        for _ in range(TRIES // 4):
            along = _pick(rng, WALL_GAP + width // 2, edge.length - WALL_GAP - width // 2)
            bottom = kind.hang + 20 * rng.randint(0, 4)
            yield _against(edge, kind, variant, along, gap=HANG_GAP, bottom=bottom)


def above(rng: random.Random, room: RoomSpace, kind: Kind, variant: int, anchor: Piece | None) -> Iterator[Piece]:
    """Yield positions on the wall above the anchor."""
    if anchor is None or anchor.against is None or kind.hang is None:
        return
    edge = anchor.against
    goal = (anchor.x - edge.x) * edge.dx + (anchor.z - edge.z) * edge.dz
    for shift in (0, 0, 100, -100, 200, -200):
        bottom = max(kind.hang, anchor.top + 100) + 20 * rng.randint(0, 3)
        yield _against(edge, kind, variant, goal + shift, gap=HANG_GAP, bottom=bottom)


def on_top(rng: random.Random, room: RoomSpace, kind: Kind, variant: int, anchor: Piece | None) -> Iterator[Piece]:
    """Yield random positions on top of the anchor."""
    for _ in range(TRIES):
        yield from _on(rng, kind, variant, anchor, share=(rng.uniform(-1, 1), rng.uniform(-1, 1)))


def on_middle(rng: random.Random, room: RoomSpace, kind: Kind, variant: int, anchor: Piece | None) -> Iterator[Piece]:
    """Yield the position in the middle of the anchor's top."""
    yield from _on(rng, kind, variant, anchor, share=(0.0, 0.0))


def on_back(rng: random.Random, room: RoomSpace, kind: Kind, variant: int, anchor: Piece | None) -> Iterator[Piece]:
    """Yield positions on top of the anchor, at the back: for pillows and screens."""
    for across in (0.0, -0.95, 0.95, -0.5, 0.5):
        yield from _on(rng, kind, variant, anchor, share=(across, -1.0))


def _on(
    rng: random.Random, kind: Kind, variant: int, anchor: Piece | None, share: tuple[float, float]
) -> Iterator[Piece]:
    if anchor is None or not anchor.yaw.square or anchor.top > HIGHEST_TOP:
        return
    width, _, depth = kind.sizes[variant]
    room_x = (anchor.size[0] - width) // 2 - TOP_MARGIN
    room_z = (anchor.size[2] - depth) // 2 - TOP_MARGIN
    if min(room_x, room_z) < 0:
        return
    x, z = anchor.yaw.apply(round(share[0] * room_x), round(share[1] * room_z))
    yield Piece(kind, variant, anchor.x + round(x), anchor.z + round(z), anchor.top, anchor.yaw)


def _maybe_turned(rng: random.Random, kind: Kind, yaw: Yaw, chance: float = TURN_CHANCE) -> Yaw:
    return yaw.turned(rng.choice(TURNED)) if kind.turns and rng.random() < chance else yaw


def row_of(rng: random.Random, room: RoomSpace, kinds: list[tuple[Kind, int]]) -> Iterator[list[Piece]]:
    """Yield whole rows of pieces, side by side at a wall as in a kitchen. A row has one piece for each (kind, variant)
    in `kinds`.
    """
    total = sum(kind.sizes[variant][0] + WALL_GAP for kind, variant in kinds)
    for edge in _walls(rng, room, total):
        low, high = WALL_GAP, edge.length - WALL_GAP - total
        for start in (*rng.sample((low, high), 2), *(_pick(rng, low, high) for _ in range(6))):
            along, pieces = start, []
            for kind, variant in kinds:
                width = kind.sizes[variant][0]
                pieces.append(_against(edge, kind, variant, along + width // 2))
                along += width + WALL_GAP
            yield pieces


SPOTS: Final[Mapping[str, Spot]] = {"wall": along_wall} | {
    spot.__name__.replace("_", " "): spot
    for spot in (
        *(wall_middle, opposite, corner, centre, anywhere, beside, before),
        *(facing, around, hung, above, on_top, on_middle, on_back),
    )
}
"""The kinds of positions that a recipe may name."""


MIN_OBJECTS: Final = 5
MAX_OBJECTS: Final = 12
"""Bounds of the number of objects in a room; each room draws its number, slightly above the lower bound."""

FILLER: Final = "filler"
"""The recipe that fills up rooms with too few objects."""


@dataclass(frozen=True, slots=True)
class Step:
    """One line of a recipe; see the head of ``recipes.yaml``."""

    kinds: tuple[str, ...]
    at: str
    anchor: tuple[str, ...] = ()
    count: tuple[int, int] = (1, 1)
    chance: float = 1.0
    needed: bool = False
    unless: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class Recipe:
    """The steps that furnish a room of one type: those of `first` in the given order, then those of `then` in random
    order.
    """

    first: tuple[Step, ...]
    then: tuple[Step, ...]


ROW: Final = "row"
"""Value of `at` for a step whose kinds form one line along a wall."""


def furnish(rng: random.Random, room: RoomSpace) -> bool:
    """Fill `room` in place with 5 to 12 pieces; return False if the pieces required for its type do not fit."""
    recipe = recipes()[room.label]
    wanted = rng.randint(MIN_OBJECTS + 2, MAX_OBJECTS)
    for step in recipe.first:
        if not _follow(rng, room, step, MAX_OBJECTS) and step.needed:
            return False
    for step in rng.sample(recipe.then, len(recipe.then)):
        _follow(rng, room, step, wanted)
    filler = recipes()[FILLER].then
    for step in rng.sample(filler, len(filler)):
        _follow(rng, room, step, MIN_OBJECTS)
    return len(room.pieces) >= MIN_OBJECTS


def _follow(rng: random.Random, room: RoomSpace, step: Step, most: int) -> bool:
    """Carry out one step while the room holds fewer than `most` pieces. Return True if the step placed a piece, or if
    it was skipped as its recipe allows.
    """
    # All random draws are made first, so that a step depends as little as possible on earlier steps.
    used, count = rng.random() < step.chance, rng.randint(*step.count)
    if step.unless and room.of_kind(step.unless):
        return True
    if not used:
        return not step.needed
    if step.at == ROW:
        return _place_row(rng, room, step)
    anchors: list[int | None] = list(room.of_kind(step.anchor)) if step.anchor else [None]
    if not anchors:
        return False
    rng.shuffle(anchors)
    placed = 0
    variant = rng.randrange(VARIANTS)
    kind = catalogue()[rng.choice(step.kinds)]
    for number in range(count):
        if len(room.pieces) >= most:
            break
        placed += any(
            _place(rng, room, step.at, kind, (variant + smaller) % VARIANTS, anchors[number % len(anchors)])
            for smaller in range(VARIANTS if step.needed else 1)
        )
    return placed > 0


def _place(rng: random.Random, room: RoomSpace, at: str, kind: Kind, variant: int, anchor: int | None) -> bool:
    target = None if anchor is None else room.pieces[anchor]
    parent = anchor if at.startswith("on") else None
    candidates = SPOTS[at](rng, room, kind, variant, target)
    return any(room.add(replace(candidate, parent=parent)) for candidate in candidates)


def _place_row(rng: random.Random, room: RoomSpace, step: Step) -> bool:
    line = [(catalogue()[kind], rng.randrange(VARIANTS)) for kind in step.kinds]
    while len(line) > 1:
        # Shuffled per length, so that the sink is not always at the same end.
        for pieces in row_of(rng, room, rng.sample(line, len(line))):
            before: list[Piece] = list(room.pieces)
            if all(room.add(piece) for piece in pieces):
                return True
            room.restore(before)
        line.pop()
    return False


@cache
def recipes() -> dict[str, Recipe]:
    """Return all recipes by name: one for each room type, and the filler recipe."""
    return {
        label: Recipe(*(tuple(_step(line) for line in recipe.get(part, ())) for part in ("first", "then")))
        for label, recipe in yaml.safe_load(own_text("condvln.samples", "recipes.yaml")).items()
    }


def _step(line: dict[str, Any]) -> Step:
    kinds = line.get("row") or line["kind"]
    return Step(
        kinds=(kinds,) if isinstance(kinds, str) else tuple(kinds),
        at=ROW if "row" in line else line["at"],
        anchor=tuple(line.get("anchor", ())),
        count=tuple(line.get("count", (1, 1))),
        chance=line.get("chance", 1.0),
        needed=line.get("needed", False),
        unless=tuple(line.get("unless", ())),
    )
