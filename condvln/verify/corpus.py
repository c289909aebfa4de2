"""Checks over all episodes: repeated ids and texts, and scenes or programs in two splits."""

from __future__ import annotations

import hashlib
from typing import Any, Final

import orjson

from condvln.verify.certificate import Certificate
from schemas.evaluation import ManifestEpisode
from schemas.program import Condition, ObjectRef, Program

__all__ = ["Corpus"]

_GROUP_OF_SPLIT: Final = {"train": "train", "val_seen": "train", "val_unseen": "val_unseen", "test": "test"}

_ALL: Final = dict.fromkeys(
    (
        *("split_named", "unique_id", "id_of_hash", "unique_episode", "split_leakage", "program_leakage"),
        "program_once",
    ),
    1,
)
"""How often each fact is checked for an episode that is in no group."""


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
        name = row.episode_id
        new = name not in self._ids
        self._ids.add(name)
        number = name if row.episode_hash == name else _number(row.episode_hash)
        episode = (row.source, row.scene_id, row.start_position, row.instruction_text)
        former = self._episodes.setdefault(_digest(episode), name)
        group = _GROUP_OF_SPLIT.get(split, split)
        first = self._scenes.setdefault((row.source, row.scene_id), group)
        unit = row.group_id or name
        its_split, its_unit = self._programs.setdefault(_digest(_told(row)), (split, unit))
        if (
            row.split == its_split == split
            and new
            and number == former == name
            and first == group
            and its_unit == unit
            and row.episode_hash != name
        ):
            certificate.all_held(_ALL)
        else:
            certificate.same("split_named", row.split, split)
            certificate.holds("unique_id", new, "an id of its own", name)
            if row.episode_hash != name:
                certificate.same("id_of_hash", name, number)
            certificate.holds("unique_episode", former == name, "one of its kind", former)
            certificate.same("split_leakage", group, first)
            certificate.same("program_leakage", split, its_split)
            certificate.holds("program_once", unit == its_unit, "one start", f"another, of {its_unit}")
        if row.group_id is not None:
            self._check_group(row, row.group_id, split, certificate)

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


def _told(row: ManifestEpisode) -> tuple[Any, ...]:
    """Return what identifies the program of a row within all scenes."""
    program = row.program
    conditions = [(c.label, c.truth, *_ids(c)) for c in program.conditions]
    leaves = [[(move.object_id, *_ids(move)) for move in leaf.moves] for leaf in program.leaves]
    return row.source, row.scene_id, program.category, conditions, leaves


def _ids(named: Condition | ObjectRef) -> tuple[Any, ...]:
    qualifier, room = named.qualifier, named.room
    if qualifier is None:
        return (room.room_id, room.anchor_id, None, ())
    return (room.room_id, room.anchor_id, qualifier.predicate, qualifier.anchor_ids)


def _digest(told: Any) -> bytes:
    return hashlib.blake2b(orjson.dumps(told), digest_size=16).digest()
