"""The instances of a scan whose mesh is painted: each instance has a colour of its own.

A texture carries the colours, or the vertices do. The mesh is cut into small triangles, and each counts to the instance
whose colour is under its centre. The small triangles of an instance are gathered in the cells of a grid.
"""

from __future__ import annotations

import io
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from condvln.arrays import F64, I64
from condvln.formats.glb_part import GlbPart, Primitive, read_part
from condvln.formats.json_document import MAX_COORDINATE
from condvln.scene.boxes import transform_points
from condvln.scene.meshes import coordinates_of, world_transforms
from schemas.errors import FormatError

__all__ = ["CELL", "FINE", "Paint", "read_paint"]

CELL: Final = 0.1
"""Edge in metres of a grid cell, and longest edge of a triangle. Paint in cells that touch, also by a corner, belongs
together.
"""
FINE: Final = 0.025
"""Longest edge in metres of a triangle that a border of the paint crosses; boxes are as precise there."""

FACES_AT_ONCE: Final = 4096
MAX_TRIANGLES: Final = 1 << 21
"""Largest number of triangles that as many faces are cut into; the faces of a scan give a few each."""
MAX_PIXELS: Final = 1 << 26
"""Largest number of pixels of a texture: 8,192 by 8,192."""
DRIFT: Final = 2
"""Largest difference of each channel of a vertex colour to its instance's: they are rounded when they are stored."""
NO_COLOUR: Final = -1
TEXTURE: Final = "texture"
LINEAR: Final = "vertex colours in linear light"
PLAIN: Final = "vertex colours as they are"

_FORMATS: Final = {"image/png": "PNG", "image/jpeg": "JPEG", "image/webp": "WEBP"}
_BITS: Final = 15
_OFFSET: Final = 1 << (_BITS - 1)
_REMEDY: Final = "Take the file from its dataset again"


@dataclass(frozen=True, eq=False, slots=True)
class Paint:
    """The painted cells of a mesh, sorted by instance and cell.

    instance : (n,) number of the instance, as in the colours that were asked for
    body : (n,) number of the connected piece of paint; all cells of a piece have one instance
    low, high : (n, 3) the box of the paint in the cell, in metres, in the scene's frame
    area : (n,) its area in square metres
    unnamed : share of the mesh's area whose colour belongs to no instance
    """

    instance: I64
    body: I64
    low: F64
    high: F64
    area: F64
    unnamed: float


def read_paint(data: bytes, where: str, transform: F64, colours: Mapping[int, int]) -> Paint:
    """Return the paint of a GLB file.

    Of several ways to store the colours, that one counts by which most of the mesh's area belongs to an instance: a
    texture; vertex colours in linear light, as glTF has them; vertex colours as they are.

    Parameters
    ----------
    transform : (4, 4) from the file's frame to the scene's
    colours : number of the instance by colour (0xRRGGBB)

    Raises
    ------
    FormatError : the file can't be read as in `condvln.formats.glb_part.read_part`, a texture can't be decoded, no
        colour belongs to an instance, or the mesh is too large
    """
    part = read_part(data, where)
    palette = _Palette(colours)
    best = _best_way(part, transform, palette, where)
    tables: list[_Table] = []
    total = unnamed = 0.0
    for corners, coordinates, picture, tints in _faces(part, transform, where):
        own = _vertex_instances(tints, best, palette)
        for some, of in _cut_all(corners, coordinates, where):
            if best == TEXTURE:
                rows, named = _cut_borders(some, picture, palette, where)
            else:
                rows, named = some, own[of]
            area = _areas(rows[..., :3])
            total += float(area.sum())
            unnamed += float(area[named < 0].sum())
            kept = named >= 0
            if kept.any():
                tables.append(_gathered(named[kept], rows[kept][..., :3], area[kept], where))
    if not tables:
        raise _strange(where)
    table = _joined(tables)
    return Paint(
        table.key >> (3 * _BITS),
        _bodies(table.key),
        table.low,
        table.high,
        table.area,
        unnamed / total if total > 0 else 0.0,
    )


