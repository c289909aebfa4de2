"""Scenes with unrelated names in which nearly all stands where it usually does, so that nearly everything that could be
asked of a scene has its usual truth there.
"""

from __future__ import annotations

import numpy as np

from condvln.bias import judge
from condvln.bias.report import ALL, BiasReport
from condvln.instructions import LabelPriors
from condvln.relations import TextFacts, relate_scene, text_facts
from condvln.scene import Scene
from schemas.config import SamplingConfig, Thresholds
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

Read = tuple[Scene, dict[str, TextFacts]]


def apartment(world: int, number: int) -> Scene:
    """A world is where things usually stand."""
    usual = np.random.default_rng(world).uniform(0.0, SIDE, (len(LABELS), 2))
    rng = np.random.default_rng([1 + world, number])
    things = []
    for label, place in zip(LABELS, usual, strict=True):
        moved = rng.uniform(0.0, SIDE, 2)
        x, z = moved if rng.random() < MOVED else place
        if rng.random() < 0.5:  # not all is everywhere
            continue
        things.append((label, x, z))
    return made_apartment(f"apartment_{number:03}", things)


def apartments(world: int) -> list[Read]:
    made = [apartment(world, number) for number in range(SCENES)]
    return [(scene, {room: text_facts(found, T) for room, found in relate_scene(scene, T).items()}) for scene in made]


def verdict(scenes: list[Read], priors: LabelPriors, rows_of) -> BiasReport:
    wanted = {"simple": 20}
    return judge(
        row
        for scene, facts in scenes
        for row in rows_of(made_sampler(scene, facts, priors.bits(scene, 0.05), per_category=wanted, candidates=1))
    )


def above_chance(report: BiasReport, guesser: str) -> float:
    (found,) = [f for f in report.findings if f.guesser == guesser and f.part == ALL]
    return found.accuracy - found.chance


def test_what_is_nearly_always_true_is_asked_as_often_where_it_is_false(rows_of) -> None:
    evened = []
    for world in range(3):
        scenes = apartments(world)
        counts = [("made", LabelPriors.of_scene(scene, T, 0.3)) for scene, _ in scenes]
        evened.append(verdict(scenes, LabelPriors.of_corpus(counts, SamplingConfig()), rows_of))
        assert abs(above_chance(evened[-1], "whole statement")) < 0.06
        assert above_chance(evened[-1], "against whole statement") < 0.05
        if world == 0:
            counted = verdict(scenes, LabelPriors.merged(one for _, one in counts), rows_of)
            assert above_chance(counted, "whole statement") > 0.06
            assert not counted.passed
            assert evened[0].episodes > 0.95 * counted.episodes
    # Of a label that is uneven in one world, the usual truth is another in the next.
    for guesser in ("whole statement", "label and room", "worth", "purpose"):
        assert np.mean([above_chance(one, guesser) for one in evened]) < 0.03, guesser
    assert sum(one.passed for one in evened) >= 2, [one.verdict() for one in evened]
