"""Variants of the stock episode: ANSR-v1, RxR-VLN-CE's guide files, and the oracle-linear twin.

ANSR-v1 adds top-level ``subgoals``, as the public evaluators of conditional episodes read them (source of the keys:
dataset type ``ANSR-v1`` of the VLN-Zero and Open-Nav forks). The key is always present, ``[]`` if the gold branch has
one move. RxR's trainers write predictions by ``instruction_id``, a number; ours is the episode's id. The twin is the
same episode with the gold branch as a plain instruction.
"""

from __future__ import annotations

import zlib
from collections import deque
from collections.abc import Callable, Mapping
from typing import Any, Final

import orjson

from condvln.export.rows import Row
from condvln.export.vlnce import encode, gold

__all__ = [
    "ORACLE_COLUMNS",
    "RXR_LANGUAGES",
    "LinearTexts",
    "OracleText",
    "ansr_bytes",
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

ORACLE_COLUMNS: Final = (
    "scene_id",
    "episode_id",
    "instruction_id",
    "category",
    "gold_leaf",
    "start_heading_degrees",
    "instruction_text",
)


class LinearTexts:
    """Linear texts for two passes over the same scenes in the same order: the first collects words, the second writes.

    Each is made once, in the first pass, and then kept, compressed with those of its scene to some 50 bytes.

    made : makes a text; see :data:`OracleText`
    """

    def __init__(self, made: Callable[[Row, Row], str]) -> None:
        self._made = made
        self._blocks: deque[tuple[str, bytes]] = deque()
        self._scene: str | None = None
        self._texts: list[tuple[str, str]] = []
        self._open_scene: str | None = None
        self._open: dict[str, str] = {}

    def first(self, episode: Row, instruction: Row) -> str:
        """Make a text in the first pass, and keep it."""
        text = self._made(episode, instruction)
        if episode["scene_id"] != self._scene:
            self._close()
            self._scene = episode["scene_id"]
        self._texts.append((_key(episode, instruction), text))
        return text

    def again(self, episode: Row, instruction: Row) -> str:
        """Return a text in the second pass: the one that was kept, or a new one if its scene is not the next one."""
        scene = episode["scene_id"]
        if scene != self._open_scene:
            self._close()
            kept = self._blocks and self._blocks[0][0] == scene
            self._open = dict(orjson.loads(zlib.decompress(self._blocks.popleft()[1]))) if kept else {}
            self._open_scene = scene
        known = self._open.pop(_key(episode, instruction), None)
        return self._made(episode, instruction) if known is None else known

    def _close(self) -> None:
        """Compress the texts of the scene that the first pass was in."""
        if self._scene is not None:
            self._blocks.append((self._scene, zlib.compress(orjson.dumps(self._texts), 1)))
        self._scene, self._texts = None, []


def _key(episode: Row, instruction: Row) -> str:
    return f"{episode['episode_id']} {instruction['instruction_id']}"


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
