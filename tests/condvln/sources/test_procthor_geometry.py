"""Houses as triangles: by hand, against their made layouts, and walked through with Habitat's builder."""

from __future__ import annotations

import gzip
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import shapely
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from condvln.navigation.occluders import MeshOccluders
from condvln.navigation.pathfinder import Pathfinder
from condvln.scene import Room, Scene
from condvln.scene.boxes import box_corners
from condvln.scene.scene import STRUCTURE, SceneGeometry
from condvln.sources.procthor import ProcthorSource
from condvln.sources.procthor_solids import WALL_THICKNESS, house_structure
from condvln.sources.registry import open_source
from condvln.sources.solids import Hole, without_holes
from schemas.errors import FormatError
from tests.condvln.sources.procthor_houses import DATABASE, House_, house, parsed, wall, write, xyz

REACHED = 1.0
"""Square metres of a room that must be walkable from the rest of the house."""


def surrounded() -> House_:
    """`house` with all its walls: the shared one twice, the outer ones once inside and once outside."""
    made = house()
    outer = [((0, 0), (4, 0), 2), ((4, 0), (8, 0), 3), ((8, 0), (8, 3), 3), ((8, 3), (4, 3), 3), ((4, 3), (0, 3), 2),
             ((0, 3), (0, 0), 2)]  # fmt: skip
    made["walls"] = made["walls"][:2]
    for number, (a, b, room) in enumerate(outer):
        made["walls"].append(wall(f"wall|{room}|{number}", f"room|{room}", a, b))
        made["walls"].append(wall(f"wall|exterior|{number}", f"room|{room}", b, a, top_first=True))
    made["windows"][0] |= {"wall0": "wall|2|0", "wall1": "wall|exterior|0"}
    return made


@pytest.fixture
def root(tmp_path: Path) -> Path:
    (tmp_path / "asset-database.json").write_text(json.dumps(DATABASE))
    return tmp_path


def geometry_of(root: Path, made: House_) -> tuple[Scene, SceneGeometry]:
    source = write(root, made)
    scene = source.read("train-0")
    return scene, source.geometry(scene)


def areas(geometry: SceneGeometry) -> NDArray[np.float64]:
    a, b, c = np.moveaxis(geometry.vertices[geometry.faces], 1, 0)
    return np.asarray(np.linalg.norm(np.cross(b - a, c - a), axis=1) / 2)


def main_island(nav: Pathfinder) -> int:
    return max(range(nav.num_islands), key=nav.island_area)


def reached(nav: Pathfinder, room: Room) -> float:
    """Square metres of a room's floor that belong to the largest island."""
    polygon = shapely.Polygon(room.polygon)
    x0, z0, x1, z1 = polygon.bounds
    x, z = (c.ravel() for c in np.meshgrid(np.arange(x0, x1, 0.2), np.arange(z0, z1, 0.2)))
    inside = shapely.contains_xy(polygon, x, z)
    points = np.column_stack([x, np.full(len(x), room.floor_y), z])[inside]
    on = nav.are_navigable(points) & (nav.get_islands(points) == main_island(nav))
    return 0.04 * int(on.sum())


def test_floors_walls_and_boxes_have_the_surfaces_that_they_should(root: Path) -> None:
    scene, geometry = geometry_of(root, surrounded())
    assert geometry.approximate
    size = areas(geometry)
    structure = geometry.owner == STRUCTURE
    corner = geometry.vertices[geometry.faces]
    flat = structure & (np.ptp(corner[:, :, 1], axis=1) == 0)
    ground = flat & (corner[:, 0, 1] == 0)
    # Two rooms of 4 × 3 m, seen from above, and the undersides of the walls.
    normals = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])[:, 1]
    assert size[ground & (normals > 0)].sum() == pytest.approx(24)
    # Outer walls 22 m, the shared one 3 m once; 3 m high; a door of 1 × 2 m and a window of 2 × 1 m out; both faces.
    upright = structure & ~flat
    # Seven walls, two of them cut in two by a hole; then the lintel (1 m high), the sill (1 m) and its lintel (1 m).
    ends = WALL_THICKNESS * 2 * (9 * 3 + 1 + 1 + 1)
    fronts = 2 * (25 * 3 - 1 * 2 - 2 * 1)
    assert size[upright].sum() == pytest.approx(fronts + ends)
    for number, item in enumerate(scene.objects):
        own = np.unique(geometry.faces[geometry.owner == number])
        assert item.obb is not None
        assert (geometry.owner == number).sum() == 12
        np.testing.assert_array_equal(geometry.vertices[own], box_corners(item.obb))
    assert set(geometry.owner.tolist()) == {STRUCTURE, *range(len(scene.objects))}


