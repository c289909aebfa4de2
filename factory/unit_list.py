"""All units of a corpus, on disk: an object of each takes 10 to 30 KB."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator
from typing import Final

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from factory.spool import Spool
from factory.unit import Unit

__all__ = ["UnitList"]

_PIECE: Final = 4096
"""Ids that are packed at a time."""


class UnitList(Collection[Unit]):
    """Units in the order of their ids, which can be iterated over many times. In memory is only their order, and their
    ids while they are put in order.

    twice : an id that two units have; None if there is none
    faulty : whether a unit could not be listed
    """

    def __init__(self, units: Iterable[Unit] = ()) -> None:
        self._spool: Spool[Unit] = Spool()
        self.faulty = False
        held: list[str] = []
        packed: list[pa.Array] = []
        for unit in units:
            self._spool.append(unit)
            self.faulty = self.faulty or unit.fault is not None
            held.append(unit.unit_id)
            if len(held) == _PIECE:
                packed.append(_packed(held))
                held.clear()
        ids = pa.chunked_array([*packed, _packed(held)])
        order = pc.sort_indices(ids)
        same = _first_of_equal(ids.take(order))
        self.twice = None if same is None else same.decode("utf-8", "surrogatepass")
        self._order = order.to_numpy()

    def __len__(self) -> int:
        return len(self._spool)

    def __iter__(self) -> Iterator[Unit]:
        return map(self._spool.__getitem__, map(int, self._order))

    def __contains__(self, unit: object) -> bool:
        return any(unit == one for one in self)


def _packed(ids: list[str]) -> pa.Array:
    # As bytes, whose order is that of the texts: an id that can't be stored as a text is named later.
    return pa.array([one.encode("utf-8", "surrogatepass") for one in ids], pa.large_binary())


def _first_of_equal(ids: pa.ChunkedArray) -> bytes | None:
    """Return the first of the sorted ids that equals the next one."""
    at = np.flatnonzero(pc.equal(ids.slice(1), ids.slice(0, max(len(ids) - 1, 0))).to_numpy())
    return ids[int(at[0])].as_py() if len(at) else None
