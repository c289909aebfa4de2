"""Variants of the stock episode: ANSR-v1, RxR-VLN-CE's guide files, and the oracle-linear twin.

ANSR-v1 adds top-level ``subgoals``, as the public evaluators of conditional episodes read them (source of the keys:
dataset type ``ANSR-v1`` of the VLN-Zero and Open-Nav forks). The key is always present, ``[]`` if the gold branch has
one move. RxR's trainers write predictions by ``instruction_id``, a number; ours is the episode's id. The twin is the
same episode with the gold branch as a plain instruction.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, Final

from condvln.export.rows import Row
from condvln.export.vlnce import encode, gold

__all__ = [
    "ORACLE_COLUMNS",
    "RXR_LANGUAGES",
    "OracleText",
    "ansr_bytes",
    "kept_texts",
    "oracle_episode",
    "oracle_text_of",
    "rxr_instruction",
    "subgoals",
]


def subgoals(row: Row) -> list[dict[str, Any]]:
    """Return the gold leaf's subgoals in order, with the success distance as their radius."""
    return [{"position": s["position"], "radius": row["success_distance"]} for s in gold(row)["subgoals"]]


def ansr_bytes(stock: bytes, row: Row) -> bytes:
    """Return the encoded ANSR-v1 episode made from the encoded stock episode ``stock``."""
    return stock[:-1] + b',"subgoals":' + encode(subgoals(row)) + b"}"


RXR_LANGUAGES: Final = {"en": "en-US", "es": "es-ES"}
"""RxR's name of a language."""


def rxr_instruction(row: Row, split: str, language: str = "en") -> dict[str, Any]:
    """Return the instruction of an RxR guide episode: the text under RxR's keys, without tokens (agents use their own
    encoder).
    """
    return {
        "instruction_id": str(row["episode_id"]),
        "instruction_text": row["instruction_text"],
        "language": RXR_LANGUAGES[language],
        "annotator_id": "0",
        "edit_distance": 0.0,
        "timed_instruction": [],
        "instruction_tokens": [],
        "split": split,
    }


OracleText = Mapping[int, str] | Callable[[Row, Row], str]
"""Linear text by episode id; or a function that makes it from the columns :data:`ORACLE_COLUMNS` of an episodes row and
the whole instructions row.
"""

TEXTS_KEPT: Final = 1 << 16
"""Number of linear texts that are kept from the pass that collects words for the one that writes: some 30 MB."""

ORACLE_COLUMNS: Final = (
    "scene_id",
    "episode_id",
    "instruction_id",
    "category",
    "gold_leaf",
    "start_heading_degrees",
    "instruction_text",
)


def kept_texts(texts: Callable[[Row, Row], str]) -> Callable[[Row, Row], str]:
    """Return a function that gives the same texts, and makes each of the first `TEXTS_KEPT` once for two calls."""
    kept: dict[tuple[str, int, str], str] = {}

    def text(episode: Row, instruction: Row) -> str:
        key = (episode["scene_id"], episode["episode_id"], instruction["instruction_id"])
        known = kept.pop(key, None)
        if known is None:
            known = texts(episode, instruction)
            if len(kept) < TEXTS_KEPT:
                kept[key] = known
        return known

    return text


def oracle_text_of(texts: OracleText, episode: Row, instruction: Row) -> str:
    """Return the linear text of one episode.

    Raises
    ------
    KeyError : the mapping lacks this episode
    """
    return texts(episode, instruction) if callable(texts) else texts[episode["episode_id"]]


def oracle_episode(stock: dict[str, Any], text: str, tokens: list[int]) -> dict[str, Any]:
    """Return the oracle-linear twin of a stock episode."""
    return {**stock, "instruction": {**stock["instruction"], "instruction_text": text, "instruction_tokens": tokens}}
