"""What the source itself states about which objects are in or on which other objects."""

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
    """Statements of a source about the objects of one room, as arrays: contained object by row, holder by column.

    on, inside : (n, n) the source says that the row rests on the column, or is contained in it
    named : (n, n) the source names the column as the row's receptacle, however the statement is interpreted
    denied : (n, n) the source names the row's receptacles, and none of them is the column or in or on it
    container : (n,) objects that others are put into
    open : (n,) containers that one can look into
    """

    on: Mask
    inside: Mask
    named: Mask
    denied: Mask
    container: Mask
    open: Mask


def holding_of(arrays: RoomArrays) -> Holding:
    """Return what the sources state about which of a room's n objects are in or on which others."""
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
    containers = np.array([kind is not None for kind in kinds], dtype=np.bool_)
    return Holding(on, inside, named, denied, containers, np.array(opened, dtype=np.bool_))


def closure(direct: Mask) -> Mask:
    """Return a mask (n, n): whether a chain of one or more links of the mask `direct` (n, n) leads from i to j."""
    found = direct.copy()
    for k in np.flatnonzero(direct.any(axis=0) & direct.any(axis=1)).tolist():  # the links through k (Warshall, 1962)
        found[found[:, k]] |= found[k]
    return found
