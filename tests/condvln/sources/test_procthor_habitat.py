"""ProcTHOR's houses in Habitat's form: rooms come back from the houses, and all else from the scenes."""

from __future__ import annotations

import gzip
import json
from collections import Counter
from pathlib import Path

import numpy as np
import pytest

from condvln.labels import vocabulary
from condvln.relations import CANONICAL, relate_room
from condvln.samples import make_samples
from condvln.scene import RoomArrays, Scene
from condvln.sources.family import look_for
from condvln.sources.registry import open_source
from condvln.sources.scene_source import Source
from schemas.config import Thresholds
from schemas.errors import ConfigError, FormatError, MissingFileError

SCENES, SEED = 3, 21
HOUSES = "houses/train.jsonl.gz"


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    make_samples(tmp_path, "ai2thor-hab", SCENES, SEED)
    return tmp_path


@pytest.fixture
def plain(tmp_path: Path) -> list[Scene]:
    """The same houses from their JSON alone."""
    make_samples(tmp_path / "plain", "procthor", SCENES, SEED)
    source = open_source("procthor", tmp_path / "plain")
    return [source.read(f"houses-{k}") for k in range(SCENES)]


def joined(folder: Path) -> Source:
    return open_source("procthor", folder / "hab", houses=folder / "houses")


def graph(scene: Scene) -> Counter[tuple[object, ...]]:
    """Every edge by its room, and the label and box of its ends."""
    edges: Counter[tuple[object, ...]] = Counter()
    for room in scene.rooms:
        objects = [o for o in scene.objects if o.room_id == room.room_id and vocabulary.fit_for_text(o.label)]
        found = relate_room(RoomArrays.of(room.room_id, objects), Thresholds())
        ends = [(o.label, *np.round(o.aabb, 3).ravel().tolist()) for o in found.objects.objects if o.aabb is not None]
        for i, j in zip(*np.nonzero(~np.eye(len(ends), dtype=bool)), strict=True):
            names = [CANONICAL[found.canonical[i, j]] if found.canonical[i, j] >= 0 else "none"]
            names += [name for name, holds in found.semantic.items() if holds[i, j]]
            edges.update((room.room_id, ends[i], name, ends[j]) for name in names)
    return edges


def test_rooms_and_relations_are_those_of_the_houses(folder: Path, plain: list[Scene]) -> None:
    source = joined(folder)
    handles = source.handles()
    assert [(h.family, h.scene_id, h.fault) for h in handles] == [
        ("procthor", f"ProcTHOR-Train-{k}", None) for k in range(SCENES)
    ]
    for k, expected in enumerate(plain):
        assert f"houses/train.jsonl.gz#{k}" in {i.path for i in handles[k].inputs}
        scene = source.read(f"ProcTHOR-Train-{k}")
        for mine, its in zip(scene.rooms, expected.rooms, strict=True):
            assert (mine.room_id, mine.label, mine.annotation) == (its.room_id, its.label, "dataset")
            np.testing.assert_array_equal(mine.polygon, its.polygon)
        assert sum(graph(expected).values()) > 300
        assert graph(scene) == graph(expected)
        assert not [w for w in scene.warnings if w.code == "object_outside_rooms"]
        # The scene has meshes, where the house has boxes only.
        surfaces = source.geometry(scene)
        assert not surfaces.approximate


def test_a_house_half_a_turn_away_is_turned_back(folder: Path, plain: list[Scene]) -> None:
    """Unity's x mirrored instead of its z: what exporters of glTF do."""
    for path in (folder / "hab/configs/scenes/ProcTHOR").rglob("*.json"):
        document = json.loads(path.read_text())
        for key in ("object_instances", "articulated_object_instances"):
            for item in document[key]:
                x, y, z = item["translation"]
                w, _, spin, _ = item["rotation"]
                item["translation"], item["rotation"] = [-x, y, -z], [-spin, 0.0, w, 0.0]
        path.write_text(json.dumps(document))
    for k, expected in enumerate(plain):
        scene = joined(folder).read(f"ProcTHOR-Train-{k}")
        rooms = Counter((o.room_id, o.label) for o in scene.objects)
        assert rooms == Counter((o.room_id, o.label) for o in expected.objects if o.label in {b for _, b in rooms})
        for mine, its in zip(scene.rooms, expected.rooms, strict=True):
            assert mine.polygon is not None
            np.testing.assert_array_equal(-mine.polygon, its.polygon)


def test_another_house_of_the_name_is_refused(folder: Path) -> None:
    lines = gzip.decompress((folder / HOUSES).read_bytes()).splitlines()
    (folder / HOUSES).write_bytes(gzip.compress(b"\n".join([lines[1], lines[0], lines[2]])))
    source = joined(folder)
    for k in (0, 1):
        with pytest.raises(FormatError, match=f"not where scene 'ProcTHOR-Train-{k}' has them") as caught:
            source.read(f"ProcTHOR-Train-{k}")
        assert caught.value.place == f"train-{k}"
    assert len(source.read("ProcTHOR-Train-2").rooms) > 1


def test_a_missing_house_is_its_scenes_fault(folder: Path) -> None:
    lines = gzip.decompress((folder / HOUSES).read_bytes()).splitlines()
    (folder / HOUSES).write_bytes(gzip.compress(b"\n".join(lines[:2])))
    faults = {h.scene_id: h.fault for h in joined(folder).handles()}
    assert [name for name, fault in faults.items() if fault is not None] == ["ProcTHOR-Train-2"]
    with pytest.raises(MissingFileError, match="line 3"):
        joined(folder).read("ProcTHOR-Train-2")


def test_scenes_without_houses_are_not_listed(folder: Path) -> None:
    scenes = folder / "hab/configs/scenes/ProcTHOR/0"
    (scenes / "FloorPlan1_physics.scene_instance.json").write_bytes(
        (scenes / "ProcTHOR-Train-0.scene_instance.json").read_bytes()
    )
    assert len(joined(folder).handles()) == SCENES


def test_nothing_is_missing_that_is_not_needed(folder: Path) -> None:
    (folder / "houses/asset-database.json").unlink()
    found = look_for("procthor", folder / "hab", folder / "houses")
    assert [(f.download.holds, f.files) for f in found if f.download.need == "required" and not f.files] == []
    assert {f.download.holds: f.files for f in found}["houses"] == 1
    assert {f.download.holds: f.files for f in found}["scene instances"] == SCENES
    assert len(joined(folder).read("ProcTHOR-Train-0").rooms) > 1
    (folder / HOUSES).unlink()
    assert {f.download.holds: f.files for f in look_for("procthor", folder / "hab", folder / "houses")}["houses"] == 0


def test_what_is_refused(folder: Path) -> None:
    with pytest.raises(ConfigError, match="names houses, which only ProcTHOR has"):
        open_source("replicacad", folder / "hab", houses=folder / "houses")
    with pytest.raises(ConfigError, match="folder of houses does not exist"):
        open_source("procthor", folder / "hab", houses=folder / "nowhere")
