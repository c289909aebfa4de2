"""Checks over all episodes: repeated ids and texts, and scenes or programs in two splits."""

from __future__ import annotations

import hashlib

from condvln.verify.certificate import Certificate
from schemas.evaluation import ManifestEpisode
from schemas.program import Condition, ObjectRef, Program

__all__ = ["Corpus"]

_GROUP_OF_SPLIT = {"train": "train", "val_seen": "train", "val_unseen": "val_unseen", "test": "test"}


class Corpus:
    """Remembers what must be unique over all episodes; takes about 200 bytes per episode."""

    def __init__(self) -> None:
        self._ids: set[int | str] = set()
        self._episodes: dict[bytes, int | str] = {}
        self._scenes: dict[tuple[str, str], str] = {}
        self._programs: dict[bytes, tuple[str, int | str]] = {}
        self._groups: dict[str, tuple[tuple[object, ...], Program]] = {}

    def check(self, row: ManifestEpisode, split: str, certificate: Certificate) -> None:
        """Check one more episode against the earlier ones."""
        certificate.same("split_named", row.split, split)
        certificate.holds("unique_id", row.episode_id not in self._ids, "an id of its own", row.episode_id)
        self._ids.add(row.episode_id)
        if row.episode_hash != row.episode_id:
            certificate.same("id_of_hash", row.episode_id, _number(row.episode_hash))
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
            self._check_group(row, row.group_id, split, certificate)

    def _check_program(self, row: ManifestEpisode, place: str, split: str, certificate: Certificate) -> None:
        unit = row.group_id or row.episode_id
        key = _digest(place + _told(row.program))
        its_split, its_unit = self._programs.setdefault(key, (split, unit))
        certificate.same("program_leakage", split, its_split)
        certificate.holds("program_once", unit == its_unit, "one start", f"another, of {its_unit}")

    def _check_group(self, row: ManifestEpisode, group_id: str, split: str, certificate: Certificate) -> None:
        """Check that the members of a counterfactual group are equal, except that one condition may have the opposite
        truth and two leaves may be exchanged.
        """
        shared = (row.source, row.scene_id, split, row.category, row.start_position, row.start_rotation, row.max_steps)
        first_shared, first = self._groups.setdefault(group_id, (shared, row.program))
        certificate.same("group", shared, first_shared, group_id)
        turned = [
            (one, other) for one, other in zip(first.conditions, row.program.conditions, strict=False) if one != other
        ]
        opposite = all(one.truth != other.truth for one, other in turned)
        certificate.holds("group", len(turned) <= 1 and opposite, "one condition turned", len(turned), group_id)
        moved = [pair for pair in zip(first.leaves, row.program.leaves, strict=False) if pair[0] != pair[1]]
        exchanged = not moved or (len(moved) == 2 and moved[0] == moved[1][::-1])
        certificate.holds("group", exchanged, "two leaves exchanged", len(moved), group_id)


def _number(episode_hash: str) -> int:
    """Return the episode id that follows from `episode_hash`: 52 bits of the SHA-256 of that hash's text."""
    return int(hashlib.sha256(episode_hash.encode()).hexdigest()[:13], 16)


def _told(program: Program) -> str:
    """Return a text that identifies a program within its scene. Making this text takes a third of the time that the
    program's JSON would take.
    """
    conditions = [(c.label, c.truth, *_ids(c)) for c in program.conditions]
    leaves = [[(move.object_id, *_ids(move)) for move in leaf.moves] for leaf in program.leaves]
    return repr((program.category, conditions, leaves))


def _ids(named: Condition | ObjectRef) -> tuple[str | None, ...]:
    qualifier = named.qualifier
    of_qualifier = (None, ()) if qualifier is None else (qualifier.predicate, qualifier.anchor_ids)
    return (named.room.room_id, named.room.anchor_id, *of_qualifier)


def _digest(text: str) -> bytes:
    return hashlib.blake2b(text.encode(), digest_size=16).digest()
