"""Read Habitat's ``.navmesh`` files, versions 1 and 2, with strict checks, write them byte-identically, compare them.

Layout after ``PathFinder.cpp`` of habitat-sim (MIT) and ``DetourNavMesh.h`` of Recast & Detour (zlib licence). Files
are untrusted: each count is checked against the actual bytes before anything is allocated, and each index that a query
follows is checked here once, because compiled kernels check none.
"""

from __future__ import annotations

import math
import os
from collections.abc import Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from condvln.formats.regular_file import read_regular
from condvln.formats.streams import write_file
from condvln.navigation.settings import NavMeshSettings
from condvln.navigation.tile import (
    BV_NODE,
    DETAIL_MESH,
    HEADER,
    LINK,
    MAX_VERTS_PER_POLYGON,
    OFF_MESH_CONNECTION,
    POLYGON,
    TILE_MAGIC,
    TILE_PORTAL,
    TILE_VERSION,
    NavMeshTile,
    Records,
    base_reference,
)
from schemas.errors import FormatError, MissingFileError

__all__ = ["Difference", "NavMeshFile", "compare_navmeshes", "parse_navmesh", "read_navmesh", "write_navmesh"]

FILE_MAGIC = 0x4D534554  # 'MSET'
FILE_VERSIONS = (1, 2)
FILE_HEADER = np.dtype(
    [
        ("magic", "<i4"),
        ("version", "<i4"),
        ("tile_count", "<i4"),
        ("origin", "<f4", 3),
        ("tile_width", "<f4"),
        ("tile_height", "<f4"),
        ("max_tiles", "<i4"),
        ("max_polys", "<i4"),
    ]
)
SETTINGS_BLOCK = np.dtype([("numbers", "<f4", 13), ("flags", "u1", 4)])
TILE_ENTRY = np.dtype([("reference", "<u4"), ("size", "<i4")])

# Size limit in bytes. A scene's navmesh has tens of kilobytes; no real one comes close to this.
MAX_FILE_BYTES = 1 << 30
# Largest coordinate in metres. It keeps squares and sums over paths finite in float32, so that kernels never compare
# NaN.
MAX_COORDINATE = 1e6
MAX_CELLS_PER_METRE = 1e4

REMEDY = "Take the file from its dataset again, or rebuild it with 'condvln navmesh build'"


@dataclass(frozen=True, eq=False)
class NavMeshFile:
    """The whole content of a ``.navmesh`` file.

    Attributes
    ----------
    tile : the mesh
    version : 1 (habitat-sim up to 0.2.1, no settings) or 2
    settings : the build settings; None in version 1
    origin, tile_width, tile_height : Detour's grid, (3,) float32 and metres; a search box outside the tile's cell finds
        nothing
    reference : Detour's reference of the tile
    max_polys : largest number of polygons that references can address
    static_objects_byte : the raw byte of ``include_static_objects``; in files of 0.2.2 to 0.2.4 it is blank padding
    """

    tile: NavMeshTile
    version: int
    settings: NavMeshSettings | None
    origin: npt.NDArray[np.float32]
    tile_width: float
    tile_height: float
    reference: int
    max_polys: int
    static_objects_byte: int = 0

    @classmethod
    def of_tile(cls, tile: NavMeshTile, settings: NavMeshSettings) -> NavMeshFile:
        """Return a version 2 file of a newly built tile, with the grid that Habitat's single-tile ``init`` makes."""
        low, high = tile.bounds
        return cls(
            tile=tile,
            version=2,
            settings=settings,
            origin=low,
            tile_width=float(high[0] - low[0]),
            tile_height=float(high[2] - low[2]),
            reference=base_reference(len(tile.polys)),
            max_polys=len(tile.polys),
            static_objects_byte=int(settings.include_static_objects),
        )

    @property
    def known_settings(self) -> NavMeshSettings:
        """Return the settings of the navmesh. A file of version 1 has none: then agent and cell sizes are those of the
        tile's header, and the others are defaults.
        """
        if self.settings is not None:
            return self.settings
        header = self.tile.header
        return NavMeshSettings(
            cell_size=_decimal(np.float32(1.0) / header["bv_quant_factor"]),
            agent_height=_decimal(header["walkable_height"]),
            agent_radius=_decimal(header["walkable_radius"]),
            agent_max_climb=_decimal(header["walkable_climb"]),
        )

    def to_bytes(self) -> bytes:
        """Return the file's bytes; for a file that was read, these equal the bytes that were read."""
        header = np.zeros((), FILE_HEADER)
        header["magic"], header["version"], header["tile_count"] = FILE_MAGIC, self.version, 1
        header["origin"], header["max_tiles"], header["max_polys"] = self.origin, 1, self.max_polys
        header["tile_width"], header["tile_height"] = self.tile_width, self.tile_height
        data = self.tile.to_bytes()
        entry = np.array((self.reference, len(data)), TILE_ENTRY)
        return header.tobytes() + self._settings_bytes() + entry.tobytes() + data

    def _settings_bytes(self) -> bytes:
        if self.version < 2:
            return b""
        settings = self.settings or NavMeshSettings()
        values = [getattr(settings, f.name) for f in fields(settings)]
        block = np.zeros((), SETTINGS_BLOCK)
        block["numbers"] = values[:13]
        block["flags"] = [*map(int, values[13:16]), self.static_objects_byte]
        return block.tobytes()


