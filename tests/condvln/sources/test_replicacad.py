"""A Habitat scene dataset, read: numbers checked by hand on a made one."""

from __future__ import annotations

import math
import os
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh

from condvln.navigation.agent import Agent
from condvln.scene import Scene, SceneObject
from condvln.scene.boxes import box_corners
from condvln.scene.meshes import MeshLibrary
from condvln.scene.tables import scene_from_tables, scene_tables
from condvln.sources.registry import open_source
from schemas.errors import ConfigError, FormatError, InputError, MissingFileError, PathEscapeError

HALF = math.sqrt(0.5)


def read(made: Any, scene: str = "flat", **options: Any) -> Scene:
    return made.source(**options).read(scene)


def codes(scene: Scene) -> list[str]:
    return [w.code for w in scene.warnings]


def box(item: SceneObject) -> list[list[float]]:
    assert item.aabb is not None
    return item.aabb.tolist()


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
    assert turned.size is not None
    assert turned.size.tolist() == [0.4, 1.0, 0.5]
    assert turned.obb is not None
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
    assert fridge.obb is not None
    np.testing.assert_allclose(sorted(fridge.obb.half_extents), [0.15, 0.225, 0.4], atol=1e-9)
    mesh = MeshLibrary(made.root).world_mesh(fridge)
    assert mesh is not None
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
    assert item.size is not None
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
    assert size is not None
    assert size.tolist() == [0.6, 0.5, 0.5]


def test_an_asset_with_z_up_is_set_upright(made: Any) -> None:
    made.object("table_01", size=[1, 0.6, 0.8], semantic_id=1, COM=[0, 0, 0], up=[0, 0, 1], front=[0, 1, 0])
    assert box(read(made).object_of["table_01:0"]) == [[0.5, 0.0, 0.7], [1.5, 0.8, 1.3]]


def test_mesh_parts_give_the_boxes_again(made: Any) -> None:
    library = MeshLibrary(made.root)
    for item in read(made).objects:
        mesh = library.world_mesh(item)
        assert mesh is not None
        assert item.aabb is not None
        np.testing.assert_allclose([mesh.vertices.min(0), mesh.vertices.max(0)], item.aabb, atol=0.00051)


def test_a_scene_survives_its_tables(made: Any) -> None:
    scene = read(made)
    tables = scene_tables(scene)
    again = scene_tables(scene_from_tables(tables, made.root, family="replicacad"))
    assert all(again[name].equals(tables[name]) for name in tables)


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
    assert (item.raw_label, item.label) == ("table", "clothes hanger")


# --- templates


def test_a_part_of_a_name_finds_its_template(made: Any) -> None:
    made.scene["object_instances"][0]["template_name"] = "able_0"
    made.write_scene()
    scene = read(made)
    assert box(scene.object_of["able_0:0"]) == [[0.5, 0.0, 0.7], [1.5, 0.8, 1.3]]
    made.object("zable_02", size=[9, 9, 9], semantic_id=1)
    scene = read(made)
    assert codes(scene) == ["ambiguous_template"]
    assert scene.object_of["able_0:0"].label == "table"


def test_an_exact_name_is_preferred_to_a_longer_one(made: Any) -> None:
    made.object("a_chair_01_long", size=[9, 9, 9], semantic_id=2)
    scene = read(made)
    assert scene.warnings == ()
    assert box(scene.object_of["chair_01:0"]) == [[2.75, 0.0, 0.8], [3.25, 1.0, 1.2]]


def test_templates_made_in_the_dataset_config(made: Any) -> None:
    made.config["objects"]["default_attributes"] = {"semantic_id": 2, "scale": [2, 2, 2]}
    made.config["objects"]["configs"] = [
        {
            "template_handle": "modified",
            "original_file": "configs/objects/table_01.object_config.json",
            "attributes": {"scale": [3, 3, 3]},
        },
        {"template_handle": "new", "attributes": {"render_asset": "objects/chair_01.glb", "COM": [0, 0, 0]}},
    ]
    made.write_config()
    for entry, name in zip(made.scene["object_instances"], ["modified", "new", "chair_01"], strict=True):
        entry["template_name"] = name
    made.write_scene()
    scene = read(made)
    sizes = {o.object_id: (o.label, None if o.size is None else o.size.tolist()) for o in scene.objects}
    assert sizes["modified:0"] == ("table", [3.0, 2.4, 1.8])
    assert sizes["new:0"] == ("chair", [1.0, 2.0, 0.8])
    assert sizes["chair_01:0"] == ("chair", [0.8, 2.0, 1.0])
    inputs = {i.path for i in made.source().handles()[0].inputs}
    assert {f"made.scene_dataset_config.json#objects.configs.{n}" for n in ("modified", "new")} <= inputs
    assert "made.scene_dataset_config.json#objects.default_attributes" in inputs


