"""Made controller metadata has every property that was measured on real floor plans."""

from __future__ import annotations

import io
import json
from typing import Any

import numpy as np
import pytest
import shapely

from condvln.samples import Layout, make_layouts
from condvln.samples.free_floor import free_floor
from condvln.samples.native_labels import native_labels
from condvln.samples.thor_metadata import FLOOR_PLANS, ROBOTHOR_SCENES, ithor_files, robothor_files
from schemas.errors import UsageError

Scene = dict[str, Any]
STRUCTURE = ("Floor", "Wall")


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


def _seen(pieces: list[Scene]) -> list[tuple[Any, ...]]:
    return sorted((item["objectType"], *np.round(_box(item), 3).ravel()) for item in pieces)


@pytest.fixture(scope="module")
def ithor(layouts: dict[str, Layout]) -> dict[str, bytes]:
    return dict(ithor_files(layouts))


@pytest.fixture(scope="module")
def robothor(layouts: dict[str, Layout]) -> dict[str, bytes]:
    return dict(robothor_files(layouts))


def test_every_room_of_a_known_type_is_a_floor_plan_of_its_number(
    ithor: dict[str, bytes], layouts: dict[str, Layout]
) -> None:
    rooms = [(layout, room) for layout in layouts.values() for room in layout.rooms if room.label in FLOOR_PLANS]
    scenes = _scenes(ithor)
    assert len(scenes) == len(rooms)
    made = dict.fromkeys(FLOOR_PLANS, 0)
    for layout, room in rooms:
        made[room.label] += 1
        scene = scenes[f"FloorPlan{FLOOR_PLANS[room.label] + made[room.label]}"]
        things = [item for item in scene["objects"] if item["objectType"] not in STRUCTURE]
        expected = sorted(
            (native_labels()[p.label].ai2thor, *np.round(p.aabb, 3).ravel()) for p in layout.in_room(room.room_id)
        )
        assert _seen(things) == expected
        (floor,) = (item for item in scene["objects"] if item["objectType"] == "Floor")
        x0, z0, x1, z1 = room.shape.bounds
        np.testing.assert_allclose(_box(floor)[:, [0, 2]], [[x0, z0], [x1, z1]], atol=1e-9)
        assert floor["assetId"] == ""


def test_robothor_scenes_are_whole_apartments_with_their_walls(
    robothor: dict[str, bytes], layouts: dict[str, Layout]
) -> None:
    for (name, scene), layout in zip(_scenes(robothor).items(), layouts.values(), strict=True):
        assert scene["sceneName"] == name
        things = [item for item in scene["objects"] if item["objectType"] not in STRUCTURE]
        assert _seen(things) == sorted(
            (native_labels()[p.label].ai2thor, *np.round(p.aabb, 3).ravel()) for p in layout.furniture
        )
        assert any(item["objectType"] == "Wall" for item in scene["objects"])
        ids = [item["objectId"] for item in scene["objects"]]
        assert len(set(ids)) == len(ids)


def test_boxes_agree_with_their_corners_and_oriented_boxes_turn_as_the_rotation_says(
    robothor: dict[str, bytes],
) -> None:
    turned = 0
    for scene in _scenes(robothor).values():
        for item in scene["objects"]:
            corners = np.array(item["axisAlignedBoundingBox"]["cornerPoints"]) * [1, 1, -1]
            np.testing.assert_allclose([corners.min(axis=0), corners.max(axis=0)], _box(item), atol=1e-6)
            movable = item["pickupable"] or item["moveable"]
            assert (item["objectOrientedBoundingBox"] is not None) == movable
            if movable:
                oriented = np.array(item["objectOrientedBoundingBox"]["cornerPoints"])
                own = oriented * [1, 1, -1]
                np.testing.assert_allclose([own.min(axis=0), own.max(axis=0)], _box(item), atol=1e-5)
                # Undo Unity's yaw (clockwise from above in x, z): what is left is an axis-aligned box.
                turn = np.radians(item["rotation"]["y"])
                rotation = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
                flat = (oriented[:, [0, 2]] - oriented[:, [0, 2]].mean(axis=0)) @ rotation.T
                assert len(np.unique(np.round(np.abs(flat), 4), axis=0)) == 1
                turned += item["rotation"]["y"] % 90 != 0
    assert turned


def test_pivots_are_not_the_middles_of_boxes_and_parents_carry_their_children(robothor: dict[str, bytes]) -> None:
    for scene in _scenes(robothor).values():
        by_id = {item["objectId"]: item for item in scene["objects"]}
        for item in scene["objects"]:
            if item["objectType"] in STRUCTURE:
                continue
            assert item["position"]["y"] == pytest.approx(_box(item)[0, 1])
            assert item["position"]["y"] < item["axisAlignedBoundingBox"]["center"]["y"]
            for parent in item["parentReceptacles"] or ():
                assert item["objectId"] in by_id[parent]["receptacleObjectIds"]
                assert _box(by_id[parent])[1, 1] == pytest.approx(_box(item)[0, 1])


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
