"""Rooms of AI2-THOR as triangles: by hand, and against the positions that the simulator's own agent reached."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from benchmarks.reachability import Reachability, reachability
from condvln.navigation.occluders import MeshOccluders
from condvln.navigation.pathfinder import Pathfinder
from condvln.samples.maker import make_samples
from condvln.scene.boxes import corners
from condvln.scene.scene import STRUCTURE, SceneGeometry
from condvln.sources.registry import open_source
from condvln.sources.scene_source import Source
from tests.condvln.sources.thor_plans import corner_points, plan, thing, write


def geometry_of(source: Source, scene_id: str = "FloorPlan207") -> SceneGeometry:
    geometry = source.geometry(source.read(scene_id))
    assert geometry is not None
    return geometry


def drawn(tmp_path: Path, *objects: Any, name: str = "FloorPlan207", family: str = "ithor") -> SceneGeometry:
    document = {"sceneName": name, "objects": list(objects)}
    return geometry_of(write(tmp_path, document, f"{name}.json", family), name)


def walked(geometry: SceneGeometry) -> Pathfinder:
    return Pathfinder.build(geometry.vertices, geometry.faces)


def bounds(geometry: SceneGeometry, owner: int = STRUCTURE) -> list[list[float]]:
    points = geometry.vertices[geometry.faces[geometry.owner == owner]].reshape(-1, 3)
    return np.round([points.min(axis=0), points.max(axis=0)], 6).tolist()


def test_a_plan_is_a_floor_within_walls_and_boxes_but_for_windows(tmp_path: Path) -> None:
    source = write(tmp_path, plan())
    scene = source.read("FloorPlan207")
    geometry = geometry_of(source)
    assert geometry.approximate
    # Nothing is built in there, so that the walls stand on the border of the floor's box, 4 × 6 m about (1, −2).
    corner = geometry.vertices[geometry.faces]
    ground = (corner[:, :, 1] == 0).all(axis=1) & (geometry.owner == STRUCTURE)
    a, b, c = np.moveaxis(corner[ground], 1, 0)
    up = np.cross(b - a, c - a)[:, 1]
    assert up[up > 0].sum() / 2 == pytest.approx(24)
    assert bounds(geometry) == [[-1.01, 0, -5.01], [3.01, 2.5, 1.01]]
    sofa = [o.object_id for o in scene.objects].index("Sofa|+01.00")
    own = np.unique(geometry.faces[geometry.owner == sofa])
    box = scene.objects[sofa].aabb
    assert box is not None
    np.testing.assert_array_equal(geometry.vertices[own], corners(box))
    assert set(geometry.owner.tolist()) == {STRUCTURE, sofa}
    again = geometry_of(source)
    assert again.vertices.tobytes() == geometry.vertices.tobytes()


def test_nothing_is_walked_or_seen_beyond_the_walls(tmp_path: Path) -> None:
    geometry = geometry_of(write(tmp_path, plan()))
    nav = walked(geometry)
    assert nav.are_navigable([[1, 0, -1], [-0.8, 0, -4.8], [2.8, 0, 0.8]]).all()
    assert not nav.are_navigable([[1, 0, -3], [-1.2, 0, -4], [3.2, 0, 0], [1, 0, 1.2]]).any()
    eyes = np.array([[1, 1.25, 0.0]] * 2)
    hidden = MeshOccluders(geometry.vertices, geometry.faces).hidden(eyes, np.array([[1, 1.25, 2.0], [2.5, 1, -4.5]]))
    assert hidden.tolist() == [True, False]


def test_oriented_boxes_are_taken_where_known(tmp_path: Path) -> None:
    turn = np.radians(30)
    edges = np.array([[np.cos(turn), 0, np.sin(turn)], [0, 1, 0], [-np.sin(turn) / 2, 0, np.cos(turn) / 2]])
    points = corner_points(np.array([1, 0.5, 2]), edges)
    reach = np.ptp(points, axis=0)
    box = thing("b", "Box", (1, 0.5, 2), tuple(reach), objectOrientedBoundingBox={"cornerPoints": points})
    geometry = drawn(tmp_path, plan()["objects"][0], box)
    got = geometry.vertices[np.unique(geometry.faces[geometry.owner == 1])]
    expected = np.array(points) * [1, 1, -1]
    assert np.linalg.norm(got[:, None] - expected[None], axis=2).min(axis=1).max() < 0.003


def test_without_a_floor_there_are_no_surfaces(tmp_path: Path) -> None:
    document = plan() | {"objects": plan()["objects"][1:]}
    source = write(tmp_path, document)
    assert source.geometry(source.read("FloorPlan207")) is None
    document["objects"].append(thing("f", "Floor", (0, 0, 0), (4, 0.1, 0)))
    source = write(tmp_path, document)
    assert source.geometry(source.read("FloorPlan207")) is None


FLOOR = thing("f", "Floor", (0, -0.1, 0), (4, 0.2, 4))


@pytest.mark.parametrize(
    ("objects", "expected"),
    [
        # No fittings: the floor's border is taken at its word.
        ([thing("a", "Sofa", (0, 0.5, 0), (3.6, 1, 3.6), assetId="Sofa_1")], [-2, -2, 2, 2]),
        # Fittings: the floor runs on below the walls by at most half a metre,
        ([thing("a", "Shelf", (0, 0.5, 0), (3.6, 1, 3.2))], [-1.8, -1.6, 1.8, 1.6]),
        # or by more where a fitting is the farthest thing; here it ends at −1 and 1 in x, at −1.8 and 0 in z.
        ([thing("a", "Shelf", (0, 0.5, 0.9), (2, 1, 1.8))], [-1, -1.8, 1, 0]),
        # Something movable that ends well inside, and beyond the fittings, is no wall,
        (
            [
                thing("a", "Shelf", (0, 0.5, 0), (1, 1, 3.8)),
                thing("b", "Sofa", (0, 0.5, 0), (2.6, 1, 1), assetId="Sofa_1"),
            ],
            [-2, -1.9, 2, 1.9],
        ),
        # a window no fitting, and what is outside of the floor moves no wall outwards.
        ([thing("a", "Window", (0, 1, 0), (3, 1, 3))], [-2, -2, 2, 2]),
        ([thing("a", "Shelf", (0, 0.5, 0), (6, 1, 6))], [-2, -2, 2, 2]),
        ([thing("a", "Shelf", (9, 0.5, 9), (1, 1, 1))], [-2, -2, 2, 2]),
    ],
)
def test_where_walls_stand(tmp_path: Path, objects: list[Any], expected: list[float]) -> None:
    low, high = bounds(drawn(tmp_path, FLOOR, *objects))
    half = 0.01
    assert [low[0] + half, low[2] + half, high[0] - half, high[2] - half] == pytest.approx(expected)


def panel(*doors: Any) -> list[Any]:
    """A floor of 4 × 4 m with a wall across it at x = 0."""
    return [FLOOR, thing("w", "Wall", (0, 1.25, 0), (0.1, 2.5, 4)), *doors]


def door(kind: str, **more: Any) -> Any:
    return thing("d", kind, (0, 1, 0), (0.14, 2, 1), **more)


@pytest.mark.parametrize(
    ("objects", "passable"),
    [
        ([FLOOR], True),
        (panel(), False),
        (panel(door("Doorway", isOpen=True)), True),
        (panel(door("Doorway", isOpen=False)), False),
        (panel(door("Door")), False),
        (panel(door("Doorframe", isOpen=False)), True),
        (panel(thing("c", "Window", (0, 1, 0), (0.14, 2, 1))), False),
    ],
)
def test_walls_that_are_objects_and_doors_in_them(tmp_path: Path, objects: list[Any], passable: bool) -> None:
    geometry = drawn(tmp_path, *objects, name="FloorPlan_Val1_1", family="robothor")
    distance = walked(geometry).geodesic_distance([-1, 0.1, -0.2], [1, 0.1, -0.2])
    assert np.isfinite(distance) == passable
    assert (geometry.owner == STRUCTURE).all()
    look = MeshOccluders(geometry.vertices, geometry.faces).hidden(np.array([[-1, 1, 0.0]]), np.array([[1, 1, 0.0]]))
    assert bool(look[0]) is not passable


def test_a_door_is_cut_out_of_its_own_wall_only(tmp_path: Path) -> None:
    objects = [*panel(door("Doorframe")), thing("w2", "Wall", (1, 1.25, 0), (0.1, 2.5, 4))]
    nav = walked(drawn(tmp_path, *objects))
    assert np.isfinite(nav.geodesic_distance([-1, 0.1, 0.0], [0.5, 0.1, 0.0]))
    assert not np.isfinite(nav.geodesic_distance([-1, 0.1, 0.0], [1.5, 0.1, 0.0]))


def test_what_the_users_zones_leave_out_still_stands(tmp_path: Path) -> None:
    """An object in no zone is no object of the scene, but nobody walks through it."""
    write(tmp_path, plan())
    zone = {"name": "a", "label": "kitchen", "poly_loop": [[-1, 0, -5], [0, 0, -5], [0, 0, -4], [-1, 0, -4]]}
    (tmp_path / "zones.json").write_text(f'{{"region_annotations": [{str(zone).replace(chr(39), chr(34))}]}}')
    source = open_source("ithor", tmp_path, regions=tmp_path / "zones.json")
    scene = source.read("FloorPlan207")
    assert "Sofa|+01.00" not in scene.object_of
    geometry = geometry_of(source)
    assert (geometry.owner == STRUCTURE).all()
    assert not walked(geometry).is_navigable([1, 0, -3])


# --- the measure


def made_floors(folder: Path, family: str, scenes: int) -> dict[str, Reachability]:
    """Our floor of each made scene against the positions that its maker says are reached."""
    make_samples(folder, family, scenes)
    source = open_source(family, folder)
    return {
        handle.scene_id: reachability(
            geometry_of(source, handle.scene_id),
            np.load(folder / f"{handle.scene_id}-reachable.npy") * [1.0, -1.0],
            hand=False,
        )
        for handle in source.handles()
    }


def test_made_plans_are_reached_where_their_makers_say(tmp_path: Path) -> None:
    found = made_floors(tmp_path, "ithor", 3)
    assert found
    assert all(floor.recall >= 0.95 for floor in found.values()), found


REAL = {
    "FloorPlan207": (145, 133, 133),
    # The box of its cooking island is 0.1 m deeper than the knobs on its front, and a chair and a bag of rubbish leave
    # more room than their boxes do.
    "FloorPlan21": (105, 93, 90),
    "FloorPlan306": (93, 94, 91),
    "FloorPlan320": (60, 65, 59),
    "FloorPlan404": (50, 49, 48),
    # One counter runs round a corner and its box holds the floor before it; a stool has been moved between releases.
    "FloorPlan6": (134, 128, 117),
    # The body of its stove is no object: the knobs and rings are, and the floor before them seems free.
    "FloorPlan9": (76, 85, 75),
}
"""Positions of the simulator, ours, and common ones."""


def test_real_plans_are_reached_where_the_simulator_says(real_data: Path) -> None:
    source = open_source("ithor", real_data / "ithor")
    found: dict[str, Reachability] = {}
    for handle in source.handles():
        reachable = np.load(real_data / "ithor" / f"{handle.scene_id}-reachable.npy") * [1.0, -1.0]
        found[handle.scene_id] = reachability(geometry_of(source, handle.scene_id), reachable)
    assert {name: (f.reachable, f.navigable, f.both) for name, f in found.items()} == REAL
    good = {name for name, f in found.items() if min(f.precision, f.recall) >= 0.9}
    assert good == {"FloorPlan207", "FloorPlan306", "FloorPlan320", "FloorPlan404"}
    assert min(min(f.precision, f.recall) for f in found.values()) >= 0.85
    assert np.mean([f.precision for f in found.values()]) >= 0.94
    assert np.mean([f.recall for f in found.values()]) >= 0.93
