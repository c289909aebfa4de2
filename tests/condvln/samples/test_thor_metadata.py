"""Made controller metadata has every property that was measured on real floor plans."""

from __future__ import annotations

import io
import json
from typing import Any

import numpy as np
import pytest
import shapely

from condvln.samples import Layout, make_layouts
from condvln.samples.floor_mesh import free_floor
from condvln.samples.thor_metadata import ROBOTHOR_SCENES, ithor_files, robothor_files
from schemas.errors import UsageError

Scene = dict[str, Any]


@pytest.fixture(scope="module")
def layouts() -> dict[str, Layout]:
    return make_layouts(7, 8)


def _scenes(files: dict[str, bytes]) -> dict[str, Scene]:
    return {name[:-5]: json.loads(content) for name, content in files.items() if name.endswith(".json")}


def _reachable(files: dict[str, bytes], name: str) -> np.ndarray:
    return np.load(io.BytesIO(files[f"{name}-reachable.npy"]))


def _box(item: Scene) -> np.ndarray:
    """[min, max] in the layout's frame."""
    center, size = (
        np.array([item["axisAlignedBoundingBox"][key][axis] for axis in "xyz"]) for key in ("center", "size")
    )
    center = center * [1, 1, -1]
    return np.stack([center - size / 2, center + size / 2])


@pytest.fixture(scope="module")
def ithor(layouts: dict[str, Layout]) -> dict[str, bytes]:
    return dict(ithor_files(layouts))


@pytest.fixture(scope="module")
def robothor(layouts: dict[str, Layout]) -> dict[str, bytes]:
    return dict(robothor_files(layouts))


@pytest.mark.parametrize("family", ["ithor", "robothor"])
def test_reachable_positions_are_grid_points_clear_of_everything(
    family: str, request: pytest.FixtureRequest, layouts: dict[str, Layout]
) -> None:
    files = request.getfixturevalue(family)
    for name, scene in _scenes(files).items():
        points = _reachable(files, name)
        assert points.dtype == np.float64
        assert len(points) > 5
        np.testing.assert_array_equal(points, np.round(points / 0.25) * 0.25)
        for item in scene["objects"]:
            low, high = _box(item)
            if item["objectType"] != "Floor" and low[1] < 1.5 and high[1] > 0.05:
                inside = (points[:, 0] > low[0]) & (points[:, 0] < high[0])
                inside &= (-points[:, 1] > low[2]) & (-points[:, 1] < high[2])
                assert not inside.any(), item["objectId"]


def test_reachable_positions_of_an_apartment_are_all_that_the_floor_has(
    robothor: dict[str, bytes], layouts: dict[str, Layout]
) -> None:
    for name, layout in zip(_scenes(robothor), layouts.values(), strict=True):
        floor = max(shapely.get_parts(free_floor(layout, 0.2)), key=lambda part: part.area)
        points = _reachable(robothor, name)
        assert shapely.covers(floor, shapely.points(points * [1, -1])).all()
        assert len(points) * 0.25**2 == pytest.approx(floor.area, rel=0.25)


def test_more_scenes_than_there_are_numbers_are_refused(layouts: dict[str, Layout]) -> None:
    one = next(iter(layouts.values()))
    with pytest.raises(UsageError, match="75 scenes"):
        list(robothor_files({str(i): one for i in range(len(ROBOTHOR_SCENES) + 1)}))
    kitchen = next(layout for layout in layouts.values() if any(room.label == "kitchen" for room in layout.rooms))
    with pytest.raises(UsageError, match="fewer scenes"):
        list(ithor_files({str(i): kitchen for i in range(31)}))
