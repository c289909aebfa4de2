"""Rooms from region annotations."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from condvln.formats.json_document import parse_json
from condvln.scene import Room, SceneObject
from condvln.sources.regions import NEAREST_REGION, RegionIndex, in_rooms, read_regions
from schemas.errors import FormatError


def region(name: str, low: tuple[float, float], high: tuple[float, float], **more: Any) -> dict[str, Any]:
    (x0, z0), (x1, z1) = low, high
    return {"name": name, "label": "kitchen", "poly_loop": [[x0, 0, z0], [x1, 0, z0], [x1, 0, z1], [x0, 0, z1]], **more}


def rooms(*regions: dict[str, Any]) -> tuple[Room, ...]:
    document = parse_json(json.dumps({"region_annotations": regions}).encode(), "s.json")
    return read_regions(document["region_annotations"], "dataset", "replicacad")


def room_at(index: RegionIndex, x: float, y: float, z: float) -> str | None:
    room, _ = index.room_of(np.array([x, y, z]))
    return None if room is None else room.room_id


def test_habitats_own_sample(real_data: Path) -> None:
    file = real_data / "habitat_test_assets" / "semantic" / "test_regions.semantic_config.json"
    read = read_regions(parse_json(file.read_bytes(), str(file))["region_annotations"], "dataset", "replicacad")
    assert [(r.room_id, r.label, r.floor_y, r.ceiling_y, r.level) for r in read] == [
        ("test_region_negativeX", "bedroom", -2.0, 2.0, 0),
        ("test_region_positiveX", "bathroom", -2.0, 2.0, 0),
    ]
    for room, (low, high) in zip(read, (([-25, -10], [-5, 10]), ([5, -10], [25, 10])), strict=True):
        assert room.polygon.shape == (6, 2)
        assert room.polygon.min(axis=0).tolist() == low
        assert room.polygon.max(axis=0).tolist() == high
    index = RegionIndex(read)
    # Habitat's own test points: inside, outside beside, below and above.
    assert room_at(index, -15, 0, 0) == "test_region_negativeX"
    assert room_at(index, 15, 0, 0) == "test_region_positiveX"
    assert room_at(index, 0, 0, 0) is None
    assert room_at(index, -6, 0, 9) is None
    assert room_at(index, 15, 3, 0) is None
    assert room_at(index, 15, -3, 0) is None


def test_the_documentations_example_is_one(repository: Path) -> None:
    text = (repository / "docs" / "zones.md").read_text(encoding="utf-8")
    example = text.split("```json\n")[1].split("```")[0]
    read = read_regions(parse_json(example.encode(), "zones.md")["region_annotations"], "user", "replicacad")
    assert [(r.room_id, r.label, r.floor_y, r.ceiling_y, r.annotation) for r in read] == [
        ("kitchen", "kitchen", 0.0, 2.5, "user"),
        ("living_room", "living room", 0.0, 2.5, "user"),
    ]


def test_the_smaller_of_two_rooms_holds_the_point() -> None:
    index = RegionIndex(rooms(region("a hall", (0, 0), (10, 10)), region("closet", (1, 1), (3, 3))))
    assert room_at(index, 2, 1, 2) == "closet"
    assert room_at(index, 5, 1, 5) == "a hall"


def test_a_point_in_the_wall_goes_to_the_nearest_room() -> None:
    index = RegionIndex(rooms(region("west", (0, 0), (4, 4)), region("east", (4.3, 0), (8, 4))))
    assert room_at(index, 4.1, 1, 2) == "west"
    assert room_at(index, 4.2, 1, 2) == "east"
    assert room_at(index, 8 + NEAREST_REGION, 1, 2) == "east"
    assert room_at(index, 8.01 + NEAREST_REGION, 1, 2) is None
    assert room_at(index, 2, 2.5 + NEAREST_REGION, 2) == "west"
    assert room_at(index, 2, 2.51 + NEAREST_REGION, 2) is None


def test_floors_make_levels() -> None:
    heights = {"cellar": -2.8, "hall": 0, "step": 0.4, "loft": 2.9}
    read = rooms(*(region(name, (0, 0), (1, 1), floor_height=y) for name, y in heights.items()))
    assert {r.room_id: r.level for r in read} == {"cellar": 0, "hall": 1, "step": 1, "loft": 2}
    index = RegionIndex(read)
    assert room_at(index, 0.5, 3.5, 0.5) == "loft"
    assert room_at(index, 0.5, -1, 0.5) == "cellar"


@given(
    st.lists(st.tuples(st.integers(0, 8), st.integers(0, 8)), min_size=1, max_size=5, unique=True),
    st.floats(-1, 10),
    st.floats(-1, 10),
    st.randoms(),
)
def test_the_order_of_regions_never_matters(corners: list, x: float, z: float, shuffler: Any) -> None:  # type: ignore[type-arg]
    regions = [region(f"r{i}", (cx, cz), (cx + 2, cz + 2)) for i, (cx, cz) in enumerate(corners)]
    first = room_at(RegionIndex(rooms(*regions)), x, 1, z)
    shuffler.shuffle(regions)
    assert room_at(RegionIndex(rooms(*regions)), x, 1, z) == first
    inside = any(cx <= x <= cx + 2 and cz <= z <= cz + 2 for cx, cz in corners)
    assert first is not None or not inside


@pytest.mark.parametrize(
    ("regions", "message"),
    [
        ([region("a", (0, 0), (1, 1)), region("a", (2, 2), (3, 3))], "two regions are named 'a'"),
        ([region(" ", (0, 0), (1, 1))], "name is empty"),
        ([region("a", (0, 0), (0, 1))], "not simple"),
        ([{**region("a", (0, 0), (1, 1)), "poly_loop": [[0, 0, 0], [1, 0, 1]]}], "at least three"),
        (
            [{**region("a", (0, 0), (1, 1)), "poly_loop": [[0, 0, 0], [1, 0, 1], [1, 0, 0], [0, 0, 1]]}],
            "not simple",
        ),
        ([region("a", (0, 0), (1, 1), extrusion_height=0)], "must be positive"),
        ([{"name": "a", "label": "b"}], "'poly_loop' is missing"),
        ([{"name": "a", "label": 1, "poly_loop": []}], "text is expected"),
        ([7], "an object is expected"),
    ],
)
def test_what_is_refused_and_how(regions: list[Any], message: str) -> None:
    with pytest.raises(FormatError, match=message) as caught:
        rooms(*regions)
    assert caught.value.where == "s.json"
    assert caught.value.place.startswith("region_annotations[")


def test_an_object_in_no_room_says_which_room_it_counts_to_or_that_it_is_left_out() -> None:
    zones = rooms(region("west", (0, 0), (4, 4)), region("east", (4.3, 0), (8, 4)))

    def placed(x: float) -> tuple[list[str], list[str]]:
        item = SceneObject("lamp", "", "lamp", "lamp", np.array([x, 1.0, 2.0]))
        found, said = in_rooms([item], zones)
        assert all(w.where == "lamp" for w in said)
        return [o.room_id for o in found], [w.code for w in said]

    assert placed(3.9) == (["west"], [])
    assert placed(4.1) == (["west"], ["nearest_room"])
    assert placed(4.25) == (["east"], ["nearest_room"])
    assert placed(4.15) == ([], ["object_outside_rooms"]), "as near to one as to the other"
    assert placed(8.2) == (["east"], ["nearest_room"])
    assert placed(8.3) == ([], ["object_outside_rooms"])
