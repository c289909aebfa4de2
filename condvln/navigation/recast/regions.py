"""Stage 7: drop small regions or merge them into neighbours (``mergeAndFilterRegions`` of Recast).

A region stores its neighbours in their order along its outline, with 0 for a wall. Two regions may be merged if they
share a single stretch of border and are never above each other.
"""

from __future__ import annotations

import numpy as np

from condvln.compiled import compiled, inlined
from condvln.navigation.recast.arrays import Array, grown
from condvln.navigation.recast.compact import CompactHeightfield

__all__ = ["merge_regions"]

# Recast stops tracing an outline after this many steps.
MAX_OUTLINE_STEPS = 40000


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
    size, kind, overlaps, outline, outline_start, outline_length = _survey(field.neighbour, area, region, count)
    above, above_start, above_length = _stacked(field.start, region, count, overlaps)
    new_id, kept = _merge(
        size,
        kind,
        overlaps,
        (outline, outline_start, outline_length),
        (above, above_start, above_length),
        min_area,
        merge_area,
    )
    return new_id[region], kept


def _stacked(start: Array, region: Array, count: int, overlaps: Array) -> tuple[Array, Array, Array]:
    """Return, for each region, the regions that have spans above or below the region's own spans; the region itself may
    be among them. The result is one list of regions, and the start and the length of each region's part of this list.
    Set ``overlaps`` for regions that have two spans in one column.
    """
    pairs = _column_pairs(start, region)
    pairs = np.unique(pairs[:, 0].astype(np.int64) * (count + 1) + pairs[:, 1])
    first, second = np.divmod(pairs, count + 1)
    overlaps[first[first == second]] = True
    length = np.bincount(first, minlength=count + 1).astype(np.int32)
    begin = (np.cumsum(length) - length).astype(np.int32)
    return second.astype(np.int32), begin, length


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
    return _without_repeats(out, 0, n)


@compiled
def _without_repeats(ring: Array, begin: int, length: int) -> int:
    """Remove from the ring ``ring[begin:begin + length]`` each item equal to the one after it; return the new
    length.
    """
    i = 0
    while i < length and length > 1:
        if ring[begin + i] == ring[begin + (i + 1) % length]:
            for k in range(begin + i, begin + length - 1):
                ring[k] = ring[k + 1]
            length -= 1
        else:
            i += 1
    return length


@compiled
def _holds(items: Array, begin: int, length: int, value: int) -> bool:
    return _position(items, begin, length, value) >= 0


@compiled
def _may_merge(
    a: int,
    b: int,
    ids: Array,
    kind: Array,
    ring: Array,
    ring_start: Array,
    ring_length: Array,
    above: Array,
    above_start: Array,
    above_length: Array,
) -> bool:
    if kind[a] != kind[b]:
        return False
    meetings = 0
    for k in range(ring_start[a], ring_start[a] + ring_length[a]):
        if ring[k] == ids[b]:
            meetings += 1
    return meetings <= 1 and not _holds(above, above_start[a], above_length[a], ids[b])


@inlined
def _drop_small(size: Array, ids: Array, ring: Array, ring_start: Array, ring_length: Array, min_area: int) -> None:
    """Remove connected groups of regions that together have fewer than ``min_area`` spans."""
    visited = np.zeros(len(size), np.bool_)
    group = np.empty(len(size), np.int32)
    for seed in range(1, len(size)):
        if size[seed] == 0 or visited[seed]:
            continue
        visited[seed] = True
        group[0] = seed
        members = 1
        done = 0
        total = 0
        while done < members:
            r = group[done]
            done += 1
            total += size[r]
            for k in range(ring_start[r], ring_start[r] + ring_length[r]):
                other = ring[k]
                if other != 0 and not visited[other] and ids[other] != 0:
                    visited[other] = True
                    group[members] = other
                    members += 1
        if total < min_area:
            for k in range(members):
                size[group[k]] = 0
                ids[group[k]] = 0


