"""Meshes made for the tests: plates and boxes with closed-form floors."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
import numpy.typing as npt
import pytest

Mesh = tuple[npt.NDArray[np.float32], npt.NDArray[np.int32]]
Join = Callable[..., Mesh]
Plate = Callable[..., Mesh]
Box = Callable[[Sequence[float], Sequence[float]], Mesh]


@pytest.fixture(scope="session")
def join() -> Join:
    """Several meshes as one, in the order given."""

    def joined(*meshes: Mesh) -> Mesh:
        first = np.cumsum([0] + [len(v) for v, _ in meshes])
        vertices = np.concatenate([v for v, _ in meshes])
        faces = np.concatenate([f + k for (_, f), k in zip(meshes, first[:-1], strict=True)])
        return vertices.astype(np.float32), faces.astype(np.int32)

    return joined


@pytest.fixture(scope="session")
def plate() -> Plate:
    """A level rectangle that faces up, from (x0, z0) to (x1, z1) at height y."""

    def made(x0: float, z0: float, x1: float, z1: float, y: float = 0.0) -> Mesh:
        corners = [[x0, y, z0], [x0, y, z1], [x1, y, z1], [x1, y, z0]]
        return np.array(corners, np.float32), np.array([[0, 1, 2], [0, 2, 3]], np.int32)

    return made


@pytest.fixture(scope="session")
def box() -> Box:
    """A closed box between two corners, faces outward."""

    def made(low: Sequence[float], high: Sequence[float]) -> Mesh:
        corner = [[(low, high)[i >> k & 1][k] for k in range(3)] for i in range(8)]
        quads = [(0, 4, 6, 2), (1, 3, 7, 5), (0, 1, 5, 4), (2, 6, 7, 3), (0, 2, 3, 1), (4, 5, 7, 6)]
        faces = [triangle for a, b, c, d in quads for triangle in ((a, b, c), (a, c, d))]
        return np.array(corner, np.float32), np.array(faces, np.int32)

    return made
