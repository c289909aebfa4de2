"""Stagings of few layouts: counted over all of them a statement seems open, and is foretold in each layout."""

from __future__ import annotations

from typing import Any

import numpy as np
import pyarrow as pa
import pytest

from condvln.bias import judge
from condvln.bias.report import ALL
from condvln.instructions import LabelPriors
from condvln.relations import TextFacts, relate_scene, text_facts
from condvln.scene import Scene
from schemas.config import SamplingConfig, Thresholds
from schemas.config.instructions import PAPER
from schemas.program import Category
from tests.condvln.bias.made_apartment import made_apartment
from tests.condvln.instructions.made_sampler import made_sampler

T = Thresholds(sector_within=20.0)

LABELS = (
    "sofa", "bed", "table", "chair", "stool", "lamp", "armchair", "piano", "plant", "desk", "television", "bicycle",
    "suitcase", "picture", "rug", "trash can", "bench", "vase",
)  # fmt: skip
STAGINGS = 10
MOVED = 3
"""Labels that stand elsewhere in each staging; all others stand where their layout has them."""
SIDE = 7.0
CATEGORIES: tuple[Category, ...] = ("simple", "chain")
PAPERS = SamplingConfig(candidates_per_episode=1, **PAPER["sampling"])
"""With the goals and stops of the paper's form, statements foretell most."""


def staging(layout: int, number: int) -> Scene:
    """An apartment of one room."""
    places = np.random.default_rng([0, layout]).uniform(0.0, SIDE, (len(LABELS), 2))
    rng = np.random.default_rng([1, layout, number])
    places[:MOVED] = rng.uniform(0.0, SIDE, (MOVED, 2))
    things = [(label, x, z) for label, (x, z) in zip(LABELS, places, strict=True)]
    return made_apartment(f"v3_sc{layout}_staging_{number:02}", things)


@pytest.fixture(scope="module")
def scenes() -> list[tuple[Scene, dict[str, TextFacts]]]:
    made = [staging(layout, number) for layout in range(2) for number in range(STAGINGS)]
    return [(scene, {room: text_facts(found, T) for room, found in relate_scene(scene, T).items()}) for scene in made]


@pytest.fixture(scope="module")
def priors(scenes) -> LabelPriors:
    return LabelPriors.merged(LabelPriors.of_scene(scene, T, 0.3) for scene, _ in scenes)


@pytest.fixture(scope="module")
def over_all(priors: LabelPriors) -> LabelPriors:
    """The same counts, without the layout that each was made in."""
    table = priors.table()
    nameless = table.set_column(0, table.schema.field(0), pa.repeat("", table.num_rows))
    return LabelPriors.merged([LabelPriors.from_table(nameless)])


def sampled(scenes, priors: LabelPriors, rows_of) -> list[dict[str, Any]]:
    wanted = dict.fromkeys(CATEGORIES, 20)
    return [
        row
        for scene, facts in scenes
        for row in rows_of(made_sampler(scene, facts, priors.bits(scene, 0.05), per_category=wanted, sampling=PAPERS))
    ]


def test_what_a_layout_foretells_is_found(scenes, over_all: LabelPriors, rows_of) -> None:
    rows = sampled(scenes, over_all, rows_of)
    report = judge(rows)
    assert {finding.guesser for finding in report.beaten} == {"statement in its layout"}
    (found,) = [f for f in report.beaten if f.part == ALL]
    assert found.accuracy > found.chance + 0.12
    # By other names the same scenes are no stagings, and who mixes them up learns nothing.
    assert judge([{**row, "scene_id": f"{row['scene_id']} b"} for row in rows]).passed


def test_few_stagings_are_enough_to_know_what_varies(rows_of) -> None:
    """With as few, what never varied among all scenes would not yet be called foretold."""
    made = [staging(layout, number) for layout in range(4) for number in range(4)]
    scenes = [(scene, {room: text_facts(found, T) for room, found in relate_scene(scene, T).items()}) for scene in made]
    priors = LabelPriors.merged(LabelPriors.of_scene(scene, T, 0.3) for scene in made)
    report = judge(sampled(scenes, priors, rows_of))
    assert report.passed, report.verdict()
    (found,) = [f for f in report.findings if f.guesser == "statement in its layout" and f.part == ALL]
    assert found.accuracy < found.chance + 0.02


def test_counted_within_a_layout_nothing_is_foretold(scenes, priors: LabelPriors, rows_of) -> None:
    rows = sampled(scenes, priors, rows_of)
    report = judge(rows)
    assert report.passed, report.verdict()
    assert report.episodes == len(rows) == 2 * STAGINGS * 20 * len(CATEGORIES)
    assert {f.category for f in report.findings if f.guesser == "statement in its layout"} == {ALL, *CATEGORIES}
