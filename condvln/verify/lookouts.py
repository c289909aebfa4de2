"""Viewpoints of an episode for observability: along the path that all its leaves share.

Paths count as shared as long as, at equal walked lengths, no two of them are more than a step apart. This is tested
every `PREFIX_SAMPLES` metres. The agent looks around at the start and then at equal distances of at most `EYE_SPACING`
metres.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import combinations
from typing import Final

import numpy as np
from numpy.typing import NDArray

from schemas.config.constants import EYE_SPACING, PREFIX_SAMPLES, PREFIX_STRAY

__all__ = ["shared_length", "stands"]

F64 = NDArray[np.float64]
EVEN: Final = 1e-6
"""Tolerance in steps: a path of 1.5000000001 m has three parts of 0.5 m or four, depending on how its length is
rounded.
"""


def stands(paths: Sequence[F64]) -> list[F64]:
    """Return the positions (n, 3), the start first, at which the agent looks around before the paths diverge.

    If the shared length is a multiple of `EYE_SPACING` up to rounding, there are two possible divisions, and both are
    returned.
    """
    walked = [_walked(path) for path in paths]
    end = _shared(paths, walked)
    parts = end / EYE_SPACING
    counts = {max(1, math.ceil(parts - EVEN)), max(1, math.ceil(parts + EVEN))}
    return [_at(paths[0], walked[0], np.linspace(0.0, end, count + 1)) for count in sorted(counts)]


def shared_length(paths: Sequence[F64]) -> float:
    """Return the length in metres of the part that all paths (n, 3) from one start have in common. This part ends at
    the last sample at which the paths agree.
    """
    return _shared(paths, [_walked(path) for path in paths])


def _shared(paths: Sequence[F64], walked: Sequence[F64]) -> float:
    shortest = min(float(lengths[-1]) for lengths in walked)
    marks = np.append(np.arange(0.0, shortest, PREFIX_SAMPLES), shortest)
    places = [_at(path, lengths, marks) for path, lengths in zip(paths, walked, strict=True)]
    apart = np.zeros(len(marks))
    for first, second in combinations(places, 2):
        away = first - second
        apart = np.maximum(apart, np.einsum("ij,ij->i", away, away))
    beyond = np.flatnonzero(np.sqrt(apart) > PREFIX_STRAY)
    together = int(beyond[0]) if len(beyond) else len(marks)
    return float(marks[max(together - 1, 0)])


def _walked(path: F64) -> F64:
    """Return the distance (n,) in metres of each corner from the start, along the path."""
    sides = np.zeros(len(path))
    along = path[1:] - path[:-1]
    np.sqrt(np.einsum("ij,ij->i", along, along), out=sides[1:])
    return np.cumsum(sides)


def _at(path: F64, walked: F64, metres: F64) -> F64:
    """Return the positions (k, 3) on a path after `metres` (k,) walked from the path's start. `walked` (n,) are the
    walked distances of the path's corners.
    """
    return np.stack([np.interp(metres, walked, path[:, axis]) for axis in range(3)], axis=1)
