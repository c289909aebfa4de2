"""Priors are sums: the same whatever the order, the grouping and the form of what they are made from."""

from __future__ import annotations

import random

import pytest

from condvln.instructions import LabelPriors
from condvln.instructions.priors import PRIORS
from condvln.labels import vocabulary
from condvln.scene.tables import scene_tables


@pytest.fixture(scope="module")
def scenes(make_scene):
    return [make_scene(seed, objects=8) for seed in range(9)]


def test_order_and_grouping_do_not_matter(scenes) -> None:
    parts = [LabelPriors.of_scene(scene) for scene in scenes]
    whole = LabelPriors.merged(parts).table()
    for seed in range(5):
        shuffled = random.Random(seed).sample(parts, len(parts))
        cut = seed + 1
        grouped = [LabelPriors.merged(shuffled[:cut]), LabelPriors.merged(shuffled[cut:])]
        assert LabelPriors.merged(grouped).table().equals(whole)
    assert whole.schema.equals(PRIORS)
    keys = list(zip(*(whole[c].to_pylist() for c in ("room_type", "label", "predicate", "anchor")), strict=True))
    assert keys == sorted(set(keys))


def test_tables_give_what_scenes_give(scenes) -> None:
    tables = [scene_tables(scene) for scene in scenes]
    parts = [LabelPriors.of_tables(t["rooms"], t["objects"]) for t in tables]
    assert LabelPriors.merged(parts).table().equals(LabelPriors.merged(map(LabelPriors.of_scene, scenes)).table())


def test_counts_are_those_of_the_rooms(scenes) -> None:
    bits = LabelPriors.merged(map(LabelPriors.of_scene, scenes), 0.5).bits(scenes[0])
    rooms = [
        (
            room.label,
            {o.label for o in scene.objects if o.room_id == room.room_id},
            {o.label for o in scene.objects if o.room_id != room.room_id},
        )
        for scene in scenes
        for room in scene.rooms
    ]
    for room_type in {room.label for room in scenes[0].rooms}:
        ours = [(here, elsewhere) for label, here, elsewhere in rooms if label == room_type]
        for label in {o.label for o in scenes[0].objects}:
            with_it = sum(label in here for here, _ in ours)
            words = vocabulary.overlapping(label)
            lacking = sum(label in elsewhere and not here & words for here, elsewhere in ours)
            assert bits.counts.get((room_type, label, "", ""), (0, 0)) == (with_it, lacking)
            assert (label in bits.plausible[room_type]) == (with_it > 0 and 2 * with_it >= len(ours))
            if label in bits.varies[room_type]:
                assert 2 * with_it == len(ours)


def test_relations_are_counted_once_a_room(scenes, facts_maker) -> None:
    bits = LabelPriors.merged(map(LabelPriors.of_scene, scenes)).bits(scenes[0])
    for room_type, label, predicate, anchor in bits.counts:
        true, false = bits.counts[room_type, label, predicate, anchor]
        assert true + false <= sum(room.label == room_type for scene in scenes for room in scene.rooms)
        assert (predicate == "") == (anchor == "")
    assert any(key[2] for key in bits.counts)


def test_a_scene_reads_only_its_own_rooms_and_labels(scenes) -> None:
    bits = LabelPriors.merged(map(LabelPriors.of_scene, scenes)).bits(scenes[3])
    seen = {o.label for o in scenes[3].objects}
    types = {room.label for room in scenes[3].rooms}
    assert {key[0] for key in bits.counts} <= types
    assert {key[1] for key in bits.counts} | {key[3] for key in bits.counts} <= {*seen, ""}


def test_a_scene_of_one_room_reads_all_labels_of_its_type(make_scene) -> None:
    scenes = [make_scene(seed, ("apartment",), 6) for seed in range(8)]
    bits = LabelPriors.merged(map(LabelPriors.of_scene, scenes)).bits(scenes[0])
    everywhere = {o.label for scene in scenes for o in scene.objects}
    assert {key[1] for key in bits.counts if not key[2]} == everywhere


def test_the_document_changes_with_what_is_read_and_only_then(scenes, make_scene) -> None:
    priors = LabelPriors.merged(map(LabelPriors.of_scene, scenes))
    elsewhere = LabelPriors.of_scene(make_scene(77, ("apartment",)))
    document = priors.bits(scenes[0]).document()
    assert LabelPriors.merged([priors, elsewhere]).bits(scenes[0]).document() == document
    more = LabelPriors.merged([priors, LabelPriors.of_scene(make_scene(78))])
    assert more.bits(scenes[0]).document() != document
    assert LabelPriors.from_table(priors.table()).bits(scenes[0]).document() == document
