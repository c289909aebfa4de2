"""The gate over programs of real scenes: it lets the shipped sampling pass and sees what that sampling prevents."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest

from condvln.bias import BiasReport, judge
from condvln.instructions import LabelPriors, PriorBits
from condvln.relations import relate_scene, text_facts
from condvln.scene import Scene
from condvln.scene.scene import layout_of
from condvln.sources.registry import open_source
from schemas.config import Thresholds
from schemas.program import CATEGORIES as ALL_CATEGORIES
from schemas.program import Category
from tests.condvln.instructions.made_sampler import made_sampler

T = Thresholds(sector_within=20.0)

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
    assert "statement in its layout" in {finding.guesser for finding in mixed.beaten}


@pytest.mark.soak
def test_a_definite_question_is_as_often_true_as_an_indefinite_one(real_data: Path) -> None:
    """Of several lamps, one is near the bed more often than the only lamp of a room is."""
    if not (real_data / "procthor").is_dir():
        pytest.skip(f"no procthor in {real_data}")
    source = open_source("procthor", real_data / "procthor")
    scenes = [scene for scene in map(source.read, (h.scene_id for h in source.handles())) if len(scene.rooms) > 1]
    priors = LabelPriors.merged(LabelPriors.of_scene(scene, T, 0.3) for scene in scenes)
    asked: list[tuple[str, int, bool, bool]] = []
    for scene in scenes:
        facts = {room: text_facts(found, T) for room, found in relate_scene(scene, T).items()}
        wanted = dict.fromkeys(ALL_CATEGORIES, 20)
        sampler = made_sampler(scene, facts, priors.bits(scene, 0.05), per_category=wanted, candidates=1)
        for category in ALL_CATEGORIES:
            for program in sampler.candidates(category):
                conditions = enumerate(program.conditions)
                asked += [(category, k, c.definite, c.truth) for k, c in conditions if c.qualifier is not None]
    truths: dict[tuple[str, int], list[bool]] = {}
    for category, k, _, truth in asked:
        truths.setdefault((category, k), []).append(truth)
    for definite in (True, False):
        found = [(truth, np.mean(truths[category, k])) for category, k, form, truth in asked if form == definite]
        assert len(found) > 800
        excess = sum(truth - usual for truth, usual in found)
        assert abs(excess) < 3.5 * np.sqrt(sum(usual * (1.0 - usual) for _, usual in found)), (definite, excess)
