"""The linter: silent on sound files, and names each defect of spoiled ones."""

from __future__ import annotations

import copy
import gzip
import json
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from condvln.export import streams
from condvln.export.validation import CODES, Finding, Options, validate
from condvln.navigation.graph_pathfinder import GraphPathfinder
from condvln.navigation.pathfinder import Pathfinder
from condvln.navigation.polygon_tile import tile_of_polygons
from schemas.errors import UsageError
from tests.strict_loader import read

Rng = np.random.Generator


def write(path: Path, document: Any) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(gzip.compress(json.dumps(document).encode(), mtime=0))
    return path


def codes(findings: list[Finding]) -> set[str]:
    return {finding.code for finding in findings}


def errors(findings: list[Finding]) -> list[Finding]:
    return [finding for finding in findings if finding.severity == "error"]


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


# -- seeded corruptions ------------------------------------------------------------------------------------------------


def pick(rng: Rng, document: Any) -> dict[str, Any]:
    episode: dict[str, Any] = document["episodes"][rng.integers(len(document["episodes"]))]
    return episode


def put(*path: Any) -> Callable[[Rng, Any], None]:
    """Set a value inside a random episode."""
    *keys, last, value = path

    def spoil(rng: Rng, document: Any) -> None:
        at = pick(rng, document)
        for key in keys:
            at = at[key]
        at[last] = value

    return spoil


def drop(*path: str) -> Callable[[Rng, Any], None]:
    """Remove a key of a random episode."""
    *keys, last = path

    def spoil(rng: Rng, document: Any) -> None:
        at = pick(rng, document)
        for key in keys:
            at = at[key]
        del at[last]

    return spoil


def scalar_first(rng: Rng, document: Any) -> None:
    """NavSpace's mistake: [w, x, y, z] where [x, y, z, w] belongs."""
    episode = next(e for e in document["episodes"] if abs(e["start_rotation"][1]) > 0.1)
    x, y, z, w = episode["start_rotation"]
    episode["start_rotation"] = [w, x, y, z]


def swapped_axes(rng: Rng, document: Any) -> None:
    """Y and Z of the goals exchanged, as in files of the scan's own frame."""
    for episode in document["episodes"]:
        for goal in episode["goals"]:
            goal["position"] = [goal["position"][0] + 40, goal["position"][2], goal["position"][1]]


def repeat(rng: Rng, document: Any) -> None:
    document["episodes"].append(copy.deepcopy(pick(rng, document)))


def no_vocabulary(rng: Rng, document: Any) -> None:
    del document["instruction_vocab"]


def shuffled_words(rng: Rng, document: Any) -> None:
    words = document["instruction_vocab"]["itos"]
    words[5], words[6] = words[6], words[5]


def other_tokens(rng: Rng, document: Any) -> None:
    tokens = pick(rng, document)["instruction"]["instruction_tokens"]
    tokens[0] = tokens[0] + 1 if tokens[0] + 1 < document["instruction_vocab"]["num_vocab"] else 2


CORRUPTIONS: list[tuple[str, Callable[[Rng, Any], None]]] = [
    ("unknown-key", put("gold_leaf", 1)),
    ("unknown-key", put("instruction", "language", "en")),
    ("unknown-key", put("goals", 0, "object_id", "sofa")),
    ("missing-key", drop("trajectory_id")),
    ("missing-key", drop("scene_id")),
    ("missing-key", drop("start_rotation")),
    ("missing-key", drop("reference_path")),
    ("missing-key", drop("instruction", "instruction_text")),
    ("missing-vocabulary", no_vocabulary),
    ("vocabulary-inconsistent", shuffled_words),
    ("wrong-type", put("episode_id", 1.5)),
    ("wrong-type", put("start_position", [1.0, 2.0])),
    ("wrong-type", put("goals", [])),
    ("wrong-type", put("reference_path", 0, ["1", 0, 0])),
    ("duplicate-id", repeat),
    ("scene-path", put("scene_id", "/data/mp3d/a/a.glb")),
    ("scene-path", put("scene_id", "gibson/gibson/Oyens/Oyens.glb")),
    ("scene-path", put("scene_id", "../mp3d/a/a.glb")),
    ("rotation-norm", put("start_rotation", [0.0, 0.9, 0.0, 0.9])),
    ("rotation-order", scalar_first),
    ("rotation-tilted", put("start_rotation", [math.sqrt(0.5), math.sqrt(0.5), 0.0, 0.0])),
    ("reference-start", put("reference_path", 0, [99.0, 0.0, 99.0])),
    ("reference-goal", put("reference_path", -1, [99.0, 0.0, 99.0])),
    ("goal-radius", put("goals", 0, "radius", -3.0)),
    ("geodesic-invalid", put("info", "geodesic_distance", None)),
    ("geodesic-too-short", swapped_axes),
    ("empty-text", put("instruction", "instruction_text", " ,")),
    ("token-range", put("instruction", "instruction_tokens", 3, 99_999)),
    ("token-length", put("instruction", "instruction_tokens", [2, 3, 4, 0])),
    ("token-mismatch", other_tokens),
    ("missing-geodesic", drop("info")),
    ("scene-prefix", put("scene_id", "data/scene_datasets/mp3d/a/a.glb")),
    ("wrong-type", put("instruction", "instruction_tokens", ["go"])),
]


