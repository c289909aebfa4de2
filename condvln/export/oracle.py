"""The oracle-linear twin: the same episode with the gold branch told as a plain instruction; all else stays."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, Final

from condvln.export.rows import Row

__all__ = ["ORACLE_COLUMNS", "OracleText", "oracle_episode", "oracle_text_of"]

OracleText = Mapping[str, str] | Callable[[Row, Row], str]
"""Linear text by episode id, or made from the columns :data:`ORACLE_COLUMNS` of a row of the episodes table and its
whole row of the instructions table."""

ORACLE_COLUMNS: Final = (
    "scene_id",
    "episode_id",
    "instruction_id",
    "category",
    "gold_leaf",
    "start_heading_degrees",
    "instruction_text",
)


def oracle_text_of(texts: OracleText, episode: Row, instruction: Row) -> str:
    """Linear text of one episode.

    Raises
    ------
    KeyError : a mapping without this episode
    """
    return texts(episode, instruction) if callable(texts) else texts[episode["episode_id"]]


def oracle_episode(stock: dict[str, Any], text: str, tokens: list[int]) -> dict[str, Any]:
    """The twin of a stock episode."""
    return {**stock, "instruction": {**stock["instruction"], "instruction_text": text, "instruction_tokens": tokens}}
