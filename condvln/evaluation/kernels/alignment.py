"""Dynamic time warping between two paths, and the distances from a reference to a path."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from condvln.compiled import compiled, inlined, register_warm_up

__all__ = ["coverage_distances", "dtw", "dtw_of_costs", "fast_dtw"]

Points = npt.NDArray[np.float64]
Ints = npt.NDArray[np.int64]


@compiled
def _gap(first: Points, i: int, second: Points, j: int) -> float:
    dx = first[i, 0] - second[j, 0]
    dy = first[i, 1] - second[j, 1]
    dz = first[i, 2] - second[j, 2]
    return float(np.sqrt(dx * dx + dy * dy + dz * dz))


@compiled
def dtw(path: Points, reference: Points) -> float:
    """Return the least sum of Euclidean distances over all monotone alignments. Only two rows of the table are kept in
    memory.
    """
    n, m = path.shape[0], reference.shape[0]
    row = np.full(m + 1, np.inf)
    row[0] = 0.0
    for i in range(n):
        diagonal = row[0]
        row[0] = np.inf
        for j in range(m):
            least = min(diagonal, row[j], row[j + 1])
            diagonal = row[j + 1]
            row[j + 1] = least + _gap(path, i, reference, j)
    return float(row[m])


@compiled
def dtw_of_costs(costs: Points) -> float:
    """Return the same sum as :func:`dtw`, computed from given distances (n, m) between the points, such as distances on
    a graph.
    """
    n, m = costs.shape
    row = np.full(m + 1, np.inf)
    row[0] = 0.0
    for i in range(n):
        diagonal = row[0]
        row[0] = np.inf
        for j in range(m):
            least = min(diagonal, row[j], row[j + 1])
            diagonal = row[j + 1]
            row[j + 1] = least + costs[i, j]
    return float(row[m])


@compiled
def coverage_distances(path: Points, reference: Points) -> Points:
    """Return the Euclidean distance (m,) from each reference point to the nearest point of the path."""
    nearest = np.empty(reference.shape[0])
    for j in range(reference.shape[0]):
        least = np.inf
        for i in range(path.shape[0]):
            gap = _gap(path, i, reference, j)
            if gap < least:
                least = gap
        nearest[j] = least
    return nearest


@compiled
def _halved(points: Points) -> Points:
    half = np.empty((points.shape[0] // 2, 3))
    for i in range(half.shape[0]):
        for k in range(3):
            half[i, k] = (points[2 * i, k] + points[2 * i + 1, k]) / 2
    return half


# Steps of an alignment, in the order in which ties are resolved.
_FROM_PATH, _FROM_REFERENCE, _FROM_BOTH = 0, 1, 2


@inlined
def _windowed(path: Points, reference: Points, low: Ints, high: Ints) -> tuple[float, Ints]:
    """Return the DTW distance and the alignment, as (k, 2) pairs. In row i of the table, which belongs to point i of
    the path, only the columns ``low[i] <= j < high[i]`` are used.
    """
    n = path.shape[0]
    starts = np.zeros(n + 1, np.int64)
    for i in range(n):
        starts[i + 1] = starts[i] + (high[i] - low[i])
    sums = np.empty(starts[n])
    moves = np.empty(starts[n], np.uint8)
    for i in range(n):
        for j in range(low[i], high[i]):
            gap = _gap(path, i, reference, j)
            at = starts[i] + j - low[i]
            above = aside = both = np.inf
            if i == 0 and j == 0:
                both = 0.0
            if i > 0 and low[i - 1] <= j < high[i - 1]:
                above = sums[starts[i - 1] + j - low[i - 1]]
            if j > low[i]:
                aside = sums[at - 1]
            if i > 0 and j > 0 and low[i - 1] <= j - 1 < high[i - 1]:
                both = sums[starts[i - 1] + j - 1 - low[i - 1]]
            least, move = above + gap, _FROM_PATH
            if aside + gap < least:
                least, move = aside + gap, _FROM_REFERENCE
            if both + gap < least:
                least, move = both + gap, _FROM_BOTH
            sums[at] = least
            moves[at] = move
    i, j = n - 1, reference.shape[0] - 1
    pairs = np.empty((n + reference.shape[0], 2), np.int64)
    count = 0
    total = sums[starts[i] + j - low[i]]
    while True:
        pairs[count, 0] = i
        pairs[count, 1] = j
        count += 1
        if i == 0 and j == 0:
            break
        move = moves[starts[i] + j - low[i]]
        if move != _FROM_REFERENCE:
            i -= 1
        if move != _FROM_PATH:
            j -= 1
    return total, pairs[:count]


@inlined
def _everything(n: int, m: int) -> tuple[Ints, Ints]:
    return np.zeros(n, np.int64), np.full(n, m, np.int64)


@inlined
def _around(pairs: Ints, n: int, m: int, radius: int) -> tuple[Ints, Ints]:
    """Return, for each row of an (n, m) table, the range of columns near an alignment: the first column, and the column
    after the last. Near means within ``radius`` cells of ``pairs``, the alignment in a table of half the size.
    """
    low = np.full(n, m, np.int64)
    high = np.zeros(n, np.int64)
    for k in range(pairs.shape[0]):
        first = max(0, 2 * (pairs[k, 1] - radius))
        last = min(m, 2 * (pairs[k, 1] + radius) + 2)
        for i in range(max(0, 2 * (pairs[k, 0] - radius)), min(n, 2 * (pairs[k, 0] + radius) + 2)):
            low[i] = min(low[i], first)
            high[i] = max(high[i], last)
    return low, high


@compiled
def fast_dtw(path: Points, reference: Points, radius: int) -> float:
    """Return the approximate DTW of Salvador and Chan (2007), as the package ``fastdtw`` computes it.

    At each level the table is restricted to cells within ``radius`` of the alignment at half the resolution. VLN-CE
    uses radius 1.
    """
    levels = 0
    n, m = path.shape[0], reference.shape[0]
    while n >= radius + 2 and m >= radius + 2:
        n //= 2
        m //= 2
        levels += 1
    total = np.inf
    pairs = np.empty((0, 2), np.int64)
    for level in range(levels, -1, -1):
        first, second = path, reference
        for _ in range(level):
            first, second = _halved(first), _halved(second)
        if level == levels:
            low, high = _everything(first.shape[0], second.shape[0])
        else:
            low, high = _around(pairs, first.shape[0], second.shape[0], radius)
        total, pairs = _windowed(first, second, low, high)
    return total


def _warm_up() -> None:
    points = np.zeros((4, 3))
    dtw(points, points)
    dtw_of_costs(np.zeros((2, 2)))
    coverage_distances(points, points)
    fast_dtw(points, points, 1)


register_warm_up("alignment", _warm_up)