def check_corruption(stock: Any, folder: Path, code: str, spoil: Callable[[Rng, Any], None], seed: int) -> None:
    before = codes(validate(write(folder / "val_seen.json.gz", stock)))
    document = copy.deepcopy(stock)
    spoil(np.random.default_rng(seed), document)
    found = validate(write(folder / "val_seen.json.gz", document))
    assert code in codes(found) - before, [f.line() for f in found][:5]
    named = next(f for f in found if f.code == code)
    assert named.message
    assert named.remedy
    assert named.line().startswith("val_seen.json.gz: ")


@pytest.mark.parametrize(("code", "spoil"), CORRUPTIONS, ids=[f"{i}-{c}" for i, (c, _) in enumerate(CORRUPTIONS)])
def test_corruptions_of_our_own_files_are_named(
    exported: Path, tmp_path: Path, code: str, spoil: Callable[[Rng, Any], None]
) -> None:
    stock = read(exported / "vlnce" / "val_seen" / "val_seen.json.gz")
    for seed in range(3):
        check_corruption(stock, tmp_path, code, spoil, seed)


@pytest.mark.parametrize(("code", "spoil"), CORRUPTIONS, ids=[f"{i}-{c}" for i, (c, _) in enumerate(CORRUPTIONS)])
def test_corruptions_of_the_real_sample_are_named(
    real_data: Path, tmp_path: Path, code: str, spoil: Callable[[Rng, Any], None]
) -> None:
    stock = read(real_data / "vlnce" / "val_seen_sample.json.gz")
    check_corruption(stock, tmp_path, code, spoil, 0)


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


# -- ground truth ------------------------------------------------------------------------------------------------------


def first(truths: Any) -> Any:
    return next(truth for truth in truths.values() if "actions" in truth)


def cut(truths: Any) -> None:
    del truths[next(iter(truths))]


TRUTHS: list[tuple[str, Callable[[Any], object]]] = [
    ("truth-missing", cut),
    ("truth-unused", lambda t: t.update(stranger=first(t))),
    ("truth-empty", lambda t: first(t).update(locations=[])),
    ("truth-start", lambda t: first(t)["locations"].__setitem__(0, [77.0, 0, 0])),
    ("truth-goal", lambda t: first(t)["locations"].__setitem__(-1, [77.0, 0, 0])),
    ("truth-sparse", lambda t: first(t)["locations"].__setitem__(-1, [77.0, 0, 0])),
    ("truth-steps", lambda t: first(t).update(forward_steps=1)),
    ("truth-steps", lambda t: first(t).update(actions=[1, 0])),
    ("truth-actions", lambda t: first(t)["actions"].append(1)),
    ("truth-actions", lambda t: first(t)["actions"].insert(0, 0)),
    ("truth-actions", lambda t: first(t)["actions"].insert(0, 4)),
    ("wrong-type", lambda t: first(t).update(forward_steps="3")),
    ("unknown-key", lambda t: first(t).update(heading=[0])),
    ("missing-key", lambda t: first(t).pop("locations")),
]


@pytest.mark.parametrize(("code", "spoil"), TRUTHS, ids=[f"{i}-{c}" for i, (c, _) in enumerate(TRUTHS)])
def test_corruptions_of_ground_truth_are_named(
    exported: Path, tmp_path: Path, code: str, spoil: Callable[[Any], object]
) -> None:
    folder = exported / "vlnce" / "test"
    write(tmp_path / "test.json.gz", read(folder / "test.json.gz"))
    truths = read(folder / "test_gt.json.gz")
    spoil(truths)
    write(tmp_path / "test_gt.json.gz", truths)
    found = validate(tmp_path)
    assert code in codes(found)
    assert {finding.file for finding in found} == {"test_gt.json.gz"}


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
    assert train["episodes"][0]["episode_id"] in found["episode-leak"].message
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
    stolen = {**second["episodes"][0], "episode_id": "stolen"}
    write(tmp_path / "test" / "test.json.gz", {**second, "episodes": [stolen]})
    assert codes(validate(tmp_path)) == {"scene-leak", "episode-leak"}
    (tmp_path / "test" / "test.json.gz").unlink()
    first = read(paths[0])
    first["episodes"].append(second["episodes"][0])
    write(paths[0], first)
    (finding,) = validate(tmp_path)
    assert (finding.code, finding.episode) == ("duplicate-id", second["episodes"][0]["episode_id"])
    second["instruction_vocab"]["word_list"] = second["instruction_vocab"]["word_list"][:-1]
    write(paths[1], second)
    assert "vocabulary-differs" in codes(validate(tmp_path))


