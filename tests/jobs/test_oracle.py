"""The oracle-linear twin of a written split: a deep diff of every episode finds the instruction and nothing else."""

from __future__ import annotations

import gzip
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from condvln.export.snapshot import export_snapshot
from condvln.formats.json_entries import read_unpacked
from condvln.labels import vocabulary
from condvln.manifest import manifest_path, read_manifest
from jobs.command import app
from jobs.oracle import oracle_split
from jobs.validate import validate_files
from schemas.config import SplitsConfig
from schemas.errors import UsageError
from tests.made_snapshot import made_snapshot

runner = CliRunner()


def read(path: Path) -> Any:
    return json.loads(read_unpacked(path))


def differences(one: Any, other: Any, at: str = "") -> Iterator[str]:
    """Paths at which two documents differ, types included."""
    if type(one) is not type(other):
        yield at
    elif isinstance(one, dict):
        for key in one.keys() | other.keys():
            if key in one and key in other:
                yield from differences(one[key], other[key], f"{at}.{key}")
            else:
                yield f"{at}.{key}"
    elif isinstance(one, list) and at not in (".instruction.instruction_tokens",):
        if len(one) != len(other):
            yield at
        for number, (a, b) in enumerate(zip(one, other, strict=False)):
            yield from differences(a, b, f"{at}[{number}]")
    elif one != other:
        yield at


@pytest.mark.parametrize("variant", ["vlnce/{0}/{0}", "ansr/{0}/{0}", "rxr/{0}/{0}_guide"])
def test_only_the_instruction_differs(export: Path, split: str, tmp_path: Path, variant: str) -> None:
    file = export / f"{variant.format(split)}.json.gz"
    out = tmp_path / file.name
    report = oracle_split(export, split, file=file, out=out)
    before, after = read(file), read(out)
    assert len(before["episodes"]) == len(after["episodes"]) == report.document["episodes"] > 0
    for one, twin in zip(before["episodes"], after["episodes"], strict=True):
        assert set(differences(one, twin)) <= {".instruction.instruction_text", ".instruction.instruction_tokens"}
        assert one["instruction"]["instruction_text"] != twin["instruction"]["instruction_text"]
        assert not any(word in twin["instruction"]["instruction_text"].lower().split() for word in ("if", "otherwise"))
    assert {key: value for key, value in before.items() if key != "episodes"} == {
        key: value for key, value in after.items() if key != "episodes"
    }
    assert not [f for f in validate_files(out).findings if f.severity == "error"]
    assert report.document["unknown_words"] == 0
    truth = file.with_name(file.name.replace(".json.gz", "_gt.json.gz"))
    assert out.with_name(truth.name).read_bytes() == truth.read_bytes()


def test_the_default_is_the_twin_that_the_export_writes(export: Path, split: str) -> None:
    twin = export / "oracle" / split / f"{split}.json.gz"
    written = twin.read_bytes()
    twin.unlink()
    result = runner.invoke(app, ["export", str(export), split, "--oracle", "--json"])
    assert result.exit_code == 0, result.output
    assert json.loads(result.stdout)["files"][0] == str(twin)
    assert twin.read_bytes() == written


def test_the_twin_names_the_gold_leaf_of_the_manifest(export: Path, split: str) -> None:
    rows = [json.loads(line) for line in (export / "manifest" / f"{split}.jsonl").read_text().splitlines()]
    told = {e["episode_id"]: e["instruction"] for e in read(export / "oracle" / split / f"{split}.json.gz")["episodes"]}
    for row in rows:
        text = told[row["episode_id"]]["instruction_text"].lower()
        for move in row["program"]["leaves"][row["gold_leaf"]]["moves"]:
            assert vocabulary.entry(move["label"]).noun.lower() in text


def test_another_seed_tells_it_in_other_words(export: Path, split: str, tmp_path: Path) -> None:
    oracle_split(export, split, out=tmp_path / "a.json.gz", seed=1)
    oracle_split(export, split, out=tmp_path / "b.json.gz", seed=1)
    assert (tmp_path / "a.json.gz").read_bytes() == (tmp_path / "b.json.gz").read_bytes()
    usual = read(export / "oracle" / split / f"{split}.json.gz")["episodes"]
    other = read(tmp_path / "a.json.gz")["episodes"]
    texts = [
        (a["instruction"]["instruction_text"], b["instruction"]["instruction_text"])
        for a, b in zip(usual, other, strict=True)
    ]
    assert any(a != b for a, b in texts)


def test_shards_are_rewritten_each(tmp_path: Path) -> None:
    export_snapshot(made_snapshot(), tmp_path, SplitsConfig(sharded=True))
    report = oracle_split(tmp_path, "train")
    shards = sorted((tmp_path / "vlnce" / "train" / "content").glob("*.json.gz"))
    assert shards
    total = 0
    for shard in shards:
        one, twin = read(shard)["episodes"], read(tmp_path / "oracle" / "train" / "content" / shard.name)["episodes"]
        assert [e["episode_id"] for e in one] == [e["episode_id"] for e in twin]
        total += len(one)
    assert report.document["episodes"] == total
    assert read(tmp_path / "oracle" / "train" / "train.json.gz")["episodes"] == []


def test_a_strangers_file_keeps_its_own_vocabulary(export: Path, split: str, tmp_path: Path) -> None:
    document = read(export / "vlnce" / split / f"{split}.json.gz")
    words = ["<pad>", "<unk>", "go", "to", "the"]
    document["instruction_vocab"] = {"word_list": words, "note": "theirs"}
    for episode in document["episodes"]:
        del episode["instruction"]["instruction_tokens"]
    document["episodes"][0]["instruction"]["instruction_tokens"] = [2, 3, 4, 0]
    theirs = tmp_path / "theirs.json.gz"
    theirs.write_bytes(gzip.compress(json.dumps(document).encode()))
    report = oracle_split(export, split, file=theirs, out=tmp_path / "twin.json.gz")
    twin = read(tmp_path / "twin.json.gz")
    assert twin["instruction_vocab"] == document["instruction_vocab"]
    assert len(twin["episodes"][0]["instruction"]["instruction_tokens"]) == 4
    assert all("instruction_tokens" not in e["instruction"] for e in twin["episodes"][1:])
    assert report.document["unknown_words"] > 0
    assert "read as UNK" in report.lines[-1]


def test_an_original_is_never_replaced(export: Path, split: str) -> None:
    with pytest.raises(UsageError, match="would replace its original"):
        oracle_split(export, split, out=export / "vlnce" / split / f"{split}.json.gz")


def test_a_pick_is_said_in_place_of_the_gold_branch(export: Path, split: str, tmp_path: Path) -> None:
    rows = read_manifest(manifest_path(export, split))
    rows = list(rows)
    gold = {str(row.episode_id): row.gold_leaf for row in rows}
    texts = {}
    for name, picks in (("gold", None), ("same", gold), ("other", {k: 1 if v == 0 else 0 for k, v in gold.items()})):
        oracle_split(export, split, out=tmp_path / f"{name}.json.gz", picks=picks)
        found = read(tmp_path / f"{name}.json.gz")["episodes"]
        texts[name] = [episode["instruction"]["instruction_text"] for episode in found]
    assert texts["same"] == texts["gold"]
    assert all(one != two for one, two in zip(texts["gold"], texts["other"], strict=True))
