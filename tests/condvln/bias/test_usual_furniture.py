"""Scenes with unrelated names in which nearly all stands where it usually does, so that nearly everything that could be
asked of a scene has its usual truth there.
"""

from __future__ import annotations

import numpy as np
import pytest

from condvln.bias import judge
from condvln.bias.report import ALL, BiasReport
from condvln.instructions import LabelPriors
from condvln.relations import TextFacts, relate_scene, text_facts
from condvln.scene import Scene
from schemas.config import SamplingConfig, Thresholds
from schemas.config.instructions import PAPER
from tests.condvln.bias.made_apartment import made_apartment
from tests.condvln.instructions.made_sampler import made_sampler

T = Thresholds(sector_within=20.0)
"""Few statements are left of things up to 3 m apart in these large rooms."""
LABELS = (
    "sofa", "bed", "table", "chair", "lamp", "sink", "refrigerator", "plant", "desk", "television", "cabinet", "rug",
)  # fmt: skip
SCENES = 90
MOVED = 0.15
"""Chance of a thing to stand elsewhere than usual."""
SIDE = 8.0

SAMPLING = SamplingConfig(
    candidates_per_episode=1,
    compass_share=1.0,
    compass_phrases=8,
    usual_places=False,
    predicates=PAPER["sampling"]["predicates"],
)
"""Nothing is on anything here: the other predicates have weights among which directions count."""

Read = tuple[Scene, dict[str, TextFacts]]


def apartment(number: int) -> Scene:
    usual = np.random.default_rng(0).uniform(0.0, SIDE, (len(LABELS), 2))
    rng = np.random.default_rng([1, number])
    things = []
    for label, place in zip(LABELS, usual, strict=True):
        moved = rng.uniform(0.0, SIDE, 2)
        x, z = moved if rng.random() < MOVED else place
        if rng.random() < 0.5:  # not all is everywhere
            continue
        things.append((label, x, z))
    return made_apartment(f"apartment_{number:03}", things)


@pytest.fixture(scope="module")
def scenes() -> list[Read]:
    made = [apartment(number) for number in range(SCENES)]
    return [(scene, {room: text_facts(found, T) for room, found in relate_scene(scene, T).items()}) for scene in made]


def verdict(scenes: list[Read], priors: LabelPriors, rows_of) -> BiasReport:
    wanted = {"simple": 20}
    return judge(
        row
        for scene, facts in scenes
        for row in rows_of(made_sampler(scene, facts, priors.bits(scene, 0.05), per_category=wanted, sampling=SAMPLING))
    )


def above_chance(report: BiasReport, guesser: str) -> float:
    (found,) = [f for f in report.findings if f.guesser == guesser and f.part == ALL]
    return found.accuracy - found.chance


def test_what_is_nearly_always_true_is_asked_as_often_where_it_is_false(scenes: list[Read], rows_of) -> None:
    counts = [("made", LabelPriors.of_scene(scene, T, 0.3)) for scene, _ in scenes]
    counted = verdict(scenes, LabelPriors.merged(one for _, one in counts), rows_of)
    evened = verdict(scenes, LabelPriors.of_corpus(counts, SAMPLING), rows_of)
    assert above_chance(counted, "whole statement") > 0.06
    assert not counted.passed
    # Over four seeds it was 0.028 to 0.055, with and without goals that fit; 0.10 without evening.
    assert abs(above_chance(evened, "whole statement")) < 0.06
    assert above_chance(evened, "against whole statement") < 0.05
    # What is left of the imbalance of labels is seen by whoever sees labels, so the gate itself may or may not close.
    assert max(one.accuracy - one.chance for one in evened.findings if one.part == ALL) < 0.08
    assert evened.episodes > 0.95 * counted.episodes
