"""HSSD: made scenes in the released layout, with labels from the table of models."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

import orjson
import pytest

from condvln.samples import make_samples
from condvln.scene import Scene
from condvln.sources.registry import open_source
from condvln.sources.source import UNKNOWN_LABEL
from schemas.errors import InputError

SCENE = "scenes/made_000.scene_instance.json"


@pytest.fixture(scope="module")
def once(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("hssd")
    make_samples(folder, family="hssd", scenes=1, seed=2)
    return folder


@pytest.fixture
def made(once: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(once, tmp_path / "hssd"))


def read(folder: Path) -> Scene:
    return open_source("hssd", folder).read("made_000")


def change(folder: Path, path: str, **keys: Any) -> None:
    document = orjson.loads((folder / path).read_bytes())
    (folder / path).write_bytes(orjson.dumps({**document, **keys}))


def labels(scene: Scene) -> dict[str, str]:
    return {o.object_id: o.raw_label for o in scene.objects}


def test_categories_of_the_table_come_before_the_classes_of_the_lexicon(made: Path) -> None:
    before = read(made)
    rigid = [o for o in before.objects if len(o.object_id.partition(":")[0]) == 40]
    assert len(rigid) > 10
    lines = (made / "semantics/objects.csv").read_text().splitlines()
    assert {o.raw_label for o in rigid} <= {line.split(",")[2] for line in lines[1:]}
    name = rigid[0].object_id.partition(":")[0]
    table = "\n".join(f"{line.rpartition(',')[0]},guitar" if line.startswith(name) else line for line in lines)
    (made / "semantics/objects.csv").write_text(table)
    after = read(made)
    assert {k for k, raw in labels(after).items() if raw != labels(before)[k]} == {
        o.object_id for o in rigid if o.object_id.startswith(name)
    }


def test_without_the_table_the_classes_count_and_others_are_unlabelled(made: Path) -> None:
    with_table = read(made)
    (made / "semantics/objects.csv").unlink()
    scene = read(made)
    classed = {
        path.name.partition(".")[0]: "semantic_id" in orjson.loads(path.read_bytes())
        for path in made.glob("objects/*/*.object_config.json")
    }
    assert set(classed.values()) == {True, False}
    for item in scene.objects:
        known = classed.get(item.object_id.partition(":")[0], True)
        assert item.raw_label == (labels(with_table)[item.object_id] if known else UNKNOWN_LABEL)
    unsure = {o.room_id for o in scene.objects if o.raw_label == UNKNOWN_LABEL}
    assert {room.room_id for room in scene.rooms if not room.complete} == unsure != set()


def test_openings_are_no_objects_of_unknown_kind(made: Path) -> None:
    """A door without a category does not keep its rooms from counting as completely annotated."""
    model = next(made.glob("objects/[0-9a-f]/*.glb"))
    (made / "objects/openings").mkdir()
    shutil.copy(model, made / "objects/openings/200-3.glb")
    config = {"render_asset": "200-3.glb", "up": [0, 1, 0], "front": [0, 0, -1]}
    (made / "objects/openings/200-3.object_config.json").write_bytes(orjson.dumps(config))
    placed = orjson.loads((made / SCENE).read_bytes())["object_instances"]
    change(made, SCENE, object_instances=[*placed, {**placed[0], "template_name": "200-3"}])
    scene = read(made)
    assert scene.object_of["200-3:0"].raw_label == "opening"
    assert not [warning for warning in scene.warnings if warning.code == "unlabelled_object"]
    assert all(room.complete for room in scene.rooms)


def test_without_annotated_regions_the_house_is_one_room(made: Path) -> None:
    """The first release: one lexicon for all scenes, no rooms, another configuration beside the first."""
    config = {
        "scene_instances": {
            "default_attributes": {"default_lighting": "", "semantic_scene_instance": "hssd_ssd_map"},
            "paths": {".json": ["scenes"]},
        },
        "semantic_scene_descriptor_instances": {"hssd_ssd_map": "semantics/hssd-hab_semantic_lexicon.json"},
    }
    change(made, "hssd-hab.scene_dataset_config.json", **config)
    shutil.rmtree(made / "semantics/scenes")
    (made / "hssd-hab-uncluttered.scene_dataset_config.json").write_bytes(b"{}")
    scene = read(made)
    assert [room.label for room in scene.rooms] == ["apartment"]
    assert len(scene.objects) > 10


@pytest.mark.parametrize(
    ("table", "message"),
    [
        (b"", "no column id and no column main_category"),
        (b"id,name\nx,y\n", "no column main_category"),
        (b"\xff\xfe\x00id", "not a table"),
        (b'id,main_category\n"x,chair\n', "not a table"),
        (b"id,main_category\n" + b"a" * 200_000 + b",chair\n", "not a table"),
    ],
)
def test_a_broken_table_is_one_error_that_names_it(made: Path, table: bytes, message: str) -> None:
    (made / "semantics/objects.csv").write_bytes(table)
    with pytest.raises(InputError, match=message) as caught:
        read(made)
    assert "objects.csv" in str(caught.value.where)


def test_rows_of_the_table_that_lack_cells_are_passed_over(made: Path) -> None:
    before, lines = labels(read(made)), (made / "semantics/objects.csv").read_text()
    (made / "semantics/objects.csv").write_text(lines + "\n\nlonely\n,,\n,,chair\n")
    assert labels(read(made)) == before