def read_navmesh(path: str | os.PathLike[str]) -> NavMeshFile:
    """Read a ``.navmesh`` file.

    Raises
    ------
    MissingFileError : the file does not exist
    FormatError : it is not a valid single-tile navmesh
    """
    file = Path(path)
    try:
        size = file.stat().st_size
        if size > MAX_FILE_BYTES:
            raise FormatError(
                f"the file has {size} bytes (at most {MAX_FILE_BYTES} are read)", where=file, remedy=REMEDY
            )
        data = read_regular(file)
    except FileNotFoundError as error:
        raise MissingFileError("the navmesh file does not exist", where=file, remedy="Check the path") from error
    except OSError as error:
        raise FormatError(f"can't be read: {error.strerror or error}", where=file, remedy=REMEDY) from error
    return parse_navmesh(data, where=file)


def write_navmesh(path: str | os.PathLike[str], navmesh: NavMeshFile) -> None:
    """Write ``navmesh`` to ``path``, whole or not at all. Raises StoreError if it can't be written."""
    write_file(Path(path), navmesh.to_bytes())


def parse_navmesh(data: bytes, where: str | os.PathLike[str] = "<bytes>") -> NavMeshFile:
    """Parse the navmesh in ``data``; ``where`` names it in errors.

    Raises
    ------
    FormatError : not a valid single-tile navmesh
    """
    reader = _Reader(data, str(where))
    header = reader.take(FILE_HEADER, 1, "file header")[0]
    if header["magic"] != FILE_MAGIC:
        reader.fail("this is not a Habitat navmesh: its first four bytes are not 'TESM'", "file header")
    version, tiles = int(header["version"]), int(header["tile_count"])
    if version not in FILE_VERSIONS:
        reader.fail(f"version {version} is not supported (only 1 and 2)", "file header")
    if tiles != 1 or header["max_tiles"] != 1:
        reader.fail(
            f"there are {tiles} tiles in a grid of {header['max_tiles']}; only single-tile meshes are supported",
            "file header",
        )
    grid = [*header["origin"], header["tile_width"], header["tile_height"]]
    reader.require_bounded(np.array(grid), "file header")
    if header["tile_width"] <= 0 or header["tile_height"] <= 0:
        reader.fail("the tile has no extent", "file header")
    settings, static_byte = _read_settings(reader) if version >= 2 else (None, 0)
    entry = reader.take(TILE_ENTRY, 1, "tile entry")[0]
    if entry["size"] != reader.left:
        reader.fail(f"the tile claims {entry['size']} bytes, but {reader.left} are left", "tile entry")
    tile = _read_tile(reader)
    max_polys = int(header["max_polys"])
    if not len(tile.polys) <= max_polys <= 1 << 22:  # Detour reserves at least ten bits for the salt
        reader.fail(f"references can address {max_polys} polygons, but the tile has {len(tile.polys)}", "file header")
    if entry["reference"] == 0 or entry["reference"] % base_reference(max_polys):
        reader.fail(f"the tile's reference {entry['reference']:#x} points into a polygon", "tile entry")
    return NavMeshFile(
        tile=tile,
        version=version,
        settings=settings,
        origin=header["origin"].astype(np.float32),
        tile_width=float(header["tile_width"]),
        tile_height=float(header["tile_height"]),
        reference=int(entry["reference"]),
        max_polys=max_polys,
        static_objects_byte=static_byte,
    )


