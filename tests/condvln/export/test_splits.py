"""Groups of scenes: the official lists, and hashes that no other scene moves."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from pydantic import ValidationError

from condvln.export.splits import fractions, hash_fraction, scene_group
from schemas.config import SplitsConfig
from schemas.errors import ConfigError

CONFIG = SplitsConfig()


def test_official_lists_are_the_published_ones(real_data: Path) -> None:
    facts = real_data.parent / "facts" / "splits.json"
    if not facts.exists():
        pytest.skip("the published lists are not here to compare with")
    lists = json.loads(facts.read_text())
    for group in ("train", "val_unseen", "test"):
        assert all(scene_group("mp3d", scene, CONFIG) == group for scene in lists["mp3d"][group])
    names = {"train": "train", "val": "val_unseen", "test": "test"}
    for scene, row in lists["gibson"]["scenes"].items():
        assert scene_group("gibson", scene, CONFIG) == names[row["full_plus"]]


@pytest.mark.parametrize(
    ("family", "scene", "group"),
    [
        ("mp3d", "17DRP5sb8fy", "train"),
        ("mp3d", "2azQ1b91cZZ", "val_unseen"),
        ("mp3d", "2t7WUuJeko7", "test"),
        ("gibson", "Allensville", "train"),
        ("gibson", "verified/Allensville", "train"),
        ("gibson", "automated/Allensville", "train"),
        ("ithor", "FloorPlan1", "train"),
        ("ithor", "FloorPlan20_physics", "train"),
        ("ithor", "FloorPlan21", "val_unseen"),
        ("ithor", "FloorPlan26", "test"),
        ("ithor", "FloorPlan207", "train"),
        ("ithor", "FloorPlan325", "val_unseen"),
        ("ithor", "FloorPlan430", "test"),
        ("robothor", "FloorPlan_Train3_2", "train"),
        ("robothor", "FloorPlan_Val1_1", "val_unseen"),
        ("hm3d", "train/00799-xyz", "train"),
        ("hm3d", "minival/00800-TEEsavR23oF", "val_unseen"),
        ("hm3d", "00899-xyz", "val_unseen"),
        ("hm3d", "test/00900-xyz", "test"),
        ("replicacad", "v3_sc0_staging_07", "train"),
        ("replicacad", "v3_sc1_staging_07", "val_unseen"),
        ("replicacad", "v3_sc1_staging_10", "val_unseen"),
        ("replicacad", "v3_sc1_staging_11", "test"),
        ("replicacad", "v3_sc2_staging_20", "train"),
        ("replicacad", "v3_sc3_staging_07", "test"),
        ("replicacad", "apt_2", "test"),
    ],
)
def test_group_by_name(family: str, scene: str, group: str) -> None:
    assert scene_group(family, scene, CONFIG) == group


def test_other_scenes_go_by_their_own_hash() -> None:
    groups = [scene_group("procthor", f"house_{i}", CONFIG) for i in range(4000)]
    for group, share in (("train", 0.8), ("val_unseen", 0.1), ("test", 0.1)):
        assert groups.count(group) / 4000 == pytest.approx(share, abs=0.025)
    other = SplitsConfig(seed=1)
    assert groups != [scene_group("procthor", f"house_{i}", other) for i in range(4000)]
    assert scene_group("procthor", "house_0", SplitsConfig(fractions=(0, 0, 1))) == "test"


def test_the_configuration_goes_before_lists_and_hashes() -> None:
    config = SplitsConfig(scenes={"train": ("procthor/train-*",), "test": ("procthor/test-?", "mp3d/17DRP5sb8fy")})
    assert {scene_group("procthor", f"train-{i}", config) for i in range(50)} == {"train"}
    assert scene_group("procthor", "test-7", config) == scene_group("mp3d", "17DRP5sb8fy", config) == "test"
    assert scene_group("mp3d", "2azQ1b91cZZ", config) == "val_unseen"
    assert scene_group("procthor", "test-70", config) == scene_group("procthor", "test-70", CONFIG)
    torn = SplitsConfig(scenes={"train": ("*",), "test": ("procthor/*",)})
    with pytest.raises(ConfigError, match=r"splits\.scenes: the patterns put procthor/a in train and in test"):
        scene_group("procthor", "a", torn)
    with pytest.raises(ValidationError):
        SplitsConfig(scenes={"val": ("*",)})  # type: ignore[dict-item]


def test_fractions_of_hashes_are_uniform_and_seeded() -> None:
    hashes = np.arange(20_000, dtype=np.uint64)
    found = fractions(hashes, 0, "val_seen")
    counts = np.histogram(found, bins=20, range=(0, 1))[0]
    assert counts.sum() == 20_000
    assert np.abs(counts - 1000).max() < 150
    assert (found != fractions(hashes, 1, "val_seen")).all()
    assert (found != fractions(hashes, 0, "order")).all()
    np.testing.assert_array_equal(found[::-1], fractions(hashes[::-1], 0, "val_seen"))


def test_names_are_kept_apart() -> None:
    assert hash_fraction(0, "a", "bc") != hash_fraction(0, "ab", "c")
    assert 0 <= hash_fraction(0) < 1
