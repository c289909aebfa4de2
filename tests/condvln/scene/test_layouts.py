"""Stagings of one layout are known by their names, and nothing else is taken for one."""

from __future__ import annotations

import pytest

from condvln.scene.scene import layout_of


@pytest.mark.parametrize(
    ("scene_id", "layout"),
    [
        ("v3_sc0_staging_00", "v3_sc0"),
        ("FloorPlan_Train12_5", "FloorPlan_Train12"),
        ("FloorPlan_Val1_2_physics", "FloorPlan_Val1"),
        ("apt_0", ""),
        ("FloorPlan201", ""),
        ("17DRP5sb8fy", ""),
        ("my_v3_sc0_staging_00", ""),
        ("v3_sc0_staging_00_b", ""),
        ("", ""),
    ],
)
def test_names(scene_id: str, layout: str) -> None:
    assert layout_of(scene_id) == layout
