"""Rewriting a written split: only instructions differ, and a stranger's file with our manifest works too."""

from __future__ import annotations

import gzip
import json
from pathlib import Path

import pytest

from condvln.export.twin import rewrite_split
from condvln.manifest import read_manifest
from schemas.errors import FormatError, MissingFileError
from schemas.evaluation import ManifestEpisode
from tests.strict_loader import load_split, read


def rows(manifest: Path) -> dict[str, ManifestEpisode]:
    return {str(row.episode_id): row for row in read_manifest(manifest)}


def told(row: ManifestEpisode) -> str:
    moves = row.program.leaves[row.gold_leaf].moves
    return "Walk to the " + ", then to the ".join(move.label for move in moves) + "."


def paths(exported: Path) -> tuple[Path, Path]:
    return exported / "vlnce" / "test" / "test.json.gz", exported / "manifest" / "test.jsonl"


def test_a_file_of_bare_tokens_stays_bare(exported: Path, tmp_path: Path) -> None:
    document, manifest = paths(exported)
    content = read(document)
    for episode in content["episodes"]:
        tokens = episode["instruction"]["instruction_tokens"]
        episode["instruction"]["instruction_tokens"] = [token for token in tokens if token]
    bare = tmp_path / "bare.json.gz"
    bare.write_bytes(gzip.compress(json.dumps(content).encode()))
    report = rewrite_split(bare, rows(manifest), tmp_path / "twin.json.gz", lambda row: "Walk to the zyzzyva.")
    assert report.unknown_words == report.episodes
    for episode in load_split(tmp_path / "twin.json.gz"):
        assert len(episode.instruction.instruction_tokens) == 5
        assert 0 not in episode.instruction.instruction_tokens


def test_what_is_amiss_is_said(exported: Path, tmp_path: Path) -> None:
    document, manifest = paths(exported)
    out = tmp_path / "twin.json.gz"
    other = exported / "manifest" / "train.jsonl"
    with pytest.raises(FormatError, match=r"is not in the manifest"):
        rewrite_split(document, rows(other), out, told)
    assert not out.exists()
    with pytest.raises(MissingFileError):
        rewrite_split(tmp_path / "none", {}, out, told)
    with pytest.raises(MissingFileError):
        rows(tmp_path / "none")
    content = read(document)
    content["episodes"][0]["instruction"]["instruction_tokens"] = 1  # no list: the twin's are bare
    (tmp_path / "odd.json").write_text(json.dumps(content))
    rewrite_split(tmp_path / "odd.json", rows(manifest), out, told)
    assert 0 not in read(out)["episodes"][0]["instruction"]["instruction_tokens"]
    for text in (b"{", b"{}", b'{"episodes": [{}]}', b"[1]"):
        (tmp_path / "bad.json").write_bytes(text)
        with pytest.raises(FormatError, match=r"bad\.json: not a VLN-CE split"):
            rewrite_split(tmp_path / "bad.json", {}, out, told)
    (tmp_path / "bad.jsonl").write_text("{}")
    with pytest.raises(FormatError, match=r"bad\.jsonl"):
        rows(tmp_path / "bad.jsonl")
