"""Facts fit for text: the strict and the loose threshold of each predicate, and nothing in between."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
import pytest

from condvln.relations import (
    CANONICAL,
    COMPASS,
    PAIR_PREDICATES,
    SEMANTIC,
    SIZE_PREDICATES,
    TEXT_PREDICATES,
    relate_room,
    text_facts,
)
from condvln.relations.text import TextFacts
from condvln.scene import OrientedBox, RoomArrays, SceneObject
from condvln.scene.meshes import WorldMesh
from schemas.config import Thresholds
from schemas.program import BEARINGS, Predicate

T = Thresholds(sector_within=21.0)
"""Directions are judged at any distance here; `test_a_direction_is_for_what_is_close` bounds it."""

Maker = Callable[..., SceneObject]
RoomOf = Callable[[Sequence[SceneObject]], RoomArrays]

HALF = 0.1
BALL = (HALF, HALF, HALF)


def facts_of(make: Maker, room_of: RoomOf, center: Sequence[float], half: Sequence[float] | None = BALL) -> TextFacts:
    """Facts about "a" (row 0) at `center` and "b" (row 1) at the origin."""
    objects = [make("a", center, half), make("b", (0, 0, 0), BALL)]
    return text_facts(relate_room(replace(room_of(objects), floor_y=-2.0), T), T)


def test_predicates_are_those_of_the_program() -> None:
    assert {*TEXT_PREDICATES, *BEARINGS} == set(Predicate.__args__)  # type: ignore[attr-defined]
    assert set(PAIR_PREDICATES) | {"between", "closest to"} | set(SIZE_PREDICATES) == set(TEXT_PREDICATES)


GAP = 2 * HALF  # of centres of touching boxes


@pytest.mark.parametrize(
    ("predicate", "center", "status"),
    [
        ("near", (0.5 + GAP, 0, 0), 1),
        ("near", (2.249 + GAP, 0, 0), 0),
        ("near", (2.250 + GAP, 0, 0), -1),
        ("near", (0.3 + GAP, 0.251 + GAP, 0), 0),  # too far above
        ("near", (2.249 + GAP, 3, 0), 0),  # denied by the distance along the ground
        ("near", (0, 0.2 + GAP, 0), 1),
        ("near", (0, 0.149 + GAP, 0), 0),  # it may rest there
        ("near", (0.151, 0.1 + GAP, 0), 1),
        ("near", (0.150, 0.1 + GAP, 0), 0),  # a quarter of it over the other, which may carry it
        ("near", (0.1, 0, 0), 1),  # half in the other
        ("near", (0.099, 0, 0), 0),
        ("far from", (3.45 + GAP, 0, 0), 1),
        ("far from", (3.449 + GAP, 0, 0), 0),
        ("far from", (2.551 + GAP, 0, 0), 0),
        ("far from", (2.55 + GAP, 0, 0), -1),
        ("higher than", (2, 0.45, 0), 1),
        ("higher than", (2, 0.449, 0), 0),
        ("higher than", (2, -0.049, 0), 0),
        ("higher than", (2, -0.05, 0), -1),
        ("higher than", (2, -1.601, 0), 0),  # less than 0.3 m off the floor
        ("lower than", (2, -0.45, 0), 1),
        ("lower than", (2, -0.449, 0), 0),
        ("lower than", (2, 0.049, 0), 0),
        ("lower than", (2, 0.05, 0), -1),
        ("above", (0, 0.45, 0), 1),
        ("above", (0, 0.449, 0), 0),
        ("above", (0, 0.15, 0), 0),  # it may rest there
        ("above", (0.201, 0.15, 0), -1),  # footprints apart, so that it can't
        ("above", (0.16, 0.45, 0), 1),  # a footprint overlap of exactly 0.2
        ("above", (0.161, 0.45, 0), 0),
        ("above", (0.499, 0.45, 0), 0),
        ("above", (0.5, 0.45, 0), -1),  # footprints 0.3 m apart
        ("below", (0, -0.45, 0), 1),
        ("below", (0.38, -0.45, 0.44), -1),
        ("on", (0.1, 0.2, 0), 0),  # as large as the other
        ("on", (0.201, 0.2, 0), -1),
        ("on", (0, 0.349, 0), 0),
        ("on", (0, 0.35, 0), -1),
        ("east of", (0.5, 0, 0), 1),
        ("east of", (0.499, 0, 0), 0),
        ("east of", (10, 0, 2.679), 1),  # tan 15° = 0.26795
        ("east of", (10, 0, 2.680), 0),
        ("east of", (10, 0, 9.999), 0),  # tan 45° = 1, from the nearest point of a footprint 0.2 m wide
        ("east of", (10, 0, 10.001), -1),
        ("north of", (0, 0, -1), 1),
        ("south of", (0, 0, -1), -1),
        ("north-west of", (-1, 0, -1), 1),
        ("west of", (0, 0, 0), 0),
    ],
)
def test_thresholds(
    make: Maker, room_of: RoomOf, predicate: str, center: tuple[float, float, float], status: int
) -> None:
    facts = facts_of(make, room_of, center)
    assert facts.status[predicate][0, 1] == status
    margin = facts.margin[predicate][0, 1]
    if status != 0:
        assert margin >= 1 - 1e-9


def test_near_needs_the_surface_too(make: Maker, room_of: RoomOf) -> None:
    """Boxes that touch while the surfaces are 0.4, 0.6 and 0.9 m apart."""
    room = room_of([make("a", (0, 0, 0), (1, 1, 1)), make("b", (1.5, 0, 0), (0.5, 0.5, 0.5))])
    for gap, status in ((0.4, 1), (0.6, 0), (0.9, 0)):
        x = 1.0 - gap
        plate = WorldMesh(np.array([[x, -1, -1], [x, 1, -1], [x, 0, 1]], float), np.array([[0, 1, 2]], np.int32), False)
        relations = relate_room(room, T, meshes=lambda o, plate=plate: plate if o.object_id == "a" else None)
        assert relations.surface[0, 1] == round(gap, 3)
        assert relations.semantic["near"][0, 1]
        assert text_facts(relations, T).status["near"][0, 1] == status


def test_unknown_extent_proves_no_nearness(make: Maker, room_of: RoomOf) -> None:
    """A centre says nothing of where a thing ends; a bounding sphere bounds its surface from below only."""
    for distance in (0.1, 1.0, 1.2, 9.0):
        assert facts_of(make, room_of, (distance, 0, 0), None).status["near"][0, 1] == 0
    balls = [make("a", (0, 0, 0), None, radius=0.5), make("b", (1.0, 0, 0), None, radius=0.5)]
    assert text_facts(relate_room(room_of(balls), T), T).status["near"][0, 1] == 0
    apart = [balls[0], make("b", (3.25, 0, 0), None, radius=0.5)]
    assert text_facts(relate_room(room_of(apart), T), T).status["near"][0, 1] == -1
    assert facts_of(make, room_of, (0, 1, 0), None).status["above"][0, 1] == 0
    assert facts_of(make, room_of, (0, 0.1, 0), None).status["above"][0, 1] == 0


def test_text_is_stricter_than_the_edges(furnished: list[SceneObject], room_of: RoomOf) -> None:
    relations = relate_room(room_of(furnished), T)
    facts = text_facts(relations, T)
    for predicate in (*SEMANTIC, *COMPASS):
        emitted = (
            relations.semantic[predicate]
            if predicate in SEMANTIC
            else relations.canonical == CANONICAL.index(predicate)
        )
        status = facts.status[predicate]
        assert not (status == 1)[~emitted].any(), predicate
        if predicate in COMPASS:
            sector = np.where(relations.canonical >= 0, relations.canonical % 8, -1)
            emitted = (sector == COMPASS.index(predicate)) & ~np.isnan(relations.metrics.azimuth)
        assert not (status == -1)[emitted].any(), predicate
        assert (np.diag(status) == 0).all()
        assert (facts.margin[predicate][status != 0] >= 1 - 1e-9).all()
        if predicate not in ("higher than", "lower than"):
            assert {-1, 1} <= set(np.unique(status).tolist()), f"the room has no case of {predicate}"


def test_opposites_are_usable_together(furnished: list[SceneObject], room_of: RoomOf) -> None:
    facts = text_facts(relate_room(room_of(furnished), T), T)
    opposites = [("near", "near"), ("far from", "far from"), ("above", "below"), ("higher than", "lower than")]
    opposites += [(COMPASS[k], COMPASS[(k + 4) % 8]) for k in range(8)]
    for predicate, opposite in opposites:
        np.testing.assert_array_equal(facts.status[predicate], facts.status[opposite].T, err_msg=predicate)
        np.testing.assert_allclose(facts.margin[predicate], facts.margin[opposite].T, atol=1e-9, err_msg=predicate)


@pytest.fixture
def counter(make: Maker) -> SceneObject:
    """A counter of 3 × 3 m with arms of 0.6 m along its north and its east side; what is south-west of them is free."""
    arms = (
        OrientedBox(np.array([0.0, 0.45, -1.2]), np.array([1.5, 0.45, 0.3]), np.eye(3)),
        OrientedBox(np.array([1.2, 0.45, 0.0]), np.array([0.3, 0.45, 1.5]), np.eye(3)),
    )
    return replace(make("counter", (0, 0.45, 0), (1.5, 0.45, 1.5)), parts=arms)


@pytest.mark.parametrize(
    ("center", "expected"),
    [
        # In the free corner: 2.26 m from either arm, and not within the counter's box for anybody who stands there.
        ((-1.46, 0.2, 1.46), {"near": -1, "on": -1, "in": 0, "south-west of": 0, "far from": -1, "above": -1}),
        # 0.40 m from the east arm, 1.20 m from the other.
        ((0.4, 0.2, 0.4), {"near": 1, "on": -1}),
        # On an arm, on both where they cross, and in the air of the free corner at the height of the top.
        ((0.0, 1.0, -1.2), {"on": 1, "near": 0, "above": 0}),
        ((1.2, 1.0, -1.2), {"on": 1}),
        ((-0.5, 1.0, 0.5), {"on": -1}),
        # Over an arm's middle, and over the middle of the box, where nothing is.
        ((0.0, 1.9, -1.2), {"above": 1, "on": -1}),
        ((0.0, 1.9, 0.0), {"above": -1}),
        # North of both arms; north of the box's centre, but east of one arm's.
        ((0.6, 0.5, -6.0), {"north of": 1, "far from": 1, "south of": -1}),
        ((1.2, 0.5, -2.4), {"north of": 0}),
    ],
)
def test_a_counter_is_its_arms(
    make: Maker, room_of: RoomOf, counter: SceneObject, center: Sequence[float], expected: dict[str, int]
) -> None:
    thing = make("thing", center, (0.1, 0.1, 0.1))
    facts = text_facts(relate_room(room_of([counter, thing]), T), T)
    assert {predicate: int(facts.status[predicate][1, 0]) for predicate in expected} == expected


@pytest.mark.parametrize(
    ("says", "center", "expected"),
    [
        ({"receptacles": ("sofa",)}, (0, 0.5, 0), 1),  # below the top of its back
        ({"receptacles": ("sofa",)}, (0, 0.9, 3), 0),  # which boxes contradict
        ({"receptacles": ("rug",)}, (0, 0.5, 0), -1),
        ({"receptacles": ("tray",)}, (0, 0.5, 0), 0),  # which is on the sofa
        ({"receptacles": ()}, (0, 0.5, 0), 0),
        ({"support": "sofa"}, (0, 0.5, 0), 0),  # found from boxes, not said
        ({}, (0, 0.5, 0), 0),
    ],
)
def test_a_source_says_what_is_on_what(
    make: Maker, room_of: RoomOf, says: dict[str, object], center: Sequence[float], expected: int
) -> None:
    """Below the top of a sofa's back boxes say nothing; its source may."""
    sofa, cushion = make("sofa", (0, 0.45, 0), (1.0, 0.45, 0.5)), make("cushion", center, (0.2, 0.1, 0.2))
    rug, tray = make("rug", (0, 0.01, 0), (2, 0.01, 2)), make("tray", (0, 0.45, 0), (0.3, 0.02, 0.3))
    tray = replace(tray, receptacles=("sofa",))
    room = room_of([replace(cushion, **says), rug, sofa, tray])
    facts = text_facts(relate_room(room, T), T)
    assert facts.status["on"][0, 2] == expected


