"""Two boxes of one thing, nameless things that look like others, high tables and fallen models."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest

from condvln.instructions.likeness import called_counters, doubles, fallen, look_alikes, mistakable
from condvln.instructions.referents import Referents
from condvln.labels import vocabulary
from condvln.labels.lists import plausible_sizes
from condvln.relations import relate_room, text_facts
from condvln.scene import MeshPart, Room, RoomArrays, SceneObject, round_mm
from condvln.scene.rotations import rotation_y
from condvln.verify.likeness import has_fallen, is_odd_sized, looks_like, may_be_one, passes_for_a_counter
from condvln.verify.surroundings import Thing
from condvln.verify.words import words
from schemas.config import Thresholds

Point = Sequence[float]
T = Thresholds()


def thing(name: str, label: str, low: Point, high: Point, tilt: float | None = None) -> SceneObject:
    mesh: tuple[MeshPart, ...] = ()
    if tilt is not None:
        about_x, angle = np.eye(4), np.radians(tilt)
        about_x[1:3, 1:3] = [[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]
        about_x[:3, :3] = 0.7 * about_x[:3, :3] @ rotation_y(1.0)  # scaled, and turned about its own upright
        mesh = (MeshPart("a.glb", about_x),)
    box = round_mm([low, high])
    return SceneObject(name, "room", label, label, round_mm(box.mean(axis=0)), box, mesh=mesh)


def referents(things: Sequence[SceneObject], family: str) -> Referents:
    room = Room("room", "kitchen", "kitchen", 0, 0.0, 2.5, None, "dataset", True)
    arrays = RoomArrays.of("room", things, 0.0)
    facts = text_facts(relate_room(arrays, T), T)
    return Referents.of(room, arrays, facts, vocabulary, 0.3, family)


# The television of a scan whose upper part has a box of its own, as it is in Gibson's building Benevolence.
SCREEN = thing("a", "television", (1.29, 1.22, 5.75), (1.85, 2.10, 6.97))
TOP = thing("b", "television", (1.385, 1.85, 5.73), (1.835, 2.14, 6.95))
SOFA = thing("z", "sofa", (-2.0, 0.0, 5.0), (-1.0, 0.86, 7.0))


@pytest.mark.parametrize(("family", "told"), [("gibson", False), ("procthor", True)])
def test_boxes_of_a_scan_that_may_be_one_thing_are_told_from_nothing(family: str, told: bool) -> None:
    """Where boxes are drawn into a scan, the bigger of the two is no other thing."""
    found = referents([SCREEN, TOP, SOFA], family)
    assert found.nameable.tolist() == [True, told, True]  # in a scan, 0.29 m is too low for a television
    assert [bool(ways) for ways in found.qualifications[:2]] == [told, told]


@pytest.mark.parametrize(
    ("low", "high", "one"),
    [
        ((0.0, 0.0, 0.0), (1.0, 1.0, 1.0), True),
        ((0.5, 0.0, 0.0), (1.5, 1.0, 1.0), True),  # half of the footprint
        ((0.501, 0.0, 0.0), (1.501, 1.0, 1.0), False),
        ((0.0, 1.15, 0.0), (1.0, 1.5, 1.0), True),
        ((0.0, 1.151, 0.0), (1.0, 1.5, 1.0), False),
        ((0.9, 0.0, 0.9), (1.0, 0.1, 1.0), True),  # the smaller footprint counts
        ((0.0, 0.2, 0.0), (0.0, 1.2, 1.0), False),  # no footprint
        ((0.5, 0.2, 0.0), (0.5, 1.2, 1.0), True),  # none, but the centre
    ],
)
def test_doubles(low: Point, high: Point, one: bool) -> None:
    first, second = thing("a", "chair", (0, 0, 0), (1, 1, 1)), thing("b", "chair", low, high)
    arrays = RoomArrays.of("room", [first, second])
    assert doubles(arrays, np.ones((2, 2), dtype=bool)).tolist() == [one, one]
    assert not doubles(arrays, np.eye(2, dtype=bool)).any()
    things = [Thing.of(item, item.label) for item in (first, second)]
    assert may_be_one(*things, "mp3d") == may_be_one(*things[::-1], "mp3d") == one
    assert not may_be_one(*things, "procthor")


@pytest.mark.parametrize(
    ("low", "high", "alike"),
    [
        ((5, 0.82, 5), (5.43, 1.92, 5.31), True),  # across the altar, and turned
        ((5, 0.82, 5), (5.43, 2.27, 5.31), False),  # 1.355 times as high
        ((5, 1.08, 5), (5.43, 2.17, 5.31), False),
        ((5, 0.82, 5), (5.43, 1.92, 5.2), False),
    ],
)
def test_a_nameless_thing_may_be_another_of_what_it_looks_like(low: Point, high: Point, alike: bool) -> None:
    """As the statue of Matterport3D's church and the "object" across from it."""
    statue = thing("a", "sculpture", (0, 0.82, 0), (0.53, 1.89, 0.41))
    other = thing("b", "object", low, high)
    found = referents([statue, other], "mp3d")
    assert found.unique.tolist() == [not alike, False]
    assert look_alikes(found.arrays, np.array([False, True]))[1] == ({"sculpture"} if alike else set())
    assert looks_like(Thing.of(other, "object"), Thing.of(statue, "sculpture")) == alike


