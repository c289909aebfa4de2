"""A sampler of programs with the configuration's defaults but for what a test names."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from condvln.instructions import PriorBits, ProgramSampler, Stops, apart_by_centres
from condvln.relations import TextFacts
from condvln.scene import Scene
from schemas.config import InstructionsConfig, PlacesConfig, SamplingConfig


def made_sampler(
    scene: Scene,
    facts: Mapping[str, TextFacts],
    bits: PriorBits,
    *,
    candidates: int = 8,
    seed: int = 0,
    stops: Stops | None = None,
    preamble: bool = True,
    sampling: SamplingConfig | None = None,
    **wanted: Any,
) -> ProgramSampler:
    """Any program may use compass words, and anything may be asked.

    wanted : keys of the instructions; candidates : candidates per episode
    """
    return ProgramSampler(
        scene,
        facts,
        bits,
        InstructionsConfig(**wanted),
        sampling
        or SamplingConfig(candidates_per_episode=candidates, compass_share=1.0, compass_phrases=8, usual_places=False),
        seed,
        stops=stops or apart_by_centres(scene, PlacesConfig()),
        preamble=preamble,
    )
