"""Which scenes are near copies of each other: one layout, restaged with some of its furniture moved.

Only the name tells. A fact may hold in half of all scenes and yet be the same in all stagings of each layout; so what
is usual is counted, and guessed, within a layout.
"""

from __future__ import annotations

import re
from typing import Final

__all__ = ["layout_of"]

# ReplicaCAD has 21 stagings of each variant of its apartment (Szot et al. 2021), RoboTHOR five of each of its
# apartments (Deitke et al. 2020).
_STAGING: Final = re.compile(r"(v\d+_sc\d+)_staging_\d+|(FloorPlan_(?:Train|Val|Test)\d+)_\d+(?:_physics)?")


def layout_of(scene_id: str) -> str:
    """Name of the layout that a scene is a staging of; empty where it is not known to be one of several."""
    found = _STAGING.fullmatch(scene_id)
    return "" if found is None else found[1] or found[2]
