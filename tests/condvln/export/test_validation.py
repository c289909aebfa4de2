"""The linter: silent on sound files, and names what is wrong with files as such and across splits."""

from __future__ import annotations

import copy
import gzip
import json
import os
import shutil
from pathlib import Path

import pyarrow.parquet as pq
import pytest

from condvln.export.validation import Options, validate
from condvln.formats import json_entries
from condvln.navigation.graph_pathfinder import GraphPathfinder
from schemas.errors import UsageError
from tests.condvln.export.findings import bert_as_published, codes, errors, rxr_as_published, write
from tests.strict_loader import read

# -- sound files -------------------------------------------------------------------------------------------------------


def test_the_real_sample_passes(real_data: Path) -> None:
    findings = validate(real_data / "vlnce")
    assert not errors(findings)
    # One of its texts holds a misspelt word, which its own vocabulary does not know.
    assert [finding.code for finding in findings] == ["unknown-words"]


def test_the_real_r2r_sample_passes(real_data: Path) -> None:
    graphs = {
        path.name.removesuffix("_connectivity.json"): GraphPathfinder.load(path)
        for path in (real_data / "mp3d" / "connectivity").glob("*.json")
    }
    assert validate(real_data / "mp3d" / "R2R_sample.json", Options(graphs=graphs)) == []


def test_our_export_passes_in_every_variant(exported: Path) -> None:
    assert [f.line() for f in validate(exported)] == []
    for variant in ("vlnce", "ansr", "oracle", "rxr"):
        assert validate(exported / variant) == []


def test_a_table_of_splits_that_is_not_the_manifests_is_named(exported: Path, tmp_path: Path) -> None:
    shutil.copytree(exported, tmp_path / "export")
    table = tmp_path / "export" / "splits.parquet"
    whole = pq.read_table(table)
    pq.write_table(whole.slice(1), table)
    (found,) = validate(tmp_path / "export")
    assert (found.code, found.file) == ("splits-differ", "splits.parquet")
    assert found.place == f"episode {whole['episode_id'][0]}"
    table.write_bytes(b"PAR1")
    assert [found.code for found in validate(tmp_path / "export")] == ["unreadable"]


# -- files as such -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("data", "code"),
    [
        (b"", "unreadable"),
        (b"{", "unreadable"),
        (gzip.compress(b'{"episodes": []}', mtime=0)[:-9], "unreadable"),
        (b'{"episodes": [{"info": {"geodesic_distance": Infinity}}]}', "not-a-number"),
        (b'{"episodes": [NaN]}', "not-a-number"),
        (b'{"scenes": []}', "unknown-shape"),
        (b'"text"', "unknown-shape"),
        (b'{"episodes": {}}', "wrong-type"),
        (b'{"episodes": [3], "instruction_vocab": {"word_list": ["<pad>", "<unk>"]}}', "wrong-type"),
        (b'{"episodes": [], "instruction_vocab": {"word_list": ["<pad>", "<unk>"]}, "version": 1}', "unknown-top-key"),
        (b'{"episodes": [], "instruction_vocab": {"word_list": [1]}}', "wrong-type"),
        (b'{"episodes": [], "instruction_vocab": {"word_list": ["a"]}}', "vocabulary-inconsistent"),
        (b'{"episodes": [], "instruction_vocab": {"word_list": ["<pad>", "<unk>"]}}', "no-episodes"),
        (b"[]", "no-episodes"),
    ],
)
def test_files_that_are_none(tmp_path: Path, data: bytes, code: str) -> None:
    path = tmp_path / ("x.json.gz" if data[:1] == b"\x1f" else "x.json")
    path.write_bytes(data)
    assert code in codes(validate(path))


def test_a_missing_subgoals_key_is_named_where_others_have_one(exported: Path, tmp_path: Path) -> None:
    document = read(exported / "ansr" / "test" / "test.json.gz")
    del document["episodes"][3]["subgoals"]
    (finding,) = validate(write(tmp_path / "test.json.gz", document))
    assert (finding.code, finding.place) == ("missing-key", f"episode {document['episodes'][3]['episode_id']}")