@pytest.mark.parametrize(("openness", "expected"), [(None, 0), (0.4, 0), (0.5, 1)])
def test_inside_what_is_said_to_be_open(make: Maker, room_of: RoomOf, openness: float | None, expected: int) -> None:
    fridge = replace(make("refrigerator", (0, 0.9, 0), (0.4, 0.9, 0.4)), openness=openness)
    apple = make("apple", (0, 0.9, 0), (0.05, 0.05, 0.05))
    facts = text_facts(relate_room(room_of([apple, fridge]), T), T)
    assert facts.status["in"][0, 1] == expected


def near_of(room_of: RoomOf, things: Sequence[SceneObject], one: str, other: str) -> int:
    room = replace(room_of(things), floor_y=0.0)
    order = {name: k for k, name in enumerate(room.object_ids)}
    status = text_facts(relate_room(room, T), T).status["near"]
    assert status[order[one], order[other]] == status[order[other], order[one]]
    return int(status[order[one], order[other]])


def test_nobody_says_near_of_what_is_on_or_in_the_other(make: Maker, room_of: RoomOf) -> None:
    """Neither is it denied, however far below or beside the thing the middle of what holds it lies."""
    table, rug = make("table", (0, 0.4, 0), (1.0, 0.4, 0.5)), make("rug", (0, 0.01, 0), (2, 0.01, 2))
    book, card = make("book", (0.3, 0.82, 0), (0.1, 0.02, 0.1)), make("card", (0.3, 0.845, 0), (0.05, 0.005, 0.05))
    chair = make("chair", (0, 0.45, 0.8), (0.2, 0.45, 0.2))
    things = [table, rug, book, card, chair]
    assert near_of(room_of, things, "book", "table") == 0
    assert near_of(room_of, things, "card", "table") == 0  # on what is on it
    assert near_of(room_of, things, "chair", "rug") == 0  # though both stand on the floor
    assert near_of(room_of, things, "chair", "table") == 1
    shelf, low = make("shelf", (5, 1, 0), (0.5, 1, 0.2)), make("low", (5, 0.02, 0), (0.1, 0.02, 0.1))
    assert near_of(room_of, [shelf, low], "low", "shelf") == 0  # inside, on the floor
    fridge = make("fridge", (0, 0.9, 0), (0.4, 0.9, 0.4))
    touching = make("case", (0.8, 1.1, 0), (0.4, 0.9, 0.4))
    assert near_of(room_of, [fridge, touching], "fridge", "case") == 1  # side by side, of other heights
    said = replace(make("far", (3, 0.9, 0), (0.1, 0.1, 0.1)), receptacles=("table",))
    assert near_of(room_of, [table, said], "far", "table") == 0  # its source says that it is on it


