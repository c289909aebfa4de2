"""Templates of a scene dataset: how they are found, and what is missing of them."""

from __future__ import annotations

from typing import Any

import pytest

from tests.condvln.sources.replicacad_reading import box, codes, read

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
    assert codes(scene) == []


def test_templates_that_come_and_go_are_seen(made: Any) -> None:
    made.write_scene()
    assert codes(read(made)) == []
    made.scene["object_instances"][0]["template_name"] = "able_0"
    made.scene["articulated_object_instances"][0]["template_name"] = "cupboard"
    made.write_scene()
    made.object("zable_02", size=[9, 9, 9], semantic_id=1)
    assert codes(read(made)) == ["ambiguous_template", "missing_template"]
    (made.root / "configs/objects/zable_02.object_config.json").unlink()
    for path in (made.root / "urdf/fridge").iterdir():
        made.write(f"urdf/cupboard/{path.name.replace('fridge', 'cupboard')}", path.read_bytes())
    assert codes(read(made)) == ["unlabelled_object"]
    made.config["objects"]["paths"][".json"] = []
    made.write_config()
    assert "missing_template" in codes(read(made))
