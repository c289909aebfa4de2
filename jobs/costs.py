"""Cost of each stage of a scene, estimated from counts that are known before a run.

A stage's CPU seconds are a sum of coefficients times counts, never negative: see `counts_of` for the counts and
`COEFFICIENTS` for the coefficients, in CPU seconds of the machine that they were fitted on. They only have to be
about right for the first run of a source: from then on the factory corrects them by its receipts (``factory.planner``).
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

import yaml

from condvln.own_tables import own_text
from condvln.sources.family import FAMILIES
from condvln.sources.source import SceneCounts

__all__ = ["COEFFICIENTS", "COMPILE_SECONDS", "STAGES", "counts_of", "stage_costs"]

COEFFICIENTS: Final[Mapping[str, Mapping[str, Mapping[str, float]]]] = yaml.safe_load(own_text("jobs", "costs.yaml"))
"""CPU seconds for one of each count that a stage's cost depends on, by family, stage and count, from ``costs.yaml``.

Fitted by ``python -m benchmarks costs`` on one of 2 cores, to 24 scenes of ReplicaCAD, 24 houses of ProcTHOR, 7 plans
of iTHOR and 14 scans of Gibson with 4, 12 and 24 episodes of each category. Of ``mesh_mb`` (building a navmesh from a
scan) only the order of magnitude is known: there are no scans to measure on. A soak test compares the estimates with
first runs of real scenes; where they are wrong by a factor of two, fit the table again.
"""

STAGES: Final = tuple(COEFFICIENTS["procthor"])
"""The stages that cost something."""

COMPILE_SECONDS: Final = 105.0
"""CPU seconds for compiling all kernels once; later runs load them from a cache."""


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
    """Return, for each stage of one scene, the estimated CPU seconds.

    asked : episodes asked of the scene, all categories and counterfactual groups together
    """
    known = counts_of(family, counts, asked)
    return {
        stage: sum(seconds * known[name] for name, seconds in counted.items())
        for stage, counted in COEFFICIENTS[FAMILIES[family].costs_like or family].items()
    }
