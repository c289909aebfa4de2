"""What collectors of training data take from an episode of a stock file, as StreamVLN's and JanusVLN's do."""

from __future__ import annotations

import gzip
import json
from pathlib import Path
from typing import Any

import pytest

from condvln.export.splits import SPLITS


def _document(path: Path) -> Any:
    return json.loads(gzip.decompress(path.read_bytes()))


@pytest.mark.parametrize("variant", ["vlnce", "ansr", "oracle"])
def test_an_episode_has_what_a_collector_takes(exported: Path, variant: str) -> None:
    """A folder's name from scene and number, one next place on the path, and actions short enough to be kept."""
    folders: set[str] = set()
    count = 0
    for split in SPLITS:
        file = exported / variant / split / f"{split}.json.gz"
        if not file.exists():
            continue
        truths = _document(file.with_name(f"{split}_gt.json.gz"))
        for episode in _document(file)["episodes"]:
            scan = episode["scene_id"].split("/")[-2]
            folders.add(f"{scan}_condvln_{int(episode['episode_id']):06d}")
            assert len(episode["reference_path"]) >= 2
            assert isinstance(episode["instruction"]["instruction_text"], str)
            # A leading -1 stands for the first frame; collectors drop what has more than 498 actions then. Half of the
            # made rows have no actions.
            assert len(truths[str(episode["episode_id"])].get("actions", [])) + 1 <= 498
            count += 1
    assert count
    assert len(folders) == count, "two episodes would be written to one folder"