def test_what_lies_in_a_container_is_near_to_nothing_else(make: Maker, room_of: RoomOf) -> None:
    sink, table = make("sink", (0, 0.8, 0), (0.3, 0.1, 0.2)), make("table", (1.2, 0.4, 0), (0.6, 0.45, 0.5))
    tomato, mug = make("tomato", (0.2, 0.8, 0), (0.05, 0.05, 0.05)), make("mug", (0.4, 0.85, 0), (0.05, 0.05, 0.05))
    assert near_of(room_of, [sink, table, tomato, mug], "mug", "table") == 1
    assert near_of(room_of, [sink, table, tomato, mug], "tomato", "table") == 0
    far = make("bed", (5, 0.4, 0), (0.6, 0.4, 0.5))
    assert near_of(room_of, [sink, far, tomato], "tomato", "bed") == -1


def test_what_is_over_another_lies_in_no_direction(make: Maker, room_of: RoomOf) -> None:
    table, apple = make("table", (0, 0.4, 0), (1.0, 0.4, 0.5)), make("apple", (0.8, 0.85, 0), (0.05, 0.05, 0.05))
    aside = make("aside", (1.001, 0.5, 0), (0.05, 0.05, 0.05))
    facts = text_facts(relate_room(room_of([table, apple, aside]), T), T)
    order = {"apple": 0, "aside": 1, "table": 2}
    for predicate in COMPASS:
        assert facts.status[predicate][order["apple"], order["table"]] == 0
        assert facts.status[predicate][order["table"], order["apple"]] == 0
    assert facts.status["east of"][order["aside"], order["table"]] == 1
    assert facts.status["north of"][order["aside"], order["table"]] == -1


