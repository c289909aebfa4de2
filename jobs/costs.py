"""Cost of each stage of a scene, estimated from counts that are known before a run.

A stage's CPU seconds are a sum of coefficients times counts, never negative: see `counts_of` for the counts and
`COEFFICIENTS` for the coefficients, in CPU seconds of the reference machine (``factory.machine``). They only have to be
right for the first run of a source: from then on the factory corrects them by its receipts (``factory.costs``).
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

from condvln.sources.family import FAMILIES
from condvln.sources.source import SceneCounts

__all__ = ["COEFFICIENTS", "COMPILE_SECONDS", "FEATURES", "counts_of", "stage_costs"]

FEATURES: Final[Mapping[str, tuple[str, ...]]] = {
    "scene": ("scene", "objects", "mesh_mb"),
    "relations": ("scene", "kilopairs"),
    "visibility": ("scene", "seen_objects"),
    "programs": ("objects", "asked"),
    "episodes": ("asked", "placed_kiloobjects"),
    "text": ("asked",),
}
"""Counts that the cost of each stage depends on; see `counts_of`."""

COEFFICIENTS: Final[Mapping[str, Mapping[str, tuple[float, ...]]]] = {
    "replicacad": {
        "scene": (0.0, 0.0018, 0.0),
        "relations": (0.176, 0.0644),
        "visibility": (0.02, 0.0020),
        "programs": (0.0045, 0.634),
        "episodes": (0.638, 0.188),
        "text": (0.113,),
    },
    "procthor": {
        "scene": (0.004, 0.0012, 0.0),
        "relations": (0.020, 0.0204),
        "visibility": (0.02, 0.0036),
        "programs": (0.0097, 0.766),
        "episodes": (0.202, 0.329),
        "text": (0.093,),
    },
    "ithor": {
        "scene": (0.032, 0.0007, 0.0),
        "relations": (0.029, 0.0085),
        "visibility": (0.02, 0.0038),
        "programs": (0.0074, 0.327),
        "episodes": (0.374, 0.016),
        "text": (0.046,),
    },
    "gibson": {
        "scene": (0.018, 0.0003, 1.0),
        "relations": (0.053, 0.0238),
        "visibility": (0.02, 0.0040),
        "programs": (0.0085, 0.713),
        # Its real scenes at hand have no navmesh; where one has, its episodes are taken to cost what ProcTHOR's do.
        "episodes": (0.188, 0.329),
        "text": (0.058,),
    },
}
"""CPU seconds of the reference machine for one of each of a stage's ``FEATURES``, by family.

Fitted by ``python -m benchmarks costs`` on 2 shared cores: 46 scenes of ReplicaCAD, 7 of iTHOR and 14 of Gibson with 12
episodes of each category, 60 houses of ProcTHOR with 20 and 30 of them with 12. Of ``mesh_mb`` (building a navmesh from
a scan) only the order of magnitude is known: there are no scans to measure on. The stage `visibility` is the mean of 5
scenes of ReplicaCAD, 10 of ProcTHOR and 7 of iTHOR; Gibson's is taken to be ProcTHOR's.
"""

COMPILE_SECONDS: Final = 105.0
"""CPU seconds for compiling all kernels once on the reference machine; later runs load them from a cache."""


def counts_of(family: str, counts: SceneCounts, asked: int) -> dict[str, float]:
    """Return the counts that costs depend on, by name.

    scene : 1
    objects : objects of the scene
    seen_objects : the same; 0 where no navmesh is shipped or can be built, so that nothing is looked for
    kilopairs : thousand ordered pairs of objects that share a room, where all rooms are equally full
    asked : hundred episodes asked of the scene
    placed_kiloobjects : thousand pairs of an episode and an object; 0 where no navmesh is shipped or can be built
    mesh_mb : megabytes of meshes that a navmesh must be built from; 0 where one is shipped
    """
    navmesh = FAMILIES[family].always_placed or counts.navmesh_bytes > 0 or counts.mesh_bytes > 0
    placed = asked if navmesh else 0
    return {
        "scene": 1.0,
        "objects": counts.objects,
        "seen_objects": counts.objects if navmesh else 0,
        "kilopairs": counts.objects**2 / counts.rooms / 1000,
        "asked": asked / 100,
        "placed_kiloobjects": placed * counts.objects / 1000,
        "mesh_mb": 0.0 if counts.navmesh_bytes else counts.mesh_bytes / 1e6,
    }


def stage_costs(family: str, counts: SceneCounts, asked: int) -> dict[str, float]:
    """Return, for each stage of one scene, the estimated CPU seconds on the reference machine.

    asked : episodes asked of the scene, all categories and counterfactual groups together
    """
    known = counts_of(family, counts, asked)
    return {
        stage: sum(c * known[name] for c, name in zip(coefficients, FEATURES[stage], strict=True))
        for stage, coefficients in COEFFICIENTS[FAMILIES[family].costs_like or family].items()
    }
