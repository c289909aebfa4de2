"""Stage 6: partition the surface into regions along the watersheds of the distance field (first half of
``rcBuildRegions``).

The level sinks from the highest distance by one cell (two half cells) at a time. At each level the existing regions
grow into newly uncovered spans, and spans that they don't reach within a few steps are flooded as new regions.
"""

from __future__ import annotations

import numpy as np

from condvln.compiled import compiled, inlined
from condvln.navigation.recast.compact import CompactHeightfield
from condvln.navigation.recast.geometry import Array
from schemas.errors import FormatError

__all__ = ["watershed"]

# Spans are sorted into this many levels at a time; a level is two half cells of distance.
LEVELS_AT_ONCE = 8
LEVEL_SHIFT = 1
# Steps that a region grows at each level, and at the end.
EXPAND_STEPS = 8
FINAL_EXPAND_STEPS = 64
LAST_LEVEL = 0
# As a count of spans in hand.
NO_SPANS = 0
# Recast marks the borders of tiles with this bit of a region's id.
REGION_LIMIT = 0x8000
UNREACHED = 0xFFFF


def watershed(field: CompactHeightfield, area: Array, distance: Array, highest: int) -> tuple[Array, int]:
    """Partition the walkable spans into regions.

    Parameters
    ----------
    area : (s,) uint8, after erosion
    distance : (s,) int32, half cells
    highest : the highest level, at which the watershed starts

    Returns
    -------
    region : (s,) int32, 0 for none
    count : ids in use are 1..count

    Raises
    ------
    FormatError
        There are more regions than Recast can number.
    """
    region, count = _watershed(field.neighbour, area, distance, highest)
    if count >= REGION_LIMIT:
        raise FormatError(
            f"the walkable surface falls into more than {REGION_LIMIT - 1:,} regions",
            place="watershed",
            remedy="Use a larger cell_size or cut the mesh into parts",
        )
    return region, count


@compiled
def _watershed(neighbour: Array, area: Array, distance: Array, highest: int) -> tuple[Array, int]:
    spans = len(area)
    region = np.zeros(spans, np.int32)
    reach = np.zeros(spans, np.int32)
    sorted_spans = np.empty(spans, np.int32)
    bucket = np.zeros(LEVELS_AT_ONCE + 1, np.int64)
    work = np.empty(spans, np.int32)
    stack = np.empty(spans, np.int32)
    dirty = np.empty((spans, 3), np.int32)
    count = 0
    held = NO_SPANS
    next_id = 1
    level = (highest + 1) & ~1
    turn = -1
    while level > 0:
        level = max(level - 2, 0)
        turn = (turn + 1) % LEVELS_AT_ONCE
        if turn == 0:
            _sort_by_level(level, area, region, distance, sorted_spans, bucket)
            held = NO_SPANS
        # Spans left over from the previous level come after those of this level.
        begin, end = bucket[turn], bucket[turn + 1]
        kept = 0
        for j in range(held):
            if region[work[j]] == 0:
                work[kept] = work[j]
                kept += 1
        for j in range(kept - 1, -1, -1):
            work[j + end - begin] = work[j]
        for j in range(end - begin):
            work[j] = sorted_spans[begin + j]
        held = _expand(EXPAND_STEPS, level, neighbour, area, region, reach, work, kept + end - begin, dirty)
        for j in range(held):
            i = work[j]
            if region[i] == 0 and _flood(i, level, next_id, neighbour, area, distance, region, reach, stack):
                count = next_id
                next_id += 1
                if next_id > REGION_LIMIT:
                    return region, count
    held = NO_SPANS
    for i in range(spans):
        if region[i] == 0 and area[i] != 0:
            work[held] = i
            held += 1
    _expand(FINAL_EXPAND_STEPS, LAST_LEVEL, neighbour, area, region, reach, work, held, dirty)
    return region, count