@pytest.mark.parametrize(
    ("table", "size", "ambiguous"),
    [
        ("dining table", (1.85, 0.89, 0.92), True),
        ("dining table", (1.85, 0.84, 0.92), False),
        ("dining table", (1.19, 0.89, 1.19), False),  # not long
        ("dining table", (1.3, 0.89, 0.7), False),  # smaller than the counter
        ("bed", (1.85, 0.89, 0.92), False),
    ],
)
def test_a_high_table_passes_for_a_counter(table: str, size: Point, ambiguous: bool) -> None:
    counter = thing("a", "counter", (0, 0, 0), (1.7, 0.9, 0.6))
    other = thing("b", table, (3, 0, 0), (3 + size[0], size[1], size[2]))
    found = referents([counter, other], "ithor")
    assert found.unique.tolist() == [not ambiguous, True]
    assert called_counters(found.arrays).tolist() == [False, ambiguous]
    things = [Thing.of(item, item.label) for item in (counter, other)]
    tables = frozenset(("table", "dining table"))
    assert [passes_for_a_counter(x, tables, things, 0.0) for x in things] == [False, ambiguous]
    alone = referents([other, thing("z", "sofa", (9, 0, 9), (10, 1, 10))], "ithor")
    assert alone.lacks("counter", vocabulary) == (table == "bed" or size[1] < 0.85 or size[0] < 1.2)


@pytest.mark.parametrize(
    ("tilt", "bottom", "down"),
    [
        (0.0, 0.0, False),
        (19.9, 0.1, False),
        (20.1, 0.1, True),
        (20.1, 0.101, False),  # it hangs or lies on something
        (180.0, 0.0, True),
        (0.0, -0.1, False),
        (0.0, -0.101, True),
        (None, -0.5, False),  # no model is known
    ],
)
def test_what_has_fallen_over_is_not_named(tilt: float | None, bottom: float, down: bool) -> None:
    first = thing("a", "coffee table", (0, bottom, 0), (0.7, 1.1, 0.8), tilt)
    second = thing("b", "table", (3, 0, 0), (4, 0.7, 0.9))
    found = referents([first, second], "replicacad")
    assert fallen(found.arrays).tolist() == [down, False]
    assert found.nameable.tolist() == [not down, True]
    assert not found.unique.any()  # it is still a rival
    assert has_fallen(Thing.of(first, "coffee table"), 0.0) == down
    assert not has_fallen(Thing.of(first, "coffee table"), float("nan"))


@pytest.mark.parametrize(("gap", "named"), [(0.5, True), (0.501, False), (2.5, False)])
def test_away_from_is_a_name_only_where_all_rivals_are_near(gap: float, named: bool) -> None:
    """Of two pictures that are both away from the coat rack, none is "the picture away from the coat rack"."""
    rack = thing("r", "coat rack", (0, 0, 0), (1, 1.8, 1))
    far = thing("a", "picture", (5, 0.5, 0), (6, 1.5, 0.1))
    other = thing("b", "picture", (1 + gap, 0.5, 0), (2 + gap, 1.5, 0.1))
    found = referents([rack, far, other], "mp3d")
    assert ("far from" in {q.predicate for q in found.qualifications[0]}) is named
    assert found.facts.status["far from"][1, 2] == (0 if gap == 0.0 else -1)


@pytest.mark.parametrize(
    ("label", "size", "odd"),
    [
        ("book", (0.2, 0.03, 0.5), False),
        ("book", (0.2, 0.03, 0.501), True),
        ("book", (0.1, 0.03, 0.05), False),
        ("book", (0.099, 0.03, 0.05), True),
        ("book", (1.0, 0.3, 0.86), True),
        ("cup", (0.2, 0.45, 0.2), True),
        ("book", (0.41, 0.26, 0.42), True),  # two stacks, or a box, in Gibson's building Darden
        ("book", (0.27, 0.12, 0.44), False),
        ("book", (0.27, 0.121, 0.44), True),
        ("bottle", (0.18, 0.37, 0.19), False),
        ("bottle", (0.29, 0.26, 0.26), True),  # too thick
        ("bottle", (0.12, 0.11, 0.16), True),  # lying, or no bottle
        ("bowl", (0.24, 0.31, 0.4), True),
        ("bowl", (0.39, 0.14, 0.14), True),  # no bowl is so long
        ("chair", (0.89, 0.27, 0.7), True),  # the back of one
        ("vase", (0.25, 0.25, 0.33), True),
        ("vase", (0.25, 0.54, 0.17), False),
        ("television", (0.95, 0.16, 0.38), True),
        ("refrigerator", (0.96, 1.79, 0.18), False),  # its front
        ("heater", (9.0, 0.1, 0.1), False),  # of which nothing is known
    ],
)
def test_a_scan_names_nothing_of_an_odd_size(label: str, size: Point, odd: bool) -> None:
    item = thing("a", label, (0, 0, 0), size)
    assert mistakable(RoomArrays.of("room", [item], 0.0)).tolist() == [odd]
    assert is_odd_sized(Thing.of(item, label), words().sizes, "gibson") == odd
    assert not is_odd_sized(Thing.of(item, label), words().sizes, "procthor")
    assert referents([item], "gibson").nameable.tolist() == [not odd]
    assert referents([item], "procthor").nameable.tolist() == [True]


def test_sizes_are_of_known_labels_and_in_order() -> None:
    assert list(plausible_sizes()) == sorted(plausible_sizes())
    for label, bounds in plausible_sizes().items():
        assert vocabulary.fit_for_text(label), label
        assert 0.0 < bounds.least < bounds.most / 1.5, label
        assert bounds.thickness > 0.0, label
        assert bounds.low < bounds.high / 1.5, label
        assert bounds.ratio > 1.2, label
    assert words().sizes == {label: bounds._asdict() for label, bounds in plausible_sizes().items()}
