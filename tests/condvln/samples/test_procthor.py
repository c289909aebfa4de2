"""Made ProcTHOR houses have every property that was measured on real ones."""

from __future__ import annotations

import gzip
import json
from collections.abc import Iterator
from typing import Any

import networkx as nx
import numpy as np
import pytest
import shapely

from condvln.samples import Layout, make_layouts
from condvln.samples.native_labels import native_labels
from condvln.samples.procthor import procthor_files

House = dict[str, Any]


@pytest.fixture(scope="module")
def layouts() -> list[Layout]:
    return list(make_layouts(7, 5).values())


@pytest.fixture(scope="module")
def files(layouts: list[Layout]) -> dict[str, bytes]:
    return dict(procthor_files({str(i): layout for i, layout in enumerate(layouts)}))


@pytest.fixture(scope="module")
def houses(files: dict[str, bytes]) -> list[House]:
    return [json.loads(line) for line in gzip.decompress(files["houses.jsonl.gz"]).splitlines()]


@pytest.fixture(scope="module")
def assets(files: dict[str, bytes]) -> dict[str, House]:
    database = json.loads(files["asset-database.json"])
    assert all(asset["objectType"] == kind for kind, listed in database.items() for asset in listed)
    found = {asset["assetId"]: asset for listed in database.values() for asset in listed}
    assert len(found) == sum(map(len, database.values()))
    return found


def _all_objects(objects: list[House]) -> Iterator[House]:
    for item in objects:
        yield item
        yield from _all_objects(item.get("children", []))


def _outline(room: House) -> np.ndarray:
    return np.array([(corner["x"], corner["z"]) for corner in room["floorPolygon"]])


def _lower(wall: House) -> np.ndarray:
    """First two corners after a stable sort by height, as Unity takes them."""
    first, second = sorted(wall["polygon"], key=lambda corner: corner["y"])[:2]
    return np.array([(c["x"], c["z"]) for c in (first, second)])


def test_rooms_are_clockwise_and_the_house_begins_at_the_origin(houses: list[House]) -> None:
    for house in houses:
        corners = np.concatenate([_outline(room) for room in house["rooms"]])
        np.testing.assert_array_equal(corners.min(axis=0), [0, 0])
        for number, room in enumerate(house["rooms"], start=2):
            assert room["id"] == f"room|{number}"
            assert not shapely.LinearRing(_outline(room)).is_ccw


def test_boxes_from_the_database_are_those_of_the_layout(
    houses: list[House], layouts: list[Layout], assets: dict[str, House]
) -> None:
    for house, layout in zip(houses, layouts, strict=True):
        (x0, _), (_, z1) = layout.bounds
        rooms = {room["id"]: shapely.Polygon(_outline(room)) for room in house["rooms"]}
        read = set()
        for item in _all_objects(house["objects"]):
            size = np.array([assets[item["assetId"]]["boundingBox"][axis] for axis in "xyz"])
            # Unity's yaw turns clockwise: (x, z) of the asset goes to (x cos + z sin, −x sin + z cos).
            turn = np.radians(item["rotation"]["y"])
            c, s = abs(np.cos(turn)), abs(np.sin(turn))
            half = np.array([c * size[0] + s * size[2], size[1], s * size[0] + c * size[2]]) / 2
            place = np.array([item["position"][axis] for axis in "xyz"])
            center = place * [1, 1, -1] + [x0, 0, z1]
            read.add((assets[item["assetId"]]["objectType"], *np.round([center - half, center + half], 3).ravel()))
            room = rooms[f"room|{item['id'].split('|')[-2]}"]
            assert room.covers(shapely.box(*(place - half)[[0, 2]], *(place + half)[[0, 2]]))
        made = {(native_labels()[piece.label].ai2thor, *np.round(piece.aabb, 3).ravel()) for piece in layout.furniture}
        assert read == made


def test_top_level_objects_are_in_the_one_room_that_their_id_names(houses: list[House]) -> None:
    for house in houses:
        for item in house["objects"]:
            spot = shapely.Point(item["position"]["x"], item["position"]["z"])
            inside = [room["id"] for room in house["rooms"] if shapely.Polygon(_outline(room)).covers(spot)]
            assert inside == [f"room|{item['id'].split('|')[1]}"]
            assert assets_type(item) == item["id"].split("|")[0]


def assets_type(item: House) -> str:
    return item["assetId"].split("_")[0]


def test_children_stand_on_their_parents(houses: list[House], assets: dict[str, House]) -> None:
    found = 0
    for house in houses:
        for item in _all_objects(house["objects"]):
            top = item["position"]["y"] + assets[item["assetId"]]["boundingBox"]["y"] / 2
            for child in item.get("children", []):
                found += 1
                bottom = child["position"]["y"] - assets[child["assetId"]]["boundingBox"]["y"] / 2
                assert bottom == pytest.approx(top, abs=1e-6)
    assert found > 20