class _Reader:
    """A cursor over ``data`` that never reads beyond the last byte."""

    def __init__(self, data: bytes, where: str) -> None:
        self.data, self.where, self.offset = data, where, 0

    @property
    def left(self) -> int:
        return len(self.data) - self.offset

    def take(self, dtype: np.dtype[Any], count: int, place: str) -> Records:
        size = dtype.itemsize * count
        if count < 0 or size > self.left:
            self.fail(
                f"the file claims {count} records of {dtype.itemsize} bytes, but {self.left} bytes are left", place
            )
        records = np.frombuffer(self.data, dtype, count, self.offset)
        self.offset += size
        return records

    def fail(self, what: str, place: str) -> None:
        raise FormatError(what, where=self.where, place=place, remedy=REMEDY)

    def require(self, sound: Any, what: str, place: str) -> None:
        """Raise an error that names the first record whose value in ``sound`` is false, if there is one."""
        if not sound.all():
            first = tuple(int(i) for i in np.argwhere(~sound)[0])
            self.fail(what, f"{place} {first[0]}")

    def require_bounded(self, numbers: Any, place: str) -> None:
        # NaN fails the comparison as well
        self.require(
            np.atleast_1d(np.abs(numbers) <= MAX_COORDINATE), "a number is NaN, infinite or beyond 1000 km", place
        )


def _read_settings(reader: _Reader) -> tuple[NavMeshSettings, int]:
    block = reader.take(SETTINGS_BLOCK, 1, "settings")[0]
    numbers = [_decimal(number) for number in block["numbers"]]
    if not all(math.isfinite(number) for number in numbers):
        reader.fail("a number of the settings is NaN or infinite", "settings")
    flags = [int(flag) for flag in block["flags"]]
    if any(flag > 1 for flag in flags[:3]):
        reader.fail(f"the filter switches are {flags[:3]}, not 0 or 1", "settings")
    names = [field.name for field in fields(NavMeshSettings)]
    values: dict[str, Any] = dict(zip(names, [*numbers, *map(bool, flags[:3]), flags[3] == 1], strict=True))
    return NavMeshSettings(**values), flags[3]


