"""Rooms of a scene dataset, from its regions or a file of the user."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from schemas.errors import ConfigError, MissingFileError
from tests.condvln.sources.replicacad_reading import read

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


@pytest.mark.parametrize("of_all", [True, False])
def test_the_classes_may_be_in_a_file_that_the_descriptor_links_to(made: Any, of_all: bool) -> None:
    """As in HSSD with annotated regions: each scene has a descriptor, and all link to one lexicon."""
    made.json("semantics/lexicon.json", {"classes": [{"name": "desk", "id": 1}, {"name": "stool", "id": 2}]})
    link = {"semantic_descriptor_filename": "../lexicon.json"}
    own = {"region_annotations": ROOMS}
    made.json("semantics/scenes/flat.semantic_config.json", own if of_all else own | link)
    made.config["semantic_scene_descriptor_instances"] = {
        "paths": {".json": ["semantics/scenes/*"]},
        **({"default_attributes": link} if of_all else {}),
    }
    made.config["scene_instances"]["default_attributes"] = {
        "semantic_scene_instance": "%%CONFIG_NAME_AS_ASSET_FILENAME%%.semantic_config.json"
    }
    made.write_config()
    made.scene.pop("semantic_scene_instance", None)
    made.write_scene()
    scene = read(made)
    assert [r.room_id for r in scene.rooms] == ["east", "west"]
    assert scene.object_of["table_01:0"].label == "desk"
    (made.root / "semantics" / "lexicon.json").unlink()
    with pytest.raises(MissingFileError, match="the semantic lexicon file does not exist"):
        read(made)


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
    with pytest.raises(ConfigError, match="does not exist"):
        made.source(regions=tmp_path / "none")


def test_an_object_in_no_room_is_left_out_and_said(made: Any) -> None:
    made.scene["object_instances"][0]["translation"] = [2.2, 0.4, 2.7]
    made.write_scene()
    made.lexicon([("table", 1), ("chair", 2)], region_annotations=ROOMS)
    scene = read(made)
    assert "table_01:0" not in scene.object_of
    assert [(w.code, w.where) for w in scene.warnings] == [("object_outside_rooms", "table_01:0")]
