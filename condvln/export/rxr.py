"""RxR-VLN-CE's guide files, for the agents that read those.

Their trainers write predictions by ``instruction_id``, a number; ours is taken from the episode's id.
"""

from __future__ import annotations

import hashlib
from typing import Any, Final

from condvln.export.rows import Row

__all__ = ["numeric_id", "rxr_episode"]

_BITS: Final = 52
"""Bits of a number that every JSON reader keeps exactly."""


def numeric_id(episode_id: str) -> int:
    """The number that stands for an episode where a format wants one."""
    return int.from_bytes(hashlib.sha256(episode_id.encode()).digest()[:8], "big") >> (64 - _BITS)


def rxr_episode(stock: dict[str, Any], row: Row, split: str) -> dict[str, Any]:
    """The guide's episode of a stock one: the text under RxR's keys, no tokens (agents bring their own encoder)."""
    return {
        **stock,
        "instruction": {
            "instruction_id": str(numeric_id(row["episode_id"])),
            "instruction_text": row["instruction_text"],
            "language": "en-US",
            "annotator_id": "0",
            "edit_distance": 0.0,
            "timed_instruction": [],
            "instruction_tokens": [],
            "split": split,
        },
    }
