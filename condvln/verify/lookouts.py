"""Places that an episode is looked around from: on the way that all its leaves have in common.

Ways are one as long as, at equal lengths walked, no two of them are more than a step apart. That is asked every
`PREFIX_SAMPLES` metres, and the agent looks around at the start and at equal distances of at most `EYE_SPACING` metres
after it.
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
"""Parts of a distance: a way of 1.5000000001 m has three of 0.5 m, or four, as the sum of its sides is rounded."""


def stands(paths: Sequence[F64]) -> list[F64]:
    """Where the agent looks around before its ways part, (n, 3), the start first.

    A way whose length is a whole number of `EYE_SPACING` but for rounding may be cut in either number of parts: two
    answers.
    """
    walked = [_walked(path) for path in paths]
    end = _shared(paths, walked)
    parts = end / EYE_SPACING
    counts = {max(1, math.ceil(parts - EVEN)), max(1, math.ceil(parts + EVEN))}
    return [_at(paths[0], walked[0], np.linspace(0.0, end, count + 1)) for count in sorted(counts)]


def shared_length(paths: Sequence[F64]) -> float:
    """Metres that ways (n, 3) from one start have in common, by the last mark at which they were one."""
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
    """Metres from the start to each corner, (n,)."""
    sides = np.zeros(len(path))
    along = path[1:] - path[:-1]
    np.sqrt(np.einsum("ij,ij->i", along, along), out=sides[1:])
    return np.cumsum(sides)


def _at(path: F64, walked: F64, metres: F64) -> F64:
    """The places (k, 3) that are so many metres along a path with lengths (n,) to its corners."""
    return np.stack([np.interp(metres, walked, path[:, axis]) for axis in range(3)], axis=1)
