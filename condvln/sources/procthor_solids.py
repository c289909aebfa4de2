"""The walls of a ProcTHOR house as slabs, with holes for open doors and windows; its L- and C-shaped counters as arms.

The asset database has one box for each asset, and that of a kitchen counter with a corner is mostly air. The shape
follows from names (``Countertop_L_8x6``, ``Countertop_C_10x4``), and the sides of the arms from the objects on the
counters: on 23 L counters of 60 houses, none of 261 objects is in the (−x, +z) quarter of the asset's frame; on 12 C
counters, none of 161 is beyond the arms along −x, −z and +x; none at all is more than 0.55 m from the outer side.
Straight counters of the same kit are 0.61 m deep.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from typing import Final

import numpy as np

from condvln.arrays import F64
from condvln.scene import OrientedBox
from condvln.scene.boxes import rounded_box
from condvln.scene.scene import round_mm
from condvln.sources.procthor_house import House, HouseWall, Opening
from condvln.sources.solids import SMALLEST, Hole, Piece, floor, pierced_wall
from schemas.errors import FormatError

__all__ = [
    "ARM_DEPTH",
    "WALL_THICKNESS",
    "counter_parts",
    "house_structure",
    "walls_with_openings",
]


WALL_THICKNESS: Final = 0.02
"""Wall thickness in metres. A house's walls are surfaces without thickness, with furniture directly against them."""

PARAPET: Final = 0.5
"""Least height in metres of the wall below a window: agents may look through it, but never step through."""

SAME_LINE: Final = 0.02
"""Tolerance in metres between an opening and the line of the wall that it is cut into."""

MAX_OPENINGS: Final = 2000
"""Largest number of openings of one house. Real houses have dozens; each is matched against each wall."""


def house_structure(house: House, where: str) -> list[Piece]:
    """Return the floors of all rooms, followed by all walls that were not removed.

    A wall between two rooms is twice in the file, and is added once. A closed door counts as wall.

    Raises
    ------
    FormatError : the house (`where`) has more openings than are allowed
    """
    if len(house.openings) > MAX_OPENINGS:
        raise FormatError(
            f"{len(house.openings)} doors and windows in one house (at most {MAX_OPENINGS} are read)",
            where=where,
            remedy="Take the file from its dataset again",
        )
    cut = [o for o in house.openings if o.passable or o.kind == "window"]
    floors = (floor(round_mm(room.polygon), 0.0) for room in house.rooms)
    return [*floors, *walls_with_openings(house.walls, cut)]


def walls_with_openings(
    walls: Sequence[HouseWall], openings: Sequence[Opening], reach: float = SAME_LINE
) -> list[Piece]:
    """Return all walls that were not removed, each once, without the `openings` that are within `reach` metres of their
    line.
    """
    return [_slabs(wall, openings, reach) for wall in _standing(walls)]


def _standing(walls: Sequence[HouseWall]) -> Iterator[HouseWall]:
    """Yield the walls that were not removed, each segment once, in file order."""
    drawn: set[tuple[object, ...]] = set()
    for wall in walls:
        if wall.empty or float(np.linalg.norm(wall.end - wall.start)) < SMALLEST:
            continue
        ends = sorted(tuple(round_mm(p).tolist()) for p in (wall.start, wall.end))
        segment = (*ends, *round_mm([wall.bottom, wall.top]).tolist())
        if segment not in drawn:
            drawn.add(segment)
            yield wall


def _slabs(wall: HouseWall, openings: Sequence[Opening], reach: float) -> Piece:
    """Return a wall without its holes, as upright boxes."""
    length = float(np.linalg.norm(wall.end - wall.start))
    holes = list(_holes(wall, (wall.end - wall.start) / length, length, openings, reach))
    return pierced_wall(wall.start, wall.end, wall.bottom, wall.top, WALL_THICKNESS, holes)


def _holes(wall: HouseWall, along: F64, length: float, openings: Sequence[Opening], beside: float) -> Iterator[Hole]:
    """Yield the holes in `wall`: one for each opening that overlaps the wall along the wall's line, even if the file
    assigns the opening to another wall.
    """
    if not openings:
        return
    ends = np.array([[o.start, o.end] for o in openings]) - wall.start
    aside = np.abs(ends @ np.array([-along[1], along[0]])).max(axis=1)
    reach = np.sort(ends @ along, axis=1)
    for number in np.nonzero((aside <= beside) & (reach[:, 0] < length) & (reach[:, 1] > 0))[0]:
        opening = openings[int(number)]
        low = opening.bottom if opening.kind == "door" else max(opening.bottom, wall.bottom + PARAPET)
        yield Hole(float(reach[number, 0]), float(reach[number, 1]), low, opening.top)


ARM_DEPTH: Final = 0.61
"""Depth of each arm in metres, from the outer to the inner side."""

_NAME: Final = re.compile(r"Countertop_(?P<shape>[LC])_\d+x\d+")
_ARMS: Final = {"L": ("+x", "-z"), "C": ("-x", "+x", "-z")}
"""Sides of the asset's box, in Unity's frame, along whose full length an arm runs."""


def counter_parts(asset_id: str, center: F64, size: F64, rotation: F64) -> tuple[OrientedBox, ...]:
    """Return the arms of a counter as boxes that overlap at the corners; empty for any other asset.

    Parameters
    ----------
    center : (3,) middle of the asset's box in the scene, metres
    size : (3,) its full lengths along the asset's axes
    rotation : (3, 3) from the asset's axes, Unity's mirrored in z, to the scene's
    """
    named = _NAME.fullmatch(asset_id)
    if named is None or not (size[[0, 2]] > ARM_DEPTH).all():
        return ()
    parts = []
    for side in _ARMS[named["shape"]]:
        axis = "xyz".index(side[1])
        # The asset's own z is mirrored by the conversion to Habitat's frame.
        sign = (1.0 if side[0] == "+" else -1.0) * (-1.0 if side[1] == "z" else 1.0)
        half, middle = size / 2, np.zeros(3)
        middle[axis] = sign * (half[axis] - ARM_DEPTH / 2)
        half = half.copy()
        half[axis] = ARM_DEPTH / 2
        parts.append(rounded_box(OrientedBox(center + rotation @ middle, half, rotation)))
    return tuple(parts)