@compiled
def _merge(
    size: Array,
    kind: Array,
    overlaps: Array,
    rings: tuple[Array, Array, Array],
    floors: tuple[Array, Array, Array],
    min_area: int,
    merge_area: int,
) -> tuple[Array, int]:
    """Return the new id of each old region, and the number of regions."""
    ring, ring_start, ring_length = rings
    above, above_start, above_length = floors
    regions = len(size)
    ids = np.arange(regions).astype(np.int32)
    _drop_small(size, ids, ring, ring_start, ring_length, min_area)
    ring_end = len(ring)
    above_end = len(above)
    merged = True
    while merged:
        merged = False
        for r in range(1, regions):
            if ids[r] == 0 or overlaps[r] or size[r] == 0:
                continue
            if size[r] > merge_area and _holds(ring, ring_start[r], ring_length[r], 0):
                continue
            target = 0
            smallest = 0xFFFFFFF
            for k in range(ring_start[r], ring_start[r] + ring_length[r]):
                other = ring[k]
                if ids[other] == 0 or overlaps[other] or size[other] >= smallest:
                    continue
                if _may_merge(
                    r, other, ids, kind, ring, ring_start, ring_length, above, above_start, above_length
                ) and _may_merge(other, r, ids, kind, ring, ring_start, ring_length, above, above_start, above_length):
                    smallest = size[other]
                    target = ids[other]
            if target == 0 or target == ids[r]:
                continue
            cut_target = _position(ring, ring_start[target], ring_length[target], ids[r])
            cut_own = _position(ring, ring_start[r], ring_length[r], ids[target])
            if cut_target < 0 or cut_own < 0:
                continue
            # The merged outline: the target's from where they meet, then this one's.
            ring = grown(ring, ring_end + ring_length[target] + ring_length[r])
            begin = ring_end
            for k in range(ring_length[target] - 1):
                ring[ring_end] = ring[ring_start[target] + (cut_target + 1 + k) % ring_length[target]]
                ring_end += 1
            for k in range(ring_length[r] - 1):
                ring[ring_end] = ring[ring_start[r] + (cut_own + 1 + k) % ring_length[r]]
                ring_end += 1
            ring_start[target] = begin
            ring_length[target] = _without_repeats(ring, begin, ring_end - begin)
            ring_length[r] = 0
            above = grown(above, above_end + above_length[target] + above_length[r])
            begin = above_end
            for k in range(above_length[target]):
                above[above_end] = above[above_start[target] + k]
                above_end += 1
            for k in range(above_length[r]):
                if not _holds(above, begin, above_end - begin, above[above_start[r] + k]):
                    above[above_end] = above[above_start[r] + k]
                    above_end += 1
            above_start[target] = begin
            above_length[target] = above_end - begin
            size[target] += size[r]
            size[r] = 0
            old = ids[r]
            for j in range(1, regions):
                if ids[j] == 0:
                    continue
                if ids[j] == old:
                    ids[j] = target
                _rename(above, above_start[j], above_length[j], old, target)
                if _rename(ring, ring_start[j], ring_length[j], old, target):
                    ring_length[j] = _without_repeats(ring, ring_start[j], ring_length[j])
            merged = True
    return _renumbered(ids)


@compiled
def _position(items: Array, begin: int, length: int, value: int) -> int:
    for k in range(length):
        if items[begin + k] == value:
            return k
    return -1


@compiled
def _rename(items: Array, begin: int, length: int, old: int, new: int) -> bool:
    changed = False
    for k in range(begin, begin + length):
        if items[k] == old:
            items[k] = new
            changed = True
    return changed


@inlined
def _renumbered(ids: Array) -> tuple[Array, int]:
    new_id = np.zeros(len(ids), np.int32)
    fresh = np.zeros(len(ids), np.int32)
    count = 0
    for r in range(len(ids)):
        if ids[r] != 0:
            if fresh[ids[r]] == 0:
                count += 1
                fresh[ids[r]] = count
            new_id[r] = fresh[ids[r]]
    return new_id, count
