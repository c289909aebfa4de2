"""The gate over programs of real scenes: it lets the shipped sampling pass and sees what that sampling prevents."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pyarrow as pa
import pytest

from condvln.bias import BiasReport, judge
from condvln.instructions import LabelPriors, PriorBits
from condvln.relations import relate_scene, text_facts
from condvln.scene import Scene
from condvln.scene.layouts import layout_of
from condvln.sources.registry import open_source
from schemas.config import Thresholds
from schemas.program import Category
from tests.condvln.instructions.made_sampler import made_sampler

T = Thresholds()

CATEGORIES: tuple[Category, ...] = ("simple", "long_chain", "deep_nested")


@pytest.mark.soak
def test_the_gate_sees_statements_that_are_foregone_conclusions(real_data: Path, rows_of) -> None:
    if not (real_data / "replicacad").is_dir():
        pytest.skip(f"no replicacad in {real_data}")
    source = open_source("replicacad", real_data / "replicacad")
    read = [source.read(handle.scene_id) for handle in source.handles()]
    scenes = [scene for scene in read if len(scene.objects) > 1]
    assert Counter(layout_of(scene.scene_id) for scene in scenes) == {"v3_sc0": 21, "v3_sc1": 21, "": 3}
    facts = [{room: text_facts(found, T) for room, found in relate_scene(scene, T).items()} for scene in scenes]
    priors = LabelPriors.merged(LabelPriors.of_scene(scene, T, 0.3) for scene in scenes)
    table = priors.table()
    nameless = pa.repeat("", table.num_rows)
    pooled = LabelPriors.merged([LabelPriors.from_table(table.set_column(0, table.schema.field(0), nameless))])
    wanted = dict.fromkeys(CATEGORIES, 2)

    def verdict(bits_of: Callable[[Scene], PriorBits]) -> BiasReport:
        samplers = [
            made_sampler(scene, known, bits_of(scene), per_category=wanted)
            for scene, known in zip(scenes, facts, strict=True)
        ]
        return judge(row for sampler in samplers for row in rows_of(sampler))

    fair = verdict(lambda scene: priors.bits(scene, 0.05))
    assert fair.passed, fair.verdict()
    assert fair.episodes > 2000
    # Without the counts of the priors, statements that are true everywhere are asked as readily as any.
    uninformed = verdict(lambda scene: replace(priors.bits(scene, 0.05), counts={}))
    assert "whole statement" in {finding.guesser for finding in uninformed.beaten}
    # With counts over both layouts together, those that are true all over one and false all over the other.
    mixed = verdict(lambda scene: pooled.bits(scene, 0.05))
    assert {finding.guesser for finding in mixed.beaten} == {"statement in its layout"}
