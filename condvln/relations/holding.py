"""What the source itself says of what is in or on what."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from condvln.labels import vocabulary
from condvln.scene import RoomArrays
from condvln.scene.containment import stated_holders
from schemas.config.constants import OPEN_SHARE

__all__ = ["Holding", "closure", "holding_of"]

Mask = NDArray[np.bool_]


@dataclass(frozen=True, eq=False, slots=True)
class Holding:
    """Statements of a source about the objects of one room, the held one by row and the holder by column.

    on, inside : (n, n) its source says that it rests on the column, and that the column contains it
    named : (n, n) its source names the column as a receptacle, whatever comes of it
    denied : (n, n) its source says what it is in or on, and that is neither the column nor in or on the column
    open : (n,) containers into which one can look
    """

    on: Mask
    inside: Mask
    named: Mask
    denied: Mask
    open: Mask


def holding_of(arrays: RoomArrays) -> Holding:
    """What the sources of n objects say."""
    n, index = len(arrays), {name: k for k, name in enumerate(arrays.object_ids)}
    on, inside, named = (np.zeros((n, n), dtype=np.bool_) for _ in range(3))
    receptacles = {item.object_id: item.receptacles or () for item in arrays.objects}
    upon, within = stated_holders(arrays.objects)
    for mask, holders in ((on, upon), (inside, within), (named, receptacles)):
        for name, found in holders.items():
            mask[index[name], [index[holder] for holder in found if holder in index]] = True
    np.fill_diagonal(named, False)
    placed = np.asarray(on.any(axis=1) | inside.any(axis=1), dtype=np.bool_)
    kinds = [vocabulary.container(label) for label in arrays.labels]
    said_open = [item.openness is not None and item.openness >= OPEN_SHARE for item in arrays.objects]
    opened = [kind == "open" or (kind == "shut" and said) for kind, said in zip(kinds, said_open, strict=True)]
    denied = placed[:, None] & ~closure(named) & ~np.eye(n, dtype=np.bool_)
    return Holding(on, inside, named, denied, np.array(opened, dtype=np.bool_))


def closure(direct: Mask) -> Mask:
    """(n, n) pairs that are linked by a chain of one or more links."""
    found = direct
    while True:
        steps = found.astype(np.float32)
        longer = found | (steps @ steps > 0)
        if (longer == found).all():
            return found
        found = longer
