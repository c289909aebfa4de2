"""Stage 7: drop small regions or merge them into neighbours (``mergeAndFilterRegions`` of Recast).

A region stores its neighbours in their order along its outline, with 0 for a wall. Two regions may be merged if they
share a single stretch of border and are never above each other.
"""

from __future__ import annotations

import numpy as np

from condvln.compiled import compiled, inlined
from condvln.navigation.recast.compact import CompactHeightfield
from condvln.navigation.recast.geometry import Array, grown

__all__ = ["merge_regions"]

# Recast stops tracing an outline after this many steps.
MAX_OUTLINE_STEPS = 40000

MOST_CELLS = 0xFFFFFFF
"""A size that no region reaches."""


def merge_regions(
    field: CompactHeightfield, area: Array, region: Array, count: int, min_area: int, merge_area: int
) -> tuple[Array, int]:
    """Drop or merge small regions. Return the remaining regions, renumbered 1..n in the order of their first
    appearance.

    Parameters
    ----------
    region : (s,) int32 with ids 1..``count``, 0 for none
    min_area : cells; connected regions that together have fewer are dropped
    merge_area : cells; regions of at most this size, and those without a wall, are merged into their smallest
        compatible neighbour

    Returns
    -------
    region : (s,) int32
    count : n
    """
    size, kind, overlaps, outline, begin, length = _survey(field.neighbour, area, region, count)
    above = _stacked(field.start, region, count, overlaps)
    rings = [
        _without_repeats(outline[a : a + n].tolist()) for a, n in zip(begin.tolist(), length.tolist(), strict=True)
    ]
    ids = _merged(size.tolist(), kind.tolist(), overlaps.tolist(), rings, above, min_area, merge_area)
    fresh = {0: 0}
    new_id = np.array([fresh.setdefault(old, len(fresh)) for old in ids], np.int32)
    return new_id[region], len(fresh) - 1


def _stacked(start: Array, region: Array, count: int, overlaps: Array) -> list[set[int]]:
    """Return the regions that share a column with each region, and mark those that lie above themselves."""
    pairs = _column_pairs(start, region)
    pairs = np.unique(pairs[:, 0].astype(np.int64) * (count + 1) + pairs[:, 1])
    first, second = np.divmod(pairs, count + 1)
    overlaps[first[first == second]] = True
    above: list[set[int]] = [set() for _ in range(count + 1)]
    for one, other in zip(first.tolist(), second.tolist(), strict=True):
        above[one].add(other)
    return above


@compiled
def _column_pairs(start: Array, region: Array) -> Array:
    """Return the ordered pairs (n, 2) int32 of regions that have spans in the same column."""
    needed = 0
    for column in range(len(start) - 1):
        layers = start[column + 1] - start[column]
        needed += layers * (layers - 1)
    pairs = np.empty((needed, 2), np.int32)
    n = 0
    for column in range(len(start) - 1):
        for i in range(start[column], start[column + 1]):
            for j in range(start[column], start[column + 1]):
                if i != j and region[i] != 0 and region[j] != 0:
                    pairs[n, 0] = region[i]
                    pairs[n, 1] = region[j]
                    n += 1
    return pairs[:n]


@compiled
def _survey(
    neighbour: Array, area: Array, region: Array, count: int
) -> tuple[Array, Array, Array, Array, Array, Array]:
    """Return six arrays: each region's size, each region's area id, an all-False array for ``overlaps``, the neighbours
    along each region's first outline as one list, and the start and the length of each region's part of this list.
    """
    size = np.zeros(count + 1, np.int32)
    kind = np.zeros(count + 1, np.uint8)
    overlaps = np.zeros(count + 1, np.bool_)
    begin = np.zeros(count + 1, np.int32)
    length = np.zeros(count + 1, np.int32)
    outline = np.empty(1024, np.int32)
    used = 0
    for i in range(len(region)):
        r = region[i]
        if r == 0:
            continue
        size[r] += 1
        if length[r] > 0:
            continue
        kind[r] = area[i]
        for direction in range(4):
            j = neighbour[i, direction]
            if (region[j] if j >= 0 else 0) != r:
                outline = grown(outline, used + MAX_OUTLINE_STEPS)
                begin[r] = used
                length[r] = _walk_outline(i, direction, neighbour, region, outline[used:])
                used += length[r]
                break
    return size, kind, overlaps, outline[:used], begin, length


