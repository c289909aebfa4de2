"""One Detour tile in memory: all of its bytes as numpy arrays.

The records are those of Detour's ``DetourNavMesh.h`` (Mikko Mononen, zlib licence), little-endian and with C's natural
packing, so that :meth:`NavMeshTile.to_bytes` returns exactly the bytes that were read. Habitat builds a scene as a
single tile.

Links and disabled polygons are those that Habitat makes when it builds or loads a tile: ``dtNavMesh::connectIntLinks``
(Detour) and ``removeZeroAreaPolys`` (``PathFinder.cpp`` of habitat-sim 0.3.4). The bounding volume tree follows
``createBVTree`` of ``DetourNavMeshBuilder.cpp``.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt

__all__ = [
    "BV_NODE",
    "DETAIL_MESH",
    "DISABLED",
    "HEADER",
    "LINK",
    "MAX_VERTS_PER_POLYGON",
    "NULL_LINK",
    "OFF_MESH_CONNECTION",
    "POLYGON",
    "TILE_MAGIC",
    "TILE_PORTAL",
    "TILE_VERSION",
    "WALKABLE",
    "Floats",
    "Indices",
    "Ints",
    "NavMeshTile",
    "Records",
    "base_reference",
    "build_bv_tree",
    "disable_zero_area",
    "link_tile",
    "polygon_areas",
    "quantise_bounds",
]

Floats: TypeAlias = npt.NDArray[np.float32]
Ints: TypeAlias = npt.NDArray[np.int32]
Indices: TypeAlias = npt.NDArray[np.int64]
Records: TypeAlias = npt.NDArray[Any]

TILE_MAGIC = 0x444E4156  # 'DNAV'
TILE_VERSION = 7
MAX_VERTS_PER_POLYGON = 6
NULL_LINK = 0xFFFFFFFF
TILE_PORTAL = 0x8000  # in ``neis``: the edge leads to another tile, not to a polygon of this one
WALKABLE = 1  # polygon flags of habitat-sim
DISABLED = 4

HEADER = np.dtype(
    [
        ("magic", "<i4"),
        ("version", "<i4"),
        ("x", "<i4"),
        ("y", "<i4"),
        ("layer", "<i4"),
        ("user_id", "<u4"),
        ("poly_count", "<i4"),
        ("vert_count", "<i4"),
        ("max_link_count", "<i4"),
        ("detail_mesh_count", "<i4"),
        ("detail_vert_count", "<i4"),
        ("detail_tri_count", "<i4"),
        ("bv_node_count", "<i4"),
        ("off_mesh_con_count", "<i4"),
        ("off_mesh_base", "<i4"),
        ("walkable_height", "<f4"),
        ("walkable_radius", "<f4"),
        ("walkable_climb", "<f4"),
        ("bmin", "<f4", 3),
        ("bmax", "<f4", 3),
        ("bv_quant_factor", "<f4"),
    ]
)
POLYGON = np.dtype(
    [
        ("first_link", "<u4"),
        ("verts", "<u2", MAX_VERTS_PER_POLYGON),
        ("neis", "<u2", MAX_VERTS_PER_POLYGON),  # per edge: 0 wall, n + 1 polygon n, TILE_PORTAL | side
        ("flags", "<u2"),
        ("vert_count", "u1"),
        ("area_and_type", "u1"),  # area in the low six bits
    ]
)
LINK = np.dtype([("ref", "<u4"), ("next", "<u4"), ("edge", "u1"), ("side", "u1"), ("bmin", "u1"), ("bmax", "u1")])
DETAIL_MESH = np.dtype(
    [("vert_base", "<u4"), ("tri_base", "<u4"), ("vert_count", "u1"), ("tri_count", "u1"), ("padding", "<u2")]
)
BV_NODE = np.dtype([("bmin", "<u2", 3), ("bmax", "<u2", 3), ("i", "<i4")])
OFF_MESH_CONNECTION = np.dtype(
    [("pos", "<f4", 6), ("rad", "<f4"), ("poly", "<u2"), ("flags", "u1"), ("side", "u1"), ("user_id", "<u4")]
)


@dataclass(frozen=True, eq=False)
class NavMeshTile:
    """A tile: p polygons over v vertices, with their detail triangles. Arrays must not be modified.

    Attributes
    ----------
    header : () HEADER
    verts : (v, 3) float32, metres, Habitat frame
    polys : (p,) POLYGON
    links : (max_link_count,) LINK, kept for the file; queries follow ``neis``
    detail_meshes : (p,) DETAIL_MESH
    detail_verts : (d, 3) float32, vertices of detail meshes beyond those of their polygon
    detail_tris : (t, 4) uint8, three corners (the polygon's, then its detail vertices) and edge flags
    bv_nodes : (n,) BV_NODE, the bounding volume tree in depth-first order
    off_mesh : (o,) OFF_MESH_CONNECTION
    """

    header: Records
    verts: Floats
    polys: Records
    links: Records
    detail_meshes: Records
    detail_verts: Floats
    detail_tris: npt.NDArray[np.uint8]
    bv_nodes: Records
    off_mesh: Records

    @classmethod
    def assemble(
        cls,
        *,
        bmin: npt.ArrayLike,
        bmax: npt.ArrayLike,
        cell_size: float,
        walkable_height: float,
        walkable_radius: float,
        walkable_climb: float,
        verts: Floats,
        polys: Records,
        detail_meshes: Records,
        detail_verts: Floats,
        detail_tris: npt.NDArray[np.uint8],
        bv_nodes: Records,
    ) -> NavMeshTile:
        """Return a tile of the given arrays, without links. Its header is the one that ``dtCreateNavMeshData`` writes.

        ``link_tile`` makes the links. One link is reserved per polygon edge, as in Detour.
        """
        header = np.zeros((), HEADER)
        header["magic"], header["version"] = TILE_MAGIC, TILE_VERSION
        header["poly_count"] = header["detail_mesh_count"] = header["off_mesh_base"] = len(polys)
        header["vert_count"] = len(verts)
        header["max_link_count"] = int(polys["vert_count"].sum(dtype=np.int64))
        header["detail_vert_count"], header["detail_tri_count"] = len(detail_verts), len(detail_tris)
        header["bv_node_count"] = len(bv_nodes)
        header["walkable_height"], header["walkable_radius"] = walkable_height, walkable_radius
        header["walkable_climb"] = walkable_climb
        header["bmin"], header["bmax"] = bmin, bmax
        header["bv_quant_factor"] = np.float32(1.0) / np.float32(cell_size)
        return cls(
            header=header,
            verts=np.ascontiguousarray(verts, np.float32),
            polys=polys,
            links=np.zeros(int(header["max_link_count"]), LINK),
            detail_meshes=detail_meshes,
            detail_verts=np.ascontiguousarray(detail_verts, np.float32).reshape(-1, 3),
            detail_tris=np.ascontiguousarray(detail_tris, np.uint8).reshape(-1, 4),
            bv_nodes=bv_nodes,
            off_mesh=np.zeros(0, OFF_MESH_CONNECTION),
        )

    def to_bytes(self) -> bytes:
        """Return the tile's bytes, as in Detour's memory and in Habitat's files."""
        sections = (
            self.header,
            self.verts.astype("<f4", copy=False),
            self.polys,
            self.links,
            self.detail_meshes,
            self.detail_verts.astype("<f4", copy=False),
            self.detail_tris,
            self.bv_nodes,
            self.off_mesh,
        )
        return b"".join(section.tobytes() for section in sections)

    def with_parts(self, **parts: Records) -> NavMeshTile:
        """Return a copy with some arrays replaced."""
        return replace(self, **parts)

    @property
    def bounds(self) -> tuple[Floats, Floats]:
        """Lowest and highest corner of the tile, (3,) float32 each, in metres; the highest corner includes the agent's
        height.
        """
        return self.header["bmin"].astype(np.float32), self.header["bmax"].astype(np.float32)

    def outlines(self) -> list[npt.NDArray[Any]]:
        """Return the corners (k, 3) of each polygon, in metres."""
        return [self.verts[poly["verts"][: poly["vert_count"]]] for poly in self.polys]

    @property
    def poly_verts(self) -> Ints:
        """(p, 6) int32 vertex index of each polygon corner; 0 beyond ``vert_count``."""
        return np.where(self._corners, self.polys["verts"], 0).astype(np.int32)

    @property
    def neighbours(self) -> Ints:
        """(p, 6) int32 polygon across each edge, -1 for a wall."""
        inside = self._corners & (self.polys["neis"] != 0) & (self.polys["neis"] < TILE_PORTAL)
        return np.where(inside, self.polys["neis"].astype(np.int32) - 1, -1).astype(np.int32)

    @property
    def detail_triangles(self) -> tuple[Floats, Ints]:
        """All detail triangles in polygon order: the corners (n, 3, 3), float32, of each triangle, and the index (n,),
        int32, of the polygon to which the triangle belongs.
        """
        counts = self.detail_meshes["tri_count"].astype(np.int64)
        poly = np.repeat(np.arange(len(self.polys)), counts)
        first = np.cumsum(counts) - counts
        rows = self.detail_meshes["tri_base"].astype(np.int64)[poly] + np.arange(len(poly)) - first[poly]
        corner = self.detail_tris[rows, :3].astype(np.int64)
        own = self.polys["vert_count"].astype(np.int64)[poly][:, None]
        of_poly = np.take_along_axis(self.poly_verts[poly].astype(np.int64), np.minimum(corner, own - 1), axis=1)
        beyond = self.detail_meshes["vert_base"].astype(np.int64)[poly][:, None] + np.maximum(corner - own, 0)
        points = np.concatenate([self.verts, self.detail_verts])
        return points[np.where(corner < own, of_poly, len(self.verts) + beyond)], poly.astype(np.int32)

    @property
    def _corners(self) -> npt.NDArray[np.bool_]:
        return np.arange(MAX_VERTS_PER_POLYGON)[None, :] < self.polys["vert_count"][:, None]


def base_reference(poly_count: int) -> int:
    """Return Detour's reference of polygon 0 of a mesh with a single tile. It is also the reference of the tile (salt
    1, tile 0).

    A 32-bit reference packs salt, tile and polygon; with one tile no bit goes to the tile, and the polygon has
    ``ilog2(nextPow2(poly_count))``.
    """
    return 1 << (poly_count - 1).bit_length()


# Area in square metres below which Habitat disables a polygon, since walking into one crashes the simulator.
ZERO_AREA = np.float32(1e-5)
INTERNAL_SIDE = 0xFF


def link_tile(tile: NavMeshTile) -> NavMeshTile:
    """Return the tile with new links and with its zero-area polygons disabled, as Habitat saves tiles.

    Links are taken from the free list in polygon order, each polygon's edges last to first, and each is put at the head
    of its polygon's list; the remaining links stay in the free list.
    """
    neighbours = tile.neighbours
    edges = np.arange(neighbours.shape[1])[::-1]
    poly, column = np.nonzero(neighbours[:, ::-1] >= 0)
    used = len(poly)
    if used > len(tile.links):
        raise ValueError(f"tile has {used} inner edges but room for {len(tile.links)} links")
    links = np.zeros(len(tile.links), LINK)
    links["next"] = np.arange(1, len(links) + 1)
    if len(links):
        links["next"][-1] = NULL_LINK
    edge = edges[column]
    index = np.arange(used)
    links["ref"][:used] = base_reference(len(tile.polys)) | neighbours[poly, edge]
    links["edge"][:used] = edge
    links["side"][:used] = INTERNAL_SIDE
    same_poly = np.zeros(used, bool)
    same_poly[1:] = poly[1:] == poly[:-1]
    links["next"][:used] = np.where(same_poly, index - 1, NULL_LINK)
    polys = tile.polys.copy()
    polys["first_link"] = NULL_LINK
    polys["first_link"][poly] = index  # the last assignment wins: the head of the list
    return disable_zero_area(tile.with_parts(links=links, polys=polys))


def disable_zero_area(tile: NavMeshTile) -> NavMeshTile:
    """Return the tile with the flags of polygons below 1e-5 m² set to DISABLED."""
    empty = polygon_areas(tile) < ZERO_AREA
    if not empty.any():
        return tile
    polys: Records = tile.polys.copy()
    polys["flags"][empty] = DISABLED
    return tile.with_parts(polys=polys)


def polygon_areas(tile: NavMeshTile) -> Floats:
    """Return the areas (p,) of the polygons in square metres. Each area is summed in float32 over the polygon's detail
    triangles, in order.
    """
    corners, poly = tile.detail_triangles
    a, b = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 1]
    cross = a[:, [1, 2, 0]] * b[:, [2, 0, 1]] - a[:, [2, 0, 1]] * b[:, [1, 2, 0]]
    squares = cross * cross
    area = np.float32(0.5) * np.sqrt((squares[:, 0] + squares[:, 1]) + squares[:, 2])
    total = np.zeros(len(tile.polys), np.float32)
    np.add.at(total, poly, area)  # unbuffered: one float32 addition per triangle, in order
    return total


