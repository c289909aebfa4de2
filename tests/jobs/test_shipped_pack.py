"""The pack of CondVLN-1 that is part of the package: whole, final, proven, and what its page and boards say of it."""

from __future__ import annotations

import json
import re
from collections import Counter
from importlib.resources import files
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest

from condvln.export.contents import CERTIFICATES, SUMMARY, read_index
from condvln.manifest import manifest_path, read_manifest
from condvln.sources.family import FAMILIES
from condvln.verify.files import find_faults
from jobs.benchmark import prove_benchmark, read_record, unpack_benchmark
from jobs.leaderboard import score_benchmark
from schemas.benchmark import Leaderboard
from schemas.evaluation import ManifestEpisode
from tests.once import made_once

NAME = Path("condvln-1")
PACKS = Path(str(files("condvln"))) / "packs"
SPLITS = ("train", "val_seen", "val_unseen", "test")


@pytest.fixture(scope="module")
def unpacked(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The export in the pack, without scenes; read only."""

    def make(folder: Path) -> Path:
        assert unpack_benchmark(NAME, folder / "condvln-1").exit_code == 0
        return folder / "condvln-1"

    return made_once(tmp_path_factory, "condvln-1", make)


@pytest.fixture(scope="module")
def episodes(unpacked: Path) -> list[ManifestEpisode]:
    return [row for split in SPLITS for row in read_manifest(manifest_path(unpacked, split))]


def test_it_is_final_whole_and_small(unpacked: Path, episodes: list[ManifestEpisode]) -> None:
    record = read_record(unpacked)
    assert (record.benchmark, record.version, record.draft) == ("CondVLN", "1", False)
    assert (PACKS / "condvln-1.tar.zst").stat().st_size <= 8 << 20
    assert [*find_faults(unpacked)] == []
    assert len(episodes) == sum(record.episodes.values()) > 11_500
    assert len({row.episode_id for row in episodes}) == len(episodes)
    assert {row.snapshot for row in episodes} == {record.snapshot_id}


def test_it_holds_no_scene_whose_terms_forbid_that(unpacked: Path, episodes: list[ManifestEpisode]) -> None:
    record = read_record(unpacked)
    assert {row.source for row in episodes} == set(record.sources)
    assert not any(FAMILIES[family].licensed for family in record.sources)
    assert all(entry.stored for entry in record.files)
    assert {Path(entry.path).suffix for entry in record.files} <= {
        *(".json", ".jsonl", ".gz", ".md", ".navmesh", ".parquet", ".pkl", ".png", ".svg", ".yaml", ".npz")
    }


def test_the_gate_was_closed_and_every_proof_passed(unpacked: Path, episodes: list[ManifestEpisode]) -> None:
    index = read_index(unpacked)
    assert index is not None
    assert index["bias"]["passed"] is True
    assert index["bias"]["tests"] > 100, "and not for want of episodes"
    summary = json.loads((unpacked / CERTIFICATES / SUMMARY).read_text())
    assert summary["proven"] == summary["episodes"] == len(episodes)
    assert not summary["faults"]
    assert sum(one["checked"] for one in summary["facts"].values()) > 100 * len(episodes)
    assert all(one["disagreed"] == 0 for one in summary["facts"].values())


def test_each_leaf_is_gold_as_often(episodes: list[ManifestEpisode]) -> None:
    for category in {row.category for row in episodes}:
        golds = Counter(row.gold_leaf for row in episodes if row.category == category)
        mean = sum(golds.values()) / len(golds)
        assert all(abs(count - mean) <= 0.03 * mean for count in golds.values()), (category, golds)


def board(split: str) -> Leaderboard:
    return Leaderboard.model_validate_json((PACKS / f"condvln-1-{split}.json").read_bytes())


@pytest.mark.parametrize("split", ["val_unseen", "test"])
def test_its_boards_are_of_it_and_on_its_page(split: str, unpacked: Path, pytestconfig: pytest.Config) -> None:
    record, found = read_record(unpacked), board(split)
    assert (found.snapshot_id, found.split) == (record.snapshot_id, split)
    rows = {row.agent: row for row in found.rows}
    assert {"oracle", "looking", "always-then", "always-else", "nearest", "random-leaf"} <= set(rows)
    assert all(row.episodes == record.episodes[split] and row.missing == 0 for row in found.rows)
    success = [row.measures["success"].mean for row in found.rows]
    assert all(one >= other for one, other in pairwise(success)), "ranked"
    page = (pytestconfig.rootpath / "docs" / "benchmark.md").read_text()
    for name, row in rows.items():
        one = row.measures["success"]
        assert re.search(
            rf"\| `{name}` \|.*\b{100 * one.mean:.1f} \[{100 * one.low:.1f}, {100 * one.high:.1f}\]", page
        ), name


def test_scores_of_results_need_no_scenes(unpacked: Path, tmp_path: Path, episodes: list[ManifestEpisode]) -> None:
    rows = [row for row in episodes if row.split == "val_unseen"]
    results: dict[str, Any] = {
        str(row.episode_id): {"success": float(k % 2), "spl": 0.5, "distance_to_goal": 1.0}
        for k, row in enumerate(rows)
    }
    (tmp_path / "mine.json").write_text(json.dumps(results))
    report = score_benchmark(unpacked, "val_unseen", [tmp_path / "mine.json"], references=False)
    (row,) = report.document["rows"]
    assert row["measures"]["success"]["mean"] == pytest.approx((len(rows) // 2) / len(rows), abs=1e-6)


@pytest.mark.soak
def test_todays_verifier_proves_it_from_the_raw_files(real_data: Path, unpacked: Path) -> None:
    report = prove_benchmark(PACKS / "condvln-1.tar.zst", [f"ithor={real_data / 'ithor'}"])
    episodes = sum(row.source == "ithor" for split in SPLITS for row in read_manifest(manifest_path(unpacked, split)))
    assert report.document["proven"] == episodes > 0
