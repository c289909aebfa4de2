"""From how far one sees that nothing with some label is there: a usual thing in range is recognised wherever it is."""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import product
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from condvln.instructions.absence import absence_range, can_be_missed
from condvln.instructions.priors import LabelPriors
from condvln.labels import vocabulary
from condvln.labels.lists import SMALL, UsualSize, _rows, usual_size
from condvln.navigation.sight import Recognition, in_view, visible_extent
from condvln.navigation.surface_samples import box_samples
from condvln.scene import Room, Scene
from condvln.verify import sight
from schemas.config import EpisodeConfig, PlacesConfig, SamplingConfig, Thresholds
from schemas.config.constants import ABSENCE_METRES, FLOOR_LIFT, LEVEL_CAMERA, TABLE_HEIGHT
from schemas.config.episodes import SeenDegrees
from tests.condvln.episodes.floors import box

PLACES, RULES = PlacesConfig(), EpisodeConfig()
RULE = Recognition.of(PLACES, RULES)
LEAST = math.tan(math.radians(LEVEL_CAMERA[1] / 2))
"""Metres above or below its eye that a level camera shows a metre away."""
LABELS = [row["label"] for row in _rows("usual")]


def box_of(size: UsualSize, *, upright: bool) -> NDArray[np.float64]:
    """The product's points on a usual thing that stands or lies on y = 0, with its longer side along x if it is not
    upright.
    """
    if size.flat:
        sides = (size.long, 0.0, size.short)
    else:
        # A thing that does not lie flat is nearly half as deep as what one sees of it is high or wide.
        width, height = (size.short, size.long) if upright else (size.long, size.short)
        sides = (width, height, size.short / 2)
    half = np.array(sides) / 2
    return box_samples(half * [0.0, 1.0, 0.0], half)


@given(
    label=st.sampled_from(LABELS),
    share=st.floats(0.0, 1.0),
    upright=st.booleans(),
    turned=st.booleans(),
    table=st.booleans(),
)
def test_a_usual_thing_is_recognised_from_everywhere_in_range(
    label: str, share: float, upright: bool, turned: bool, table: bool
) -> None:
    """On the floor and on a table, from all distances but those from which a level camera looks past it: there it was
    recognised from farther away.
    """
    size, far = usual_size(label), absence_range(label, PLACES)
    on_table = size.flat == "table" or (not size.flat and table)
    height = PLACES.eye_height - (TABLE_HEIGHT if on_table else FLOOR_LIFT)
    points = box_of(size, upright=upright)
    if size.flat and turned:
        points = points[:, ::-1]
    near = height / LEAST + float(np.abs(points[:, 2]).max()) + 1e-6
    most = math.sqrt(max(far * far - height * height, 0.0))
    if most < near:
        return
    ahead = near + share * (most - near)
    eye = np.array([[0.0, height, ahead]])
    seen = in_view(eye, points, RULE.view)
    extent = visible_extent(eye, points, seen)
    assert RULE.holds(seen, extent).all(), (label, ahead, extent)


def places(**keys: float) -> PlacesConfig:
    least = SeenDegrees(short=keys.pop("short"), long=keys.pop("long"))
    return PlacesConfig(seen_degrees=least, **keys)


@given(
    st.builds(
        places,
        short=st.floats(0.5, 8.0),
        long=st.floats(8.0, 20.0),
        sight_range=st.floats(1.0, 30.0),
        eye_height=st.floats(0.2, 2.5),
    )
)
def test_the_verifier_finds_the_same_range_by_trying_all_distances(places: PlacesConfig) -> None:
    for label in [*LABELS, "no such thing"]:
        assert absence_range(label, places) == sight.absence_range(label, places), label


def test_small_things_are_missed_from_nowhere_and_others_from_where_the_floor_is_in_range() -> None:
    for label in ("pen", "candle", "fork", "remote control", "egg", "scissors", "credit card"):
        assert not can_be_missed(label, PLACES)
    for label in ("lamp", "sofa", "backpack", "television", "plant"):
        assert can_be_missed(label, PLACES)
    # Within 2.5 m a level camera shows a ring of floor a few steps wide, and misses the disc inside it.
    for label in ("laptop", "mug", "pillow"):
        assert 1.0 < absence_range(label, PLACES) < 3.0
        assert not can_be_missed(label, PLACES)
    for label in LABELS:
        height, far = PLACES.eye_height - FLOOR_LIFT, absence_range(label, PLACES)
        disc = (height / math.tan(math.radians(LEVEL_CAMERA[1] / 2))) ** 2
        assert can_be_missed(label, PLACES) == (far**2 - height**2 - disc >= disc)
    # To a robot of half a metre the floor is near, and what lies on tables is out of sight.
    low = PlacesConfig(eye_height=0.5)
    assert can_be_missed("mug", low)
    assert not can_be_missed("laptop", low)


def test_every_label_that_text_names_has_a_size() -> None:
    assert {label for label in vocabulary.labels if vocabulary.fit_for_text(label)} <= {*LABELS}
    assert len({*LABELS}) == len(LABELS)
    for label in LABELS:
        size = usual_size(label)
        assert size.long >= size.short > 0, label
        assert size.flat in ("", "floor", "table"), label
    assert usual_size("no such thing") is SMALL
    assert list(ABSENCE_METRES) == sorted(ABSENCE_METRES)


@pytest.mark.parametrize("rooms", [1, 2])
def test_nothing_is_asked_about_the_presence_of_what_cannot_be_missed(rooms: int) -> None:
    """Some kitchens have remote controls, some backpacks: only the presence of backpacks is asked."""

    def kitchen(number: int) -> Scene:
        labels = [*(["remote control"] if number % 2 else []), *(["backpack"] if number % 4 < 2 else []), "sofa", "bed"]
        things = [
            replace(box(label, 2.0 * k, 2.0), object_id=f"{label}/{k}", room_id="0") for k, label in enumerate(labels)
        ]
        outline = np.array([[0.0, 0.0], [9.0, 0.0], [9.0, 9.0], [0.0, 9.0]])
        places = [Room(str(k), "kitchen", "kitchen", 0, 0.0, 2.5, outline, "dataset", True) for k in range(rooms)]
        return Scene("made", f"house {number}", Path(), tuple(places), tuple(things))

    scenes = [kitchen(number) for number in range(40)]
    sampling = SamplingConfig()
    counts = [("made", LabelPriors.of_scene(scene, Thresholds(), sampling.anchor_size)) for scene in scenes]
    priors = LabelPriors.of_corpus(counts, sampling)
    for scene, far_sighted in product(scenes[1:10:4], (False, True)):
        # Who recognises all from afar can miss a remote control too.
        places = PlacesConfig(seen_degrees=SeenDegrees(short=0.01, long=0.02)) if far_sighted else PLACES
        bits = priors.bits(scene, sampling.plausible_share, places=places)
        assert ("remote control" in bits.plausible["kitchen"]) == far_sighted
        assert ("remote control" in bits.varies["kitchen"]) == far_sighted
        assert "backpack" in bits.varies["kitchen"]
