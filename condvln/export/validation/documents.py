"""Checks of ``{episodes, instruction_vocab}`` documents: stock VLN-CE, ANSR-v1 and RxR guides."""

from __future__ import annotations

from typing import Any, Final

from condvln.export.tokens import PAD_INDEX, UNK_INDEX, Vocabulary
from condvln.export.validation.document import Document, Kind, PathfinderOf
from condvln.export.validation.episodes import WITHHELD, EpisodeChecks
from condvln.export.validation.findings import LintReport

__all__ = ["check_document"]

_BERT_PAD, _BERT_UNK = "[PAD]", "[UNK]"
"""Special words of BERT's own vocabulary, which ``<split>_bertidx`` files have in place of R2R's."""

_TOP: Final = frozenset({"episodes", "instruction_vocab"})


def check_document(report: LintReport, content: dict[str, Any], pathfinder_of: PathfinderOf | None = None) -> Document:
    """Check one document; if ``pathfinder_of`` is given, also check it against the navmeshes of its scenes."""
    episodes = content.get("episodes")
    if not isinstance(episodes, list):
        report.add("episodes", "wrong-type", "not a list")
        return Document("vlnce")
    for key in sorted(set(content) - _TOP):
        report.add(key, "unknown-top-key", f"unknown key {key!r}")
    if not episodes:
        report.add("episodes", "no-episodes", "there is none")
    document = Document(_kind(report.file, episodes))
    document.vocabulary = _vocabulary(report, content.get("instruction_vocab"), document)
    withheld = all(isinstance(one, dict) and not one.keys() & WITHHELD for one in episodes)
    checks = EpisodeChecks(report, document, pathfinder_of, withheld=bool(episodes) and withheld)
    if episodes and withheld:
        report.add("episodes", "goals-withheld", "no episode has goals or a reference path")
    for number, episode in enumerate(episodes):
        report.episode = ""
        checks.check(f"episodes[{number}]", episode)
    report.episode = ""
    return document


def _kind(file: str, episodes: list[Any]) -> Kind:
    records = [episode for episode in episodes if isinstance(episode, dict)]
    if not records:  # an empty split: only the file's name tells the format
        return "rxr" if "_guide." in file or "_follower." in file else "vlnce"
    if 2 * sum("subgoals" in record for record in records) > len(records):
        return "ansr"
    told = [record["instruction"] for record in records if isinstance(record.get("instruction"), dict)]
    # A single wrong key does not change the file's format.
    if 2 * sum("language" in instruction for instruction in told) > len(told):
        return "rxr"
    return "vlnce"


def _vocabulary(report: LintReport, found: Any, document: Document) -> Vocabulary | None:
    if found is None and document.kind == "rxr":
        return None
    if not isinstance(found, dict) or not isinstance(found.get("word_list"), list):
        report.add("instruction_vocab", "missing-vocabulary", "no instruction_vocab.word_list")
        return None
    words = found["word_list"]
    place = "instruction_vocab"
    if not all(isinstance(word, str) for word in words):
        report.add(f"{place}.word_list", "wrong-type", "not a list of words")
        return None
    document.bert = words[:1] == [_BERT_PAD] and _BERT_UNK in words
    if len(set(words)) != len(words) or not (document.bert or words[:2] == ["<pad>", "<unk>"]):
        report.add(f"{place}.word_list", "vocabulary-inconsistent", "does not begin <pad>, <unk>, or repeats a word")
        return None
    index = {word: number for number, word in enumerate(words)}
    wanted: dict[str, Any] = {
        "word2idx_dict": index,
        "stoi": index,
        "itos": words,
        "num_vocab": len(words),
        "UNK_INDEX": words.index(_BERT_UNK) if document.bert else UNK_INDEX,
        "PAD_INDEX": PAD_INDEX,
    }
    for key, value in wanted.items():
        if key in found and found[key] != value:
            report.add(f"{place}.{key}", "vocabulary-inconsistent", f"{key} does not agree with word_list")
    return None if document.bert else Vocabulary(tuple(words))