def test_assets_named_by_search_path_need_no_config(made: Any) -> None:
    made.config["objects"]["paths"][".glb"] = ["objects/bare/*.glb"]
    made.write_config()
    made.write("objects/bare/crate.glb", (made.root / "objects/table_01.glb").read_bytes())
    made.scene["object_instances"][0]["template_name"] = "crate"
    made.write_scene()
    scene = read(made)
    assert box(scene.object_of["crate:0"]) == [[0.5, 0.0, 0.7], [1.5, 0.8, 1.3]]
    assert codes(scene) == ["unlabelled_object"]


def test_an_unknown_template_keeps_its_place(made: Any) -> None:
    made.scene["object_instances"][0]["template_name"] = "objects/sphinx"
    made.write_scene()
    scene = read(made)
    item = scene.object_of["sphinx:0"]
    assert (item.geometry, item.label, item.center.tolist()) == ("none", "unknown", [1.0, 0.4, 1.0])
    assert codes(scene) == ["missing_template"]


# --- what is missing, and the scene goes on


def test_a_missing_mesh_loses_the_extent_only(made: Any) -> None:
    (made.root / "objects/table_01.glb").unlink()
    scene = read(made)
    item = scene.object_of["table_01:0"]
    assert (item.geometry, item.aabb, item.obb, item.size, item.radius) == ("none", None, None, None, None)
    assert item.center.tolist() == [1.0, 0.4, 1.0]
    (warning,) = scene.warnings
    assert (warning.code, warning.where) == ("missing_mesh", "table_01:0")
    assert "objects/table_01.glb" in warning.message


def test_the_bodys_own_collision_mesh_stands_in(made: Any) -> None:
    made.object("table_01", size=[1, 0.8, 0.6], semantic_id=1, COM=[0, 0, 0], collision_asset="../../objects/cv.glb")
    (made.root / "objects/table_01.glb").rename(made.root / "objects/cv.glb")
    scene = read(made)
    assert codes(scene) == ["collision_mesh_used"]
    assert box(scene.object_of["table_01:0"]) == [[0.5, 0.0, 0.7], [1.5, 0.8, 1.3]]


@pytest.mark.parametrize("gone", ["urdf/fridge/door.glb", "urdf/fridge/fridge.urdf"])
def test_a_missing_link_or_urdf_loses_the_extent(made: Any, gone: str) -> None:
    (made.root / gone).unlink()
    scene = read(made)
    assert scene.object_of["fridge:0"].geometry == "none"
    assert codes(scene) == ["missing_mesh" if gone.endswith("glb") else "missing_template"]


def test_a_missing_stage_mesh_is_said(made: Any) -> None:
    (made.root / "stages/stage.glb").unlink()
    scene = read(made)
    assert scene.stage == ()
    assert codes(scene) == ["missing_stage_mesh"]


def test_a_scene_without_objects_is_returned(made: Any) -> None:
    made.scene = {"stage_instance": {"template_name": "stage"}, "object_instances": []}
    made.write_scene("bare")
    scene = read(made, "bare")
    assert scene.objects == ()
    assert len(scene.rooms) == 1
    assert scene.navmesh is None
    assert codes(scene) == ["no_navmesh"]


# --- bad input: one error that names the file, this scene only


def faults(made: Any) -> dict[str, InputError | None]:
    return {h.scene_id: h.fault for h in made.source().handles()}


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"translation": [0, math.nan, 0]}, "NaN is not allowed"),
        ({"translation": [0, math.inf, 0]}, "Infinity is not allowed"),
        ({"translation": "here"}, "an array is expected, not text"),
        ({"translation": [0, 1]}, "3 numbers are expected, not 2"),
        ({"translation": [0, 1, 1e9]}, "beyond ±100000"),
        ({"rotation": [0, 0, 0, 0]}, "is no rotation"),
        ({"rotation": [1, 0, 0]}, "4 numbers are expected"),
        ({"template_name": 7}, "text is expected, not a number"),
        ({"uniform_scale": 0}, "a scale is zero"),
        ({"motion_type": True}, "text is expected, not true or false"),
    ],
)
def test_a_broken_entry_is_this_scenes_fault_alone(made: Any, change: dict[str, Any], message: str) -> None:
    made.write_scene("sound")
    made.scene["object_instances"][1] |= change
    made.write_scene()
    fault = faults(made)
    assert fault["sound"] is None
    assert isinstance(fault["flat"], FormatError)
    with pytest.raises(FormatError, match=message) as caught:
        read(made)
    assert caught.value.where.endswith("configs/scenes/flat.scene_instance.json")
    assert caught.value.remedy
    assert len(read(made, "sound").objects) == 4


