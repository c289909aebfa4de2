"""The walls of a ProcTHOR house as slabs, cut where doors stand open and where windows let a look through."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from condvln.scene.scene import round_mm
from condvln.sources.procthor_house import House, HouseWall, Opening
from condvln.sources.solids import SMALLEST, Hole, Piece, floor, pierced_wall
from schemas.errors import FormatError

__all__ = ["WALL_THICKNESS", "house_structure"]

F64 = NDArray[np.float64]

WALL_THICKNESS: Final = 0.02
"""Metres. A house's walls are surfaces without thickness, and furniture stands right against them."""

PARAPET: Final = 0.5
"""Metres of wall that stay below a window however low it begins: it may be looked through, never stepped through."""

SAME_LINE: Final = 0.02
"""Metres by which an opening may miss the line of a wall that it is cut into."""

MAX_OPENINGS: Final = 2000
"""Openings of one house. Real ones have some dozens; each is looked for in each wall."""


def house_structure(house: House, where: str) -> list[Piece]:
    """Floors of all rooms, then all walls that stand.

    A wall between two rooms is in the file once for each, and is drawn once. A closed door is as good as its wall.

    Raises
    ------
    FormatError : the house (`where`) has more openings than a house can have
    """
    if len(house.openings) > MAX_OPENINGS:
        raise FormatError(
            f"{len(house.openings)} doors and windows in one house (at most {MAX_OPENINGS} are read)",
            where=where,
            remedy="Take the file from its dataset again",
        )
    cut = [o for o in house.openings if o.passable or o.kind == "window"]
    pieces = [_slabs(wall, cut) for wall in _standing(house.walls)]
    return [*(floor(round_mm(room.polygon), 0.0) for room in house.rooms), *pieces]


def _standing(walls: Sequence[HouseWall]) -> Iterator[HouseWall]:
    """Walls that were not taken away, each segment once, in file order."""
    drawn: set[tuple[object, ...]] = set()
    for wall in walls:
        if wall.empty or float(np.linalg.norm(wall.end - wall.start)) < SMALLEST:
            continue
        ends = sorted(tuple(round_mm(p).tolist()) for p in (wall.start, wall.end))
        segment = (*ends, *round_mm([wall.bottom, wall.top]).tolist())
        if segment not in drawn:
            drawn.add(segment)
            yield wall


def _slabs(wall: HouseWall, openings: Sequence[Opening]) -> Piece:
    """What is left of a wall around its holes, as upright boxes."""
    length = float(np.linalg.norm(wall.end - wall.start))
    holes = list(_holes(wall, (wall.end - wall.start) / length, length, openings))
    return pierced_wall(wall.start, wall.end, wall.bottom, wall.top, WALL_THICKNESS, holes)


def _holes(wall: HouseWall, along: F64, length: float, openings: Sequence[Opening]) -> Iterator[Hole]:
    """The holes that openings, of whichever wall on the same line, make in this wall."""
    if not openings:
        return
    ends = np.array([[o.start, o.end] for o in openings]) - wall.start
    aside = np.abs(ends @ np.array([-along[1], along[0]])).max(axis=1)
    reach = np.sort(ends @ along, axis=1)
    for number in np.nonzero((aside <= SAME_LINE) & (reach[:, 0] < length) & (reach[:, 1] > 0))[0]:
        opening = openings[int(number)]
        low = opening.bottom if opening.kind == "door" else max(opening.bottom, wall.bottom + PARAPET)
        yield Hole(float(reach[number, 0]), float(reach[number, 1]), low, opening.top)