@inlined
def _sort_by_level(level: int, area: Array, region: Array, distance: Array, spans: Array, bucket: Array) -> None:
    """Write the free spans of the next levels to ``spans``, sorted by level. The spans of the k-th of these levels are
    ``spans[bucket[k]:bucket[k + 1]]``, in ascending order.
    """
    top = level >> LEVEL_SHIFT
    bucket[:] = 0
    for i in range(len(area)):
        if area[i] != 0 and region[i] == 0:
            k = max(top - (distance[i] >> LEVEL_SHIFT), 0)
            if k < LEVELS_AT_ONCE:
                bucket[k + 1] += 1
    for k in range(LEVELS_AT_ONCE):
        bucket[k + 1] += bucket[k]
    place = bucket.copy()
    for i in range(len(area)):
        if area[i] != 0 and region[i] == 0:
            k = max(top - (distance[i] >> LEVEL_SHIFT), 0)
            if k < LEVELS_AT_ONCE:
                spans[place[k]] = i
                place[k] += 1


@compiled
def _expand(
    steps: int,
    level: int,
    neighbour: Array,
    area: Array,
    region: Array,
    reach: Array,
    work: Array,
    held: int,
    dirty: Array,
) -> int:
    """Grow regions into the first ``held`` spans of ``work``, one ring per step. Return the number of spans that are
    still free; these are then listed first in ``work``.

    A span joins the neighbour that is nearest to its region's seed. At level 0 growth continues until nothing changes.
    """
    kept = 0
    for j in range(held):
        if region[work[j]] == 0:
            work[kept] = work[j]
            kept += 1
    held = kept
    step = 0
    while held > 0:
        changed = 0
        kept = 0
        for j in range(held):
            i = work[j]
            best = 0
            nearest = UNREACHED
            for direction in range(4):
                k = neighbour[i, direction]
                if k >= 0 and area[k] == area[i] and region[k] > 0 and reach[k] + 2 < nearest:
                    best = region[k]
                    nearest = reach[k] + 2
            if best != 0:
                dirty[changed, 0], dirty[changed, 1], dirty[changed, 2] = i, best, nearest
                changed += 1
            else:
                work[kept] = i
                kept += 1
        held = kept
        for j in range(changed):
            region[dirty[j, 0]] = dirty[j, 1]
            reach[dirty[j, 0]] = dirty[j, 2]
        if changed == 0:
            break
        if level > 0:
            step += 1
            if step >= steps:
                break
    return held


@inlined
def _flood(
    seed: int,
    level: int,
    new_id: int,
    neighbour: Array,
    area: Array,
    distance: Array,
    region: Array,
    reach: Array,
    stack: Array,
) -> bool:
    """Assign the basin around ``seed`` to the region ``new_id``. The basin extends one level (two half cells) below
    ``level``; spans of the basin that are adjacent to other regions are left free. Return whether the new region has
    any span.
    """
    floor = max(level - 2, 0)
    region[seed] = new_id
    reach[seed] = 0
    stack[0] = seed
    height = 1
    filled = 0
    while height > 0:
        height -= 1
        i = stack[height]
        if _touches_other(i, new_id, neighbour, area, region):
            region[i] = 0
            continue
        filled += 1
        for direction in range(4):
            j = neighbour[i, direction]
            if j >= 0 and area[j] == area[i] and distance[j] >= floor and region[j] == 0:
                region[j] = new_id
                reach[j] = 0
                stack[height] = j
                height += 1
    return filled > 0


@inlined
def _touches_other(i: int, own: int, neighbour: Array, area: Array, region: Array) -> bool:
    """Return whether one of the eight neighbours of span ``i`` is in another region."""
    for direction in range(4):
        j = neighbour[i, direction]
        if j < 0 or area[j] != area[i]:
            continue
        if region[j] != 0 and region[j] != own:
            return True
        k = neighbour[j, (direction + 1) & 3]
        if k >= 0 and area[k] == area[i] and region[k] != 0 and region[k] != own:
            return True
    return False
