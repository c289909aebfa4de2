"""Bad input in a scene dataset: one error that names the file, for that scene only."""

from __future__ import annotations

import math
import os
import re
from pathlib import Path
from typing import Any

import pytest

from condvln.sources.registry import open_source
from schemas.errors import ConfigError, FormatError, MissingFileError, PathEscapeError
from tests.condvln.sources.replicacad_reading import faults, read


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"translation": [0, math.nan, 0]}, "the number NaN is not finite"),
        ({"translation": [0, math.inf, 0]}, "the number Infinity is not finite"),
        ({"translation": "here"}, "an array is expected, not text"),
        ({"translation": [0, 1]}, "3 numbers are expected, not 2"),
        ({"translation": [0, 1, 1e9]}, "beyond ±100000"),
        ({"rotation": [0, 0, 0, 0]}, "is not a rotation"),
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


def first_fault(made: Any) -> str:
    try:
        return next((str(handle.fault) for handle in made.source().handles() if handle.fault is not None), "")
    except (ConfigError, FormatError) as error:
        return str(error)


def test_a_number_that_is_not_finite_costs_its_scene_wherever_it_is(made: Any) -> None:
    """In each number of each JSON file: it is refused where the file is read, so that no hash of inputs meets it."""
    found = 0
    for file in sorted(made.root.rglob("*.json")):
        sound = file.read_bytes()
        for number in re.finditer(rb"(?<=[\[:,\s])-?[0-9.]+(?=[,\]\s}])", sound):
            file.write_bytes(sound[: number.start()] + b"1e999" + sound[number.end() :])
            found += 1
            assert "1e999 is not finite" in first_fault(made)
        file.write_bytes(sound)
    assert found > 20


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


def test_links_of_a_urdf_stay_inside(made: Any) -> None:
    urdf = made.root / "urdf/fridge/fridge.urdf"
    urdf.write_bytes(urdf.read_bytes().replace(b"door.glb", b"../../../door.glb"))
    with pytest.raises(PathEscapeError, match="leads out of the dataset") as caught:
        read(made)
    assert caught.value.place == "link door"


def test_a_search_path_beside_the_dataset_is_not_followed(made: Any) -> None:
    robots = made.root.parent / "robots"
    robots.mkdir()
    (robots / "fetch.urdf").write_text("not xml")
    assert read(made).warnings == ()


def test_a_root_that_is_none_is_one_clear_error(made: Any, tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="does not exist") as caught:
        open_source("replicacad", tmp_path / "nowhere")
    assert "nowhere" in caught.value.where
    with pytest.raises(ConfigError, match="0 files"):
        open_source("replicacad", tmp_path)
    with pytest.raises(ConfigError, match="unknown source family 'x'"):
        open_source("x", made.root)
    os.link(made.root / "made.scene_dataset_config.json", made.root / "b.scene_dataset_config.json")
    with pytest.raises(ConfigError, match="2 files"):
        made.source()


def test_a_variant_of_the_configuration_may_be_beside_it(made: Any) -> None:
    """HSSD has hssd-hab and hssd-hab-uncluttered in one folder: the shorter name is the dataset."""
    before = read(made)
    variant = made.root / "made-uncluttered.scene_dataset_config.json"
    variant.write_text("{}")
    after = read(made)
    assert [o.object_id for o in after.objects] == [o.object_id for o in before.objects] != []
    variant.rename(made.root / "madeuncluttered.scene_dataset_config.json")
    with pytest.raises(ConfigError, match="2 files"):
        made.source()