@pytest.mark.parametrize(
    "text",
    [b"", b"{", b"[]", b'{"object_instances": {}}', b'{"object_instances": [], "object_instances": []}', b"\xff"],
)
def test_a_broken_scene_file_is_its_fault_alone(made: Any, text: bytes) -> None:
    made.write_scene("sound")
    made.write("configs/scenes/flat.scene_instance.json", text)
    fault = faults(made)
    assert isinstance(fault["flat"], FormatError)
    assert fault["sound"] is None


def test_a_missing_lexicon_names_it_and_the_mend_suffices(made: Any) -> None:
    lexicon = made.root / "configs/ssd/lexicon.json"
    kept = lexicon.read_bytes()
    lexicon.unlink()
    source = made.source()
    (handle,) = source.handles()
    assert isinstance(handle.fault, MissingFileError)
    assert "configs/ssd/lexicon.json" in str(handle.fault)
    assert handle.fault.remedy.startswith("Download it again")
    with pytest.raises(MissingFileError):
        source.read("flat")
    lexicon.write_bytes(kept)
    assert source.handles()[0].fault is None
    assert len(source.read("flat").objects) == 4


def test_a_truncated_mesh_is_refused_and_the_mend_suffices(made: Any) -> None:
    file = made.root / "objects/table_01.glb"
    kept = file.read_bytes()
    file.write_bytes(kept[:-100])
    source = made.source()
    with pytest.raises(FormatError, match="the header claims") as caught:
        source.read("flat")
    assert caught.value.where == str(file)
    file.write_bytes(kept)
    assert len(source.read("flat").objects) == 4


@pytest.mark.parametrize("value", ["../../../secret.glb", "/etc/passwd", "../../../../../../etc/passwd.glb"])
@pytest.mark.parametrize("key", ["render_asset", "collision_asset"])
def test_a_path_out_of_the_root_is_refused(made: Any, key: str, value: str) -> None:
    (made.root / "objects/table_01.glb").unlink()
    config = {"render_asset": "../../objects/table_01.glb", "semantic_id": 1, key: value}
    made.json("configs/objects/table_01.object_config.json", config)
    with pytest.raises(PathEscapeError) as caught:
        read(made)
    assert caught.value.where.endswith("table_01.object_config.json")
    assert caught.value.place == key


def test_a_symlink_out_of_the_root_is_refused(made: Any, tmp_path: Path) -> None:
    file = made.root / "objects/table_01.glb"
    (tmp_path / "outside.glb").write_bytes(file.read_bytes())
    file.unlink()
    file.symlink_to(tmp_path / "outside.glb")
    with pytest.raises(PathEscapeError, match="symbolic link"):
        read(made)


def test_links_of_a_urdf_stay_inside(made: Any) -> None:
    urdf = made.root / "urdf/fridge/fridge.urdf"
    urdf.write_bytes(urdf.read_bytes().replace(b"door.glb", b"../../../door.glb"))
    with pytest.raises(PathEscapeError, match="climbs out") as caught:
        read(made)
    assert caught.value.place == "link door"


def test_a_search_path_beside_the_dataset_is_not_followed(made: Any) -> None:
    robots = made.root.parent / "robots"
    robots.mkdir()
    (robots / "fetch.urdf").write_text("not xml")
    assert read(made).warnings == ()


@pytest.mark.parametrize(
    ("data", "message"),
    [(b"TESM", "file header"), (b"XXXX" + bytes(300), "not 'TESM'"), (None, "bytes")],
)
def test_a_broken_navmesh_is_refused(made: Any, data: bytes | None, message: str) -> None:
    file = made.root / "navmeshes_default/flat.navmesh"
    file.write_bytes(file.read_bytes()[:-7] if data is None else data)
    fault = faults(made)["flat"]
    assert isinstance(fault, FormatError)
    assert message in str(fault)
    assert fault.where == str(file)


# --- the navmesh


def test_the_navmesh_that_fits_the_agent_is_taken(made: Any) -> None:
    scene = read(made)
    assert scene.navmesh is not None
    assert (scene.navmesh.path, scene.navmesh.fits, scene.navmesh.built) == (
        "navmeshes_default/flat.navmesh",
        True,
        False,
    )
    assert scene.navmesh.agent_radius == 0.1
    wide = read(made, agent=Agent(radius=0.3))
    assert wide.navmesh is not None
    assert (wide.navmesh.path, wide.navmesh.fits) == ("navmeshes/flat.navmesh", True)
    assert wide.warnings == ()


