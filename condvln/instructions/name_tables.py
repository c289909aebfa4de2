"""The names of rooms and of targets as arrays of numbers, from which a compiled kernel draws."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from itertools import accumulate
from typing import Final

import numpy as np
from numpy.typing import NDArray

from condvln.instructions.kernels.conditions import NOTHING
from condvln.instructions.kernels.programs import MOST_ANCHORS, NameTables
from condvln.instructions.predicates import GROUP_OF
from condvln.instructions.statement_tables import NumberedStatements
from condvln.instructions.stops import Target
from schemas.config import SamplingConfig
from schemas.program import ObjectRef, RoomRef

__all__ = ["NumberedNames", "preferences"]

I64 = NDArray[np.int64]

GROUPS: Final = {name: k for k, name in enumerate(("", *sorted(set(GROUP_OF.values()))))}
"""Numbers of the groups of predicates; the first is for names without one."""


def preferences(refs: Sequence[ObjectRef], sampling: SamplingConfig) -> list[float]:
    """Return the weights of `refs`, the names of one object, set by their predicates; a name of weight 0 is used only
    if the object has no other name.
    """
    groups = [_group(ref) for ref in refs]
    weights = [_weight(group, sampling) / groups.count(group) for group in groups]
    return weights if any(weights) else [1.0] * len(refs)


def _group(ref: ObjectRef) -> str:
    return "" if ref.qualifier is None else GROUP_OF[ref.qualifier.predicate]


def _weight(group: str, sampling: SamplingConfig) -> float:
    weight: float = getattr(sampling.predicates, group, 1.0)
    return weight


class NumberedNames:
    """All names of the rooms and targets of a scene by numbers.

    Parameters
    ----------
    rooms : the names of each room, in order of the rooms' numbers
    targets : in order of their numbers
    names_of : returns the names of a target in a room with a certain name
    statements : whose numbers of labels and rooms are used
    asked, start : ids of the rooms about which conditions can be asked, and egocentric ones

    Attributes
    ----------
    refs : names of targets by number
    """

    def __init__(
        self,
        rooms: Mapping[str, Sequence[RoomRef]],
        targets: Sequence[Target],
        names_of: Callable[[Target, RoomRef], Sequence[ObjectRef]],
        statements: NumberedStatements,
        sampling: SamplingConfig,
        asked: Collection[str],
        start: Collection[str],
    ) -> None:
        self.refs: list[ObjectRef] = []
        self._rooms = {room_id: tuple(names) for room_id, names in rooms.items()}
        first, sums = [0], list[float]()
        key_first = []
        for target in targets:
            key_first.append(len(first) // 2)
            for room in self._rooms[target.room_id]:
                everything = names_of(target, room)
                for at_start in (False, True):
                    refs = [ref for ref in everything if at_start or not ref.is_bearing]
                    self.refs += refs
                    sums += accumulate(preferences(refs, sampling))
                    first.append(len(self.refs))
        anchors = [() if ref.qualifier is None else ref.qualifier.anchor_labels for ref in self.refs]
        names = [name for own in self._rooms.values() for name in own]
        labels = [target.label for target in targets]
        room_labels = [name.anchor_label for name in names]
        statements.add_labels([*labels, *(label for own in anchors for label in own), *filter(None, room_labels)])
        groups = [_group(ref) for ref in self.refs]
        known: dict[int, int] = {}
        self.tables = NameTables(
            room_first=np.cumsum([0, *map(len, self._rooms.values())], dtype=np.int64),
            room_anchor=np.array([statements.label(label) for label in room_labels], np.int64),
            key_first=np.array(key_first, np.int64),
            first=np.array(first, np.int64),
            sums=np.array(sums, np.float64),
            weight=np.array([_weight(group, sampling) for group in groups], np.float64),
            group=np.array([GROUPS[group] for group in groups], np.int64),
            anchors=np.array(
                [[*map(statements.label, own), *[NOTHING] * MOST_ANCHORS][:MOST_ANCHORS] for own in anchors], np.int64
            ).reshape(-1, MOST_ANCHORS),
            bearing=np.array([ref.is_bearing for ref in self.refs], bool),
            same=np.array([known.setdefault(id(ref), k) for k, ref in enumerate(self.refs)], np.int64),
            label=np.array([statements.label(label) for label in labels], np.int64),
            statement_room=np.array([statements.room(room_id) for room_id in self._rooms], np.int64),
            asked=np.array([room_id in asked for room_id in self._rooms], bool),
            start=np.array([room_id in start for room_id in self._rooms], bool),
        )
