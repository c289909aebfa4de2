"""Checks over all episodes: repeated ids and texts, and scenes or programs in two splits."""

from __future__ import annotations

import hashlib
from typing import Any, Final

import orjson

from condvln.verify.certificate import Certificate
from condvln.verify.files import UnplacedText
from schemas.evaluation import ManifestEpisode
from schemas.program import Condition, ObjectRef, Program

__all__ = ["Corpus"]

_GROUP_OF_SPLIT: Final = {"train": "train", "val_seen": "train", "val_unseen": "val_unseen", "test": "test"}


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
        group = _GROUP_OF_SPLIT.get(split, split)
        certificate.same("split_named", row.split, split)
        certificate.same("id_of_hash", row.episode_id, _number(row.episode_hash))
        certificate.same("split_leakage", group, self._scenes.setdefault((row.source, row.scene_id), group))
        place = (row.start_position, row.start_rotation, row.max_steps)
        certificate.same("program_leakage", split, self._check(row, row.episode_id, split, place, certificate))

    def check_text(self, row: UnplacedText, certificate: Certificate) -> None:
        """Check one more text that has no episode against the earlier ones."""
        self._check(row, row.instruction_id, "", (), certificate)

    def _check(
        self,
        row: ManifestEpisode | UnplacedText,
        name: int | str,
        split: str,
        place: tuple[object, ...],
        certificate: Certificate,
    ) -> str:
        """Check what episodes and texts have both, and return the split in which the row's program was first. `place`
        has the start, if there is one, and what else the members of a group share.
        """
        certificate.holds("unique_id", name not in self._ids, "an id of its own", name)
        self._ids.add(name)
        episode = (row.source, row.scene_id, place[:1], row.instruction_text)
        former = self._episodes.setdefault(_digest(episode), name)
        certificate.holds("unique_episode", former == name, "one of its kind", former)
        unit = row.group_id or name
        its_split, its_unit = self._programs.setdefault(_digest(_told(row)), (split, unit))
        certificate.holds("program_once", unit == its_unit, "one start", f"another, of {its_unit}")
        if row.group_id is not None:
            shared = (row.source, row.scene_id, split, row.category, *place)
            self._compare_group(shared, row.program, row.group_id, certificate)
        return its_split

    def _compare_group(
        self, shared: tuple[object, ...], program: Program, group_id: str, certificate: Certificate
    ) -> None:
        """Check that the members of a counterfactual group are equal, except that one condition may have the opposite
        truth and two leaves may be exchanged.
        """
        first_shared, first = self._groups.setdefault(group_id, (shared, program))
        certificate.same("group", shared, first_shared, group_id)
        turned = [
            (one, other) for one, other in zip(first.conditions, program.conditions, strict=False) if one != other
        ]
        opposite = all(one.truth != other.truth for one, other in turned)
        certificate.holds("group", len(turned) <= 1 and opposite, "one condition turned", len(turned), group_id)
        moved = [pair for pair in zip(first.leaves, program.leaves, strict=False) if pair[0] != pair[1]]
        exchanged = not moved or (len(moved) == 2 and moved[0] == moved[1][::-1])
        certificate.holds("group", exchanged, "two leaves exchanged", len(moved), group_id)


def _number(episode_hash: str) -> int:
    """Return the episode id that follows from `episode_hash`: 52 bits of the SHA-256 of that hash's text."""
    return int(hashlib.sha256(episode_hash.encode()).hexdigest()[:13], 16)


def _told(row: ManifestEpisode | UnplacedText) -> tuple[Any, ...]:
    """Return what identifies the program of a row within all scenes."""
    program = row.program
    conditions = [(c.label, c.truth, *_ids(c)) for c in program.conditions]
    leaves = [[(move.object_id, *_ids(move)) for move in leaf.moves] for leaf in program.leaves]
    leads = [branch.lead and (branch.lead.room_id, branch.lead.anchor_id) for branch in program.branches]
    return row.source, row.scene_id, program.category, conditions, leaves, leads


def _ids(named: Condition | ObjectRef) -> tuple[Any, ...]:
    qualifier, room = named.qualifier, named.room
    if qualifier is None:
        return (room.room_id, room.anchor_id, None, ())
    return (room.room_id, room.anchor_id, qualifier.predicate, qualifier.anchor_ids)


def _digest(told: Any) -> bytes:
    return hashlib.blake2b(orjson.dumps(told), digest_size=16).digest()