class _Palette:
    """The colours of the instances, sorted."""

    def __init__(self, colours: Mapping[int, int]) -> None:
        self._colours = np.array(sorted(colours), dtype=np.int64)
        self._numbers = np.array([colours[colour] for colour in sorted(colours)], dtype=np.int64)

    def exact(self, colours: I64) -> I64:
        """Return the instance of each colour, −1 for none."""
        if not len(self._colours):
            return np.full(colours.shape, -1, np.int64)
        at = np.searchsorted(self._colours, colours).clip(max=len(self._colours) - 1)
        return np.where(self._colours[at] == colours, self._numbers[at], -1)

    def near(self, colours: I64) -> I64:
        """Return the instance of each colour, else the only one whose colour differs by at most `DRIFT` in each
        channel; −1 for none.
        """
        distinct, back = np.unique(colours, return_inverse=True)
        found = self.exact(distinct)
        own = _channels(self._colours)
        for k in np.flatnonzero((found < 0) & (distinct > 0)):  # black is what nobody painted
            close = np.flatnonzero((np.abs(own - _channels(distinct[k])) <= DRIFT).all(axis=-1))
            if len(close) == 1:
                found[k] = self._numbers[close[0]]
        return np.asarray(found[back].reshape(colours.shape), dtype=np.int64)


def _channels(colours: NDArray[np.integer] | np.integer) -> I64:
    return np.stack([(colours >> 16) & 255, (colours >> 8) & 255, colours & 255], axis=-1).astype(np.int64)


def _best_way(part: GlbPart, transform: F64, palette: _Palette, where: str) -> str:
    named = {TEXTURE: 0.0, LINEAR: 0.0, PLAIN: 0.0}
    for corners, coordinates, picture, tints in _faces(part, transform, where):
        area = _areas(corners)
        if picture is not None:
            middle = palette.exact(_texels(picture, coordinates.mean(axis=1)))
            named[TEXTURE] += float(area[middle >= 0].sum())
        if tints is not None:
            for way in (LINEAR, PLAIN):
                named[way] += float(area[_vertex_instances(tints, way, palette) >= 0].sum())
    best = max(named, key=lambda way: named[way])
    if not named[best] > 0:
        raise _strange(where)
    return best


def _strange(where: str) -> FormatError:
    return FormatError(
        "no face of the mesh has a colour of the annotation",
        where=where,
        remedy="Take the mesh and its list of instances from the same version of the dataset",
    )


_Faces = tuple[F64, F64, "NDArray[np.uint8] | None", "F64 | None"]


def _faces(part: GlbPart, transform: F64, where: str) -> Iterator[_Faces]:
    """Yield of each placed primitive the corners (n, 3, 3) of its faces in the scene's frame, their texture coordinates
    (n, 3, 2), the texture (h, w, 3) or None, and the vertex colours (n, 3, 3) in [0, 1] or None.
    """
    pictures = _Pictures(part, where)
    world = world_transforms(part)
    for number, node in enumerate(part.nodes):
        for own in part.meshes[node.mesh] if node.mesh is not None else ():
            triangles = own.faces
            placed = transform_points(transform @ world[number], own.points.astype(np.float64))
            if not (np.abs(placed[triangles]) <= MAX_COORDINATE).all():
                raise FormatError(
                    f"a vertex is NaN, infinite or beyond ±{MAX_COORDINATE:g} m", where=where, remedy=_REMEDY
                )
            coordinates, picture = pictures.of(own)
            tints = own.rows("COLOR_0")
            own_tints = None if tints is None else np.nan_to_num(np.asarray(tints[:, :3], np.float64))[triangles]
            yield placed[triangles], coordinates[triangles], picture, own_tints


