"""The bounding volume tree of a tile's polygons, after ``createBVTree`` of Detour's ``DetourNavMeshBuilder.cpp``."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from condvln.navigation.tile import BV_NODE, Floats, Records

__all__ = ["build_bv_tree", "quantise_bounds"]

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
