"""Priors are sums: the same whatever the order, the grouping and the form of what they are made from."""

from __future__ import annotations

import gc
import random
import tracemalloc
from collections import Counter
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pyarrow.compute as pc
import pytest

from condvln.instructions import LabelPriors, balance, priors
from condvln.instructions.absence import presence_asked
from condvln.instructions.balance import informative_weights
from condvln.instructions.likeness import called_otherwise
from condvln.instructions.priors import PRIORS
from condvln.instructions.referents import Referents
from condvln.instructions.statement_counts import StatementCounts
from condvln.instructions.statements import statement_truths
from condvln.labels import vocabulary
from condvln.labels.lists import also_called
from condvln.relations import relate_room, text_facts
from condvln.scene import Room, Scene, SceneObject, round_mm
from condvln.scene.scene import layout_of
from condvln.scene.tables import scene_tables
from factory.rows import logical_hash
from jobs.stages.scene import COUNTING
from schemas.config import PlacesConfig, SamplingConfig, Thresholds
from schemas.config.constants import EVIDENCE, STAGINGS

FITTED = (21, "a2e10eafd7f032546b07f04c3db1e927")
"""Version of the priors, and the hash of the table that it fits."""


def counted(scene: Scene) -> LabelPriors:
    """Counts of one scene under the configuration's defaults."""
    return LabelPriors.of_scene(scene, Thresholds(), SamplingConfig().anchor_size)


def presence_of(scene: Scene) -> Callable[[str], bool | None]:
    """Return the function that says whether a label's presence in a scene of one room is true; None if neither truth
    can be claimed.
    """
    (room,) = scene.rooms
    arrays = scene.arrays(room.room_id)
    facts = text_facts(relate_room(arrays, Thresholds()), Thresholds())
    referents = Referents.of(room, arrays, facts, vocabulary, SamplingConfig().anchor_size, scene.family)
    seen = {one.label for one in scene.objects if not one.hidden}
    return lambda label: True if label in seen else (False if referents.lacks(label, vocabulary) else None)


def cubes(scene: Scene) -> Scene:
    """Return the scene with all objects a cubic metre, so that few might be called otherwise."""
    objects = [replace(one, aabb=one.aabb[0] + np.array([np.zeros(3), np.ones(3)])) for one in scene.objects]
    return replace(scene, objects=tuple(objects))


def presence_counts(stagings: list[Scene], labels: set[str]) -> dict[str, tuple[int, int]]:
    """Return the numbers of stagings in which a label's presence is true and false; all if it has one truth only."""
    told = [presence_of(scene) for scene in stagings]
    found = {}
    for label in labels:
        truths = [truth for truth in (one(label) for one in told) if truth is not None]
        both = truths.count(True), truths.count(False)
        found[label] = both if all(both) else (len(told), 0) if both[0] else (0, len(told))
    return found


@pytest.fixture(scope="module")
def scenes(make_scene):
    return [make_scene(seed, objects=8) for seed in range(9)]


def test_order_and_grouping_do_not_matter(scenes) -> None:
    parts = [counted(scene) for scene in scenes]
    whole = LabelPriors.merged(parts).table()
    for seed in range(5):
        shuffled = random.Random(seed).sample(parts, len(parts))
        cut = seed + 1
        grouped = [LabelPriors.merged(shuffled[:cut]), LabelPriors.merged(shuffled[cut:])]
        assert LabelPriors.merged(grouped).table().equals(whole)
    assert whole.schema.equals(PRIORS)
    keys = list(zip(*(whole[c].to_pylist() for c in PRIORS.names[:-3]), strict=True))
    assert keys == sorted(set(keys))


def test_tables_give_what_scenes_give(scenes) -> None:
    tables = [scene_tables(scene) for scene in scenes]
    parts = [LabelPriors.of_tables(t["rooms"], t["objects"], Thresholds(), 0.3) for t in tables]
    assert LabelPriors.merged(parts).table().equals(LabelPriors.merged(map(counted, scenes)).table())


