"""The gate over programs of real scenes: it lets the shipped sampling pass and sees what that sampling prevents."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from condvln.bias import judge
from condvln.instructions import InstructionConfig, LabelPriors, ProgramSampler, instruction_id, render
from condvln.relations import relate_scene, text_facts
from condvln.scene import Scene
from condvln.sources.registry import open_source
from schemas.program import Category

CATEGORIES: tuple[Category, ...] = ("simple", "chain")


def rows_of(scene: Scene, sampler: ProgramSampler) -> Iterator[dict[str, Any]]:
    """Manifest rows without places."""
    for category in CATEGORIES:
        for k, program in enumerate(sampler.candidates(category)):
            yield {
                "episode_id": f"{scene.scene_id} {category} {k}",
                "source": scene.family,
                "scene_id": scene.scene_id,
                "category": category,
                "group_id": None,
                "instruction_text": render(program, 0, instruction_id(scene.family, scene.scene_id, program)),
                "program": program.model_dump(mode="json"),
                "leaves": [{"geodesic_distance": 0.0, "route_length": 0.0}] * len(program.leaves),
                "gold_leaf": program.gold_leaf(),
            }


@pytest.mark.soak
def test_the_gate_sees_statements_that_are_foregone_conclusions(real_data: Path) -> None:
    if not (real_data / "replicacad").is_dir():
        pytest.skip(f"no replicacad in {real_data}")
    source = open_source("replicacad", real_data / "replicacad")
    read = [source.read(handle.scene_id) for handle in source.handles()]
    scenes = [scene for scene in read if len(scene.objects) > 1][::2]
    facts = [{room: text_facts(found) for room, found in relate_scene(scene).items()} for scene in scenes]
    priors = LabelPriors.merged(LabelPriors.of_scene(scene) for scene in scenes)
    config = InstructionConfig(per_category=dict.fromkeys(CATEGORIES, 3), candidates_per_episode=8)

    def drawn(informed: bool) -> list[dict[str, Any]]:
        rows = []
        for scene, known in zip(scenes, facts, strict=True):
            bits = priors.bits(scene)
            bits = bits if informed else replace(bits, counts={})
            rows += rows_of(scene, ProgramSampler(scene, known, bits, config, seed=0))
        return rows

    fair = judge(drawn(informed=True))
    assert fair.passed, fair.verdict()
    assert fair.episodes > 1000
    # Without the counts of the priors, statements that are true everywhere are asked as readily as any.
    told = {finding.guesser for finding in judge(drawn(informed=False)).beaten}
    assert "whole statement" in told