def test_else_a_shipped_one_with_a_warning(made: Any) -> None:
    scene = read(made, agent=Agent(radius=0.2))
    assert scene.navmesh is not None
    assert (scene.navmesh.path, scene.navmesh.fits, scene.navmesh.agent_radius) == (
        "navmeshes/flat.navmesh",
        False,
        0.3,
    )
    assert codes(scene) == ["navmesh_does_not_fit"]


def test_an_unknown_navmesh_handle_falls_back_to_the_scenes_name(made: Any) -> None:
    made.scene["navmesh_instance"] = "empty_stage_navmesh"
    made.write_scene()
    scene = read(made)
    assert scene.navmesh is not None
    assert scene.navmesh.path == "navmeshes_default/flat.navmesh"
    assert codes(scene) == ["navmesh_handle_unknown"]


def test_a_dangling_navmesh_entry_is_no_fault(made: Any) -> None:
    made.scene["navmesh_instance"] = "withheld"
    made.write_scene("withheld")
    assert faults(made) == {"flat": None, "withheld": None}
    assert read(made, "withheld").navmesh is None


def test_scenes_may_share_a_navmesh_of_either_radius(made: Any) -> None:
    made.write_scene("twin")
    assert [read(made, name).navmesh for name in ("flat", "twin")] == [read(made).navmesh] * 2


def test_an_asked_folder_of_navmeshes_comes_first(made: Any) -> None:
    made.navmesh("mine/flat.navmesh", 0.1)
    scene = read(made, navmesh="mine")
    assert scene.navmesh is not None
    assert scene.navmesh.path == "mine/flat.navmesh"


# --- rooms

ROOMS = [
    {
        "name": "east",
        "label": "kitchen",
        "poly_loop": [[2.5, 0, 0], [6, 0, 0], [6, 0, 4], [2.5, 0, 4]],
        "floor_height": 0,
        "extrusion_height": 2.5,
    },
    {"name": "west", "label": "living room", "poly_loop": [[0, 0, 0], [2.5, 0, 0], [2.5, 0, 2], [0, 0, 2]]},
]


def test_regions_of_the_dataset_are_its_rooms(made: Any) -> None:
    made.lexicon([("table", 1), ("chair", 2)], region_annotations=ROOMS)
    scene = read(made)
    assert [(r.room_id, r.raw_label, r.label, r.annotation) for r in scene.rooms] == [
        ("east", "kitchen", "kitchen", "dataset"),
        ("west", "living room", "living room", "dataset"),
    ]
    assert {o.object_id: o.room_id for o in scene.objects} == {
        "chair_01:0": "east", "chair_01:1": "east", "fridge:0": "east", "table_01:0": "west"
    }  # fmt: skip
    assert scene.rooms[1].polygon is not None
    assert scene.rooms[1].polygon.tolist() == [[0, 0], [2.5, 0], [2.5, 2], [0, 2]]
    assert (scene.rooms[1].floor_y, scene.rooms[1].ceiling_y) == (0.0, 2.5)


def test_a_scenes_own_descriptor_brings_rooms_and_the_default_one_the_classes(made: Any) -> None:
    made.json("configs/ssd/flat.semantic_config.json", {"region_annotations": ROOMS})
    made.config["semantic_scene_descriptor_instances"]["paths"] = {".json": ["configs/ssd"]}
    made.write_config()
    made.scene["semantic_scene_instance"] = "%%CONFIG_NAME_AS_ASSET_FILENAME%%.semantic_config.json"
    made.write_scene()
    scene = read(made)
    assert [r.room_id for r in scene.rooms] == ["east", "west"]
    assert scene.object_of["table_01:0"].label == "table"


def test_a_side_file_is_marked_as_the_users(made: Any, tmp_path: Path) -> None:
    side = tmp_path / "zones" / "stage.semantic_config.json"
    side.parent.mkdir()
    side.write_text('{"region_annotations": [{"name": "z", "label": "bedroom", "poly_loop": '
                    '[[0, 0, 0], [6, 0, 0], [6, 0, 4], [0, 0, 4]]}]}')  # fmt: skip
    for regions in (side, side.parent):
        scene = read(made, regions=regions)
        assert [(r.room_id, r.label, r.annotation) for r in scene.rooms] == [("z", "bedroom", "user")]
        (handle,) = made.source(regions=regions).handles()
        assert "regions/stage.semantic_config.json#region_annotations" in {i.path for i in handle.inputs}
    with pytest.raises(ConfigError, match="is not there"):
        made.source(regions=tmp_path / "none")


