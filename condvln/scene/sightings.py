"""Which objects of a scene can't be seen, and for which this is uncertain."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from condvln.scene.scene import RoomArrays

__all__ = ["EVERYTHING_SEEN", "Sightings"]


@dataclass(frozen=True, slots=True)
class Sightings:
    """Ids of objects that certainly or perhaps can't be seen from where an agent can stand. All other objects can be
    seen.

    unseen : certainly not visible; they do not make a word ambiguous
    doubtful : perhaps visible; text uses no word that might mean them
    """

    unseen: frozenset[str] = frozenset()
    doubtful: frozenset[str] = frozenset()

    def hidden(self, arrays: RoomArrays) -> NDArray[np.bool_]:
        """Return whether each object of a room can't be seen, (n,) bool. This includes objects in shut containers."""
        return np.asarray(arrays.hidden | np.array([name in self.unseen for name in arrays.object_ids], dtype=bool))

    def in_doubt(self, arrays: RoomArrays) -> NDArray[np.bool_]:
        """Return whether each object of a room is in `doubtful` and not in a shut container, (n,) bool."""
        return np.asarray(~arrays.hidden & np.array([name in self.doubtful for name in arrays.object_ids], dtype=bool))


EVERYTHING_SEEN: Final = Sightings()
"""Every object is visible, except inside shut containers."""
