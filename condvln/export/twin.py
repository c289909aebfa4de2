"""The oracle-linear twin of a split that is already written: ours, or a stranger's file whose manifest we have."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import orjson
from pydantic import ValidationError

from condvln.export.oracle import oracle_episode
from condvln.export.streams import read_unpacked
from condvln.export.tokens import PAD_INDEX, UNK_INDEX, Vocabulary
from condvln.export.vlnce import document_writer, encode
from schemas.errors import FormatError, MissingFileError
from schemas.evaluation import ManifestEpisode

__all__ = ["TwinReport", "rewrite_split"]

LinearText = Callable[[ManifestEpisode], str]
"""The gold branch told as a plain instruction."""


@dataclass(frozen=True)
class TwinReport:
    """What a rewriting did: episodes, and words that the split's own vocabulary does not know."""

    episodes: int
    unknown_words: int


def rewrite_split(document: Path, manifest: Path, out: Path, text_of: LinearText) -> TwinReport:
    """Write the twin of ``document`` as ``out``: the same vocabulary, ids, places and paths, only the instructions
    differ.

    Raises
    ------
    MissingFileError, FormatError : one of the files is missing or damaged, or an episode is not in the manifest
    """
    content = _document(document)
    rows = _manifest(manifest)
    vocabulary = Vocabulary.from_document(content["instruction_vocab"])
    unknown = 0
    with document_writer(out, vocabulary) as writer:
        for episode in content["episodes"]:
            row = rows.get(str(episode["episode_id"]))
            if row is None:
                raise FormatError(
                    f"episode {episode['episode_id']} is not in {manifest.name}",
                    where=document,
                    remedy="Give the manifest of the same split",
                )
            text = text_of(row)
            tokens = _tokens(vocabulary, text, episode["instruction"].get("instruction_tokens"))
            unknown += tokens.count(UNK_INDEX)
            writer.add(encode(oracle_episode(episode, text, tokens)))
    return TwinReport(writer.entries.count, unknown)


def _tokens(vocabulary: Vocabulary, text: str, former: list[int] | None) -> list[int]:
    """Padded as the split's own instructions are, or bare where they are bare."""
    if former and former[-1] == PAD_INDEX:
        return vocabulary.padded(text, len(former))
    return vocabulary.encode(text)


def _document(path: Path) -> dict[str, Any]:
    data = read_unpacked(path)
    try:
        content = orjson.loads(data)
        if not all(isinstance(e["instruction"], dict) and "episode_id" in e for e in content["episodes"]):
            raise KeyError("instruction")
        Vocabulary.from_document(content["instruction_vocab"])
    except (ValueError, KeyError, TypeError) as error:
        raise FormatError(
            f"not a VLN-CE split ({type(error).__name__}: {error})", where=path, remedy="See condvln export --validate"
        ) from error
    found: dict[str, Any] = content
    return found


def _manifest(path: Path) -> dict[str, ManifestEpisode]:
    try:
        rows = [ManifestEpisode.model_validate_json(line) for line in path.read_bytes().splitlines() if line.strip()]
    except (FileNotFoundError, IsADirectoryError) as error:
        raise MissingFileError("no such file", where=path, remedy="Check the path") from error
    except ValidationError as error:
        first = error.errors()[0]
        place = ".".join(str(part) for part in first["loc"])
        raise FormatError(str(first["msg"]), where=path, place=place, remedy="Export the split again") from error
    return {row.episode_id: row for row in rows}