@inlined
def _walk_outline(span: int, direction: int, neighbour: Array, region: Array, out: Array) -> int:
    """Write to ``out`` the adjacent regions along the outline that contains the edge of ``span`` in ``direction``;
    return their number. A region is written wherever it differs from the region written before.
    """
    first_span = span
    first_direction = direction
    j = neighbour[span, direction]
    beside = region[j] if j >= 0 else 0
    out[0] = beside
    n = 1
    for _ in range(1, MAX_OUTLINE_STEPS):
        j = neighbour[span, direction]
        other = region[j] if j >= 0 else 0
        if other != region[span]:
            if other != beside:
                beside = other
                out[n] = beside
                n += 1
            direction = (direction + 1) & 3
        else:
            span = j
            direction = (direction + 3) & 3
        if span == first_span and direction == first_direction:
            break
    return n


def _without_repeats(ring: list[int]) -> list[int]:
    """Take from a ring each number that the next one repeats, in place, and return it."""
    i = 0
    while i < len(ring) and len(ring) > 1:
        if ring[i] == ring[(i + 1) % len(ring)]:
            del ring[i]
        else:
            i += 1
    return ring


def _drop_small(size: list[int], ids: list[int], rings: list[list[int]], min_area: int) -> None:
    """Drop groups of connected regions that are smaller than `min_area` together."""
    visited: set[int] = {0}
    for seed in range(1, len(size)):
        if size[seed] == 0 or seed in visited:
            continue
        visited.add(seed)
        group = [seed]
        for r in group:  # grows meanwhile
            fresh = [other for other in dict.fromkeys(rings[r]) if other not in visited and ids[other] != 0]
            visited.update(fresh)
            group += fresh
        if sum(size[r] for r in group) < min_area:
            for r in group:
                size[r] = ids[r] = 0


def _merged(
    size: list[int],
    kind: list[int],
    overlaps: list[bool],
    rings: list[list[int]],
    above: list[set[int]],
    min_area: int,
    merge_area: int,
) -> list[int]:
    """Return the region that each region belongs to after merging; 0 for those that are dropped."""
    ids = list(range(len(size)))
    _drop_small(size, ids, rings, min_area)

    def may_merge(a: int, b: int) -> bool:
        return kind[a] == kind[b] and rings[a].count(ids[b]) <= 1 and ids[b] not in above[a]

    merged = True
    while merged:
        merged = False
        for r in range(1, len(size)):
            if ids[r] == 0 or overlaps[r] or size[r] == 0 or (size[r] > merge_area and 0 in rings[r]):
                continue
            target, smallest = 0, MOST_CELLS
            for other in rings[r]:
                if ids[other] == 0 or overlaps[other] or size[other] >= smallest:
                    continue
                if may_merge(r, other) and may_merge(other, r):
                    target, smallest = ids[other], size[other]
            old = ids[r]
            if target in (0, old) or old not in rings[target] or ids[target] not in rings[r]:
                continue
            theirs, own = rings[target].index(old), rings[r].index(ids[target])
            ring = rings[target][theirs + 1 :] + rings[target][:theirs] + rings[r][own + 1 :] + rings[r][:own]
            rings[target], rings[r] = _without_repeats(ring), []
            above[target] |= above[r]
            size[target] += size[r]
            size[r] = 0
            for j in range(1, len(size)):
                if ids[j] == 0:
                    continue
                if ids[j] == old:
                    ids[j] = target
                if old in above[j]:
                    above[j] = above[j] - {old} | {target}
                if old in rings[j]:
                    rings[j] = _without_repeats([target if other == old else other for other in rings[j]])
            merged = True
    return ids
