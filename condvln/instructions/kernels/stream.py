"""Random choices from a stream of uniforms, exactly as ``condvln.seeding.Draws`` makes them.

A stream is an array of uniforms that is read from its end, and `left`: how many of them are still unread, whether more
were asked for than there are, and how many were unread when the last piece of work ended. A kernel whose stream ended
must be called again with a longer one, since from then on it read zeros; it does its last piece of work again.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from condvln.compiled import compiled

__all__ = ["cumulative", "index", "uniform"]

Doubles = npt.NDArray[np.float64]
Longs = npt.NDArray[np.int64]


@compiled
def uniform(stream: Doubles, left: Longs) -> float:
    """Return the next uniform in [0, 1); 0 if none is left."""
    unread, value = left[0], 0.0
    if unread == 0:
        left[1] = 1
    else:
        value = stream[unread - 1]
        left[0] = unread - 1
    return value


@compiled
def index(n: int, stream: Doubles, left: Longs) -> int:
    """Return a random index below `n`."""
    return int(uniform(stream, left) * n)


@compiled
def cumulative(sums: Doubles, begin: int, end: int, stream: Doubles, left: Longs) -> int:
    """Return a random index from `begin` to `end` - 1, with probabilities in proportion to weights. ``sums[begin:end]``
    are the running sums of the weights.
    """
    sought = uniform(stream, left) * sums[end - 1]
    low, high = begin, end
    while low < high:
        middle = (low + high) // 2
        if sought < sums[middle]:
            high = middle
        else:
            low = middle + 1
    return min(low, end - 1)