def _read_tile(reader: _Reader) -> NavMeshTile:
    header = reader.take(HEADER, 1, "tile header").reshape(())
    if header["magic"] != TILE_MAGIC or header["version"] != TILE_VERSION:
        reader.fail(f"not a Detour tile of version {TILE_VERSION}", "tile header")
    _check_header(reader, header)
    tile = NavMeshTile(
        header=header,
        verts=_points(reader, int(header["vert_count"]), "vertices"),
        polys=reader.take(POLYGON, int(header["poly_count"]), "polygons"),
        links=reader.take(LINK, int(header["max_link_count"]), "links"),
        detail_meshes=reader.take(DETAIL_MESH, int(header["detail_mesh_count"]), "detail meshes"),
        detail_verts=_points(reader, int(header["detail_vert_count"]), "detail vertices"),
        detail_tris=reader.take(np.dtype(np.uint8), 4 * int(header["detail_tri_count"]), "detail triangles").reshape(
            -1, 4
        ),
        bv_nodes=reader.take(BV_NODE, int(header["bv_node_count"]), "bounding volume tree"),
        off_mesh=reader.take(OFF_MESH_CONNECTION, 0, "off-mesh connections"),
    )
    if reader.left:
        reader.fail(f"{reader.left} bytes are left over", "end of tile")
    _check_polygons(reader, tile)
    _check_detail(reader, tile)
    leaf = tile.bv_nodes["i"]
    reader.require(leaf < len(tile.polys), "the leaf refers to a missing polygon", "bounding volume node")
    return tile


def _check_header(reader: _Reader, header: Records) -> None:
    place = "tile header"
    if header["off_mesh_con_count"] != 0:
        reader.fail("off-mesh connections are not supported; Habitat's own builder makes none", place)
    if header["x"] != 0 or header["y"] != 0 or header["layer"] != 0:
        reader.fail("the tile belongs to a tiled mesh; only single-tile meshes, as Habitat makes, are read", place)
    if header["poly_count"] < 1 or header["vert_count"] < 3:
        reader.fail("the mesh is empty", place)
    if header["detail_mesh_count"] != header["poly_count"]:
        reader.fail("each polygon needs one detail mesh", place)
    if header["bv_node_count"] < 1:
        reader.fail("the bounding volume tree is missing", place)
    sizes: Sequence[str] = ("walkable_height", "walkable_radius", "walkable_climb")
    reader.require_bounded(np.array([*(header[name] for name in sizes), *header["bmin"], *header["bmax"]]), place)
    if not 0 < header["bv_quant_factor"] <= MAX_CELLS_PER_METRE:
        reader.fail(f"the tree has {header['bv_quant_factor']} cells per metre", place)
    if (header["bmin"] > header["bmax"]).any():
        reader.fail("the lower bound is above the upper one", place)


def _points(reader: _Reader, count: int, place: str) -> npt.NDArray[np.float32]:
    record = np.dtype((np.float32, 3)).newbyteorder("<")
    points = reader.take(np.dtype([("xyz", record)]), count, place)["xyz"]
    reader.require(
        (np.abs(points) <= MAX_COORDINATE).all(axis=1), "a coordinate is NaN, infinite or beyond 1000 km", place
    )
    return np.ascontiguousarray(points, np.float32)


def _check_polygons(reader: _Reader, tile: NavMeshTile) -> None:
    polys, place = tile.polys, "polygon"
    count = polys["vert_count"]
    reader.require((count >= 3) & (count <= MAX_VERTS_PER_POLYGON), "the polygon does not have 3 to 6 vertices", place)
    reader.require(polys["area_and_type"] >> 6 == 0, "it is not a ground polygon", place)
    used = np.arange(MAX_VERTS_PER_POLYGON)[None, :] < count[:, None]
    reader.require(((polys["verts"] < len(tile.verts)) | ~used).all(axis=1), "it refers to a missing vertex", place)
    neis = polys["neis"]
    reader.require(
        ((neis <= len(polys)) | (neis >= TILE_PORTAL) | ~used).all(axis=1), "it refers to a missing neighbour", place
    )
    if int((tile.neighbours >= 0).sum()) > len(tile.links):
        reader.fail("there are fewer links than inner edges", "tile header")


