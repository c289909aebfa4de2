"""Layouts: groups of scenes that are variants of one scene with some furniture moved.

The layout is recognised by the scene's name. A fact may be true in half of all scenes and yet be constant within each
layout, so label statistics are counted, and guessed, within a layout.
"""

from __future__ import annotations

import re
from functools import lru_cache
from typing import Final

__all__ = ["layout_of"]

# ReplicaCAD has 21 variants of each of its layouts (Szot et al. 2021), RoboTHOR five of each apartment (Deitke et al.
# 2020).
_STAGING: Final = re.compile(r"(v\d+_sc\d+)_staging_\d+|(FloorPlan_(?:Train|Val|Test)\d+)_\d+(?:_physics)?")


@lru_cache(maxsize=1024)
def layout_of(scene_id: str) -> str:
    """Return the name of a scene's layout; empty if the scene is not known to be one of several variants."""
    found = _STAGING.fullmatch(scene_id)
    return "" if found is None else found[1] or found[2]
