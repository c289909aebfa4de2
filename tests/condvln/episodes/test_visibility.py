"""What can be seen from where an agent can stand: rooms whose answer follows from the plan."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from condvln.episodes.view import SceneView
from condvln.episodes.visibility import Visibility, scene_visibility, sightings_from_table, visibility_table
from condvln.navigation.sight import Recognition, View, visible_extent
from condvln.scene import Scene
from condvln.scene.scene import STRUCTURE, Sightings
from schemas.config import EpisodeConfig, PlacesConfig
from schemas.tables import VISIBILITY
from tests.condvln.episodes.floors import apartment, box, box_triangles, grid_floor, inside, surfaces_of

EYE = 1.25
RULE = Recognition.of(PlacesConfig(), EpisodeConfig())


def seen(scene: Scene, view: SceneView) -> dict[str, Visibility]:
    floor = grid_floor(6, 6, lambda x, z: any(inside(o, x, z) for o in scene.objects))
    found = scene_visibility(scene, view, floor, range(floor.num_islands), EYE, RULE)
    return {one.object_id: one for one in found}


def shut_in(lid: float) -> tuple[Scene, SceneView]:
    """A vase on a table in a case of walls, whose lid lies at this height; the case is open above where it is 0."""
    vase = dataclasses.replace(box("vase", 3, 3, 0.1, 0.5, 0.8), room_id="zone")
    lamp = box("lamp", 1, 1, 0.2, 0.0, 1.0)
    scene = apartment(vase, lamp)
    walls = [((2.5, 0, 2.5), (3.5, 1, 2.52)), ((2.5, 0, 3.48), (3.5, 1, 3.5))]
    walls += [((2.5, 0, 2.5), (2.52, 1, 3.5)), ((3.48, 0, 2.5), (3.5, 1, 3.5))]
    if lid:
        walls.append(((2.5, lid, 2.5), (3.5, lid + 0.02, 3.5)))
    parts = [(STRUCTURE, box_triangles(*wall)) for wall in walls]
    parts += [(k, box_triangles(*item.aabb)) for k, item in enumerate(scene.objects)]
    return scene, SceneView(scene, surfaces_of(parts))


def test_a_lid_hides_what_an_open_case_shows() -> None:
    for lid, shown in ((0.0, True), (0.98, False)):
        found = seen(*shut_in(lid))
        assert found["lamp"].seeable
        assert (found["vase"].seeable, found["vase"].unseen) == (shown, not shown)


def test_a_glimpse_is_neither_seeable_nor_unseen() -> None:
    """Of a thin pole that pierces the lid of its case the upper 2 cm show."""
    scene, _ = shut_in(0.98)
    pole = dataclasses.replace(box("vase", 3, 3, 0.05, 0.01, 1.02))
    scene = apartment(pole, scene.objects[1])
    walls = [((2.5, 0, 2.5), (3.5, 1, 2.52)), ((2.5, 0, 3.48), (3.5, 1, 3.5)), ((2.5, 0, 2.5), (2.52, 1, 3.5))]
    walls += [((3.48, 0, 2.5), (3.5, 1, 3.5)), ((2.5, 0.98, 2.5), (3.5, 1.0, 3.5))]
    parts = [(STRUCTURE, box_triangles(*wall)) for wall in walls]
    parts += [(k, box_triangles(*item.aabb)) for k, item in enumerate(scene.objects)]
    found = seen(scene, SceneView(scene, surfaces_of(parts)))["vase"]
    assert not found.seeable
    assert not found.unseen
    assert 0 < found.share < 1 / 16


def test_what_a_shut_container_hides_is_unseen_wherever_it_is() -> None:
    scene = apartment(dataclasses.replace(box("vase", 3, 3), hidden=True), box("lamp", 1, 1))
    found = seen(scene, SceneView(scene))
    assert (found["vase"].seeable, found["vase"].unseen, found["vase"].places) == (False, True, 0)
    assert found["lamp"].seeable


def test_parts_of_the_building_are_not_looked_for_and_nameless_things_are() -> None:
    scene = apartment(box("vase", 3, 3), box("wall", 1, 1), box("object", 5, 5))
    assert set(seen(scene, SceneView(scene))) == {"vase", "object"}


def test_where_nobody_can_stand_nothing_is_seen() -> None:
    scene = apartment(box("vase", 3, 3))
    floor = grid_floor(6, 6, lambda x, z: False)
    (found,) = scene_visibility(scene, SceneView(scene), floor, (), EYE, RULE)
    assert (found.places, found.seeable, found.unseen, found.nearest_view) == (0, False, True, None)


def test_the_nearest_view_is_the_distance_to_the_nearest_place_that_sees_it() -> None:
    scene = apartment(box("vase", 3, 3, 0.3))
    found = seen(scene, SceneView(scene))["vase"]
    assert found.nearest_view is not None
    assert 0.3 <= found.nearest_view < 2.0


def test_the_table_keeps_what_is_unseen_and_what_is_in_doubt() -> None:
    scene = apartment(box("vase", 1, 1), box("lamp", 3, 3), box("sofa", 5, 5))
    made = [
        Visibility("lamp", 9, 1, 0.02, 1.0, None, seeable=False, unseen=False),
        Visibility("sofa", 9, 9, 0.5, 1.0, 9.5, seeable=True, unseen=False),
        Visibility("vase", 9, 0, 0.0, None, None, seeable=False, unseen=True),
    ]
    table = visibility_table(scene, made)
    assert table.schema == VISIBILITY
    assert sightings_from_table(table) == Sightings(frozenset({"vase"}), frozenset({"lamp"}), {"sofa": 9.5})
    assert sightings_from_table(visibility_table(scene, None)) == Sightings()


@pytest.mark.parametrize("name", ["seeable", "unseen", "places", "share", "nearest_view", "degrees"])
def test_without_a_navmesh_all_is_null(name: str) -> None:
    table = visibility_table(apartment(box("vase", 1, 1), box("lamp", 3, 3)), None)
    assert table["object_id"].to_pylist() == ["lamp", "vase"]
    assert table[name].null_count == 2


def test_the_rows_do_not_depend_on_the_order_of_objects() -> None:
    scene, view = shut_in(0.0)
    turned = dataclasses.replace(scene, objects=scene.objects[::-1])
    again = SceneView(turned, surfaces_of([(k, box_triangles(*o.aabb)) for k, o in enumerate(turned.objects)]))
    plain = SceneView(scene, surfaces_of([(k, box_triangles(*o.aabb)) for k, o in enumerate(scene.objects)]))
    assert seen(turned, again) == seen(scene, plain)
    assert np.all([one.seeable for one in seen(scene, view).values()])


@pytest.mark.parametrize("holder", ["shelf", "coffee table", "counter", "refrigerator"])
def test_a_frame_hides_nothing_of_what_is_on_it_and_a_solid_does(holder: str) -> None:
    """Seen from below through the box: a vase on top of it, one that lies in it, and one behind it."""
    around = dataclasses.replace(box("holder", 1.0, 0.0, 0.5, 0.0, 2.0), label=holder)
    top, inner = box("vase", 1.3, 0.0, 0.1, 2.02, 2.12), box("lamp", 1.3, 0.0, 0.1, 1.0, 1.1)
    behind = box("sofa", 3.0, 0.0, 0.1, 0.0, 0.5)
    view = SceneView(apartment(around, top, inner, behind))
    eye = np.array([[0.0, EYE, 0.0]])
    shown = {name: bool(view.seen(eye, view.target(name), View(range=9.0)).any()) for name in ("vase", "lamp", "sofa")}
    assert shown == {"vase": holder in ("shelf", "coffee table"), "lamp": True, "sofa": False}


def test_a_small_thing_is_recognised_from_close_by_only() -> None:
    """A vase 0.2 m wide appears 2.5° wide up to about 4.6 m away, and a tall lamp in front of it hides it."""
    vase, lamp = box("vase", 0.0, 0.0, 0.1, 0.9, 1.3), box("lamp", 3.0, 0.0, 0.3, 0.0, 2.0)
    view = SceneView(apartment(vase, lamp))
    eyes = np.array([[0.0, EYE, z] for z in (1.5, 4.0, 5.5)] + [[4.5, EYE, 0.0]])
    assert view.recognised(eyes, "vase", RULE).tolist() == [True, True, False, False]
    target, degrees = view.target("vase"), view.degrees(eyes, "vase", RULE)
    extent = visible_extent(eyes, target.samples, view.seen(eyes, target, RULE.view))
    np.testing.assert_array_equal(degrees, np.where([True, True, False, False], extent[:, 0], 0.0))
    assert extent[2, 0] > 0, "it is seen, and too small"
    assert not extent[3].any()
    # The samples lie on the surface: they reach nearly as far as the box does.
    corners = np.array([[x, y, 0.1] for x in (-0.1, 0.1) for y in (0.9, 1.3)])
    whole = visible_extent(eyes[:1], corners, np.ones((1, 4)))
    assert (0.8 * whole <= extent[:1]).all()
    assert (extent[:1] <= 1.15 * whole).all()


def test_a_level_camera_does_not_recognise_what_lies_at_its_feet() -> None:
    view = SceneView(apartment(box("vase", 0.0, 0.0, 0.2, 0.0, 0.1)))
    eyes = np.array([[0.0, EYE, 0.6]])
    level = Recognition.of(PlacesConfig(), EpisodeConfig())
    tilting = dataclasses.replace(level, view=dataclasses.replace(level.view, pitch=None))
    assert not view.recognised(eyes, "vase", level)[0]
    assert view.recognised(eyes, "vase", tilting)[0]
