"""What holds of every made apartment, over random seeds."""

from __future__ import annotations

from collections import Counter, defaultdict
from itertools import combinations

import networkx as nx
import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st

from condvln.samples import Layout, make_layout, make_layouts
from condvln.samples.catalogue import catalogue
from condvln.samples.floor_mesh import free_floor
from condvln.samples.furnishing import MAX_OBJECTS, MIN_OBJECTS
from condvln.samples.layout import WALL_THICKNESS
from schemas.errors import UsageError


def no_two_boxes_overlap(layout: Layout) -> None:
    low = np.array([piece.aabb[0] for piece in layout.furniture])
    high = np.array([piece.aabb[1] for piece in layout.furniture])
    for i, j in combinations(range(len(low)), 2):
        common = np.minimum(high[i], high[j]) - np.maximum(low[i], low[j])
        assert (common <= 1e-9).any(), (layout.furniture[i], layout.furniture[j])


def each_piece_stands_inside_its_room_and_within_its_height(layout: Layout) -> None:
    for piece in layout.furniture:
        inside = layout.room_of[piece.room_id].shape.buffer(-WALL_THICKNESS / 2 + 1e-9, join_style="mitre")
        (x0, y0, z0), (x1, y1, z1) = piece.aabb
        assert inside.covers(shapely.box(x0, z0, x1, z1)), piece
        assert 0 <= y0 < y1 <= layout.ceiling, piece


def small_things_lie_on_what_carries_them(layout: Layout) -> None:
    for piece in layout.furniture:
        if piece.parent is not None:
            parent = layout.furniture_of[piece.parent]
            assert parent.room_id == piece.room_id
            assert piece.aabb[0, 1] == parent.aabb[1, 1]
            assert shapely.box(*parent.aabb[:, [0, 2]].ravel()).covers(shapely.box(*piece.aabb[:, [0, 2]].ravel()))
        else:
            hang = catalogue()[piece.kind].hang
            assert piece.aabb[0, 1] == 0 if hang is None else piece.aabb[0, 1] >= hang / 1000


def rooms_tile_the_plan_and_doors_join_them_all(layout: Layout) -> None:
    shapes = [room.shape for room in layout.rooms]
    (x0, z0), (x1, z1) = layout.bounds
    assert sum(shape.area for shape in shapes) == pytest.approx(shapely.union_all(shapes).area)
    assert shapely.union_all(shapes).area == pytest.approx((x1 - x0) * (z1 - z0))
    graph = nx.Graph()
    graph.add_nodes_from(room.room_id for room in layout.rooms)
    for door in layout.doors:
        assert door.width >= 0.9
        opening = shapely.LineString([door.start, door.end])
        shared = layout.room_of[door.rooms[0]].shape.intersection(layout.room_of[door.rooms[1]].shape)
        assert shared.buffer(1e-9).covers(opening), door
        graph.add_edge(*door.rooms)
    assert nx.is_connected(graph)


def nobody_walks_through_a_bathroom(layout: Layout) -> None:
    for room in layout.rooms:
        if room.label in ("bathroom", "laundry room", "office"):
            assert sum(room.room_id in door.rooms for door in layout.doors) == 1


def the_free_floor_is_one_part_that_reaches_every_doorway_and_room(layout: Layout) -> None:
    floor = free_floor(layout)
    assert isinstance(floor, shapely.Polygon)
    assert floor.is_valid
    for door in layout.doors:
        assert floor.covers(shapely.Point(door.center)), door
    for room in layout.rooms:
        # The middle of a room may lie under its table; free floor is never far from it.
        assert floor.distance(room.shape.centroid) < 1.5
        assert floor.intersection(room.shape).area > 0.25 * room.area, room
    for piece in layout.furniture:
        if piece.parent is None and piece.aabb[0, 1] < 1.5 and piece.size[1] > 0.05:
            assert floor.distance(piece.footprint) >= 0.1 - 0.0015, piece