class _Pictures:
    """The textures of a file; the last one that was asked for is kept."""

    def __init__(self, part: GlbPart, where: str) -> None:
        self._part, self._where = part, where
        self._last: tuple[int, NDArray[np.uint8]] | None = None

    def of(self, own: Primitive) -> tuple[F64, NDArray[np.uint8] | None]:
        """Return the texture coordinates (n, 2) of a primitive's vertices, zero where there are none, and its texture,
        None if there is none.
        """
        none = np.zeros((len(own.points), 2))
        look = self._part.look
        if own.material is None or look is None:
            return none, None
        slot = look.materials[own.material].get("pbrMetallicRoughness", {}).get("baseColorTexture")
        if slot is None:
            return none, None
        name, moved = coordinates_of(slot)
        places = own.rows(name)
        image = look.textures[int(slot["index"])].get("source")
        if places is None or image is None:
            return none, None
        rows = np.nan_to_num(np.asarray(places, np.float64), nan=0.0, posinf=0.0, neginf=0.0)
        return rows @ moved[:2, :2].T + moved[:2, 2], self._picture(image)

    def _picture(self, index: int) -> NDArray[np.uint8]:
        if self._last is None or self._last[0] != index:
            assert self._part.look is not None
            own = self._part.look.images[index]
            self._last = index, _pixels(own.data, own.mime, f"{self._where}, image {index}")
        return self._last[1]


def _pixels(data: bytes, mime: str, where: str) -> NDArray[np.uint8]:
    from PIL import Image

    if mime not in _FORMATS:
        raise FormatError(f"a texture is {mime}, which can't carry exact colours here", where=where, remedy=_REMEDY)
    try:
        with Image.open(io.BytesIO(data), formats=(_FORMATS[mime],)) as picture:
            if picture.width * picture.height > MAX_PIXELS:
                raise FormatError(f"a texture has more than {MAX_PIXELS:,} pixels", where=where, remedy=_REMEDY)
            return np.asarray(picture.convert("RGB"))
    except (OSError, ValueError, SyntaxError, Image.DecompressionBombError) as error:
        raise FormatError(f"a texture can't be decoded ({error!r:.120})", where=where, remedy=_REMEDY) from None


def _texels(picture: NDArray[np.uint8] | None, places: F64) -> I64:
    """Return the colours (n,) under texture coordinates (n, 2), which repeat beyond 0 to 1; −1 without a texture."""
    if picture is None:
        return np.full(len(places), NO_COLOUR, np.int64)
    height, width = picture.shape[:2]
    inside = places - np.floor(places)
    # glTF counts rows from the top.
    column = (inside[:, 0] * width).astype(np.int64).clip(max=width - 1)
    row = (inside[:, 1] * height).astype(np.int64).clip(max=height - 1)
    red, green, blue = picture[row, column].astype(np.int64).T
    return np.asarray((red << 16) | (green << 8) | blue, dtype=np.int64)


def _vertex_instances(tints: F64 | None, way: str, palette: _Palette) -> I64:
    """Return the instance of each face: that of two corners at least, −1 for none."""
    if tints is None or way == TEXTURE:
        return np.zeros(0, np.int64)
    light: F64 = np.clip(tints, 0.0, 1.0)
    if way == LINEAR:
        # The transfer curve of sRGB, IEC 61966-2-1.
        light = np.where(light <= 0.0031308, light * 12.92, 1.055 * np.power(light, 1 / 2.4) - 0.055)
    red, green, blue = np.moveaxis(np.rint(light * 255).astype(np.int64), -1, 0)
    a, b, c = palette.near((red << 16) | (green << 8) | blue).T
    return np.asarray(np.where((a == b) | (a == c), a, np.where(b == c, b, -1)), dtype=np.int64)


def _areas(corners: F64) -> F64:
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    areas: F64 = np.linalg.norm(across, axis=-1) / 2
    return areas


def _cut_all(corners: F64, coordinates: F64, where: str) -> Iterator[tuple[F64, I64]]:
    """Yield triangles (n, 3, 5), position and texture coordinates, none with an edge longer than `CELL`, and the face
    (n,) that each is of.
    """
    rows = np.concatenate([corners, coordinates], axis=2)
    for start in range(0, len(rows), FACES_AT_ONCE):
        yield _cut(rows[start : start + FACES_AT_ONCE], CELL, where, start)