def test_counts_are_those_of_the_rooms(scenes) -> None:
    bits = LabelPriors.merged(map(counted, scenes)).bits(scenes[0], 0.5)
    rooms = [
        (
            room.label,
            {o.label for o in scene.objects if o.room_id == room.room_id},
            {o.label for o in scene.objects if o.room_id != room.room_id},
            frozenset().union(*called_otherwise(scene.arrays(room.room_id))),
        )
        for scene in scenes
        for room in scene.rooms
    ]
    for room_type in {room.label for room in scenes[0].rooms}:
        ours = [row for label, *row in rooms if label == room_type]
        for label in {o.label for o in scenes[0].objects}:
            with_it = sum(label in here for here, _, _ in ours)
            words = vocabulary.overlapping(label)
            lacking = sum(label in elsewhere and not (here | called) & words for here, elsewhere, called in ours)
            assert bits.counts.get((room_type, label, "", "", False), (0, 0)) == (with_it, lacking)
            often = with_it > 0 and 2 * with_it >= len(ours)
            assert (label in bits.plausible[room_type]) == (often and presence_asked(room_type, label, PlacesConfig()))
            if label in bits.varies[room_type]:
                assert 2 * with_it == len(ours)


def test_relations_are_counted_once_a_room(scenes, facts_maker) -> None:
    bits = LabelPriors.merged(map(counted, scenes)).bits(scenes[0], 0.05)
    rooms = Counter(room.label for scene in scenes for room in scene.rooms)
    together: Counter[tuple[str, ...]] = Counter()
    for (room_type, label, predicate, anchor, definite), seen in bits.counts.items():
        together[room_type, label, predicate, anchor] += sum(seen)
        assert (predicate == "") == (anchor == "")
        assert predicate or not definite
    assert all(count <= rooms[key[0]] for key, count in together.items())
    assert {key[4] for key in bits.counts if key[2]} == {True, False}


def test_a_scene_reads_only_its_own_rooms_and_labels(scenes) -> None:
    bits = LabelPriors.merged(map(counted, scenes)).bits(scenes[3], 0.05)
    seen = {o.label for o in scenes[3].objects}
    types = {room.label for room in scenes[3].rooms}
    assert {key[0] for key in bits.counts} <= types
    anchors = {label for key in bits.counts for label in key[3].split(" + ")}
    assert {key[1] for key in bits.counts} | anchors <= {*seen, ""}


def test_a_scene_of_one_room_reads_all_labels_of_its_type(make_scene) -> None:
    scenes = [make_scene(seed, ("apartment",), 6) for seed in range(8)]
    bits = LabelPriors.merged(map(counted, scenes)).bits(scenes[0], 0.05)
    everywhere = {o.label for scene in scenes for o in scene.objects}
    assert {key[1] for key in bits.counts if not key[2]} == everywhere


def test_the_document_changes_with_what_is_read_and_only_then(scenes, make_scene) -> None:
    priors = LabelPriors.merged(map(counted, scenes))
    elsewhere = counted(make_scene(77, ("apartment",)))
    document = priors.bits(scenes[0], 0.05).document()
    assert LabelPriors.merged([priors, elsewhere]).bits(scenes[0], 0.05).document() == document
    more = LabelPriors.merged([priors, counted(make_scene(78))])
    assert more.bits(scenes[0], 0.05).document() != document
    assert LabelPriors.from_table(priors.table()).bits(scenes[0], 0.05).document() == document


def test_a_scene_keeps_the_counts_that_its_rooms_can_ask_for(scenes, make_scene) -> None:
    stagings = [
        replace(make_scene(300 + k, ("kitchen", "bedroom"), 7), scene_id=f"v3_sc0_staging_{k:02}")
        for k in range(STAGINGS)
    ]
    table = LabelPriors.merged(map(counted, [*scenes, *stagings])).table()
    layout = table.filter(pc.equal(table["layout"], layout_of(stagings[0].scene_id)))
    for scene in (*scenes[:4], stagings[0]):
        bits = LabelPriors.from_table(table).bits(scene, 0.05)
        types, labels = {room.label for room in scene.rooms}, {o.label for o in scene.objects}
        everything = StatementCounts(layout if bits.staged else table).about(types, labels)
        read = {key: seen for key, seen in everything.items() if key[1]}
        assert bits.counts.items() <= read.items()
        for room in scene.rooms:
            here = {"", *scene.arrays(room.room_id).labels}
            asked = {key for key in read if key[0] == room.label and here.issuperset({key[1], *key[3].split(" + ")})}
            assert asked <= bits.counts.keys()
            assert {key for key in read if not key[2]} <= bits.counts.keys()
    assert bits.even