def test_an_object_in_no_room_is_left_out_and_said(made: Any) -> None:
    made.scene["object_instances"][0]["translation"] = [2.2, 0.4, 2.7]
    made.write_scene()
    made.lexicon([("table", 1), ("chair", 2)], region_annotations=ROOMS)
    scene = read(made)
    assert "table_01:0" not in scene.object_of
    assert [(w.code, w.where) for w in scene.warnings] == [("object_outside_rooms", "table_01:0")]


# --- handles


def test_inputs_are_all_that_is_read_and_no_more(made: Any) -> None:
    made.write_scene("other")
    flat, other = made.source().handles()
    assert [i.path for i in flat.inputs] == [
        "configs/objects/chair_01.object_config.json",
        "configs/objects/table_01.object_config.json",
        "configs/scenes/flat.scene_instance.json",
        "configs/ssd/lexicon.json#classes.1",
        "configs/ssd/lexicon.json#classes.2",
        "configs/stages/stage.stage_config.json",
        "made.scene_dataset_config.json#navmesh_instances.flat",
        "made.scene_dataset_config.json#semantic_scene_descriptor_instances.map",
        "navmeshes/flat.navmesh",
        "navmeshes_default/flat.navmesh",
        "objects/chair_01.glb",
        "objects/table_01.glb",
        "stages/stage.glb",
        "urdf/fridge/body.glb",
        "urdf/fridge/door.glb",
        "urdf/fridge/fridge.urdf",
    ]
    assert (flat.family, flat.scene_id, other.scene_id) == ("replicacad", "flat", "other")
    assert flat.cost > 0


def test_a_change_elsewhere_in_a_shared_file_changes_no_input(made: Any) -> None:
    (before,) = made.source().handles()
    made.lexicon([("table", 1), ("chair", 2), ("refrigerator", 3), ("sphinx", 4)])
    made.config["navmesh_instances"]["new"] = "navmeshes/new.navmesh"
    made.write_config()
    (after,) = made.source().handles()
    assert before.inputs == after.inputs
    made.lexicon([("desk", 1), ("chair", 2)])
    (after,) = made.source().handles()
    changed = {i.path for i in set(before.inputs) ^ set(after.inputs)}
    assert changed == {"configs/ssd/lexicon.json#classes.1"}


def test_what_appears_later_is_a_new_input(made: Any) -> None:
    mesh = made.root / "objects/table_01.glb"
    kept = mesh.read_bytes()
    mesh.unlink()
    (before,) = made.source().handles()
    mesh.write_bytes(kept)
    (after,) = made.source().handles()
    assert {i.path for i in set(after.inputs) - set(before.inputs)} == {"objects/table_01.glb"}


def test_listing_reads_no_mesh(made: Any) -> None:
    for name in ("table_01", "chair_01"):
        (made.root / f"objects/{name}.glb").write_bytes(b"not a mesh")
    (handle,) = made.source().handles()
    assert handle.fault is None


def test_scenes_are_chosen_by_id_and_pattern(made: Any) -> None:
    for name in ("b1", "b2", "c1"):
        made.write_scene(name)

    def ids(**options: Any) -> list[str]:
        return [h.scene_id for h in made.source(**options).handles()]

    assert ids() == ["b1", "b2", "c1", "flat"]
    assert ids(scenes=["b?"]) == ["b1", "b2"]
    assert ids(scenes=["*"], exclude=["b*", "flat"]) == ["c1"]
    assert ids(scenes=["c1", "b1"]) == ["b1", "c1"]
    with pytest.raises(ConfigError, match=r"none of the 4 scenes fits z\*"):
        ids(scenes=["z*"])
    found = made.source(scenes=["b1", "zz"]).handles()
    assert [(h.scene_id, type(h.fault)) for h in found] == [("b1", type(None)), ("zz", MissingFileError)]


def test_a_root_that_is_none_is_one_clear_error(made: Any, tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="is not there") as caught:
        open_source("replicacad", tmp_path / "nowhere")
    assert "nowhere" in caught.value.where
    with pytest.raises(ConfigError, match="0 files"):
        open_source("replicacad", tmp_path)
    with pytest.raises(ConfigError, match="unknown source family 'x'"):
        open_source("x", made.root)
    os.link(made.root / "made.scene_dataset_config.json", made.root / "b.scene_dataset_config.json")
    with pytest.raises(ConfigError, match="2 files"):
        made.source()
