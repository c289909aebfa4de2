"""Read Matterport3D's ``.house`` files: a building's levels, regions, surfaces, panoramas and objects, one record per
line.

The format is that of the dataset's ``data_organization.md``. Coordinates stay in the file's frame (metres, z up).
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import Final, NoReturn

import numpy as np

from condvln.arrays import F64
from condvln.formats.json_document import MAX_COORDINATE
from condvln.sources.source import MAX_OBJECTS
from schemas.errors import FormatError

__all__ = ["HouseFile", "HouseObject", "HouseRegion", "Panorama", "read_house_file"]


VERSION: Final = "ASCII 1.1"
_REMEDY = "Take the file from its dataset again"
_PANORAMA_NAME: Final = 32

# Number of words of each kind of record, including the letter. P is a panorama or a portal, distinguished by its
# length.
_WORDS: Final = {"H": 29, "L": 18, "R": 20, "S": 22, "V": 13, "P": 13, "I": 41, "C": 11, "O": 24, "E": 19, "portal": 15}
_COUNTED: Final = {
    "I": 3, "P": 4, "V": 5, "S": 6, "E": 7, "O": 8, "C": 9, "R": 10, "portal": 11, "L": 12,
}  # fmt: skip
"""Kinds of records, and the position in the H record of their number."""


@dataclass(frozen=True, eq=False, slots=True)
class HouseRegion:
    """A region: its room type as the file's one-letter code, its level, its floor corners (n, 2) as (x, y), and the
    heights of the floor (z) and of the room; metres.
    """

    index: int
    level: int
    label: str
    corners: F64
    floor: float
    height: float


@dataclass(frozen=True, eq=False, slots=True)
class HouseObject:
    """An object: indices of region and category (−1 for none), and its oriented box in the file's order: centre (3,),
    axes (3, 3) as columns, half lengths (3,), which may be negative in a file that is wrong.
    """

    index: int
    region: int
    category: int
    centre: F64
    axes: F64
    half_lengths: F64


@dataclass(frozen=True, eq=False, slots=True)
class Panorama:
    """A camera position: its name, index of its region, and position (3,) in metres."""

    name: str
    region: int
    position: F64


@dataclass(frozen=True, eq=False, slots=True)
class HouseFile:
    """The parts of a ``.house`` file that a scene needs. `categories` are the names of the object categories by index;
    a `#` in a name stands for a blank.
    """

    regions: tuple[HouseRegion, ...]
    objects: tuple[HouseObject, ...]
    panoramas: tuple[Panorama, ...]
    categories: dict[int, str]


def read_house_file(data: bytes, where: str) -> HouseFile:
    """Read a ``.house`` file of version 1.1.

    Raises
    ------
    FormatError : the version differs; a record has a wrong length or an invalid number; counts differ from the
        header's; an index is out of range; a region has no floor
    """
    return _Reader(data, where).house()


@dataclass
class _Reader:
    data: bytes
    where: str
    line: int = 0
    words: list[str] = field(default_factory=list)
    counts: Counter[str] = field(default_factory=Counter)
    regions: dict[int, tuple[int, str, float]] = field(default_factory=dict)
    surfaces: dict[int, int] = field(default_factory=dict)
    corners: dict[int, list[F64]] = field(default_factory=dict)
    objects: dict[int, HouseObject] = field(default_factory=dict)
    panoramas: list[Panorama] = field(default_factory=list)
    categories: dict[int, str] = field(default_factory=dict)

    def house(self) -> HouseFile:
        lines = self._lines()
        first = next(lines, "")
        if first.strip() != VERSION:
            self.fail(f"the first line is {first.strip()!r:.20}, not {VERSION!r}; only that version can be read")
        header: list[int] | None = None
        kinds = {"R": self._region, "S": self._surface, "V": self._vertex, "P": self._panorama_or_portal}
        kinds |= {"C": self._category, "O": self._object}
        for text in lines:
            self.words = text.split()
            if not self.words:
                continue
            kind = self.words[0]
            if kind not in _WORDS or kind == "portal":
                self.fail(f"there is no record {kind!r:.12}")
            if kind == "P" and len(self.words) == _WORDS["portal"] and len(self.words[1]) != _PANORAMA_NAME:
                kind = "portal"
            if len(self.words) != _WORDS[kind]:
                self.fail(f"a record {self.words[0]} must have {_WORDS[kind]} words, this one has {len(self.words)}")
            self.counts[kind] += 1
            if kind == "H":
                header = [self.integer(i) for i in range(3, 13)]
            handler: Callable[[], None] | None = kinds.get(self.words[0])
            if handler is not None:
                handler()
        return self._checked(header)

    def _lines(self) -> Iterator[str]:
        """Yield the lines of the file without building a list of them."""
        start = 0
        while start < len(self.data):
            end = self.data.find(b"\n", start)
            end = len(self.data) if end < 0 else end
            self.line += 1
            yield self.data[start:end].decode("latin1")
            start = end + 1

    def _region(self) -> None:
        index, label = self.integer(1), self.words[5]
        if index in self.regions:
            self.fail(f"two regions have the index {index}")
        self.regions[index] = (self.integer(2), label, self.number(15))

    def _surface(self) -> None:
        self.surfaces[self.integer(1)] = self.integer(2)

    def _vertex(self) -> None:
        self.corners.setdefault(self.integer(2), []).append(self.vector(4))

    def _panorama_or_portal(self) -> None:
        if len(self.words[1]) == _PANORAMA_NAME:
            self.panoramas.append(Panorama(self.words[1], self.integer(3), self.vector(5)))

    def _category(self) -> None:
        self.categories[self.integer(1)] = self.words[3]

    def _object(self) -> None:
        index = self.integer(1)
        if index in self.objects:
            self.fail(f"two objects have the index {index}")
        if len(self.objects) == MAX_OBJECTS:
            self.fail(f"more than {MAX_OBJECTS} objects")
        first, second = self.vector(7), self.vector(10)
        axes = np.column_stack([first, second, np.cross(first, second)])
        self.objects[index] = HouseObject(
            index, self.integer(2), self.integer(3), self.vector(4), axes, self.vector(13)
        )

    def _checked(self, header: list[int] | None) -> HouseFile:
        self.line = 0
        if header is None:
            self.fail("there is no record H")
        for kind, word in _COUNTED.items():
            claimed = header[word - 3]
            if self.counts[kind] != claimed:
                self.fail(f"the record H claims {claimed} records {kind}, but there are {self.counts[kind]}")
        for item in self.objects.values():
            if item.region != -1 and item.region not in self.regions:
                self.fail(f"the object {item.index} is in region {item.region}, which does not exist")
            if item.category != -1 and item.category not in self.categories:
                self.fail(f"the object {item.index} is of category {item.category}, which does not exist")
        return HouseFile(
            regions=tuple(self._region_of(index) for index in sorted(self.regions)),
            objects=tuple(self.objects[index] for index in sorted(self.objects)),
            panoramas=tuple(self.panoramas),
            categories=self.categories,
        )

    def _region_of(self, index: int) -> HouseRegion:
        level, label, height = self.regions[index]
        loops = [np.array(self.corners.get(s, ())) for s, region in sorted(self.surfaces.items()) if region == index]
        loops = [loop for loop in loops if len(loop) >= 3]
        if not loops:
            self.fail(f"the region {index} has no floor of three corners or more")
        if not height > 0:
            self.fail(f"the region {index} has no height")
        floor = max(loops, key=_area)
        return HouseRegion(index, level, label, floor[:, :2], float(min(loop[:, 2].min() for loop in loops)), height)

    def integer(self, word: int) -> int:
        try:
            value = int(self.words[word])
        except ValueError:
            self.fail(f"word {word} is {self.words[word]!r:.20}, not a whole number")
        if abs(value) >= 1 << 53:
            self.fail(f"word {word} is too large")
        return value

    def number(self, word: int) -> float:
        try:
            value = float(self.words[word])
        except ValueError:
            value = math.nan
        if not abs(value) <= MAX_COORDINATE:
            self.fail(f"word {word} is {self.words[word]!r:.20}, not a number up to {MAX_COORDINATE:g}")
        return value

    def vector(self, word: int) -> F64:
        return np.array([self.number(word + i) for i in range(3)])

    def fail(self, what: str) -> NoReturn:
        raise FormatError(what, where=self.where, place=f"line {self.line}" if self.line else "", remedy=_REMEDY)


def _area(loop: F64) -> float:
    """Return the area of a polygon's projection on the ground."""
    x, y = loop[:, 0], loop[:, 1]
    return abs(float(x @ np.roll(y, -1) - y @ np.roll(x, -1))) / 2
