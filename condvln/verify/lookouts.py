"""Viewpoints of an episode for observability: along the path that all its leaves share.

Paths count as shared as long as, at equal walked lengths, no two of them are more than a step apart. This is tested
every `PREFIX_SAMPLES` metres. The agent looks around at the start and then at equal distances of at most `EYE_SPACING`
metres.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from condvln.verify.geodesics import Point
from condvln.verify.kernels.parting import places_along, shared_lengths
from schemas.config.constants import EYE_SPACING, PREFIX_SAMPLES, PREFIX_STRAY

__all__ = ["stands"]

F64 = NDArray[np.float64]
EVEN: Final = 1e-6
"""Tolerance in steps: a path of 1.5000000001 m has three parts of 0.5 m or four, depending on how its length is
rounded.
"""


def stands(episodes: Sequence[Sequence[Sequence[Point]]]) -> list[list[F64]]:
    """Return for each episode, given by the paths of its leaves, the positions (n, 3), the start first, at which the
    agent looks around before the paths diverge.

    If the shared length is a multiple of `EYE_SPACING` up to rounding, there are two possible divisions, and both are
    returned.
    """
    if not episodes:
        return []
    paths = [path for episode in episodes for path in episode]
    corners = np.array([corner for path in paths for corner in path], dtype=np.float64)
    path_ends = np.cumsum([len(path) for path in paths])
    row_ends = np.cumsum([len(episode) for episode in episodes])
    lengths, walked = shared_lengths(corners, path_ends, row_ends, PREFIX_SAMPLES, PREFIX_STRAY)
    parts = lengths[:, None] / EYE_SPACING + (-EVEN, EVEN)
    counts = np.maximum(np.ceil(parts).astype(np.int64), 1)
    # The first path of each episode, divided in one or two ways.
    row, way = np.nonzero([(True, fewer != more) for fewer, more in counts.tolist()])
    first = np.concatenate([[0], row_ends[:-1]])[row]
    firsts = np.where(first > 0, path_ends[first - 1], 0)
    chosen = counts[row, way]
    places = places_along(corners, walked, firsts, path_ends[first] - 1, lengths[row], chosen)
    found: list[list[F64]] = [[] for _ in episodes]
    for number, part in zip(row.tolist(), np.split(places, np.cumsum(chosen + 1)[:-1]), strict=True):
        found[number].append(part)
    return found
