from __future__ import annotations

import numpy as np
import pytest

from condvln.navigation.navmesh_file import compare_navmeshes
from condvln.navigation.recast import RecastProfile, build_navmesh
from condvln.navigation.settings import NavMeshSettings


@pytest.fixture(scope="module")
def low_door(join, plate, box) -> tuple[np.ndarray, np.ndarray]:
    """A room under a slab that leaves exactly as many voxels as the agent is high: 8 of 0.2 m above a floor voxel."""
    return join(plate(0, 0, 4, 4), box([1.5, 1.8, -0.1], [2.5, 2.4, 4.1]))


def test_the_profiles_part_where_the_clearance_is_just_the_height(low_door) -> None:
    ours, others = (
        build_navmesh(*low_door, NavMeshSettings(), profile)
        for profile in (RecastProfile.HABITAT_0_3_4, RecastProfile.HABITAT_0_3_3)
    )
    found = compare_navmeshes(ours, others)
    assert found is not None
    assert found.stage == "polygon mesh"


def test_files_tell_the_stage(low_door, join, box) -> None:
    first = build_navmesh(*low_door)
    assert compare_navmeshes(first, build_navmesh(*low_door)) is None
    radius = compare_navmeshes(first, build_navmesh(*low_door, NavMeshSettings(agent_radius=0.2)))
    assert radius.stage == "settings"
    pillar = compare_navmeshes(first, build_navmesh(*join(low_door, box([1, 0, 1], [1.2, 1.5, 1.2]))))
    assert (pillar.stage, pillar.array) == ("polygon mesh", "verts")
    assert pillar.first != pillar.second
