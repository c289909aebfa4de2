"""What each stage of a scene costs, estimated from counts that are known before a run.

A stage's CPU seconds are a sum of coefficients times counts, never negative: see `counts_of` for the counts and
`COEFFICIENTS` for the coefficients, in CPU seconds of the reference machine (``factory.speed``). They only have to be
right for the first run of a source: from then on the factory corrects them by its receipts (``factory.costs``).
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

from condvln.sources.source import SceneCounts

__all__ = ["COEFFICIENTS", "COMPILE_SECONDS", "FEATURES", "LIKE", "counts_of", "stage_costs"]

FEATURES: Final[Mapping[str, tuple[str, ...]]] = {
    "scene": ("scene", "objects", "mesh_mb"),
    "relations": ("scene", "kilopairs"),
    "programs": ("scene", "objects", "asked"),
    "episodes": ("scene", "placed", "placed_kiloobjects"),
    "text": ("scene", "asked"),
}
"""The counts that each stage's cost is made of."""

COEFFICIENTS: Final[Mapping[str, Mapping[str, tuple[float, ...]]]] = {
    "replicacad": {
        "scene": (0.0, 0.0018, 0.0),
        "relations": (0.176, 0.0644),
        "programs": (0.51, 0.0045, 0.0),
        "episodes": (0.51, 0.0, 0.188),
        "text": (0.09, 0.0),
    },
    "procthor": {
        "scene": (0.0, 0.0013, 0.0),
        "relations": (0.02, 0.0133),
        "programs": (1.33, 0.0026, 0.0),
        "episodes": (0.37, 0.0, 0.335),
        "text": (0.1, 0.0),
    },
    "ithor": {
        "scene": (0.032, 0.0007, 0.0),
        "relations": (0.04, 0.0),
        "programs": (0.26, 0.0074, 0.0),
        "episodes": (0.3, 0.0, 0.016),
        "text": (0.037, 0.0),
    },
    "gibson": {
        "scene": (0.018, 0.0003, 0.0),
        "relations": (0.05, 0.0),
        "programs": (0.57, 0.0085, 0.0),
        "episodes": (0.15, 0.0, 0.335),
        "text": (0.046, 0.0),
    },
}
"""CPU seconds of the reference machine for one of each of a stage's ``FEATURES``, by family."""

LIKE: Final[Mapping[str, str]] = {"robothor": "ithor", "mp3d": "gibson"}
"""Families without scenes to measure on, and the family whose scenes are most like theirs."""

COMPILE_SECONDS: Final = 105.0
"""CPU seconds that compiling all kernels takes once on the reference machine; after that they come from a cache."""

_ALWAYS_PLACED: Final = ("procthor", "ithor", "robothor")
"""Families of which every scene gets a navmesh, built from its walls or its reachable positions."""


def counts_of(family: str, counts: SceneCounts, asked: int) -> dict[str, float]:
    """The counts that costs are made of, by name.

    scene : 1
    objects : objects of the scene
    kilopairs : thousand ordered pairs of objects that share a room, where all rooms are equally full
    asked : hundred episodes asked of the scene
    placed : the same where the scene has a navmesh or gets one; else 0
    placed_kiloobjects : placed episodes times objects, in thousands of both multiplied
    mesh_mb : megabytes of meshes that a navmesh must be built from; 0 where one is shipped
    """
    navmesh = family in _ALWAYS_PLACED or counts.navmesh_bytes > 0 or counts.mesh_bytes > 0
    placed = asked if navmesh else 0
    return {
        "scene": 1.0,
        "objects": counts.objects,
        "kilopairs": counts.objects**2 / counts.rooms / 1000,
        "asked": asked / 100,
        "placed": placed / 100,
        "placed_kiloobjects": placed * counts.objects / 1000,
        "mesh_mb": 0.0 if counts.navmesh_bytes else counts.mesh_bytes / 1e6,
    }


def stage_costs(family: str, counts: SceneCounts, asked: int) -> dict[str, float]:
    """CPU seconds on the reference machine of each stage of one scene.

    asked : episodes asked of the scene, all categories and counterfactual groups together
    """
    known = counts_of(family, counts, asked)
    return {
        stage: sum(c * known[name] for c, name in zip(coefficients, FEATURES[stage], strict=True))
        for stage, coefficients in COEFFICIENTS[LIKE.get(family, family)].items()
    }
