"""The boxes (pieces) of which a room's objects consist: one box for most objects, several for an L-shaped counter."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from condvln.arrays import Bools
from condvln.relations.metrics import millimetres
from condvln.scene import RoomArrays, round_mm
from condvln.scene.boxes import aabb_of, box_corners

__all__ = ["Pieces"]


@dataclass(frozen=True, eq=False)
class Pieces:
    """The m ≥ n pieces of n objects; the pieces of one object are consecutive.

    arrays : the pieces as arrays, each with its object's id and label; equal to `whole` if every object is one piece
    owner (m,) : index of each piece's object
    """

    whole: RoomArrays
    arrays: RoomArrays
    owner: NDArray[np.intp]

    @classmethod
    def of(cls, whole: RoomArrays) -> Pieces:
        """Return the pieces of a room's objects."""
        counts = np.array([max(1, len(item.parts)) for item in whole.objects], dtype=np.intp)
        owner = np.repeat(np.arange(len(whole), dtype=np.intp), counts)
        if len(owner) == len(whole):
            return cls(whole, whole, owner)
        boxes = np.stack([whole.aabb_min, whole.aabb_max], axis=1)[owner]
        centers = whole.centers[owner]
        compound = [k for k in range(len(owner)) if whole.objects[owner[k]].parts]
        first = np.searchsorted(owner, owner)
        for k in compound:
            boxes[k] = round_mm(aabb_of(box_corners(whole.objects[owner[k]].parts[k - first[k]])))
            # Centres in whole millimetres, halves rounded to even, so that every computation gives the same ones.
            centers[k] = np.rint(millimetres(boxes[k]).sum(axis=0) / 2.0) / 1000.0
        arrays = RoomArrays(
            room_id=whole.room_id,
            object_ids=tuple(whole.object_ids[i] for i in owner),
            labels=tuple(whole.labels[i] for i in owner),
            centers=centers,
            aabb_min=boxes[:, 0],
            aabb_max=boxes[:, 1],
            radius=whole.radius[owner],
            hidden=whole.hidden[owner],
            objects=tuple(whole.objects[i] for i in owner),
            floor_y=whole.floor_y,
        )
        return cls(whole, arrays, owner)

    @cached_property
    def compound(self) -> Bools:
        """Mask (n,) of objects with several pieces."""
        return np.bincount(self.owner, minlength=len(self.whole)) > 1

    @property
    def several(self) -> bool:
        """Whether any object has several pieces."""
        return self.arrays is not self.whole

    def spread(self, values: NDArray[Any]) -> NDArray[Any]:
        """Return an array (m, m) for pairs of pieces. Each pair of pieces has the entry of `values` (n, n) for the two
        objects to which the pieces belong.
        """
        return values[np.ix_(self.owner, self.owner)] if self.several else values

    def any(self, mask: Bools) -> Bools:
        """Return a mask (n, n) for pairs of objects: whether the mask (m, m) is true for some pair of a piece of one
        object and a piece of the other.
        """
        return np.asarray(self._reduced(np.logical_or, mask), dtype=np.bool_)

    def all(self, mask: Bools) -> Bools:
        """Return, for each two of the n objects, whether `mask` is true for every pair of their pieces, as (n, n).
        `mask` (m, m) has an entry for each two of the m pieces.
        """
        return np.asarray(self._reduced(np.logical_and, mask), dtype=np.bool_)

    def least(self, values: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return, for each two of the n objects, the least value over all pairs of their pieces, as (n, n); NaN if one
        of these values is NaN. `values` (m, m) has a value for each two of the m pieces.
        """
        return np.asarray(self._reduced(np.minimum, values), dtype=np.float64)

    def most(self, values: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return, for each two of the n objects, the greatest value over all pairs of their pieces, as (n, n); NaN if
        one of these values is NaN. `values` (m, m) has a value for each two of the m pieces.
        """
        return np.asarray(self._reduced(np.maximum, values), dtype=np.float64)

    def _reduced(self, how: Callable[..., Any], values: NDArray[Any]) -> NDArray[Any]:
        if not self.several:
            return values
        first = np.flatnonzero(np.diff(self.owner, prepend=-1))
        found: NDArray[Any] = how.reduceat(how.reduceat(values, first, axis=0), first, axis=1)  # type: ignore[attr-defined]
        return found