def every_coordinate_lies_on_the_millimetre_grid(layout: Layout) -> None:
    numbers = [c for room in layout.rooms for c in np.ravel(room.polygon)]
    numbers += [c for piece in layout.furniture for c in (*piece.center, *piece.aabb.ravel())]
    millimetres = np.array(numbers) * 1000
    assert np.abs(millimetres - np.round(millimetres)).max() < 1e-6


def rooms_hold_five_to_twelve_objects_with_unique_ids(layout: Layout) -> None:
    assert all(MIN_OBJECTS <= len(layout.in_room(room.room_id)) <= MAX_OBJECTS for room in layout.rooms)
    assert len(layout.furniture_of) == len(layout.furniture)
    assert len(layout.room_of) == len(layout.rooms)
    assert sum(len(layout.in_room(room.room_id)) for room in layout.rooms) == len(layout.furniture)


PROPERTIES = (
    no_two_boxes_overlap,
    each_piece_stands_inside_its_room_and_within_its_height,
    small_things_lie_on_what_carries_them,
    rooms_tile_the_plan_and_doors_join_them_all,
    nobody_walks_through_a_bathroom,
    the_free_floor_is_one_part_that_reaches_every_doorway_and_room,
    every_coordinate_lies_on_the_millimetre_grid,
    rooms_hold_five_to_twelve_objects_with_unique_ids,
)


@pytest.mark.rounds(12)
@given(st.integers(0, 2**63 - 1), st.none() | st.integers(2, 8))
@settings(max_examples=25)
def test_every_property_holds_of_every_apartment(seed: int, n_rooms: int | None) -> None:
    layout = make_layout(seed, n_rooms)
    assert n_rooms is None or len(layout.rooms) == n_rooms
    for holds in PROPERTIES:
        holds(layout)


@pytest.mark.parametrize("n_rooms", [-1, 0, 1, 9])
def test_other_numbers_of_rooms_are_refused(n_rooms: int) -> None:
    with pytest.raises(UsageError, match="2 to 8"):
        make_layout(0, n_rooms)


@pytest.fixture(scope="module")
def many() -> list[Layout]:
    return list(make_layouts(70, seed=3).values())


def test_seven_scenes_have_all_sizes(many: list[Layout]) -> None:
    for start in range(0, 70, 7):
        assert sorted(len(layout.rooms) for layout in many[start : start + 7]) == list(range(2, 9))


def test_presence_of_labels_tells_scenes_apart(many: list[Layout]) -> None:
    """Conditions of presence need labels that are there in some rooms of a type and not in others."""
    present: dict[str, Counter[str]] = defaultdict(Counter)
    rooms: Counter[str] = Counter()
    for layout in many:
        for room in layout.rooms:
            rooms[room.label] += 1
            present[room.label].update({piece.label for piece in layout.in_room(room.room_id)})
    for label, count in rooms.items():
        open_question = [name for name, times in present[label].items() if 0.05 <= times / count <= 0.95]
        assert len(open_question) >= 10, (label, open_question)
    assert len({name for names in present.values() for name in names}) >= 60


def test_repeated_labels_and_room_types_call_for_qualifiers(many: list[Layout]) -> None:
    rooms = [[piece.label for piece in layout.in_room(room.room_id)] for layout in many for room in layout.rooms]
    assert sum(len(set(labels)) < len(labels) for labels in rooms) > 0.45 * len(rooms)
    # … while most objects can be named by their label alone.
    alone = sum(times == 1 for labels in rooms for times in Counter(labels).values())
    assert alone > 0.6 * sum(map(len, rooms))
    assert sum(len({room.label for room in layout.rooms}) < len(layout.rooms) for layout in many) > 0.2 * len(many)
    assert any(len(room.polygon) == 6 for layout in many for room in layout.rooms)
    assert any(not piece.yaw.square for layout in many for piece in layout.furniture)
