"""What only shows when all episodes are seen together: repeats, and scenes or programs in two splits."""

from __future__ import annotations

import hashlib

from condvln.verify.certificate import Certificate
from schemas.evaluation import ManifestEpisode

__all__ = ["Corpus"]

_GROUP_OF_SPLIT = {"train": "train", "val_seen": "train", "val_unseen": "val_unseen", "test": "test"}


class Corpus:
    """Remembers, of each episode that was seen, what another must not repeat; some 200 bytes an episode."""

    def __init__(self) -> None:
        self._ids: set[str] = set()
        self._episodes: dict[bytes, str] = {}
        self._scenes: dict[tuple[str, str], str] = {}
        self._programs: dict[bytes, tuple[str, str]] = {}
        self._groups: dict[str, tuple[str, str, str, str, int]] = {}

    def check(self, row: ManifestEpisode, split: str, certificate: Certificate) -> None:
        """Hold one more episode against those before it."""
        certificate.same("split_named", row.split, split)
        certificate.holds("unique_id", row.episode_id not in self._ids, "an id of its own", row.episode_id)
        self._ids.add(row.episode_id)
        place = f"{row.source}\0{row.scene_id}\0"
        former = self._episodes.setdefault(
            _digest(f"{place}{row.start_position}\0{row.instruction_text}"), row.episode_id
        )
        certificate.holds("unique_episode", former == row.episode_id, "one of its kind", former)
        group = _GROUP_OF_SPLIT.get(split, split)
        first = self._scenes.setdefault((row.source, row.scene_id), group)
        certificate.same("split_leakage", group, first)
        self._check_program(row, place, split, certificate)
        if row.group_id is not None:
            shared = (row.source, row.scene_id, split, row.category, row.max_steps)
            certificate.same("group", shared, self._groups.setdefault(row.group_id, shared), row.group_id)

    def _check_program(self, row: ManifestEpisode, place: str, split: str, certificate: Certificate) -> None:
        unit = row.group_id or row.episode_id
        key = _digest(place + row.program.model_dump_json())
        its_split, its_unit = self._programs.setdefault(key, (split, unit))
        certificate.same("program_leakage", split, its_split)
        certificate.holds("program_once", unit == its_unit, "one start", f"another, of {its_unit}")


def _digest(text: str) -> bytes:
    return hashlib.blake2b(text.encode(), digest_size=16).digest()
