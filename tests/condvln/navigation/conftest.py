"""Navmeshes for the tests of navigation: small ones with closed forms, and the real ones."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from condvln.navigation.pathfinder import Pathfinder
from condvln.navigation.polygon_tile import tile_of_polygons

# Two rooms of an L: 4 x 2 m along x and, beyond z = 2, 2 x 2 m. The reflex corner is at (2, 2). Area 12 m².
L_VERTICES = [[0, 0, 0], [4, 0, 0], [4, 0, 2], [2, 0, 2], [0, 0, 2], [2, 0, 4], [0, 0, 4]]
L_POLYGONS = [[0, 1, 2, 3, 4], [4, 3, 5, 6]]


@pytest.fixture(scope="session")
def l_shape() -> Pathfinder:
    """The L-shaped floor."""
    return Pathfinder.from_tile(tile_of_polygons(L_VERTICES, L_POLYGONS))


@pytest.fixture(scope="session")
def two_islands() -> Pathfinder:
    """Two floors with nothing between them: 1 x 1 m at the origin and 3 x 1 m from x = 4, one metre higher."""
    vertices = [[0, 0, 0], [1, 0, 0], [1, 0, 1], [0, 0, 1], [4, 1, 0], [7, 1, 0], [7, 1, 1], [4, 1, 1]]
    return Pathfinder.from_tile(tile_of_polygons(vertices, [[0, 1, 2, 3], [4, 5, 6, 7]]))


@pytest.fixture(scope="session")
def home(real_data: Path) -> Pathfinder:
    """A real home of four islands over several heights."""
    return Pathfinder.load(real_data / "hm3d" / "TEEsavR23oF.basis.navmesh")


@pytest.fixture(scope="session")
def home_points(home: Pathfinder) -> np.ndarray:
    """300 points on the floor of ``home``."""
    return home.get_random_navigable_points(300, 7)
