"""What can be seen from where an agent can stand: rooms whose answer follows from the plan."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

import condvln.episodes.view as view_module
from condvln.episodes.view import SceneView
from condvln.episodes.visibility import Visibility, scene_visibility, sightings_from_table, visibility_table
from condvln.navigation.sight import View
from condvln.scene import Scene
from condvln.scene.geometry import STRUCTURE
from condvln.scene.sightings import Sightings
from schemas.tables import VISIBILITY
from tests.condvln.episodes.floors import apartment, box, box_triangles, grid_floor, inside, surfaces_of

EYE = 1.25


def seen(scene: Scene, view: SceneView) -> dict[str, Visibility]:
    floor = grid_floor(6, 6, lambda x, z: any(inside(o, x, z) for o in scene.objects))
    found = scene_visibility(scene, view, floor, range(floor.num_islands), EYE)
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


@pytest.mark.parametrize("lid", [0.0, 0.98])
@pytest.mark.parametrize("at_once", [1, 700, 1 << 18])
def test_lines_tested_in_turns_tell_what_all_lines_tell(
    lid: float, at_once: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """From places around the case, on its lid, in it and far away; of targets of different sizes, one after the other
    or together.
    """
    monkeypatch.setattr(view_module, "LOOKS_AT_ONCE", at_once)
    _, view = shut_in(lid)
    rng = np.random.default_rng(3)
    eyes = np.concatenate([rng.uniform([0, 0.2, 0], [6, 1.8, 6], (40, 3)), [[3.0, 0.7, 3.0], [np.nan, 1.0, 1.0]]])
    targets = [view.target("vase"), view.denser_target("lamp", 100), view.target("lamp")]
    for reach in (View(range=np.inf), View(range=2.0)):
        for few in (eyes, eyes[:1], eyes[:0]):
            found = list(view.sighted(few, targets, reach))
            assert len(found) == len(targets)
            for target, (from_eye, samples) in zip(targets, found, strict=True):
                lines = view.seen(few, target, reach)
                assert np.array_equal(from_eye, lines.any(axis=1))
                assert np.array_equal(samples, lines.any(axis=0))
    assert view.seen(eyes, targets[0], View(range=2.0)).any()


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
    (found,) = scene_visibility(scene, SceneView(scene), floor, (), EYE)
    assert (found.places, found.seeable, found.unseen, found.nearest_view) == (0, False, True, None)


def test_the_nearest_view_is_the_distance_to_the_nearest_place_that_sees_it() -> None:
    scene = apartment(box("vase", 3, 3, 0.3))
    found = seen(scene, SceneView(scene))["vase"]
    assert found.nearest_view is not None
    assert 0.3 <= found.nearest_view < 2.0


def test_the_table_keeps_what_is_unseen_and_what_is_in_doubt() -> None:
    scene = apartment(box("vase", 1, 1), box("lamp", 3, 3), box("sofa", 5, 5))
    made = [
        Visibility("lamp", 9, 1, 0.02, 1.0, seeable=False, unseen=False),
        Visibility("sofa", 9, 9, 0.5, 1.0, seeable=True, unseen=False),
        Visibility("vase", 9, 0, 0.0, None, seeable=False, unseen=True),
    ]
    table = visibility_table(scene, made)
    assert table.schema == VISIBILITY
    assert sightings_from_table(table) == Sightings(frozenset({"vase"}), frozenset({"lamp"}))
    assert sightings_from_table(visibility_table(scene, None)) == Sightings()


@pytest.mark.parametrize("name", ["seeable", "unseen", "places", "share", "nearest_view"])
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
    shown = {name: bool(view.glimpsed(eye, name, View(range=9.0))[0]) for name in ("vase", "lamp", "sofa")}
    assert shown == {"vase": holder in ("shelf", "coffee table"), "lamp": True, "sofa": False}
    # Objects that are looked for together, each from eyes of its own, are seen as if each was the only one.
    eyes = [eye + np.array([[k * 0.7, 0.0, k * 0.3]]) * np.arange(4)[:, None] for k in range(3)]
    together = view.glimpsed_each(eyes, ["vase", "lamp", "sofa"], View(range=9.0))
    for own, name, found in zip(eyes, ("vase", "lamp", "sofa"), together, strict=True):
        assert found.tolist() == view.seen(own, view.target(name), View(range=9.0)).any(axis=1).tolist()
