"""Loaders as strict as those of VLN-CE, habitat-lab and the ANSR-v1 forks: a key too many is a TypeError, one too
few a KeyError.

Written from the published behaviour of ``VLNCEDatasetV1.from_json``, ``VLNDatasetV1.from_json`` and
``ANSRDatasetV1``: each record is ``Class(**record)`` of an attrs class. ``RxRVLNCEDatasetV1`` takes ids as they are;
the others make texts of them.
"""

from __future__ import annotations

import gzip
import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any


@dataclass
class Instruction:
    instruction_text: str
    instruction_tokens: list[int] | None = None


@dataclass
class RxRInstruction:
    instruction_id: str
    instruction_text: str
    language: str
    annotator_id: str | None = None
    edit_distance: float | None = None
    timed_instruction: list[dict[str, float | str]] | None = None
    instruction_tokens: list[str] | None = None
    split: str | None = None


@dataclass
class Goal:
    position: list[float]
    radius: float | None = None


@dataclass
class Episode:
    episode_id: str
    scene_id: str
    start_position: list[float]
    start_rotation: list[float]
    instruction: Any
    trajectory_id: str
    info: dict[str, Any] | None = None
    goals: list[Any] | None = None
    start_room: str | None = None
    shortest_paths: Any = None
    reference_path: list[list[float]] | None = None


@dataclass
class AnsrEpisode(Episode):
    subgoals: list[Any] | None = None


def read(path: Path) -> Any:
    with gzip.open(path, "rt") as file:
        return json.load(file)


def load_split(path: Path, kind: type[Episode] = Episode, instruction: type = Instruction) -> list[Episode]:
    """Load one split as a strict loader does, asserting all that it needs.

    Ids are texts then: a list of allowed ids, the keys of the ground truth and of predictions are.
    """
    document = read(path)
    vocabulary = document["instruction_vocab"]["word_list"] if instruction is Instruction else None
    loaded = []
    for record in document["episodes"]:
        if instruction is not RxRInstruction:
            record["episode_id"] = str(record["episode_id"])
            record["trajectory_id"] = str(record["trajectory_id"])
        episode = kind(**record)
        assert type(episode.episode_id) is type(episode.trajectory_id) is str
        for name in ("scene_id", "start_position", "start_rotation", "instruction", "reference_path"):
            assert getattr(episode, name) is not None
        episode.scene_id = "data/scene_datasets/" + episode.scene_id.removeprefix("data/scene_datasets/")
        episode.instruction = instruction(**episode.instruction)
        episode.goals = [Goal(**goal) for goal in episode.goals or []]
        assert episode.goals
        if isinstance(episode, AnsrEpisode):
            assert episode.subgoals is not None
            episode.subgoals = [Goal(**goal) for goal in episode.subgoals]
        if vocabulary is not None:
            assert all(0 <= token < len(vocabulary) for token in episode.instruction.instruction_tokens)
        loaded.append(episode)
    return loaded
