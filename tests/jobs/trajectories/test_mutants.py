"""Faults planted in a folder of trajectories: the verifier names each damaged walk, and no other."""

from __future__ import annotations

import hashlib
import json
import os
import shutil
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from jobs.trajectories import Request
from tests.jobs.trajectories.made import proven, rows

LEAST = 500


@dataclass
class Walk:
    """One walk to damage: its row, its entry in StreamVLN's list, and its poses."""

    row: dict[str, Any]
    entry: dict[str, Any]
    poses: list[dict[str, Any]]
    texts: list[str]
    folder: Path
    draw: np.random.Generator

    def one(self) -> dict[str, Any]:
        """A pose of the walk."""
        return self.poses[int(self.draw.integers(len(self.poses)))]

    def replace(self, image: str, data: bytes) -> None:
        """Write an image; the file that it is a link to stays."""
        path = self.folder / image
        path.unlink(missing_ok=True)
        path.write_bytes(data)


def swapped_frame(walk: Walk) -> bool:
    one, other = (walk.poses[int(k)]["image"] for k in walk.draw.choice(len(walk.poses), size=2, replace=False))
    first, second = ((walk.folder / image).read_bytes() for image in (one, other))
    walk.replace(one, second)
    walk.replace(other, first)
    return first != second


def shifted_action(walk: Walk) -> bool:
    before = walk.row["executed"]
    shifted = [*before[1:-1], before[0], 0]
    walk.row |= {"actions": shifted, "executed": shifted, "repeats": [1] * len(shifted)}
    walk.entry |= {"actions": [-1, *shifted[:-1]], "repeats": [1] * len(shifted)}
    for pose in walk.poses:
        pose |= {"action": shifted[pose["frame"]], "executed": shifted[pose["frame"]]}
    return shifted != before


def wrong_position(walk: Walk) -> bool:
    pose, axis = walk.one(), str(walk.draw.choice(["x", "y", "z"]))
    pose["position"] = pose["position"] | {axis: pose["position"][axis] + 0.01}
    return True


def wrong_heading(walk: Walk) -> bool:
    walk.one()["heading"] += np.pi / 12
    return True


def wrong_rotation(walk: Walk) -> bool:
    pose = walk.one()
    pose["rotation"] = pose["rotation"] | {"y": -pose["rotation"]["w"], "w": pose["rotation"]["y"]}
    return True


def truncated_image(walk: Walk) -> bool:
    """Also the recorded size and hash are those of the truncated file."""
    pose = walk.one()
    data = (walk.folder / pose["image"]).read_bytes()[: -int(walk.draw.integers(20, 200))]
    walk.replace(pose["image"], data)
    pose |= {"bytes": len(data), "sha256": hashlib.sha256(data).hexdigest()}
    return True


def lost_image(walk: Walk) -> bool:
    (walk.folder / walk.one()["image"]).unlink()
    return True


def swapped_instruction(walk: Walk) -> bool:
    text = str(walk.draw.choice([text for text in walk.texts if text != walk.row["instruction_text"]]))
    walk.row["instruction_text"] = text
    walk.entry["instructions"] = [text]
    return True


def shifted_entry(walk: Walk) -> bool:
    before = walk.entry["actions"]
    walk.entry["actions"] = [*before[1:], before[0]]
    return True


def moved_goal(walk: Walk) -> bool:
    goal = walk.row["goals"][0]
    walk.row["goals"] = [goal | {"x": goal["x"] + 0.5}, *walk.row["goals"][1:]]
    return True


def wrong_distance(walk: Walk) -> bool:
    walk.one()["distance_to_goal"] += 0.05
    return True


def lost_frame(walk: Walk) -> bool:
    walk.poses.remove(walk.one())
    return True


def wrong_repeats(walk: Walk) -> bool:
    at = int(np.flatnonzero(walk.row["repeats"])[0])
    walk.row["repeats"] = [*walk.row["repeats"][:at], 0, *walk.row["repeats"][at + 1 :]]
    return True


KINDS: tuple[Callable[[Walk], bool], ...] = (
    swapped_frame,
    shifted_action,
    wrong_position,
    wrong_heading,
    wrong_rotation,
    truncated_image,
    lost_image,
    swapped_instruction,
    shifted_entry,
    moved_goal,
    wrong_distance,
    lost_frame,
    wrong_repeats,
)


@pytest.mark.soak
def test_mutants_are_caught(asked: Request, made: Path, tmp_path: Path) -> None:
    """In each round two thirds of the walks get a fault of any kind; the verifier names these walks alone."""
    draw = np.random.default_rng(7)
    tables = {name: rows(made, name) for name in ("trajectories", "poses")}
    # The main camera alone: a third of the images, and of the time.
    tables["poses"] = [row for row in tables["poses"] if row["camera"] == "rgb"]
    record = json.loads((made / "trajectories.json").read_bytes())
    record["cameras"] = {"rgb": record["cameras"]["rgb"]}
    record["layouts"] = ["streamvln"]
    schemas = {name: pq.read_schema(made / f"{name}.parquet") for name in tables}
    entries = json.loads((made / "annotations.json").read_bytes())
    owners = sorted({row["frames_of"] for row in tables["trajectories"]})
    texts = sorted({row["instruction_text"] for row in tables["trajectories"]})
    planted: Counter[str] = Counter()
    missed: list[str] = []
    turn = 0
    while planted.total() < LEAST:
        out = tmp_path / "mutant"
        for name in owners:
            shutil.copytree(made / "images" / name / "rgb", out / "images" / name / "rgb", copy_function=os.link)
        (out / "trajectories.json").write_text(json.dumps(record))
        shutil.copy(made / "left_out.parquet", out)
        walks = {row["trajectory"]: dict(row) for row in tables["trajectories"]}
        listed = {entry["trajectory"]: dict(entry) for entry in entries}
        poses: dict[str, list[dict[str, Any]]] = {}
        for row in tables["poses"]:
            poses.setdefault(row["trajectory"], []).append(dict(row))
        chosen: dict[str, str] = {}
        for name in sorted(str(name) for name in draw.choice(owners, size=2 * len(owners) // 3, replace=False)):
            kind = KINDS[turn % len(KINDS)]
            turn += 1
            if kind(Walk(walks[name], listed[name], poses[name], texts, out, draw)):
                chosen[name] = kind.__name__
        found = {"trajectories": [*walks.values()], "poses": [row for group in poses.values() for row in group]}
        for table, content in found.items():
            pq.write_table(pa.Table.from_pylist(content, schema=schemas[table]), out / f"{table}.parquet")
        (out / "annotations.json").write_text(json.dumps([*listed.values()]))
        # An oracle walk has the images and actions of its direct walk.
        document = proven(asked, out, render_every=0).document
        faults = {fault["trajectory"].replace("_oracle", "_direct") for fault in document["faults"]}
        assert faults <= chosen.keys(), faults - chosen.keys()
        planted.update(chosen.values())
        missed += [f"{kind} of {name}" for name, kind in chosen.items() if name not in faults]
        shutil.rmtree(out)
    print(f"{planted.total() - len(missed)} of {planted.total()} mutants caught: {dict(planted)}")
    assert planted.keys() == {kind.__name__ for kind in KINDS}
    assert not missed
