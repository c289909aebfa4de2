"""The VLN-CE document: the real file reads and writes to equal JSON."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from condvln.export.tables import rows_of
from condvln.export.vlnce import ground_truth, scene_file
from schemas.vlnce import GroundTruth, VlnCeDocument
from tests.made_snapshot import MemoryTables
from tests.strict_loader import load_split, read


def test_the_real_sample_reads_and_writes_to_equal_json(real_data: Path) -> None:
    stock = read(real_data / "vlnce" / "val_seen_sample.json.gz")
    again = VlnCeDocument.model_validate(stock).model_dump(mode="json", exclude_unset=True)
    assert json.dumps(again) == json.dumps(stock)
    truths = read(real_data / "vlnce" / "val_seen_sample_gt.json.gz")
    for truth in truths.values():
        again = GroundTruth.model_validate(truth).model_dump(mode="json", exclude_unset=True)
        assert again == truth
        assert len(truth["locations"]) == truth["forward_steps"] + 1


def test_our_strict_loader_takes_the_real_sample(real_data: Path) -> None:
    assert len(load_split(real_data / "vlnce" / "val_seen_sample.json.gz")) == 30


def test_our_keys_are_those_of_the_real_sample(real_data: Path, exported: Path) -> None:
    stock = read(real_data / "vlnce" / "val_seen_sample.json.gz")
    ours = read(exported / "vlnce" / "train" / "train.json.gz")
    assert list(ours) == list(stock)
    assert list(ours["instruction_vocab"]) == list(stock["instruction_vocab"])
    for key in ("instruction", None):
        a, b = (d["episodes"][0][key] if key else d["episodes"][0] for d in (stock, ours))
        assert list(a) == list(b)
    assert list(ours["episodes"][0]["goals"][0]) == list(stock["episodes"][0]["goals"][0])
    assert len(ours["episodes"][0]["instruction"]["instruction_tokens"]) == 200


def test_walked_locations_come_before_the_dense_path(tables: MemoryTables) -> None:
    row = next(row for row in rows_of(tables.tables["replicacad"]["episodes"]) if row["actions"])
    assert ground_truth(row)["actions"] == row["actions"]
    assert ground_truth(row)["locations"] == row["locations"]
    bare = ground_truth({**row, "actions": None, "locations": None})
    assert "actions" not in bare
    assert bare["forward_steps"] == len(bare["locations"]) - 1


@pytest.mark.parametrize(
    ("family", "scene", "path"),
    [
        ("mp3d", "17DRP5sb8fy", "mp3d/17DRP5sb8fy/17DRP5sb8fy.glb"),
        ("gibson", "Oyens", "gibson/Oyens/Oyens.glb"),
        ("gibson", "verified/Oyens", "gibson/Oyens/Oyens.glb"),
        ("gibson", "automated/Oyens", "gibson/Oyens/Oyens.glb"),
        ("replicacad", "v3_sc0_staging_00", "replicacad/v3_sc0_staging_00/v3_sc0_staging_00.glb"),
        ("procthor", "train-7", "procthor/train-7/train-7.glb"),
        ("procthor", "10k/train-7", "procthor/10k/train-7/train-7.glb"),
        ("procthor", "ProcTHOR-Train-7", "procthor/ProcTHOR-Train-7/ProcTHOR-Train-7.glb"),
        ("ithor", "FloorPlan207", "ithor/FloorPlan207/FloorPlan207.glb"),
        ("hm3d", "val/00800-TEEsavR23oF", "hm3d/val/00800-TEEsavR23oF/TEEsavR23oF.basis.glb"),
        ("robothor", "FloorPlan_Val1_1", "robothor/FloorPlan_Val1_1/FloorPlan_Val1_1.glb"),
    ],
)
def test_scene_files_are_where_stock_loaders_have_them(family: str, scene: str, path: str) -> None:
    """A mesh in a folder of its own name, one folder below the dataset's; of one building there is one mesh."""
    assert scene_file(family, scene) == path