def test_walls_close_each_room_and_list_their_corners_as_unity_expects(houses: list[House]) -> None:
    for house in houses:
        walls = {wall["id"]: wall for wall in house["walls"]}
        assert len(walls) == len(house["walls"])
        for room in house["rooms"]:
            own = [wall for wall in house["walls"] if wall["id"].startswith(f"wall|{room['id'][5:]}|")]
            lines = [shapely.LineString(_lower(wall)) for wall in own]
            assert shapely.polygonize(lines).geoms[0].equals(shapely.Polygon(_outline(room)))
            for wall in own:
                assert [corner["y"] > 0 for corner in wall["polygon"]] == [False, False, True, True]
        for name, wall in walls.items():
            suffix = name.split("|", 2)[2]
            twins = [walls[other] for other in walls if other != name and other.split("|", 2)[2] == suffix]
            assert len(twins) == 1, "a wall has two sides"
            np.testing.assert_array_equal(_lower(wall), _lower(twins[0])[::-1])
            if name.startswith("wall|exterior"):
                assert [corner["y"] > 0 for corner in wall["polygon"]] == [True, True, False, False]
                assert wall["roomId"] == twins[0]["roomId"]


def test_doors_lie_where_the_layout_has_them(houses: list[House], layouts: list[Layout]) -> None:
    front = 0
    for house, layout in zip(houses, layouts, strict=True):
        (x0, _), (_, z1) = layout.bounds
        walls = {wall["id"]: _lower(wall) for wall in house["walls"]}
        number = {room.room_id: f"room|{i}" for i, room in enumerate(layout.rooms, start=2)}
        read = set()
        for door in house["doors"]:
            start, end = walls[door["wall0"]]
            along = (end - start) / np.linalg.norm(end - start)
            ends = [start + along * corner["x"] for corner in door["holePolygon"]]
            if door["room0"] == door["room1"]:
                front += 1
                assert door["wall1"].startswith("wall|exterior")
                assert (door["openable"], door["openness"]) == (False, 0)
                continue
            np.testing.assert_array_equal(walls[door["wall0"]], walls[door["wall1"]][::-1])
            assert door.get("openness", 1) == 1
            assert ("openness" in door) == door["assetId"].startswith("Doorway")
            ends = sorted(tuple(np.round([x + x0, z1 - z], 3).tolist()) for x, z in ends)
            read.add((frozenset((door["room0"], door["room1"])), *ends))
        made = {(frozenset(number[r] for r in d.rooms), *sorted((d.start, d.end))) for d in layout.doors}
        assert read == made
    assert front


def test_the_rooms_of_a_house_are_joined(houses: list[House]) -> None:
    for house in houses:
        graph = nx.Graph((door["room0"], door["room1"]) for door in house["doors"])
        graph.add_nodes_from(room["id"] for room in house["rooms"])
        assert nx.is_connected(graph)


def test_the_agent_starts_on_open_floor(houses: list[House], layouts: list[Layout]) -> None:
    for house, layout in zip(houses, layouts, strict=True):
        (x0, _), (_, z1) = layout.bounds
        agent = house["metadata"]["agent"]
        spot = shapely.Point(agent["position"]["x"] + x0, z1 - agent["position"]["z"])
        assert agent["position"]["y"] == 0.95
        assert all(piece.footprint.distance(spot) > 0.25 for piece in layout.furniture if piece.aabb[0, 1] < 1.5)
        assert house["metadata"]["schema"] == "1.0.0"


def test_one_house_more_changes_no_line_before_it(layouts: list[Layout], houses: list[House]) -> None:
    fewer = dict(procthor_files({str(i): layout for i, layout in enumerate(layouts[:3])}))
    lines = gzip.decompress(fewer["houses.jsonl.gz"]).splitlines()
    assert [json.loads(line) for line in lines] == houses[:3]


def test_the_older_schema_says_the_same_in_its_own_way(
    layouts: list[Layout], houses: list[House], assets: dict[str, House]
) -> None:
    files = dict(procthor_files({str(i): layout for i, layout in enumerate(layouts)}, schema="0.0.1"))
    older = [json.loads(line) for line in gzip.decompress(files["houses.jsonl.gz"]).splitlines()]
    for old, new in zip(older, houses, strict=True):
        assert "schema" not in old["metadata"]
        assert old["objects"] == new["objects"]
        assert [wall["polygon"] for wall in old["walls"]] == [wall["polygon"] for wall in new["walls"]]
        assert {type(room["floorMaterial"]) for room in old["rooms"]} == {str}
        for one, other in zip(old["doors"], new["doors"], strict=True):
            box, width = one["boundingBox"], assets[one["assetId"]]["boundingBox"]["x"]
            assert [box["min"], box["max"]] == other["holePolygon"]
            # The upgrade of ProcTHOR's own tools: corner, offset and half the asset give its middle.
            assert box["min"]["x"] + one["assetOffset"]["x"] + width / 2 == pytest.approx(other["assetPosition"]["x"])
