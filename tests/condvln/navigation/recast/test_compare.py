from __future__ import annotations

import numpy as np
import pytest

from condvln.navigation.recast import RecastProfile, build_navmesh
from condvln.navigation.recast.compare import STAGE_OF_ARRAY, compare_builds, compare_navmeshes, first_difference
from condvln.navigation.recast.stages import BuildStages, build_stages
from condvln.navigation.settings import NavMeshSettings

SETTINGS = NavMeshSettings()


@pytest.fixture(scope="module")
def low_door(join, plate, box) -> tuple[np.ndarray, np.ndarray]:
    """A room under a slab that leaves exactly as many voxels as the agent is high: 8 of 0.2 m above a floor voxel."""
    return join(plate(0, 0, 4, 4), box([1.5, 1.8, -0.1], [2.5, 2.4, 4.1]))


@pytest.fixture(scope="module")
def stages(low_door) -> BuildStages:
    return build_stages(*low_door, SETTINGS)


def test_equal_builds_have_no_difference(stages, low_door) -> None:
    assert compare_builds(stages, build_stages(*low_door, SETTINGS)) is None


def test_the_profiles_part_at_the_low_height_filter(stages, low_door) -> None:
    other = build_stages(*low_door, SETTINGS, RecastProfile.HABITAT_0_3_3)
    difference = compare_builds(stages, other)
    assert difference is not None
    assert (difference.stage, difference.array) == ("low height filter", "solid3")


@pytest.mark.parametrize("name", STAGE_OF_ARRAY)
def test_a_changed_item_is_found_at_its_stage(stages, name: str) -> None:
    arrays = stages.arrays()
    changed = {key: array.copy() for key, array in arrays.items()}
    place = len(changed[name]) // 2
    changed[name][place] = changed[name][place] == 0
    for later in list(STAGE_OF_ARRAY)[list(STAGE_OF_ARRAY).index(name) + 1 :]:
        changed[later] = changed[later][:-1]
    difference = first_difference(arrays, changed)
    assert difference is not None
    assert (difference.stage, difference.array, difference.index) == (STAGE_OF_ARRAY[name], name, place)
    assert (difference.first, difference.second) == (arrays[name][place], changed[name][place])


def test_an_array_that_ends_early_differs_at_its_end(stages) -> None:
    arrays = stages.arrays()
    difference = first_difference(arrays, {"pm_regs": arrays["pm_regs"][:-1]})
    assert difference is not None
    assert difference.index == len(arrays["pm_regs"]) - 1
    assert difference.second is None


def test_files_tell_the_stage_too(low_door, join, box) -> None:
    first = build_navmesh(*low_door)
    assert compare_navmeshes(first, build_navmesh(*low_door)) is None
    radius = compare_navmeshes(first, build_navmesh(*low_door, NavMeshSettings(agent_radius=0.2)))
    assert radius is not None
    assert radius.stage == "settings"
    pillar = compare_navmeshes(first, build_navmesh(*join(low_door, box([1, 0, 1], [1.2, 1.5, 1.2]))))
    assert pillar is not None
    assert pillar.stage == "polygon mesh"