def test_a_superlative_needs_another_thing_of_its_label(make: Maker, room_of: RoomOf) -> None:
    """Nobody says "the mug closest to the sink" of the only mug, though a cup might be called one."""
    sink = make("z", (0, 0.5, 0), (0.3, 0.1, 0.3))
    two = [replace(make(name, (x, 0.5, 0), BALL), label=label) for name, x, label in (("a", 1, "mug"), ("b", 4, "cup"))]
    rival = np.array([[False, True, False], [True, False, False], [False, False, False]])
    for label, expected in (("cup", 0), ("mug", 1)):
        room = room_of([two[0], replace(two[1], label=label), sink])
        assert text_facts(relate_room(room, T), T).closest(rival)[0][0, 2] == expected


@pytest.mark.parametrize(
    ("x", "true", "false"), [(3.0, 1, True), (3.001, 0, False), (-3.0, -1, True), (-3.001, -1, False)]
)
def test_a_direction_is_for_what_is_close(make: Maker, room_of: RoomOf, x: float, true: int, false: bool) -> None:
    """Farther apart, no condition states or denies a direction. A rival may still be excluded by it."""
    objects, t = [make("a", (x, 0, 0), BALL), make("b", (0, 0, 0), BALL)], Thresholds()
    facts = text_facts(relate_room(replace(room_of(objects), floor_y=-2.0), t), t)
    assert facts.status["east of"][0, 1] == true
    assert facts.denied["north of"][0, 1] == false