# -- genuine files of others -------------------------------------------------------------------------------------------


def test_a_split_whose_goals_are_kept_back_is_lawful(exported: Path, tmp_path: Path) -> None:
    """As the test split of R2R_VLNCE v1-3: 3,408 episodes without goals and reference_path were 6,816 errors."""
    document = read(exported / "vlnce" / "test" / "test.json.gz")
    full = [dict(episode) for episode in document["episodes"]]
    for episode in document["episodes"]:
        del episode["goals"], episode["reference_path"], episode["info"]
    (finding,) = validate(write(tmp_path / "test.json.gz", document))
    assert (finding.code, finding.severity) == ("goals-withheld", "warning")
    for key in ("goals", "reference_path"):  # one episode that has either: the others lack it
        document["episodes"][2][key] = full[2][key]
        found = validate(write(tmp_path / "test.json.gz", document))
        errors = [finding for finding in found if finding.severity == "error"]
        assert {finding.code for finding in errors} == {"missing-key"}
        assert len(errors) == 2 * len(full) - (1 if key == "goals" else 2)


def test_files_indexed_by_bert_are_lawful(exported: Path, tmp_path: Path) -> None:
    """As ``<split>_bertidx.json.gz``, Open-Nav's 100 episodes among them: the vocabulary beside them is of words."""
    document = bert_as_published(exported)
    assert validate(write(tmp_path / "test_bertidx.json.gz", document)) == []

    def spoilt(at: int, token: int) -> set[str]:
        other = copy.deepcopy(document)
        other["episodes"][1]["instruction"]["instruction_tokens"][at] = token
        return codes(validate(write(tmp_path / "spoilt.json.gz", other)))

    assert spoilt(2, 30_522) == spoilt(0, 29_999) == spoilt(9, 29_999) == {"token-range"}


def test_the_vocabulary_of_bert_is_lawful_beside_its_tokens(exported: Path, tmp_path: Path) -> None:
    """As the published R2R_VLNCE v1-2 BERTidx files have it: 30,522 word pieces, [PAD] first, [UNK] at 100."""
    document = read(exported / "vlnce" / "test" / "test.json.gz")
    words = ["[PAD]", *(f"piece{k}" for k in range(1, 30_522))]
    words[100] = "[UNK]"
    index = {word: k for k, word in enumerate(words)}
    document["instruction_vocab"] = {
        "word_list": words,
        "word2idx_dict": index,
        "stoi": index,
        "itos": words,
        "num_vocab": len(words),
        "UNK_INDEX": 100,
        "PAD_INDEX": 0,
    }
    for episode in document["episodes"]:
        episode["instruction"]["instruction_tokens"] = [101, 2065, 100, 102] + [0] * 196
    assert validate(write(tmp_path / "test_bertidx.json.gz", document)) == []
    document["episodes"][0]["instruction"]["instruction_tokens"][1] = 30_522
    assert codes(validate(write(tmp_path / "range.json.gz", document))) == {"token-range"}
    document["episodes"][0]["instruction"]["instruction_tokens"][1] = 2065
    document["instruction_vocab"]["UNK_INDEX"] = 1
    assert codes(validate(write(tmp_path / "unk.json.gz", document))) == {"vocabulary-inconsistent"}


def test_followers_of_rxr_are_lawful(exported: Path, tmp_path: Path) -> None:
    """As RxR-VLN-CE's files: guides without a geodesic, followers without a trajectory, a challenge without goals."""
    guides = rxr_as_published(exported)
    followers = copy.deepcopy(guides)
    for number, episode in enumerate(followers["episodes"]):
        del episode["trajectory_id"]
        episode["episode_id"] = str(60_000 + number)
        metrics = {"ndtw": 0.99, "ne": 0.42, "sdtw": 0.99, "spl": 1.0, "sr": 1.0}
        episode["info"] = {"metrics": metrics, "demonstration_id": "1", "role": "follower"}
    write(tmp_path / "test" / "test_guide.json.gz", guides)
    write(tmp_path / "test" / "test_follower.json.gz", followers)
    assert validate(tmp_path) == []
    for episode in guides["episodes"]:
        del episode["goals"], episode["reference_path"]
    (finding,) = validate(write(tmp_path / "challenge" / "test_challenge_guide.json.gz", guides))
    assert (finding.code, finding.severity) == ("goals-withheld", "warning")


