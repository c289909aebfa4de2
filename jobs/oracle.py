"""``condvln export --oracle``: write the oracle-linear twin of a split. The twin's texts are plain instructions, which
give only the gold branch of each episode.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

from condvln.evaluation.walker import heading_of
from condvln.export.contents import read_index
from condvln.export.twin import TwinReport, rewrite_split
from condvln.formats.streams import atomic_copy
from condvln.instructions import oracle_linear, render_moves, with_preamble
from condvln.instructions.predicates import COMPASS
from condvln.manifest import manifest_path, read_manifest
from jobs.report import Report
from schemas.config import WordingConfig
from schemas.errors import UsageError
from schemas.evaluation import ManifestEpisode
from schemas.program import ObjectRef, RoomRef

__all__ = ["oracle_split", "text_of_moves", "twin_text"]

_SHARDS: Final = "content"
_TRUTH: Final = "_gt.json.gz"


def twin_text(episode: ManifestEpisode, texts: Mapping[str, Any], leaf: int | None = None) -> str:
    """Return one branch of an episode as a plain instruction, in words that are chosen as for the episode's own text.

    texts : how the export's texts were rendered, as its record says; its defaults where it does not
    leaf : the branch; the gold one where None
    """
    wording = WordingConfig.model_validate({k: v for k, v in texts.items() if k in WordingConfig.model_fields})
    heading = -math.degrees(heading_of(episode.start_rotation)) % 360.0
    moves = oracle_linear(episode.program, leaf)
    seed, preamble = int(texts.get("seed", 0)), bool(texts.get("preamble", True))
    return text_of_moves(moves, episode.instruction_id, heading, wording, seed=seed, preamble=preamble)


def text_of_moves(
    moves: tuple[RoomRef | ObjectRef, ...],
    instruction_id: str,
    heading_degrees: float,
    wording: WordingConfig | str = "en",
    *,
    seed: int,
    preamble: bool,
) -> str:
    """Return the stops of one leaf as a plain instruction; `seed` and `instruction_id` choose the words.

    heading_degrees : start heading, clockwise from north; preamble : open with it where compass words are used
    """
    told = render_moves(moves, seed, instruction_id, wording)
    qualifiers = [move.qualifier for move in moves if isinstance(move, ObjectRef)]
    compass = any(one is not None and one.predicate in COMPASS for one in qualifiers)
    return with_preamble(told, heading_degrees, seed, instruction_id, wording) if preamble and compass else told


def oracle_split(
    export: Path,
    split: str,
    *,
    file: Path | None = None,
    out: Path | None = None,
    seed: int | None = None,
    picks: Mapping[str, int] | None = None,
) -> Report:
    """Write the oracle-linear twin of a split, with the twin's shards and ground truth.

    Parameters
    ----------
    file : a VLN-CE, ANSR-v1 or RxR file of the split's episodes; by default the export's own stock file
    out : by default ``oracle/<split>/<split>.json.gz`` of the export
    seed : of the words; by default the export's own
    picks : the branch by the manifest's ids, as somebody picked it; the gold one where None

    Raises
    ------
    MissingFileError, FormatError : a file is missing or damaged, or an episode is not in the manifest
    UsageError : the twin would replace its original
    """
    document = file or export / "vlnce" / split / f"{split}.json.gz"
    target = out or export / "oracle" / split / f"{split}.json.gz"
    if target.resolve() == document.resolve():
        raise UsageError("the twin would replace its original", where=target, remedy="Name another file with --out")
    rows = read_manifest(manifest_path(export, split))
    manifest = {name: row for row in rows for name in (str(row.episode_id), row.episode_hash)}
    texts = (read_index(export) or {}).get("texts")
    texts = texts if isinstance(texts, dict) else {}
    if seed is not None:
        texts = {**texts, "seed": seed}

    def text_of(row: ManifestEpisode) -> str:
        return twin_text(row, texts, None if picks is None else picks[str(row.episode_id)])

    done = rewrite_split(document, manifest, target, text_of)
    files = [target]
    for shard in sorted((document.parent / _SHARDS).glob("*.json.gz")):
        files.append(target.parent / _SHARDS / shard.name)
        done += rewrite_split(shard, manifest, files[-1], text_of)
    truth = document.with_name(document.name.removesuffix(".json.gz") + _TRUTH)
    if truth.is_file():
        files.append(target.with_name(target.name.removesuffix(".json.gz") + _TRUTH))
        if files[-1].resolve() != truth.resolve():
            atomic_copy(truth, files[-1])
    return _report(done, files)


def _report(done: TwinReport, files: list[Path]) -> Report:
    mean = max(done.episodes, 1)
    lines = [
        f"{done.episodes} episodes in {files[0]}",
        f"{done.words_before / mean:.1f} words an instruction became {done.words / mean:.1f}",
    ]
    if done.unknown_words:
        lines.append(f"{done.unknown_words} words are not in the split's vocabulary and read as UNK")
    counts = {"words_before": done.words_before, "words": done.words, "unknown_words": done.unknown_words}
    return Report({"episodes": done.episodes, **counts, "files": [str(path) for path in files]}, lines)