@pytest.mark.parametrize("rooms", [("apartment",), ("kitchen", "bedroom")], ids=["one room", "two rooms"])
def test_a_staging_reads_the_counts_of_its_layout(make_scene, rooms: tuple[str, ...]) -> None:
    def made(name: str, count: int, seed: int) -> list[Scene]:
        scenes = [make_scene(seed + k, rooms, 7) for k in range(count)]
        return [replace(scene, scene_id=name.format(k)) for k, scene in enumerate(scenes)]

    stagings = made("v3_sc0_staging_{:02}", STAGINGS, 0)
    others = made("v3_sc1_staging_{:02}", STAGINGS - 1, 100) + made("apt_{}", 5, 200)
    priors = LabelPriors.merged(map(counted, [*stagings, *others]))
    pooled = LabelPriors.merged(
        counted(replace(scene, scene_id=f"apt_{k}")) for k, scene in enumerate([*stagings, *others])
    )
    alone = LabelPriors.merged(map(counted, stagings))
    for scene in stagings:
        found = priors.bits(scene, 0.05)
        # What is plausible is a matter of all scenes, what is foretold one of the layout.
        assert (found.plausible, found.varies) == (pooled.bits(scene, 0.05).plausible, pooled.bits(scene, 0.05).varies)
        assert found.staged == set(rooms)
        assert {found.evidence(room) for room in rooms} == {STAGINGS}
        assert found.document()["staged"] == sorted(rooms)
        assert found.even
        assert found.even == alone.bits(scene, 0.05).even
        assert found.even.keys() <= found.counts.keys()
        assert not found.label_weights, "each statement is balanced by itself"
        own = alone.bits(scene, 0.05).counts
        assert {key: seen for key, seen in found.counts.items() if seen[0] or key[2]} == {
            key: seen for key, seen in own.items() if seen[0] or key[2]
        }
        if scene.single_room:
            # A label that no staging holds is known to be lacking in all of them.
            everywhere = {o.label for s in [*stagings, *others] for o in s.objects}
            presence = {key[1]: seen for key, seen in found.counts.items() if not key[2]}
            everywhere = {label for label in everywhere if presence_asked(rooms[0], label, PlacesConfig())}
            presence = {label: seen for label, seen in presence.items() if label in everywhere}
            assert presence == presence_counts(stagings, everywhere)
    for scene in others:
        # Too few stagings, or none at all.
        assert priors.bits(scene, 0.05) == pooled.bits(scene, 0.05)
        assert not priors.bits(scene, 0.05).even
        assert {priors.bits(scene, 0.05).evidence(room) for room in rooms} == {EVIDENCE}
        assert "staged" not in priors.bits(scene, 0.05).document()


def test_what_is_counted_is_what_these_thresholds_let_be_asked(scenes) -> None:
    scene, stock = scenes[0], Thresholds()
    wide = Thresholds(near_true=0.1, near=1.5, near_false=2.5, surface_within=2.5)

    def near(thresholds: Thresholds) -> tuple[int, int]:
        table = LabelPriors.of_scene(scene, thresholds, 0.3).table()
        rows = table.filter(pc.equal(table["predicate"], "near"))
        return (pc.sum(rows["n_true"]).as_py(), pc.sum(rows["n_false"]).as_py())

    assert near(wide) < near(stock), "fewer are surely near"
    assert near(wide)[1] < near(stock)[1], "fewer are surely apart"
    assert not LabelPriors.of_scene(scene, stock, 3.0).table().equals(LabelPriors.of_scene(scene, stock, 0.3).table())