def test_an_empty_guide_is_a_guide(exported: Path, tmp_path: Path) -> None:
    write(tmp_path / "val_unseen_guide.json.gz", {"episodes": []})
    assert codes(validate(tmp_path)) == {"no-episodes"}
    write(tmp_path / "val_unseen_guide.json.gz", {"episodes": [3]})
    assert "wrong-type" in codes(validate(tmp_path))


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
    monkeypatch.setattr(streams.read_unpacked, "__defaults__", (1 << 20,))
    (tmp_path / "x.json.gz").write_bytes(gzip.compress(b" " * (2 << 20)))
    (finding,) = validate(tmp_path)
    assert finding.code == "unreadable"
    assert "holds more than" in finding.message


def test_no_file_is_an_error(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="no VLN-CE"):
        validate(tmp_path)


# -- against navmeshes and graphs --------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("change", "code"),
    [
        ({}, None),
        ({"start_position": [1.0, 3.0, 1.0], "reference_path": [[1.0, 3.0, 1.0], [3.0, 0.0, 1.0]]}, "start-off-mesh"),
        ({"goals": [{"position": [3.0, 0.0, 2.5], "radius": 1.0}]}, "goal-off-mesh"),
        ({"goals": [{"position": [11.0, 0.0, 1.0], "radius": 1.0}]}, "unreachable"),
        ({"info": {"geodesic_distance": 2.5}}, "geodesic-differs"),
    ],
)
def test_against_the_navmesh(tmp_path: Path, change: dict[str, Any], code: str | None) -> None:
    vertices = [[0, 0, 0], [4, 0, 0], [4, 0, 2], [0, 0, 2], [10, 0, 0], [12, 0, 0], [12, 0, 2], [10, 0, 2]]
    pathfinder = Pathfinder.from_tile(tile_of_polygons(vertices, [[0, 1, 2, 3], [4, 5, 6, 7]]))
    episode = {
        "episode_id": "a",
        "trajectory_id": "a",
        "scene_id": "made/a/a.glb",
        "start_position": [1.0, 0.0, 1.0],
        "start_rotation": [0.0, 0.0, 0.0, 1.0],
        "info": {"geodesic_distance": 2.0},
        "goals": [{"position": [3.0, 0.0, 1.0], "radius": 1.0}],
        "instruction": {"instruction_text": "Go.", "instruction_tokens": [2, 3]},
        "reference_path": [[1.0, 0.0, 1.0], [3.0, 0.0, 1.0]],
        **change,
    }
    words = ["<pad>", "<unk>", "go", "."]
    path = write(tmp_path / "x.json.gz", {"episodes": [episode], "instruction_vocab": {"word_list": words}})
    found = codes(validate(path, Options(pathfinder_of=lambda episode: pathfinder)))
    assert found == set() if code is None else code in found
    assert not codes(validate(path, Options(pathfinder_of=lambda episode: None))) & {code}


@pytest.mark.parametrize(
    ("change", "code"),
    [
        ({}, None),
        ({"path": ["0", "9"]}, "unknown-viewpoint"),
        ({"path": ["0", "2"]}, "path-disconnected"),
        ({"path": ["0"]}, "wrong-type"),
        ({"path": ["0", "0", "1"]}, "duplicate-viewpoint"),
        ({"distance": 3.0}, "distance-differs"),
        ({"distance": None}, "distance-differs"),
        ({"heading": 6.4}, "heading-range"),
        ({"heading": -0.1}, "heading-range"),
        ({"instructions": []}, "wrong-type"),
        ({"instructions": [" "]}, "empty-text"),
    ],
)
def test_r2r_items(tmp_path: Path, change: dict[str, Any], code: str | None) -> None:
    graph = GraphPathfinder.from_edges([[0, 0, 0], [2, 0, 0], [4, 0, 0]], [(0, 1), (1, 2)])
    item = {
        "scan": "s",
        "path_id": 1,
        "path": ["0", "1", "2"],
        "heading": 1.0,
        "instructions": ["Go."],
        "distance": 4.0,
    }
    path = tmp_path / "R2R_x.json"
    path.write_text(json.dumps([{**item, **change}]))
    found = codes(validate(path, Options(graphs={"s": graph})))
    assert found == set() if code is None else code in found
    path.write_text(json.dumps([item, item, {"scan": "s"}]))
    assert {"duplicate-id", "missing-key"} <= codes(validate(path))


def test_every_code_has_a_remedy_and_is_used(repository: Path) -> None:
    source = "".join(path.read_text() for path in (repository / "condvln" / "export" / "validation").glob("*.py"))
    for code, rule in CODES.items():
        assert rule.remedy
        assert source.count(f'"{code}"') >= 2, code