@pytest.mark.parametrize(("z", "denied"), [(10.001, False), (17.320, False), (17.321, True), (-17.321, True)])
def test_a_condition_denies_a_direction_where_another_is_meant(
    make: Maker, room_of: RoomOf, z: float, denied: bool
) -> None:
    """From 45° off a word tells rivals apart; a condition is false from 60° off. tan 60° = 1.73205."""
    facts = facts_of(make, room_of, (10, 0, z))
    assert facts.status["east of"][0, 1] == -1
    assert facts.denied["east of"][0, 1] == denied
    assert facts.denied["west of"][0, 1]


@pytest.mark.parametrize(
    ("center", "expected"),
    [
        # In front of the east end: 45° from the middle, north of the nearest point; nobody calls it "not north".
        ((1.4, 0.2, -1.4), {"north-east of": 0, "north of": 0, "east of": 0, "west of": -1, "south of": -1}),
        # Clear of the end on both axes, and seen as north-east from it.
        ((2.4, 0.2, -2.2), {"north-east of": 1, "north of": 0}),
        # A little beyond the end: 27.9° off north-east from its corner.
        ((1.9, 0.2, -1.6), {"north-east of": 0}),
        # In front of the middle, and a little aside of it.
        ((0.2, 0.2, -1.4), {"north of": 1, "north-east of": 0, "east of": -1}),
        # In front of a place between middle and end: 27° off north from the middle.
        ((0.7, 0.2, -1.4), {"north of": 0, "north-east of": 0}),
        # Beyond the end, nearly in line with the counter.
        ((2.5, 0.2, -0.2), {"east of": 1, "north of": -1}),
        # As close to the end as to the line along its front.
        ((1.85, 0.2, -0.485), {"east of": 0}),
    ],
)
def test_a_long_counter_lies_in_a_direction_from_all_of_it(
    make: Maker, room_of: RoomOf, center: Sequence[float], expected: dict[str, int]
) -> None:
    """A counter 3 m long from west to east, and a thing around it; the same holds with the two exchanged."""
    counter, thing = make("counter", (0, 0.45, 0), (1.5, 0.45, 0.3)), make("thing", center, (0.1, 0.2, 0.1))
    facts = text_facts(relate_room(room_of([counter, thing]), T), T)
    assert {predicate: int(facts.status[predicate][1, 0]) for predicate in expected} == expected
    opposite = {predicate: COMPASS[(COMPASS.index(predicate) + 4) % 8] for predicate in expected}
    assert {predicate: int(facts.status[opposite[predicate]][0, 1]) for predicate in expected} == expected