def test_statements_about_what_people_confuse_are_counted_as_they_are_drawn() -> None:
    """If a bench by the bed left open whether an ottoman is by it, and priors counted that as false, the factors over
    stagings would even out statements that are never drawn.
    """
    assert "ottoman" in also_called(low=False)["bench"]
    places = {"ottoman": [(0.0, 0.0), (6.0, 6.0)], "bench": [(3.2, 3.0)], "bed": [(3.0, 4.0)], "desk": [(6.0, 0.5)]}
    objects = []
    for label, spots in places.items():
        for number, (x, z) in enumerate(spots):
            box = round_mm(np.array([[x - 0.4, 0.0, z - 0.4], [x + 0.4, 0.9, z + 0.4]]))
            name = f"{label}:{number}"
            objects.append(SceneObject(name, "r0", label, label, round_mm(box.mean(axis=0)), aabb=box))
    room = Room("r0", "apartment", "apartment", 0, 0.0, 2.5, None, "scene", True)
    name = "v3_sc0_staging_00"
    scene = Scene(family="replicacad", scene_id=name, root=Path("."), rooms=(room,), objects=tuple(objects))
    arrays, size = scene.arrays("r0"), SamplingConfig().anchor_size
    facts = text_facts(relate_room(arrays, Thresholds()), Thresholds())
    drawn = Referents.of(room, arrays, facts, vocabulary, size, "replicacad")
    told = {
        ("apartment", truths.labels[row], truths.predicate, truths.anchor_keys(arrays.labels)[column], truth)
        for truths in statement_truths(drawn, vocabulary)
        for truth, table in ((True, truths.true), (False, truths.false))
        for row, column in np.argwhere(table)
    }
    rows = [row for row in counted(scene).table().to_pylist() if row["predicate"]]
    found = {
        (row["room_type"], row["label"], row["predicate"], row["anchor"], truth)
        for row in rows
        for truth, number in ((True, row["n_true"]), (False, row["n_false"]))
        if number
    }
    assert found == told
    assert ("apartment", "ottoman", "near", "bed", False) in told


def test_factors_are_of_a_family_and_kept_in_the_table(make_scene) -> None:
    scenes = [make_scene(500 + k, ("kitchen", "bedroom"), 9) for k in range(30)]
    counts = [counted(scene) for scene in scenes]
    fitted = LabelPriors.of_corpus([("made", one) for one in counts], SamplingConfig())
    table = fitted.table()
    plain = table.filter(pc.equal(table["tilt"], 0))
    assert plain.equals(LabelPriors.merged(counts).table())
    assert set(table.filter(pc.not_equal(table["tilt"], 0))["staging"].to_pylist()) == {"made"}
    bits = LabelPriors.from_table(table).bits(scenes[0], 0.05)
    assert bits == fitted.bits(scenes[0], 0.05)
    assert len(bits.even) > 20
    assert {statement[2] for statement in bits.even} >= {"", "near"}
    assert bits.document() != LabelPriors.merged(counts).bits(scenes[0], 0.05).document()
    elsewhere = LabelPriors.of_corpus([("other", one) for one in counts], SamplingConfig())
    assert not elsewhere.bits(scenes[0], 0.05).even


def test_factors_change_only_with_the_version(make_scene) -> None:
    """A store keeps the priors of a version. The golden corpus of the stages has no rooms that share a word."""
    rooms = ("kitchen", "bedroom", "bedroom", "bathroom")
    scenes = [make_scene(900 + k, rooms[: 2 + k % 3], 7) for k in range(30)]
    fitted = LabelPriors.of_corpus([("made", counted(scene)) for scene in scenes], SamplingConfig()).table()
    assert (COUNTING, logical_hash(fitted)[0]) == FITTED, "raise COUNTING, and write the pair anew"


def test_the_fit_holds_no_more_for_more_scenes(make_scene, monkeypatch) -> None:
    counts = [counted(make_scene(700 + k, ("kitchen", "bedroom"), 5)) for k in range(20)]
    monkeypatch.setattr(priors, "MERGE_ROWS", 2000)
    monkeypatch.setattr(balance, "IN_MEMORY", 1 << 12)

    def peak(number: int) -> int:
        gc.collect()
        tracemalloc.start()
        try:
            assert LabelPriors.of_corpus((("made", counts[k % 20]) for k in range(number)), SamplingConfig())
            return tracemalloc.get_traced_memory()[1]
        finally:
            tracemalloc.stop()

    peak(20)
    grown = [peak(number) for number in (200, 600)]
    assert grown[1] - grown[0] < 400 * 100, grown