def test_all_surfaces_look_outwards(root: Path) -> None:
    scene, geometry = geometry_of(root, surrounded())
    a, b, c = np.moveaxis(geometry.vertices[geometry.faces], 1, 0)
    six = np.einsum("ni,ni->n", a, np.cross(b, c))
    for number, item in enumerate(scene.objects):
        assert six[geometry.owner == number].sum() / 6 == pytest.approx(8 * np.prod(item.obb.half_extents))
    # The floor lies at height 0, where its share is nothing, so that the rest is the walls.
    assert six[geometry.owner == STRUCTURE].sum() / 6 == pytest.approx(WALL_THICKNESS * (25 * 3 - 1 * 2 - 2 * 1))


SEEN = [
    ("through the door", [3, 1.25, -2], [5, 1.25, -2], {}, True),
    ("beside the door", [3, 1.25, -1], [5, 1.25, -1], {}, False),
    ("above the door", [3, 2.5, -2], [5, 2.5, -2], {}, False),
    ("through the window", [2, 1.5, -1], [2, 1.5, 1], {}, True),
    ("below the window", [2, 0.75, -1], [2, 0.75, 1], {}, False),
    ("through the closed door", [3, 1.25, -2], [5, 1.25, -2], {"openness": 0}, False),
    ("through a door frame", [3, 1.25, -2], [5, 1.25, -2], {"openness": 0, "assetId": "Doorframe_1"}, True),
    ("where the wall was taken away", [3, 1.25, -0.5], [5, 1.25, -0.5], "empty", True),
    ("out of the house", [3, 1.25, -1], [3, 1.25, 1], "empty", False),
]


@pytest.mark.parametrize(("eye", "point", "change", "seen"), [s[1:] for s in SEEN], ids=[s[0] for s in SEEN])
def test_what_is_seen(root: Path, eye: list[float], point: list[float], change: Any, seen: bool) -> None:
    made = surrounded()
    made["objects"] = []
    if change == "empty":
        made["doors"] = []
        for face in made["walls"][:2]:
            face["empty"] = True
    else:
        made["doors"][0] |= change
    geometry = geometry_of(root, made)[1]
    hidden = MeshOccluders(geometry.vertices, geometry.faces).hidden(np.array([eye], float), np.array([point], float))
    assert bool(hidden[0]) is not seen


@pytest.mark.parametrize(
    ("change", "connected"), [({}, True), ({"openness": 0}, False), ({"openness": 0.5}, True), ("empty", True)]
)
def test_what_is_walked(root: Path, change: Any, connected: bool) -> None:
    made = surrounded()
    # A window down to the floor, between the rooms, is no door either.
    low = {
        "id": "w",
        "room0": "room|2",
        "room1": "room|3",
        "wall0": made["walls"][0]["id"],
        "wall1": made["walls"][1]["id"],
    }
    made["windows"].append(low | {"assetId": "Window_2", "holePolygon": [xyz(2, 0, 0), xyz(2.9, 2.9, 0)]})
    if change == "empty":
        made["doors"], made["windows"] = [], []
        for face in made["walls"][:2]:
            face["empty"] = True
    else:
        made["doors"][0] |= change
    geometry = geometry_of(root, made)[1]
    nav = Pathfinder.build(geometry.vertices, geometry.faces)
    assert np.isfinite(nav.geodesic_distance([1, 0.1, -0.5], [7, 0.1, -0.5])) == connected
    # Nowhere out of the house.
    around = [[x, 0.1, z] for x, z in ((-0.5, -1), (8.5, -1), (2, 0.5), (2, -3.5))]
    assert not nav.are_navigable(around).any()