def test_forms_of_one_split_are_no_leak(exported: Path, tmp_path: Path) -> None:
    """As R2R_VLNCE_v1-2_preprocessed_BERTidx, where ``_raw`` beside ``_bertidx`` was 16,848 errors."""
    for split in ("train", "test"):
        write(tmp_path / split / f"{split}_raw.json.gz", read(exported / "vlnce" / split / f"{split}.json.gz"))
        write(tmp_path / split / f"{split}_bertidx.json.gz", bert_as_published(exported, split))
    assert validate(tmp_path) == []
    stolen = read(tmp_path / "train" / "train_raw.json.gz")
    stolen["episodes"][0]["episode_id"] = "7"
    write(tmp_path / "test" / "test_raw.json.gz", stolen)
    assert {"scene-leak", "episode-leak"} <= codes(validate(tmp_path))


# -- across splits -----------------------------------------------------------------------------------------------------


def test_leaks_between_splits_are_named(exported: Path, tmp_path: Path) -> None:
    train = read(exported / "vlnce" / "train" / "train.json.gz")
    seen = read(exported / "vlnce" / "val_seen" / "val_seen.json.gz")
    unseen = read(exported / "vlnce" / "val_unseen" / "val_unseen.json.gz")
    for name, document in (("train", train), ("val_seen", seen), ("val_unseen", unseen)):
        write(tmp_path / name / f"{name}.json.gz", document)
    assert validate(tmp_path) == []
    unseen["episodes"].append({**train["episodes"][0], "episode_id": "stolen"})
    unseen["instruction_vocab"]["word_list"].append("zebra")
    write(tmp_path / "val_unseen" / "val_unseen.json.gz", unseen)
    found = {finding.code: finding for finding in validate(tmp_path)}
    assert {"scene-leak", "episode-leak"} <= set(found)
    assert found["episode-leak"].place == "episode stolen"
    assert str(train["episodes"][0]["episode_id"]) in found["episode-leak"].message
    for key in ("itos",):
        unseen["instruction_vocab"][key].append("zebra")
    for key in ("stoi", "word2idx_dict"):
        unseen["instruction_vocab"][key]["zebra"] = unseen["instruction_vocab"]["num_vocab"]
    unseen["instruction_vocab"]["num_vocab"] += 1
    write(tmp_path / "val_unseen" / "val_unseen.json.gz", unseen)
    assert "vocabulary-differs" in codes(validate(tmp_path))