def test_presence_in_a_single_room_has_no_factor(make_scene) -> None:
    """What is absent from a single room is absent from its scene; the fit is of rooms among others."""
    scenes = [make_scene(500 + k, ("kitchen", "bedroom"), 9) for k in range(30)]
    one = make_scene(540, ("kitchen",), 9)
    priors = LabelPriors.of_corpus([("made", counted(scene)) for scene in (*scenes, one)], SamplingConfig())
    assert any(not statement[2] for statement in priors.bits(scenes[0], 0.05).even)
    even = priors.bits(one, 0.05).even
    assert even
    assert all(statement[2] for statement in even)


def test_presence_in_a_staged_single_room_is_counted_where_either_can_be_claimed(make_scene) -> None:
    base = cubes(make_scene(3, ("apartment",), 12))

    def staging(number: int, labels: list[str], hidden: int = 0) -> Scene:
        objects = [replace(one, label=label) for one, label in zip(base.objects, labels, strict=False)]
        objects[len(objects) - hidden :] = [replace(one, hidden=True) for one in objects[len(objects) - hidden :]]
        return replace(base, scene_id=f"v3_sc0_staging_{number:02}", objects=tuple(objects))

    rooms = [["bed", "lamp", "backpack"], ["bed", "lamp", "rug"], ["bed", "rug"], ["bed", "armchair"], ["bed", "chair"]]
    assert {"chair", "armchair"} <= vocabulary.overlapping("chair") & vocabulary.overlapping("armchair")
    stagings = [staging(k, labels) for k, labels in enumerate(rooms)]
    stagings += [staging(5, ["bed", "backpack"], hidden=1), staging(6, [])]
    elsewhere = replace(base, objects=(replace(base.objects[0], label="piano"),))
    priors = LabelPriors.merged(map(counted, [*stagings, *[replace(elsewhere, scene_id=f"apt_{k}") for k in range(2)]]))
    for scene in stagings:
        bits = priors.bits(scene, 0.05)
        found = {key[1]: both for key, both in bits.counts.items() if not key[2]}
        assert found == presence_counts(stagings, set(found))
        assert found == {
            "bed": (6, 1),
            "lamp": (2, 5),
            "rug": (2, 5),
            # Where there is a chair, nobody can say that there is no armchair, nor the other way round; and a backpack
            # that nobody sees may be found.
            "chair": (1, 5),
            "armchair": (1, 5),
            "backpack": (1, 5),
            "piano": (0, 7),
        }
        assert {key[1] for key in bits.even if not key[2]} == {*found} - {"piano"}


def test_presence_in_many_stagings_of_a_single_room_is_about_as_uneven_as_a_coin(make_scene) -> None:
    """Stagings differ in how many of the things they hold, so that a thing that is usual is missing where much is."""
    base = cubes(make_scene(5, ("apartment",), 24))
    labels = sorted({one.label for one in base.objects})
    draw = random.Random(0)
    stagings = []
    for k in range(20):
        full = draw.choice([0.2, 1.0])
        held = {label for j, label in enumerate(labels) if draw.random() < full * (0.2 + 0.8 * (j % 2))}
        objects = tuple(one for one in base.objects if one.label in held)
        stagings.append(replace(base, scene_id=f"v3_sc0_staging_{k:02}", objects=objects))
    priors = LabelPriors.merged(map(counted, stagings))

    def excess(even: bool) -> float:
        """The root mean square of the excess of labels' draws, in parts of a fair coin's, by loops over scenes and
        labels.
        """
        drawn: dict[str, list[float]] = {}
        for scene in stagings:
            bits, told = priors.bits(scene, 0.0), presence_of(scene)
            sides: dict[bool, dict[str, float]] = {True: {}, False: {}}
            for (_, label, predicate, *_), both in bits.counts.items():
                truth = told(label)
                if predicate or min(both) == 0 or truth is None:
                    continue
                factor = bits.even["apartment", label, "", "", False].one if even else 1.0
                sides[truth][label] = informative_weights(*both, STAGINGS)[truth] * (factor if truth else 1 / factor)
            if not all(sides.values()):
                continue
            used = min(1.0, *(sum(side.values()) for side in sides.values()))
            for truth, side in sides.items():
                for label, weight in side.items():
                    drawn.setdefault(label, []).append((1 if truth else -1) * used * weight / sum(side.values()))
        return float(np.sqrt(np.mean([sum(ds) ** 2 / sum(d * d for d in ds) for ds in drawn.values()])))

    assert excess(even=False) > 2.0
    assert excess(even=True) < 1.1