def test_side_zones_change_no_walls(root: Path, tmp_path: Path) -> None:
    geometry = geometry_of(root, surrounded())[1]
    zone = {"name": "all", "label": "kitchen", "poly_loop": [[0, 0, 0], [8, 0, 0], [8, 0, -3], [0, 0, -3]],
            "floor_height": 0, "extrusion_height": 3}  # fmt: skip
    (tmp_path / "zones.semantic_config.json").write_text(json.dumps({"region_annotations": [zone]}))
    source = open_source("procthor", root, regions=tmp_path / "zones.semantic_config.json")
    again = source.geometry(source.read("train-0"))
    np.testing.assert_array_equal(again.vertices, geometry.vertices)


def test_walls_are_those_of_the_file_as_it_is_now(root: Path) -> None:
    source = write(root, surrounded())
    scene = source.read("train-0")
    first = source.geometry(scene)
    lower = surrounded()
    lower["walls"] = lower["walls"][:-2]  # both sides of one
    write(root, lower)
    changed, fresh = source.geometry(scene), write(root, lower).geometry(scene)
    assert len(changed.faces) < len(first.faces)
    np.testing.assert_array_equal(changed.vertices, fresh.vertices)


@given(
    holes=st.lists(st.tuples(*[st.floats(0, 4.5), st.floats(0.1, 2), st.floats(0, 3.5), st.floats(0.1, 3)]), max_size=4)
)
def test_what_is_left_of_a_wall_is_all_but_its_holes(holes: list[tuple[float, float, float, float]]) -> None:
    cut = [Hole(round(x, 2), round(x + w, 2), round(y, 2), round(y + h, 2)) for x, w, y, h in holes]
    rest = without_holes(Hole(0.0, 4.0, 0.0, 3.0), cut)
    expected = shapely.box(0, 0, 4, 3) - shapely.union_all([shapely.box(h.near, h.low, h.far, h.high) for h in cut])
    pieces = [shapely.box(r.near, r.low, r.far, r.high) for r in rest]
    assert sum(p.area for p in pieces) == pytest.approx(expected.area, abs=1e-9)
    assert shapely.union_all(pieces).symmetric_difference(expected).area == pytest.approx(0, abs=1e-9)


def test_more_openings_than_a_house_has_are_refused() -> None:
    made = house()
    made["windows"] = [made["windows"][0] | {"id": f"w{i}"} for i in range(2001)]
    with pytest.raises(FormatError, match="2002 doors and windows"):
        house_structure(parsed(made), "h.json")


# --- the sixty real houses


@pytest.fixture(scope="module")
def real(real_data: Path) -> ProcthorSource:
    source = open_source("procthor", real_data / "procthor")
    assert isinstance(source, ProcthorSource)
    return source


def reach_every_room(real: ProcthorSource, real_data: Path, numbers: range) -> int:
    """Geodesics some houses; gives the number of their rooms.

    Rooms that the generator itself calls not navigable need not be reached; none of the sixty houses has one.
    """
    with gzip.open(real_data / "procthor" / "houses60.jsonl.gz") as lines:
        documents = [json.loads(line) for line in lines]
    assert len(documents) == 60
    rooms = 0
    for number in numbers:
        scene, metadata = real.read(f"houses60-{number}"), documents[number]["metadata"]
        assert "RoomsNotNavigable" not in metadata["warnings"]
        geometry = real.geometry(scene)
        nav = Pathfinder.build(geometry.vertices, geometry.faces)
        for room in scene.rooms:
            assert reached(nav, room) >= REACHED, (scene.scene_id, room.room_id)
            rooms += 1
        at = metadata["agent"]["position"]
        start = [at["x"], 0.0, -at["z"]]
        assert nav.is_navigable(start), scene.scene_id
        assert nav.get_island(start) == main_island(nav), scene.scene_id
    return rooms


@pytest.mark.parametrize(
    ("numbers", "rooms"), [(range(9, 60, 10), 33), pytest.param(range(60), 296, marks=pytest.mark.soak)]
)
def test_every_room_of_real_houses_is_reached(
    real: ProcthorSource, real_data: Path, numbers: range, rooms: int
) -> None:
    assert reach_every_room(real, real_data, numbers) == rooms
