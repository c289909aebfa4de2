"""The linter names each defect of spoiled files: seeded corruptions of ours, of the real sample, of ground truth."""

from __future__ import annotations

import copy
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from condvln.export.validation import validate
from tests.condvln.export.findings import bert_as_published, codes, rxr_as_published, write
from tests.strict_loader import read

Rng = np.random.Generator


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


COMMON: list[tuple[str, Callable[[Rng, Any], None]]] = [
    ("unknown-key", put("gold_leaf", 1)),
    ("unknown-key", put("goals", 0, "object_id", "sofa")),
    ("missing-key", drop("scene_id")),
    ("missing-key", drop("start_rotation")),
    ("missing-key", drop("reference_path")),
    ("missing-key", drop("instruction", "instruction_text")),
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
    ("empty-text", put("instruction", "instruction_text", " ,")),
    ("scene-prefix", put("scene_id", "data/scene_datasets/mp3d/a/a.glb")),
]
"""What is wrong in every format."""

CORRUPTIONS: list[tuple[str, Callable[[Rng, Any], None]]] = [
    *COMMON,
    ("unknown-key", put("instruction", "language", "en")),
    ("missing-key", drop("trajectory_id")),
    ("missing-vocabulary", no_vocabulary),
    ("vocabulary-inconsistent", shuffled_words),
    ("geodesic-too-short", swapped_axes),
    ("token-range", put("instruction", "instruction_tokens", 3, 99_999)),
    ("token-length", put("instruction", "instruction_tokens", [2, 3, 4, 0])),
    ("token-mismatch", other_tokens),
    ("missing-geodesic", drop("info")),
    ("wrong-type", put("instruction", "instruction_tokens", ["go"])),
]
"""What is wrong in R2R's files; RxR's have no vocabulary and no geodesic, and followers no trajectory."""


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


RXR: list[tuple[str, Callable[[Rng, Any], None]]] = [
    *COMMON,
    ("unknown-key", put("instruction", "path", [])),
    ("missing-key", drop("instruction")),
    ("missing-key", drop("goals")),
    ("missing-key", drop("start_position")),
    ("missing-key", drop("episode_id")),
    ("wrong-type", put("instruction", "instruction_text", 5)),
    ("wrong-type", put("start_rotation", [0.0, 0.0, 1.0])),
    ("wrong-type", put("info", [])),
    ("wrong-type", put("trajectory_id", [1])),
    ("id-not-text", put("episode_id", 17)),
    ("wrong-type", put("goals", 0, "position", [1.0, 2.0])),
    ("reference-short", put("reference_path", [])),
]


def test_corruptions_of_rxr_are_named(exported: Path, tmp_path: Path) -> None:
    stock = rxr_as_published(exported)
    for seed, (code, spoil) in enumerate(RXR):
        check_corruption(stock, tmp_path, code, spoil, seed)
    assert len(RXR) >= 30


def test_corruptions_of_files_indexed_by_bert_are_named(exported: Path, tmp_path: Path) -> None:
    stock = bert_as_published(exported)
    for seed, (code, spoil) in enumerate(CORRUPTIONS):
        # word pieces are not compared with the text
        check_corruption(stock, tmp_path, "token-range" if code == "token-mismatch" else code, spoil, seed)
    assert len(CORRUPTIONS) >= 30


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