def _cut_borders(rows: F64, picture: NDArray[np.uint8] | None, palette: _Palette, where: str) -> tuple[F64, I64]:
    """Return triangles and their instances; those with several colours are cut to `FINE`."""

    def named(places: F64) -> I64:
        return palette.exact(_texels(picture, places))

    middle = named(rows[..., 3:].mean(axis=1))
    mixed = np.any([named(rows[:, k, 3:]) != middle for k in range(3)], axis=0)
    if not mixed.any():
        return rows, middle
    fine, _ = _cut(rows[mixed], FINE, where)
    return np.concatenate([rows[~mixed], fine]), np.concatenate([middle[~mixed], named(fine[..., 3:].mean(axis=1))])


def _cut(rows: F64, longest: float, where: str, first: int = 0) -> tuple[F64, I64]:
    """Halve triangles at the middle of their longest edge until no edge is longer than `longest`. Return them with the
    number of the triangle that each is of, counted from `first`.
    """
    small: list[F64] = []
    owners: list[I64] = []
    owner = np.arange(first, first + len(rows))
    count = 0
    while len(rows):
        edges = rows[:, [1, 2, 0], :3] - rows[..., :3]
        squares = np.einsum("nij,nij->ni", edges, edges)
        large = squares.max(axis=1) > longest**2
        small.append(rows[~large])
        owners.append(owner[~large])
        count += len(small[-1])
        at = squares[large].argmax(axis=1)
        rows, owner = rows[large], np.tile(owner[large], 2)
        if count + len(owner) > MAX_TRIANGLES:
            raise FormatError("the faces of the mesh are too large for a scan", where=where, remedy=_REMEDY)
        every = np.arange(len(rows))
        a, b, c = (rows[every, (at + k) % 3] for k in range(3))
        middle = (a + b) / 2
        rows = np.concatenate([np.stack([a, middle, c], axis=1), np.stack([middle, b, c], axis=1)])
    return np.concatenate(small), np.concatenate(owners)


class _Table(NamedTuple):
    """Cells by key: the instance's number above three coordinates of the cell."""

    key: I64
    low: F64
    high: F64
    area: F64


def _gathered(instance: I64, corners: F64, area: F64, where: str) -> _Table:
    cell = np.floor(corners.mean(axis=1) / CELL).astype(np.int64) + _OFFSET
    if ((cell < 1) | (cell >= 2 * _OFFSET - 1)).any():
        raise FormatError(f"the mesh reaches beyond {_OFFSET * CELL:.0f} m", where=where, remedy=_REMEDY)
    key = (((instance << _BITS | cell[:, 0]) << _BITS) | cell[:, 1]) << _BITS | cell[:, 2]
    return _reduced(_Table(key, corners.min(axis=1), corners.max(axis=1), area))


def _joined(tables: list[_Table]) -> _Table:
    return _reduced(_Table(*map(np.concatenate, zip(*tables, strict=True))))


def _reduced(table: _Table) -> _Table:
    """Return one row for each key, sorted."""
    order = np.argsort(table.key, kind="stable")
    key = table.key[order]
    first = np.flatnonzero(np.concatenate([[True], key[1:] != key[:-1]]))
    return _Table(
        key[first],
        np.minimum.reduceat(table.low[order], first),
        np.maximum.reduceat(table.high[order], first),
        np.add.reduceat(table.area[order], first),
    )


def _bodies(key: I64) -> I64:
    """Return the connected piece of each cell: cells of one instance that touch."""
    pairs = []
    for x in (-1, 0, 1):
        for y in (-1, 0, 1):
            for z in (-1, 0, 1):
                step = (x << 2 * _BITS) + (y << _BITS) + z
                if step > 0:  # each pair once
                    at = np.searchsorted(key, key + step).clip(max=len(key) - 1)
                    met = np.flatnonzero(key[at] == key + step)
                    pairs.append(np.stack([met, at[met]]))
    one, other = np.concatenate(pairs, axis=1)
    graph = coo_array((np.ones(len(one), np.int8), (one, other)), shape=(len(key), len(key)))
    return np.asarray(connected_components(graph, directed=False)[1], dtype=np.int64)
