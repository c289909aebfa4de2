from __future__ import annotations

import subprocess
import sys

PROGRAM = """
import numpy as np
from condvln.navigation.recast import build_navmesh
from condvln.navigation.recast.builder import _warm_up
from condvln.compiled import compilation_reported_to

_warm_up()
with compilation_reported_to(print):
    corners = np.array([[0, 0, 0], [0, 0, 6], [6, 0, 6], [6, 0, 0]], np.float32)
    quad = np.array([[0, 1, 2], [0, 2, 3]], np.int32)
    build_navmesh(corners, quad)
    build_navmesh(corners.astype(np.float64).tolist(), quad.astype(np.uint8), profile="habitat<=0.3.3")
    corners.flags.writeable = quad.flags.writeable = False
    build_navmesh(corners, quad)
    build_navmesh(np.asfortranarray(corners), np.asfortranarray(quad))
    wavy = np.random.default_rng(1).uniform(0, [6, 0.4, 6], (300, 3)).astype(np.float32)
    faces = np.arange(300).reshape(100, 3)
    build_navmesh(np.concatenate([corners, wavy]), np.concatenate([quad, faces + 4]))
"""


def test_after_the_warm_up_nothing_is_left_to_compile() -> None:
    """In a process of its own: other tests have compiled for whatever types they met."""
    done = subprocess.run([sys.executable, "-c", PROGRAM], capture_output=True, text=True, check=True)
    assert done.stdout == ""
