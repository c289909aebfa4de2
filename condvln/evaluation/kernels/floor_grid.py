"""Kernels of an agent's own map: record what one camera view shows of the floor, find cheapest paths, test straight
lines.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from condvln.compiled import compiled, register_warm_up

__all__ = ["chart", "line_is_open", "open_areas", "ways"]

Bools = npt.NDArray[np.bool_]
F64 = npt.NDArray[np.float64]
F32 = npt.NDArray[np.float32]
I16 = npt.NDArray[np.int16]
I32 = npt.NDArray[np.int32]
I64 = npt.NDArray[np.int64]


@compiled
def chart(
    depth: F32,
    regions: I16,
    columns: F64,
    rows: F64,
    place: F64,
    heading: float,
    eye: float,
    cell: float,
    climb: float,
    high: float,
    height: float,
    reach: float,
    hit: Bools,
    tall: Bools,
    clear: Bools,
    near: F32,
    region: I16,
) -> None:
    """Record in the grid what one camera view shows: cells with obstacles, and cells whose floor is open.

    Parameters
    ----------
    depth (h, w) : metres along the optical axis, 0 where nothing is seen; the camera is level
    regions (h, w) : room number of each pixel's point, -1 if unknown
    columns (w,), rows (h,) : see `condvln.sensors.camera.pixel_rays`
    place (2,) : x and z of the agent in metres; `eye` : height in metres of the eye above the feet
    climb, height : points between these heights in metres above the feet are obstacles; above `high` they are tall
    hit, tall, clear, near, region (n, n) : outputs; the grid's middle is the origin, rows along x
    """
    h, w = depth.shape
    n = hit.shape[0]
    half = n // 2
    blind = eye / -rows[h - 1]
    s, c = np.sin(heading), np.cos(heading)
    for j in range(w):
        slant = np.sqrt(1.0 + columns[j] * columns[j])
        dx = (-s + c * columns[j]) / slant
        dz = (-c - s * columns[j]) / slant
        wall, far = np.inf, 0.0
        for i in range(h):
            d = depth[i, j]
            if d <= 0.0:
                continue
            ground = d * slant
            if ground > reach:
                continue
            up = eye + rows[i] * d
            if up >= height:
                continue
            a = int(np.floor((place[0] + dx * ground) / cell)) + half
            b = int(np.floor((place[1] + dz * ground) / cell)) + half
            if a < 0 or b < 0 or a >= n or b >= n:
                continue
            if up > climb or up < -climb:
                hit[a, b] = True
                if up > high:
                    tall[a, b] = True
                wall = min(wall, ground)
            else:
                far = max(far, ground)
                clear[a, b] = True
                if regions[i, j] >= 0:
                    region[a, b] = regions[i, j]
                near[a, b] = min(near[a, b], ground)
        # The camera does not see the floor around the agent's feet; it is assumed open up to the next obstacle.
        stop = min(wall - cell, max(far, blind))
        walked = 0.0
        while walked <= stop:
            a = int(np.floor((place[0] + dx * walked) / cell)) + half
            b = int(np.floor((place[1] + dz * walked) / cell)) + half
            if a < 0 or b < 0 or a >= n or b >= n:
                break
            clear[a, b] = True
            near[a, b] = min(near[a, b], walked)
            walked += cell / 2


@compiled
def ways(cost: F32, start: int) -> tuple[F32, I32]:
    """Return the least costs from the cell `start` to all cells of a grid, by Dijkstra's algorithm. Each cell has eight
    neighbours.

    Parameters
    ----------
    cost (n, m) : cost of walking the width of a cell in it; infinite if it can't be entered
    start : flat index; it may be left even if its own cost is infinite

    Returns
    -------
    (n·m,) costs in cells, infinite if there is no path; (n·m,) flat index of the previous cell, -1 at the start
    """
    n, m = cost.shape
    distance = np.full(n * m, np.inf, np.float32)
    before = np.full(n * m, -1, np.int32)
    heap_key = np.empty(8 * n * m + 8, np.float32)
    heap_cell = np.empty(8 * n * m + 8, np.int32)
    size = 1
    heap_key[0] = 0.0
    heap_cell[0] = start
    distance[start] = 0.0
    while size > 0:
        key, here = heap_key[0], heap_cell[0]
        size -= 1
        last_key, last_cell = heap_key[size], heap_cell[size]
        hole = 0
        while True:
            child = 2 * hole + 1
            if child >= size:
                break
            if child + 1 < size and heap_key[child + 1] < heap_key[child]:
                child += 1
            if heap_key[child] >= last_key:
                break
            heap_key[hole] = heap_key[child]
            heap_cell[hole] = heap_cell[child]
            hole = child
        heap_key[hole] = last_key
        heap_cell[hole] = last_cell
        if key > distance[here]:
            continue
        a, b = here // m, here % m
        for da in range(-1, 2):
            for db in range(-1, 2):
                p, q = a + da, b + db
                if (da == 0 and db == 0) or p < 0 or q < 0 or p >= n or q >= m or not np.isfinite(cost[p, q]):
                    continue
                if da != 0 and db != 0 and here != start:
                    # Diagonal steps do not cut corners.
                    if not (np.isfinite(cost[a, q]) and np.isfinite(cost[p, b])):
                        continue
                    step = np.float32(1.41421356) * cost[p, q]
                elif da != 0 and db != 0:
                    step = np.float32(1.41421356) * cost[p, q]
                else:
                    step = cost[p, q]
                there = p * m + q
                if distance[here] + step < distance[there]:
                    distance[there] = distance[here] + step
                    before[there] = here
                    hole = size
                    size += 1
                    while hole > 0:
                        parent = (hole - 1) // 2
                        if heap_key[parent] <= distance[there]:
                            break
                        heap_key[hole] = heap_key[parent]
                        heap_cell[hole] = heap_cell[parent]
                        hole = parent
                    heap_key[hole] = distance[there]
                    heap_cell[hole] = there
    return distance, before


@compiled
def line_is_open(shut: Bools, a: float, b: float, p: float, q: float, ignored: float) -> bool:
    """Return whether the straight line from (a, b) to (p, q), in cell coordinates, meets no cell of the mask `shut`.
    The last `ignored` cells of the line are not tested.
    """
    length = np.sqrt((p - a) * (p - a) + (q - b) * (q - b))
    steps = int(np.ceil(2 * (length - ignored)))
    for k in range(steps + 1):
        t = min(0.5 * k, max(length - ignored, 0.0)) / max(length, 1e-9)
        i, j = int(np.floor(a + t * (p - a))), int(np.floor(b + t * (q - b)))
        if i < 0 or j < 0 or i >= shut.shape[0] or j >= shut.shape[1] or shut[i, j]:
            return False
    return True


@compiled
def open_areas(wanted: Bools, shut: Bools, rows: I64, columns: I64, radius: int, rays: int) -> F64:
    """Return for each of k cells the area, in cells, of the cells in the mask `wanted` that straight lines from the
    cell reach: up to `radius` cells long, in `rays` directions, as far as the first cell of the mask `shut`.
    """
    found = np.zeros(len(rows))
    for k in range(len(rows)):
        for ray in range(rays):
            angle = 2 * np.pi * ray / rays
            da, db = np.cos(angle), np.sin(angle)
            for away in range(1, radius + 1):
                i, j = int(np.floor(rows[k] + 0.5 + da * away)), int(np.floor(columns[k] + 0.5 + db * away))
                if i < 0 or j < 0 or i >= shut.shape[0] or j >= shut.shape[1] or shut[i, j]:
                    break
                if wanted[i, j]:
                    found[k] += 2 * np.pi * away / rays
    return found


def _warm_up() -> None:
    grid, rays, place = np.zeros((8, 8), bool), np.array([0.5, -0.5]), np.zeros(2)
    flat, near, region = np.ones((2, 2), np.float32), np.ones((8, 8), np.float32), np.zeros((8, 8), np.int16)
    rooms = flat.astype(np.int16)
    chart(
        flat,
        rooms,
        -rays,
        rays,
        place,
        0.0,
        1.25,
        0.1,
        0.2,
        1.0,
        1.5,
        5.0,
        grid,
        grid.copy(),
        grid.copy(),
        near,
        region,
    )
    ways(np.ones((8, 8), np.float32), 0)
    line_is_open(grid, 0.0, 0.0, 3.0, 3.0, 0.0)
    open_areas(grid, grid, np.zeros(1, np.int64), np.zeros(1, np.int64), 1, 8)


register_warm_up("an agent's map", _warm_up)