def _check_detail(reader: _Reader, tile: NavMeshTile) -> None:
    mesh, place = tile.detail_meshes, "detail mesh"
    tri_end = mesh["tri_base"].astype(np.int64) + mesh["tri_count"]
    reader.require(
        (mesh["tri_count"] > 0) & (tri_end <= len(tile.detail_tris)), "it refers to missing triangles", place
    )
    vert_end = mesh["vert_base"].astype(np.int64) + mesh["vert_count"]
    reader.require(vert_end <= len(tile.detail_verts), "it refers to missing vertices", place)
    counts = mesh["tri_count"].astype(np.int64)
    if counts.sum() > len(tile.detail_tris):  # shared ranges would let a small file allocate much memory
        reader.fail(f"detail meshes claim {counts.sum()} triangles, but the tile has {len(tile.detail_tris)}", place)
    poly = np.repeat(np.arange(len(mesh)), counts)
    rows = np.arange(len(poly)) + (mesh["tri_base"].astype(np.int64) - (np.cumsum(counts) - counts))[poly]
    limit = tile.polys["vert_count"].astype(np.int64) + mesh["vert_count"]
    sound = (tile.detail_tris[rows, :3] < limit[poly][:, None]).all(axis=1)
    if not sound.all():
        reader.fail("a triangle refers to a missing vertex", f"{place} {int(poly[np.argmin(sound)])}")


def _decimal(value: Any) -> float:
    """Return the shortest decimal that rounds to this float32: 0.05, not 0.05000000074505806."""
    return float(str(np.float32(value)))


# The stage that makes each part of a navmesh file, in build order.
STAGE_OF_PART = {
    "settings": "settings",
    "bounds": "mesh bounds",
    "verts": "polygon mesh",
    "polys": "polygon mesh",
    "detail_meshes": "detail mesh",
    "detail_verts": "detail mesh",
    "detail_tris": "detail mesh",
    "bv_nodes": "bounding volume tree",
    "links": "links",
    "header": "tile header",
    "file": "file header",
}


@dataclass(frozen=True)
class Difference:
    """The first difference of two builds.

    Attributes
    ----------
    stage : the stage that made it
    array : name of the array or part
    index : first row or item that differs; if one array is shorter, its length
    first, second : the values there, None beyond the end
    """

    stage: str
    array: str
    index: int
    first: Any
    second: Any

    def __str__(self) -> str:
        return f"{self.stage}: {self.array}[{self.index}] is {self.first} in the first and {self.second} in the second"


def compare_navmeshes(first: NavMeshFile, second: NavMeshFile) -> Difference | None:
    """Return the first difference between two navmesh files, in the order in which a build makes their parts; None if
    the files are equal byte for byte.
    """
    theirs = _parts(second)
    for name, a in _parts(first).items():
        b = theirs[name]
        shared = min(len(a), len(b))
        rows = np.flatnonzero(_unequal(a[:shared], b[:shared]))
        if len(rows) or len(a) != len(b):
            index = int(rows[0]) if len(rows) else shared
            return Difference(STAGE_OF_PART[name], name, index, _item(a, index), _item(b, index))
    return None


def _parts(navmesh: NavMeshFile) -> dict[str, Records]:
    tile, settings = navmesh.tile, navmesh.settings
    own: dict[str, Records] = {
        "settings": np.array([] if settings is None else list(vars(settings).values()), np.float64),
        "bounds": np.concatenate(tile.bounds),
        "header": tile.header.reshape(1),
        "file": np.frombuffer(navmesh.to_bytes(), np.uint8),
    }
    return {name: own[name] if name in own else getattr(tile, name) for name in STAGE_OF_PART}


def _unequal(a: Records, b: Records) -> Records:
    """Return a mask (n,) of the rows of ``a`` that differ from the same row of ``b``. If both arrays have the same
    dtype, their rows are compared bitwise, so that NaN equals NaN; otherwise by value.
    """
    count = len(a)
    if count and a.dtype == b.dtype:
        a, b = (np.frombuffer(rows.tobytes(), np.uint8).reshape(count, -1) for rows in (a, b))
    different: Records = (a != b).any(axis=tuple(range(1, a.ndim)))
    return different


def _item(array: Records, index: int) -> Any:
    return array[index].tolist() if index < len(array) else None
