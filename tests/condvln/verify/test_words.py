"""The vocabulary as the verifier reads it, against the vocabulary's own code: two readings of the same tables."""

from __future__ import annotations

from pathlib import Path

import pytest

from condvln.labels import vocabulary
from condvln.labels.lexicon import SOURCE_OF_FAMILY
from condvln.sources.registry import READERS, open_source
from condvln.verify import words as module
from condvln.verify.referents import SceneReferents
from condvln.verify.surfaces import Shapes
from condvln.verify.words import folded, words
from schemas.config import Thresholds
from schemas.errors import CondVLNError


def test_what_may_be_meant_is_the_same() -> None:
    for label in vocabulary.labels:
        assert words().meant_by(label) == vocabulary.overlapping(label)
    for label in vocabulary.room_labels:
        assert words().rooms_meant_by(label) == vocabulary.overlapping_rooms(label)
    assert words().meant_by("blorb") == words().rooms_meant_by("blorb") == {"blorb"}


def test_the_rooms_that_a_general_word_may_mean_are_the_same() -> None:
    for label in vocabulary.room_labels:
        for other in [*vocabulary.room_labels, "blorb"]:
            meant = words().any_room(label) or other in words().rooms_meant_by(label)
            assert meant == vocabulary.might_mean_room(label, other)


@pytest.mark.parametrize("family", sorted(SOURCE_OF_FAMILY))
def test_what_a_nameless_thing_may_be_is_the_same(family: str) -> None:
    raws = [*vocabulary.raw_labels(family), "ObjaZyx", "ObjaSideTable", "blorb", "unknown", "RoomDecor"]
    for label in {vocabulary.canonical(raw, family) for raw in raws} | {*vocabulary.labels}:
        for side in (None, 0.1, 0.9, 2.0, 14.0):
            found = words().may_be(label, family, side)
            assert found == (vocabulary.may_be(label, family, side), vocabulary.is_vague(label, family)), (label, side)


def test_what_text_may_name_is_the_same() -> None:
    assert {*words().nouns} == {x for x in vocabulary.labels if vocabulary.fit_for_text(x)}
    assert {*words().rooms} == {x for x in vocabulary.room_labels if vocabulary.room(x).fit_for_text}
    for label, (noun, article) in words().nouns.items():
        assert (noun, article) == (vocabulary.entry(label).noun, vocabulary.entry(label).article)


@pytest.mark.parametrize("family", sorted(SOURCE_OF_FAMILY))
def test_raw_labels_are_read_alike(family: str) -> None:
    assert module.SOURCE_OF_FAMILY == SOURCE_OF_FAMILY
    for raw in [
        *vocabulary.raw_labels(family),
        "ArmChair",
        "ObjaSideTable",
        "ObjaZyx",
        "arm_chair 2",
        "Blorb",
        "table 7",
        "bath tub",
        "",
    ]:
        for spelled in (raw, raw.upper(), raw.replace(" ", "_"), f"{raw} 3"):
            assert words().label(spelled, family) == vocabulary.canonical(spelled, family)


@pytest.mark.parametrize("raw", ["Bedroom", "b", "B", "S", "s", "LivingRoom", "living room", "tv room", "study", "x?"])
@pytest.mark.parametrize("family", sorted(SOURCE_OF_FAMILY))
def test_raw_rooms_are_read_alike(raw: str, family: str) -> None:
    assert words().room_type(raw, family) == vocabulary.room_type(raw, family)


def test_a_listed_model_goes_before_a_wrong_label() -> None:
    assert words().label("chopping_board", "replicacad", "frl_apartment_clothes_hanger_02") == "clothes rack"
    assert words().label("chopping_board", "replicacad", "some_model") == "cutting board"


def test_folding() -> None:
    assert {folded(raw) for raw in ("ArmChair", "arm_chair", "arm#chair", " Arm  chair ")} == {"arm chair"}
    assert folded("TVStand") == "tv stand"


@pytest.mark.parametrize("family", sorted(READERS))
def test_real_scenes_are_labelled_alike(real_data: Path, family: str) -> None:
    """The readers' labels and the verifier's, of every object and room of some real scenes."""
    try:
        source = open_source(family, real_data / family)
        handles = [handle for handle in source.handles() if handle.fault is None][::6]
    except CondVLNError as error:
        pytest.skip(f"no scenes of {family} here: {error}")
    for handle in handles:
        scene = source.read(handle.scene_id)
        views = SceneReferents(scene, Thresholds(), 0.3, Shapes(scene.root)).rooms
        for room in scene.rooms:
            assert views[room.room_id].label == room.label
        things = [thing for view in views.values() for thing in view._all]
        assert {thing.object_id: thing.label for thing in things} == {
            item.object_id: item.label for item in scene.objects if item.room_id in views
        }