def sharded(exported: Path, folder: Path, copies: int = 1) -> list[Path]:
    """The train split cut in two shards under ``train/content``, its base file empty."""
    document = read(exported / "vlnce" / "train" / "train.json.gz")
    episodes, vocabulary = document["episodes"], document["instruction_vocab"]
    write(folder / "train" / "train.json.gz", {"episodes": [], "instruction_vocab": vocabulary})
    halves = episodes[: len(episodes) // 2], episodes[len(episodes) // 2 :]
    paths = []
    for name, half in zip("ab", halves, strict=True):
        path = folder / "train" / "content" / f"{name}.json.gz"
        paths.append(write(path, {"episodes": half, "instruction_vocab": vocabulary}))
    return paths


def test_shards_are_one_split(exported: Path, tmp_path: Path) -> None:
    paths = sharded(exported, tmp_path)
    assert validate(tmp_path) == []
    # what one shard holds leaks into another split as if it stood in the split's own file
    second = read(paths[1])
    stolen = {**second["episodes"][0], "episode_id": 7}
    write(tmp_path / "test" / "test.json.gz", {**second, "episodes": [stolen]})
    assert codes(validate(tmp_path)) == {"scene-leak", "episode-leak"}
    (tmp_path / "test" / "test.json.gz").unlink()
    first = read(paths[0])
    first["episodes"].append(second["episodes"][0])
    write(paths[0], first)
    (finding,) = validate(tmp_path)
    assert (finding.code, finding.episode) == ("duplicate-id", str(second["episodes"][0]["episode_id"]))
    second["instruction_vocab"]["word_list"] = second["instruction_vocab"]["word_list"][:-1]
    write(paths[1], second)
    assert "vocabulary-differs" in codes(validate(tmp_path))


def test_an_empty_guide_is_a_guide(exported: Path, tmp_path: Path) -> None:
    write(tmp_path / "val_unseen_guide.json.gz", {"episodes": []})
    assert codes(validate(tmp_path)) == {"no-episodes"}
    write(tmp_path / "val_unseen_guide.json.gz", {"episodes": [3]})
    assert "wrong-type" in codes(validate(tmp_path))


def test_a_test_split_of_r2r_has_starts_alone(tmp_path: Path) -> None:
    """As R2R_test.json: its 1,391 items were errors."""
    item = {"scan": "s", "path_id": 1, "path": ["0"], "heading": 1.0, "instructions": ["Go."]}
    items = [item, {**item, "path_id": 2}]
    (finding,) = validate(write(tmp_path / "R2R_test.json.gz", items))
    assert (finding.code, finding.severity) == ("goals-withheld", "warning")
    for other in ({"path": ["0", "1"]}, {"distance": 4.0}):  # one item that has more: the other one is cut
        found = validate(write(tmp_path / "R2R_test.json.gz", [item, {**item, "path_id": 2, **other}]))
        assert "wrong-type" in codes(found)
        assert errors(found)
    assert "wrong-type" in codes(validate(write(tmp_path / "R2R_test.json.gz", [{**item, "path": []}])))


def test_scans_of_two_r2r_splits_must_differ(tmp_path: Path) -> None:
    item = {"scan": "s", "path_id": 1, "path": ["0", "1"], "heading": 1.0, "instructions": ["Go."], "distance": 4.0}
    for name in ("R2R_train.json", "R2R_val_seen.json"):
        (tmp_path / name).write_text(json.dumps([item]))
    assert validate(tmp_path) == []
    (tmp_path / "R2R_val_unseen.json").write_text(json.dumps([item]))
    found = validate(tmp_path)
    assert codes(found) == {"scene-leak"}
    assert {finding.file for finding in found} == {"R2R_val_unseen.json"}


def test_a_bomb_is_not_unpacked(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(json_entries.read_unpacked, "__defaults__", (1 << 20,))
    (tmp_path / "x.json.gz").write_bytes(gzip.compress(b" " * (2 << 20)))
    (finding,) = validate(tmp_path)
    assert finding.code == "unreadable"
    assert "is longer than 1048576 bytes" in finding.message


def test_no_file_is_an_error(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="no VLN-CE"):
        validate(tmp_path)


def test_what_is_no_file_is_a_finding(tmp_path: Path) -> None:
    """Neither waited for nor read without end; a name that is not UTF-8 can be printed."""
    os.mkfifo(tmp_path / "fifo.json.gz")
    (tmp_path / "zero.json").symlink_to("/dev/zero")
    (tmp_path / "itself.json").symlink_to("itself.json")
    (tmp_path / os.fsdecode(b"\xff.json")).write_text("[")
    found = {finding.file: (finding.code, finding.message) for finding in validate(tmp_path)}
    assert {file: code for file, (code, _) in found.items()} == dict.fromkeys(
        ["fifo.json.gz", "zero.json", "itself.json", r"\xff.json"], "unreadable"
    )
    assert found["fifo.json.gz"][1] == "the file can't be read (it is a FIFO, not a file)"
    assert found["zero.json"][1] == "the file can't be read (it is a character device, not a file)"