Cells = npt.NDArray[np.uint16]


def quantise_bounds(lower: Floats, upper: Floats, tile_min: Floats, cell_size: float) -> tuple[Cells, Cells]:
    """Return boxes in whole cells, counted from the tile's lowest corner. The numbers are truncated and clamped to 16
    bits; Detour uses the cell size in all directions.

    Parameters
    ----------
    lower, upper : (p, 3) float32, corners of each polygon's box over its detail vertices
    tile_min : (3,) float32
    cell_size : metres

    Returns
    -------
    two (p, 3) uint16
    """
    factor = np.float32(1.0) / np.float32(cell_size)
    low = np.clip(((lower - tile_min) * factor).astype(np.int32), 0, 0xFFFF).astype(np.uint16)
    high = np.clip(((upper - tile_min) * factor).astype(np.int32), 0, 0xFFFF).astype(np.uint16)
    return low, high


def build_bv_tree(lower: Cells, upper: Cells) -> Records:
    """Return the tree over p boxes, (2p,) of type BV_NODE. The last node stays blank, as in Detour.

    Nodes are in depth-first order. A leaf holds its polygon; an inner node holds the number of nodes to skip, negated.
    Each node splits its items in the middle after a stable sort by lower bound along the longest axis (ties: x before y
    before z). Detour calls ``qsort``, which glibc keeps stable; files built on another platform may order ties
    differently.

    Parameters
    ----------
    lower, upper : (p, 3) uint16, from :func:`quantise_bounds`
    """
    nodes = np.zeros(2 * len(lower), BV_NODE)
    order = np.arange(len(lower))
    if len(lower):
        _split(nodes, 0, order, 0, len(lower), lower, upper)
    return nodes


