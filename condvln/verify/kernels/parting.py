"""How far the paths of an episode's leaves go together, and places along the first of them, for many episodes."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from condvln.compiled import compiled, register_warm_up

__all__ = ["places_along", "shared_lengths"]

F64 = NDArray[np.float64]
I64 = NDArray[np.int64]


@compiled
def _place(corners: F64, walked: F64, first: int, last: int, metres: float) -> tuple[float, float, float]:
    """Return the position after `metres` on the path whose corners are those from `first` up to `last`."""
    at = first
    while at < last and walked[at + 1] <= metres:
        at += 1
    x, y, z = corners[at, 0], corners[at, 1], corners[at, 2]
    if at == last or walked[at] >= metres:
        return x, y, z
    side, beyond = walked[at + 1] - walked[at], metres - walked[at]
    return (
        (corners[at + 1, 0] - x) / side * beyond + x,
        (corners[at + 1, 1] - y) / side * beyond + y,
        (corners[at + 1, 2] - z) / side * beyond + z,
    )


@compiled
def shared_lengths(corners: F64, path_ends: I64, row_ends: I64, samples: float, stray: float) -> tuple[F64, F64]:
    """Return for each of r rows the metres (r,) that its paths have in common, and the metres (n,) walked from the
    start of each path to each of its corners.

    corners (n, 3), path_ends (p,) : of all paths, concatenated; row_ends (r,) : end index of each row's paths
    samples : metres between the places that are compared; stray : metres by which paths that go together are apart
    """
    walked = np.zeros(len(corners))
    for path in range(len(path_ends)):
        for at in range((path_ends[path - 1] if path else 0) + 1, path_ends[path]):
            x, y = corners[at, 0] - corners[at - 1, 0], corners[at, 1] - corners[at - 1, 1]
            z = corners[at, 2] - corners[at - 1, 2]
            walked[at] = walked[at - 1] + math.sqrt(x * x + y * y + z * z)
    lengths = np.empty(len(row_ends))
    for row in range(len(row_ends)):
        begin, end = row_ends[row - 1] if row else 0, row_ends[row]
        shortest = np.inf
        for path in range(begin, end):
            shortest = min(shortest, walked[path_ends[path] - 1])
        places = np.empty((end - begin, 3))
        number, together, metres = 0, 0.0, 0.0
        while True:
            parted = False
            for path in range(begin, end):
                first = path_ends[path - 1] if path else 0
                place = _place(corners, walked, first, path_ends[path] - 1, metres)
                places[path - begin, 0], places[path - begin, 1], places[path - begin, 2] = place
                for other in range(path - begin):
                    x, y = places[other, 0] - place[0], places[other, 1] - place[1]
                    z = places[other, 2] - place[2]
                    parted = parted or math.sqrt(x * x + y * y + z * z) > stray
            if parted:
                break
            together = metres
            if not metres < shortest:
                break
            number += 1
            metres = min(number * samples, shortest)
        lengths[row] = together
    return lengths, walked


@compiled
def places_along(corners: F64, walked: F64, firsts: I64, lasts: I64, lengths: F64, parts: I64) -> F64:
    """Return places on k paths, concatenated: the ends of as many equal parts of each path's first metres as `parts`
    (k,) says.

    firsts, lasts (k,) : the first and the last corner of each path; lengths (k,) : metres of it that are divided
    """
    places = np.empty((np.sum(parts) + len(parts), 3))
    at = 0
    for path in range(len(parts)):
        for part in range(parts[path] + 1):
            metres = lengths[path] if part == parts[path] else part * (lengths[path] / parts[path])
            place = _place(corners, walked, firsts[path], lasts[path], metres)
            places[at, 0], places[at, 1], places[at, 2] = place
            at += 1
    return places


def _warm_up() -> None:
    one, corners = np.ones(1, np.int64), np.zeros((1, 3))
    lengths, walked = shared_lengths(corners, one, one, 1.0, 1.0)
    places_along(corners, walked, one - 1, one - 1, lengths, one)


register_warm_up("paths that part", _warm_up)
