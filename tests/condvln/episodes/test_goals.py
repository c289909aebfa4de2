"""Goal points are spread out among those on the same side of walls."""

from __future__ import annotations

from typing import cast

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from condvln.episodes.footprint import Footprint
from condvln.episodes.goals import _farthest, _spread
from condvln.navigation.protocol import PathfinderProtocol


class Ways:
    """A pathfinder that knows the geodesic distance to each point by the point's height."""

    def __init__(self) -> None:
        self.asked = 0

    def geodesic_distances(self, start: np.ndarray, ends: np.ndarray) -> np.ndarray:
        self.asked += len(ends)
        return 1e3 * ends[:, 1]


@given(st.integers(1, 40), st.integers(1, 9), st.floats(0.0, 1.0), st.integers(0, 2**32))
def test_few_geodesics_decide_as_all_of_them(n: int, count: int, share: float, seed: int) -> None:
    rng = np.random.default_rng(seed)
    points = rng.random((n, 3)) * [3.0, 1e-3, 3.0]
    points[0, 1] = 0.0
    limit = 1e3 * float(np.quantile(points[:, 1], share))
    box = Footprint(np.array([1.5, 1.5]), np.array([0.2, 0.4]), np.eye(2))
    pathfinder = Ways()
    found = _spread(points, box, count, cast("PathfinderProtocol", pathfinder), limit)
    reached = points[1e3 * points[:, 1] <= limit]
    chosen = reached[_farthest(reached, count, np.zeros(len(reached), bool))]
    assert np.array_equal(found, chosen[np.argsort(box.distance(chosen), kind="stable")])
    assert len(found) <= pathfinder.asked <= n
