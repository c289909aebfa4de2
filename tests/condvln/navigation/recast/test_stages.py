"""The stages of a build against the reference dump of one: every array of every stage."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from condvln.navigation.recast.builder import build_stages
from condvln.navigation.recast.geometry import Array
from condvln.navigation.settings import NavMeshSettings
from tests.condvln.navigation.recast.dumps import arrays_of

SETTINGS = NavMeshSettings()


@pytest.fixture(scope="module")
def dump(real_data: Path) -> dict[str, Array]:
    with np.load(real_data / "navmesh_golden" / "build" / "apt1.stages.npz") as stages:
        return dict(stages)


@pytest.fixture(scope="module")
def mesh(real_data: Path) -> dict[str, Array]:
    with np.load(real_data / "navmesh_golden" / "build" / "apt1.npz") as arrays:
        return dict(arrays)


def test_the_stages_of_one_build_are_those_of_the_dump(dump: dict[str, Array], mesh: dict[str, Array]) -> None:
    """In their order, so that the first that differs names the stage at fault."""
    arrays = arrays_of(build_stages(mesh["vertices"], mesh["faces"], SETTINGS))
    assert set(dump) - {"meta"} == set(arrays) - {"tile"}
    del arrays["tile"]
    for name, array in arrays.items():
        np.testing.assert_array_equal(array, dump[name], err_msg=name)