def _split(
    nodes: Records, position: int, order: npt.NDArray[np.int64], begin: int, end: int, lower: Cells, upper: Cells
) -> int:
    """Write the subtree over the boxes ``order[begin:end]`` to ``nodes``, beginning at ``position``. Return the
    position after the subtree.
    """
    items = order[begin:end]
    low, high = lower[items].min(axis=0), upper[items].max(axis=0)
    nodes["bmin"][position], nodes["bmax"][position] = low, high
    if len(items) == 1:
        nodes["i"][position] = items[0]
        return position + 1
    axis = int(np.argmax(high - low))
    order[begin:end] = items[np.argsort(lower[items, axis], kind="stable")]
    middle = begin + len(items) // 2
    after_left = _split(nodes, position + 1, order, begin, middle, lower, upper)
    after = _split(nodes, after_left, order, middle, end, lower, upper)
    nodes["i"][position] = position - after
    return after


def find_islands(tile: NavMeshTile) -> tuple[Indices, Floats]:
    """Return the connected component of each polygon (p,) and the radius of each in metres, as habitat-sim's
    ``IslandSystem`` finds them.

    Flood fill in polygon order, into walkable neighbours only; a polygon that nothing reaches is an island of its own.
    The radius is the greatest distance between a polygon corner of the island and the mean of all its polygon corners
    (with repeats, in the order of the fill), in float32.
    """
    walkable, sizes = ((tile.polys["flags"] & WALKABLE) != 0).tolist(), tile.polys["vert_count"].tolist()
    neighbours = tile.neighbours.tolist()
    verts = tile.poly_verts
    corners = [verts[poly, :size] for poly, size in enumerate(sizes)]
    island, radii = [-1] * len(sizes), list[np.float32]()
    for seed in range(len(sizes)):
        if island[seed] >= 0:
            continue
        island[seed] = len(radii)
        waiting, members = [seed], []
        while waiting:
            members.append(waiting.pop())
            for other in neighbours[members[-1]]:
                if other >= 0 and island[other] < 0 and walkable[other]:
                    island[other] = len(radii)
                    waiting.append(other)
        points = tile.verts[np.concatenate([corners[poly] for poly in members])]
        away = points - np.cumsum(points, axis=0, dtype=np.float32)[-1] / np.float32(len(points))
        squares = away * away
        radii.append(np.sqrt((squares[:, 0] + squares[:, 1]) + squares[:, 2]).max())
    return np.array(island, np.int64), np.array(radii, np.float32)