@pytest.mark.parametrize(
    ("center", "status"),
    [
        ((0.1, 0.2, 0.0), 1),
        ((1.0, 0.2, 0.0), 0),  # far from the line of the centres, and between the counters all the same
        ((1.5, 0.2, 0.7), 0),  # at the corner of the shorter one
        ((1.501, 0.2, 0.0), -1),  # beyond its end
        ((0.0, 0.2, 1.301), -1),  # behind one
        ((0.0, 0.2, -2.0), -1),  # behind the other
    ],
)
def test_what_is_between_long_counters_is_not_denied(
    make: Maker, room_of: RoomOf, center: Sequence[float], status: int
) -> None:
    """Counters 3 and 4 m long, face to face 1.4 m apart, and a thing between or beside them."""
    counters = [make("counter", (0, 0.45, 1.0), (1.5, 0.45, 0.3)), make("island", (0, 0.45, -1.0), (2.0, 0.45, 0.3))]
    arrays = replace(room_of([*counters, make("thing", center, (0.1, 0.2, 0.1))]), floor_y=0.0)
    found, _ = text_facts(relate_room(arrays, T), T).between(np.array([[0, 1], [1, 0]]))
    assert found[2].tolist() == [status, status]


def test_a_condition_does_not_deny_a_direction_from_the_nearest_point(make: Maker, room_of: RoomOf) -> None:
    """64° off north from the counter's middle, but straight in front of its end."""
    counter, thing = make("counter", (0, 0.45, 0), (1.5, 0.45, 0.3)), make("thing", (1.5, 0.2, -0.7), (0.1, 0.2, 0.1))
    facts = text_facts(relate_room(room_of([counter, thing]), T), T)
    assert not facts.denied["north of"][1, 0]
    assert facts.denied["south of"][1, 0]
    assert facts.status["north of"][1, 0] == 0


@pytest.mark.parametrize(
    ("half", "expected"),
    [
        ((0.2, 0.2, 0.2), 1),
        ((0.2, 0.12, 0.2), 1),  # 1.92 times the volume, and level
        ((0.3, 0.096, 0.3), 1),  # the other 1.04 times as tall
        ((0.3, 0.094, 0.3), 0),
        ((0.6, 0.2, 0.096), 1),
        ((0.6, 0.2, 0.094), 0),  # the other is deeper
        ((0.094, 0.2, 0.6), 0),
        ((0.05, 0.05, 0.05), -1),
        ((0.106, 0.05, 0.05), 0),  # a longer one
    ],
)
def test_the_bigger_is_smaller_in_no_way(
    make: Maker, room_of: RoomOf, half: tuple[float, float, float], expected: int
) -> None:
    """A wide faucet and a tall one: nobody knows which is the bigger."""
    pair = [make("a", (0, 0.5, 0), half), make("b", (3, 0.5, 0), (0.1, 0.1, 0.1))]
    room = room_of([replace(item, label="faucet") for item in pair])
    sizes = text_facts(relate_room(room, T), T).sizes(np.array([[False, True], [True, False]]))
    assert sizes["bigger"].tolist() == [expected, -expected]
    assert sizes["smaller"].tolist() == [-expected, expected]


def test_what_is_on_the_anchor_is_not_called_closest_to_it(make: Maker, room_of: RoomOf) -> None:
    table = make("z", (0, 0.4, 0), (1.0, 0.4, 0.5))
    rival = np.array([[False, True, False], [True, False, False], [False, False, False]])
    for height, expected in ((0.82, 0), (1.4, 1)):
        knives = [make("a", (0, height, 0), (0.1, 0.02, 0.1)), make("b", (4, height, 0), (0.1, 0.02, 0.1))]
        knives = [replace(knife, label="knife") for knife in knives]
        assert text_facts(relate_room(room_of([*knives, table]), T), T).closest(rival)[0][0, 2] == expected
