"""A Habitat scene dataset, read: numbers checked by hand on a made one."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
import trimesh

from condvln.scene.boxes import box_corners
from condvln.scene.meshes import MeshLibrary
from schemas.errors import FormatError
from tests.condvln.sources.replicacad_reading import HALF, box, codes, read


def test_a_sound_scene_has_everything(made: Any) -> None:
    scene = read(made)
    assert [o.object_id for o in scene.objects] == ["chair_01:0", "chair_01:1", "fridge:0", "table_01:0"]
    assert [o.label for o in scene.objects] == ["chair", "chair", "refrigerator", "table"]
    assert [o.raw_label for o in scene.objects] == ["chair", "chair", "fridge", "table"]
    assert [o.static for o in scene.objects] == [False, True, True, True]
    assert [o.geometry for o in scene.objects] == ["mesh"] * 4
    assert scene.warnings == ()
    (room,) = scene.rooms
    assert (room.room_id, room.label, room.annotation, room.complete) == ("apartment", "apartment", "scene", True)
    assert {o.room_id for o in scene.objects} == {"apartment"}
    assert (room.floor_y, room.ceiling_y) == (0.0, 1.3)
    assert [part.path for part in scene.stage] == ["stages/stage.glb"]


def test_boxes_are_those_of_the_turned_meshes(made: Any) -> None:
    by_id = read(made).object_of
    assert box(by_id["table_01:0"]) == [[0.5, 0.0, 0.7], [1.5, 0.8, 1.3]]
    assert box(by_id["chair_01:0"]) == [[2.75, 0.0, 0.8], [3.25, 1.0, 1.2]]
    assert box(by_id["chair_01:1"]) == [[2.8, 0.0, 2.75], [3.2, 1.0, 3.25]]
    turned = by_id["chair_01:1"]
    assert turned.center.tolist() == [3.0, 0.5, 3.0]
    assert turned.size.tolist() == [0.4, 1.0, 0.5]
    assert turned.obb.half_extents.tolist() == [0.25, 0.5, 0.2]
    np.testing.assert_allclose(turned.obb.rotation @ [1, 0, 0], [0, 0, -1], atol=1e-9)
    assert turned.radius == pytest.approx(math.ceil(1000 * math.hypot(0.2, 0.5, 0.25)) / 1000)


def test_the_world_box_is_of_the_vertices_not_of_the_turned_local_box(made: Any) -> None:
    # A regular octahedron turned by 45° about y has the same reach along x; its turned local box does not.
    made.write("objects/table_01.glb", bytes(trimesh.creation.icosphere(0, 1.0).export(file_type="glb")))
    diamond = trimesh.Trimesh(
        [[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]],
        [[0, 2, 4], [4, 2, 1], [1, 2, 5], [5, 2, 0], [4, 3, 0], [1, 3, 4], [5, 3, 1], [0, 3, 5]],
    )
    made.write("objects/table_01.glb", bytes(diamond.export(file_type="glb")))
    made.scene["object_instances"][0] |= {"rotation": [math.cos(math.pi / 8), 0, math.sin(math.pi / 8), 0]}
    made.write_scene()
    item = read(made).object_of["table_01:0"]
    assert box(item) == [[0.293, -0.6, 0.293], [1.707, 1.4, 1.707]]
    assert item.obb is not None
    assert np.abs(box_corners(item.obb)[:, 0] - 1).max() == pytest.approx(math.sqrt(2), abs=2e-3)


def test_an_articulated_body_stands_on_its_links(made: Any) -> None:
    fridge = read(made).object_of["fridge:0"]
    # Body: ±0.4, ±0.8 up, ±0.3; door: 0.4 to 0.5 along x, its middle 0.4 up; all at half size about (5, 0.9, 2).
    assert len(fridge.mesh) == 2
    assert box(fridge) == [[4.8, 0.5, 1.85], [5.25, 1.3, 2.15]]
    np.testing.assert_allclose(sorted(fridge.obb.half_extents), [0.15, 0.225, 0.4], atol=1e-9)
    mesh = MeshLibrary(made.root).world_mesh(fridge)
    assert mesh.watertight
    assert trimesh.Trimesh(mesh.vertices, mesh.faces).volume == pytest.approx((0.8 * 0.6 * 1.6 + 0.1 * 0.6 * 0.8) / 8)


@pytest.mark.parametrize(("name", "origin"), [("COM", "COM"), ("asset_local", "asset_local"), ("com", "Com")])
@pytest.mark.parametrize("where", ["scene", "object"])
def test_translation_origin(made: Any, name: str, origin: str, where: str) -> None:
    made.object("table_01", size=[1, 0.8, 0.6], centre=[0, 0.4, 0], semantic_id=1, COM=[0, 0.4, 0], scale=[2, 2, 2])
    entry = made.scene["object_instances"][0] | {"translation": [1, 2, 1], "rotation": [HALF, HALF, 0, 0]}
    made.scene["object_instances"][0] = entry
    (made.scene if where == "scene" else entry)["translation_origin"] = origin
    made.write_scene()
    item = read(made).object_of["table_01:0"]
    # The asset's middle is 0.8 m (scaled) from its origin, along the axis that the rotation takes to +z.
    assert item.center.tolist() == ([1, 2, 1] if name.lower() == "com" else [1, 2, 1.8])
    assert item.size.tolist() == [2.0, 1.2, 1.6]


def test_without_a_center_of_mass_the_box_centre_is_placed(made: Any) -> None:
    made.object("table_01", size=[1, 0.8, 0.6], centre=[5, 6, 7], semantic_id=1)
    assert read(made).object_of["table_01:0"].center.tolist() == [1, 0.4, 1]
    made.scene["translation_origin"] = "asset_local"
    made.write_scene()
    assert read(made).object_of["table_01:0"].center.tolist() == [6, 6.4, 8]


def test_scales_multiply_and_come_before_the_rotation(made: Any) -> None:
    made.object("chair_01", size=[0.5, 1, 0.4], semantic_id=2, COM=[0, 0, 0], scale=[2, 1, 1])
    made.scene["object_instances"][2] |= {"non_uniform_scale": [1, 1, 3], "uniform_scale": 0.5}
    made.write_scene()
    size = read(made).object_of["chair_01:1"].size
    assert size.tolist() == [0.6, 0.5, 0.5]


def test_an_asset_with_z_up_is_set_upright(made: Any) -> None:
    made.object("table_01", size=[1, 0.6, 0.8], semantic_id=1, COM=[0, 0, 0], up=[0, 0, 1], front=[0, 1, 0])
    assert box(read(made).object_of["table_01:0"]) == [[0.5, 0.0, 0.7], [1.5, 0.8, 1.3]]


def test_mesh_parts_give_the_boxes_again(made: Any) -> None:
    library = MeshLibrary(made.root)
    for item in read(made).objects:
        mesh = library.world_mesh(item)
        assert item.aabb is not None
        np.testing.assert_allclose([mesh.vertices.min(0), mesh.vertices.max(0)], item.aabb, atol=0.00051)


# --- ids and labels


def test_an_entry_may_bring_its_own_id(made: Any) -> None:
    made.scene["object_instances"][1]["id"] = "the chair"
    made.write_scene()
    assert [o.object_id for o in read(made).objects] == ["chair_01:0", "fridge:0", "table_01:0", "the chair"]


@pytest.mark.parametrize("taken", ["twice", "chair_01:0"])
def test_two_objects_with_one_id_are_refused(made: Any, taken: str) -> None:
    made.scene["object_instances"][0]["id"] = taken
    if taken == "twice":
        made.scene["object_instances"][1]["id"] = taken
    made.write_scene()
    with pytest.raises(FormatError, match=f"two objects have the id {taken!r}") as caught:
        read(made)
    assert caught.value.where.endswith("flat.scene_instance.json")
    assert caught.value.place == "object_instances[1]"


def test_a_body_without_a_class_is_unknown_and_said_so(made: Any) -> None:
    made.object("table_01", size=[1, 0.8, 0.6], semantic_id=99, COM=[0, 0, 0])
    scene = read(made)
    item = scene.object_of["table_01:0"]
    assert (item.raw_label, item.label, item.geometry) == ("unknown", "unknown", "mesh")
    # It could be anything: nothing may be said to be absent beside it.
    assert [r.complete for r in scene.rooms] == [False]
    assert codes(scene) == ["unlabelled_object"]


def test_a_template_listed_by_name_overrules_its_semantic_id(made: Any) -> None:
    made.object("frl_apartment_clothes_hanger_02", size=[1, 1, 1], semantic_id=1, COM=[0, 0, 0])
    made.scene["object_instances"][0]["template_name"] = "objects/frl_apartment_clothes_hanger_02"
    made.write_scene()
    item = read(made).object_of["frl_apartment_clothes_hanger_02:0"]
    assert (item.raw_label, item.label) == ("table", "clothes rack")
