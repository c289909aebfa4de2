"""Made ProcTHOR houses have every property that was measured on real ones."""

from __future__ import annotations

import gzip
import json
from typing import Any

import numpy as np
import pytest
import shapely

from condvln.samples import Layout, make_layouts
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


def _lower(wall: House) -> np.ndarray:
    """First two corners after a stable sort by height, as Unity takes them."""
    first, second = sorted(wall["polygon"], key=lambda corner: corner["y"])[:2]
    return np.array([(c["x"], c["z"]) for c in (first, second)])


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
