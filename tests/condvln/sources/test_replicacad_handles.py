"""What a scene of the dataset is keyed on, and which scenes are listed."""

from __future__ import annotations

from typing import Any

import pytest

from schemas.errors import ConfigError, MissingFileError


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
    # What the cost of a run is estimated from.
    scene = made.source().read("flat")
    assert (flat.counts.objects, flat.counts.rooms) == (len(scene.objects), len(scene.rooms))
    assert flat.counts.navmesh_bytes == max(i.size for i in flat.inputs if i.path.endswith(".navmesh"))
    assert flat.counts.mesh_bytes == sum(i.size for i in flat.inputs if i.path.endswith(".glb"))


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
