"""Write the oracle-linear twin of an existing split: a split of our own, or any other file for which there is a
manifest.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import astuple, dataclass
from pathlib import Path
from typing import Any

import orjson

from condvln.export.tokens import PAD_INDEX, UNK_INDEX, Vocabulary, tokenize
from condvln.export.vlnce import encode, oracle_episode
from condvln.formats.json_entries import read_unpacked
from condvln.formats.streams import JsonArrayStream, atomic_stream
from schemas.errors import FormatError
from schemas.evaluation import ManifestEpisode

__all__ = ["TwinReport", "rewrite_split"]

LinearText = Callable[[ManifestEpisode], str]
"""Returns the gold branch of a manifest row as a plain instruction."""


@dataclass(frozen=True)
class TwinReport:
    """What was written as the oracle twin of a split: the number of episodes, how many words their texts had before and
    have now, and how many words of the new texts the split's vocabulary lacks.
    """

    episodes: int
    words_before: int
    words: int
    unknown_words: int

    def __add__(self, other: TwinReport) -> TwinReport:
        return TwinReport(*(a + b for a, b in zip(astuple(self), astuple(other), strict=True)))


def rewrite_split(
    document: Path, manifest: Mapping[str, ManifestEpisode], out: Path, text_of: LinearText
) -> TwinReport:
    """Write the twin of ``document`` as ``out``: with the same vocabulary, ids, starts and paths, but other
    instructions.

    Parameters
    ----------
    document : a stock VLN-CE, ANSR-v1 or RxR file
    manifest : manifest rows by episode id

    Raises
    ------
    MissingFileError, FormatError : one of the files is missing or damaged, or an episode is not in the manifest
    StoreError : the file can't be written
    """
    content = _document(document)
    found = content.get("instruction_vocab")
    vocabulary = None if found is None else Vocabulary.from_document(found)
    rest = b"".join(b"," + encode(key) + b":" + encode(value) for key, value in content.items() if key != "episodes")
    counts = [0, 0, 0]
    with atomic_stream(out, closing=b"]" + rest + b"}") as stream:
        stream.write(b'{"episodes":[')
        entries = JsonArrayStream(stream)
        for episode in content["episodes"]:
            row = manifest.get(str(episode["episode_id"]))
            if row is None:
                raise FormatError(
                    f"episode {episode['episode_id']} is not in the manifest",
                    where=document,
                    remedy="Give the manifest of the same split",
                )
            text = text_of(row)
            twin = _twin(episode, text, vocabulary)
            entries.entry(encode(twin))
            words = tokenize(text)
            counts[0] += len(tokenize(episode["instruction"]["instruction_text"]))
            counts[1] += len(words)
            counts[2] += 0 if vocabulary is None else sum(token == UNK_INDEX for token in vocabulary.encode(text))
    return TwinReport(entries.count, *counts)


def _twin(episode: dict[str, Any], text: str, vocabulary: Vocabulary | None) -> dict[str, Any]:
    former = episode["instruction"]
    twin = oracle_episode(episode, text, _tokens(vocabulary, text, former.get("instruction_tokens")))
    told = twin["instruction"]
    if "instruction_tokens" not in former:
        del told["instruction_tokens"]
    if former.get("timed_instruction"):  # RxR's timing of the former words
        told["timed_instruction"] = []
    return twin


def _tokens(vocabulary: Vocabulary | None, text: str, former: Any) -> list[int]:
    """Return the tokens of ``text``; an empty list without a vocabulary. If ``former``, the episode's tokens in the
    original split, is padded, the result is padded to the same length.
    """
    if vocabulary is None:
        return []
    if isinstance(former, list) and former and former[-1] == PAD_INDEX:
        return vocabulary.padded(text, len(former))
    return vocabulary.encode(text)


def _document(path: Path) -> dict[str, Any]:
    data = read_unpacked(path)
    try:
        content = orjson.loads(data)
        for episode in content["episodes"]:
            if not isinstance(episode["instruction"]["instruction_text"], str) or "episode_id" not in episode:
                raise KeyError("instruction_text")
        if "instruction_vocab" in content:
            Vocabulary.from_document(content["instruction_vocab"])
    except (ValueError, KeyError, TypeError) as error:
        raise FormatError(
            f"not a VLN-CE split ({type(error).__name__}: {error})",
            where=path,
            remedy="Check the file with condvln verify PATH --lint",
        ) from error
    found: dict[str, Any] = content
    return found
