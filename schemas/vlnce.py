"""The stock R2R_VLNCE v1-3 document in the form that VLN-CE's loader accepts; the loader raises a TypeError on unknown
keys.

Source of the keys: R2R_VLNCE v1-3 and ``VLNExtendedEpisode``/``InstructionData`` of VLN-CE.
"""

from __future__ import annotations

from typing import Any

from pydantic import Field

from schemas.base import Document, Finite

__all__ = [
    "GroundTruth",
    "Instruction",
    "InstructionVocabulary",
    "NavigationGoal",
    "VlnCeDocument",
    "VlnCeEpisode",
]

Point = tuple[Finite, Finite, Finite]


class NavigationGoal(Document):
    """A point to reach; evaluators read `radius` from their own configuration, not from here."""

    position: Point
    radius: Finite | None = None


class Instruction(Document):
    """The text and its tokens, padded with the vocabulary's PAD index."""

    instruction_text: str
    instruction_tokens: list[int] | None = None


class VlnCeEpisode(Document):
    """One episode; CondVLN's own fields are under ``info``."""

    episode_id: int | str
    trajectory_id: int | str
    scene_id: str
    start_position: Point
    start_rotation: tuple[Finite, Finite, Finite, Finite]
    info: dict[str, Any] | None = None
    goals: list[NavigationGoal] = Field(min_length=1)
    instruction: Instruction
    reference_path: list[Point]


class InstructionVocabulary(Document):
    """Word tables of the vocabulary: PAD is 0, UNK is 1."""

    word_list: list[str]
    word2idx_dict: dict[str, int]
    stoi: dict[str, int]
    itos: list[str]
    num_vocab: int
    UNK_INDEX: int
    PAD_INDEX: int


class VlnCeDocument(Document):
    """Content of ``<split>.json.gz``: episodes and vocabulary."""

    episodes: list[VlnCeEpisode]
    instruction_vocab: InstructionVocabulary


class GroundTruth(Document):
    """One entry of ``<split>_gt.json.gz``, keyed there by episode id."""

    locations: list[Point]
    forward_steps: int | None = None
    actions: list[int] | None = None
