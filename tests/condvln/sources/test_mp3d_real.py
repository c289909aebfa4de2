"""The real scans of Matterport3D: every measured fact that their files can tell again."""

from __future__ import annotations

from collections import Counter
from pathlib import Path

import numpy as np
import pytest
import shapely

from condvln.scene import Scene
from condvln.scene.boxes import box_corners
from condvln.scene.tables import scene_from_tables, scene_tables
from condvln.sources.house_file import HouseFile
from condvln.sources.mp3d import Mp3dSource
from condvln.sources.registry import open_source
from schemas.errors import FormatError


@pytest.fixture(scope="module")
def real(real_data: Path) -> Mp3dSource:
    source = open_source("mp3d", real_data / "mp3d")
    assert isinstance(source, Mp3dSource)
    return source


@pytest.fixture(scope="module")
def house(real: Mp3dSource) -> HouseFile:
    return real.house("YmJkqBEsHnH")


@pytest.fixture(scope="module")
def scene(real: Mp3dSource) -> Scene:
    return real.read("YmJkqBEsHnH")


def test_the_defective_scan_is_the_only_fault(real: Mp3dSource) -> None:
    assert [h.scene_id for h in real.handles()] == ["YmJkqBEsHnH", "gZ6f7yhEvPG"]
    with pytest.raises(FormatError, match=r"the first line is 'ASCII 1\.', not 'ASCII 1\.1'"):
        real.read("gZ6f7yhEvPG")


def test_the_scan_is_read_whole(scene: Scene, house: HouseFile) -> None:
    assert (len(scene.rooms), len(scene.objects), len(house.panoramas), len(house.categories)) == (4, 109, 11, 1659)
    assert Counter(o.geometry for o in scene.objects) == {"obb": 109}
    assert [(w.code, w.where) for w in scene.warnings] == [
        ("unlabelled_object", "unknown_64"),
    ]
    left = scene.object_of["unknown_64"].size
    assert left is not None
    np.testing.assert_allclose(left, [17.6, 3.0, 5.8], atol=0.06)


def test_region_outlines_are_counter_clockwise_and_have_their_areas(scene: Scene, house: HouseFile) -> None:
    assert all(shapely.LinearRing(r.corners).is_ccw for r in house.regions)
    areas = [round(shapely.Polygon(r.polygon).area, 2) for r in scene.rooms]
    assert areas == pytest.approx([84.97, 21.36, 15.12, 1.12], abs=0.02)


def test_panoramas_stand_in_their_own_region(house: HouseFile, real_data: Path) -> None:
    for panorama in house.panoramas:
        region = house.regions[panorama.region]
        assert shapely.Polygon(region.corners).contains(shapely.Point(panorama.position[:2]))
    listed = real_data / "mp3d/YmJkqBEsHnH/house_segmentations/panorama_to_region.txt"
    lines = [line.split() for line in listed.read_text().splitlines()]
    assert [(p.name, p.region) for p in house.panoramas] == [(name, int(region)) for _, name, region, _ in lines]


def test_boxes_have_half_lengths_along_unit_axes_in_descending_order(house: HouseFile, real_data: Path) -> None:
    upright = Counter(int(np.argmax(np.abs(o.axes[2]))) for o in house.objects)
    assert upright == {0: 46, 1: 41, 2: 22}
    for item in house.objects:
        np.testing.assert_allclose(item.axes.T @ item.axes, np.eye(3), atol=1e-4)
        assert (np.diff(item.half_lengths) <= 1e-6).all()
    # The union of an object's segments against the box, in the world: as large, not half or double.
    segments: dict[int, list[np.ndarray]] = {}
    file = real_data / "mp3d/YmJkqBEsHnH/house_segmentations/YmJkqBEsHnH.house"
    for line in file.read_text().splitlines():
        if line.startswith("E "):
            words = line.split()
            segments.setdefault(int(words[2]), []).append(np.array(words[8:14], dtype=float).reshape(2, 3))
    ratios = []
    for item in house.objects:
        union = np.array(segments[item.index])
        extent = union[:, 1].max(axis=0) - union[:, 0].min(axis=0)
        ratios.append(extent / (2 * np.abs(item.axes) @ item.half_lengths))
    median = np.median(ratios, axis=0)
    assert ((median > 0.9) & (median < 1.01)).all()
    assert median[2] == pytest.approx(1.0, abs=0.001)


def test_rows_agree_with_the_oriented_boxes_and_survive_their_tables(scene: Scene) -> None:
    for item in scene.objects:
        assert item.obb is not None
        assert item.aabb is not None
        corners = box_corners(item.obb)
        np.testing.assert_allclose([corners.min(0), corners.max(0)], item.aabb, atol=0.003)
    tables = scene_tables(scene)
    again = scene_tables(scene_from_tables(tables, scene.root, family="mp3d"))
    assert all(again[name].equals(tables[name]) for name in tables)
