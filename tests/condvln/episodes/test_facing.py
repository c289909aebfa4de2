"""Starts chosen by what text says of left, right, ahead and behind; the verifier's own code is the judge."""

from __future__ import annotations

import math
from itertools import product

import numpy as np
import pytest

from condvln.episodes.facing import Facings
from condvln.scene import Room, Scene
from condvln.verify.standpoint import Standpoint
from condvln.verify.surroundings import Thing
from schemas.config import Thresholds
from schemas.program import SHAPES, Condition, Leaf, ObjectRef, Program, Qualifier, RoomRef
from tests.condvln.episodes.floors import apartment, box, grid_floor, placer_of

T = Thresholds()
ZONE = RoomRef(room_id="zone", label="apartment")
THINGS = (
    box("sofa", 1.0, 1.0),
    box("bed", 7.0, 1.0),
    box("desk", 1.0, 7.0),
    box("stove", 7.0, 7.0),
    box("plant", 4.0, 7.0),
)
ASKED = (("sofa", "left"), ("bed", "behind"))


def asking(*asked: tuple[str, str, bool], stops: tuple[ObjectRef, ...] = ()) -> Program:
    """A program whose conditions ask for bearings: (thing, direction, truth)."""
    category = {1: "simple", 2: "nested"}[len(asked)]
    goals = ("desk", "stove", "plant")[: len(asked) + 1]
    moves = [[ObjectRef(object_id=name, label=name, room=ZONE)] for name in goals]
    moves[0] = [*stops, *moves[0]]
    return Program(
        category=category,
        conditions=tuple(
            Condition(
                label=name,
                room=ZONE,
                qualifier=Qualifier(predicate=direction),
                definite=True,
                truth=truth,
                witnesses=(name,) if truth else (),
            )
            for name, direction, truth in asked
        ),
        branches=SHAPES[category].branches,
        leaves=tuple(Leaf(moves=tuple(own)) for own in moves),
    )


def places() -> np.ndarray:
    grid = np.stack(np.meshgrid(np.arange(0.5, 8.0, 0.5), np.arange(0.5, 8.0, 0.5)), axis=-1).reshape(-1, 2)
    return np.column_stack([grid[:, 0], np.zeros(len(grid)), grid[:, 1]])


def verdict(scene: Scene, name: str, direction: str, place: np.ndarray, heading: float) -> int:
    yaw = -math.radians(heading)
    point = Standpoint(1000.0 * place[0], 0.0, 1000.0 * place[2], (-math.sin(yaw), -math.cos(yaw)))
    return point.judge(direction, Thing.of(scene.object_of[name], name), T).verdict


def test_only_the_heading_tells_the_truth_of_one_bearing() -> None:
    scene, at = apartment(*THINGS), places()
    facings = Facings(scene, at, T)
    found = {truth: facings.headings([asking(("sofa", "left", truth))], 0.3) for truth in (True, False)}
    assert np.array_equal(found[True].possible, found[False].possible), "the place says nothing"
    far = np.linalg.norm(at[:, [0, 2]] - [1.0, 1.0], axis=1) > 1.5
    assert found[True].possible[far].all(), "every place that is not close to it serves"
    for truth, headings in found.items():
        for k in np.flatnonzero(headings.possible)[::7]:
            for j in np.flatnonzero(headings.fit[k])[::11]:
                assert verdict(scene, "sofa", "left", at[k], headings.headings[j]) == (1 if truth else -1)


def test_only_the_heading_tells_the_truths_of_two() -> None:
    scene, at = apartment(*THINGS), places()
    facings = Facings(scene, at, T)
    cases = {
        truths: facings.headings([asking(*((*a, t) for a, t in zip(ASKED, truths, strict=True)))], 0.0)
        for truths in product((True, False), repeat=2)
    }
    masks = [case.possible for case in cases.values()]
    assert all(np.array_equal(masks[0], mask) for mask in masks)
    assert 0 < masks[0].sum() < len(at), "some places can't have all four cases"
    for truths, case in cases.items():
        k = int(np.flatnonzero(case.possible)[0])
        heading = case.headings[case.fit[k]][0]
        assert [verdict(scene, name, d, at[k], heading) == 1 for name, d in ASKED] == list(truths)


def test_a_stop_that_goes_by_its_bearing_has_no_rival_there() -> None:
    chairs = [box("a", 2.0, 4.0), box("b", 6.0, 4.0)]
    scene = apartment(*THINGS, *(_labelled(chair, "chair") for chair in chairs))
    at = places()
    stop = ObjectRef(object_id="a", label="chair", room=ZONE, qualifier=Qualifier(predicate="left"))
    found = Facings(scene, at, T).headings([asking(("sofa", "ahead", True), stops=(stop,))], 0.0)
    assert found.possible.any()
    for k in np.flatnonzero(found.possible):
        for j in np.flatnonzero(found.fit[k])[::5]:
            heading = found.headings[j]
            assert verdict(scene, "a", "left", at[k], heading) == 1
            assert verdict(scene, "b", "left", at[k], heading) == -1
            assert verdict(scene, "sofa", "ahead", at[k], heading) == 1


def test_the_start_is_in_the_room_of_what_is_said_and_in_no_other() -> None:
    square = np.array([[0.0, 0.0], [4.0, 0.0], [4.0, 8.0], [0.0, 8.0]])
    rooms = [
        Room(name, "apartment", "apartment", 0, 0.0, 2.5, square + shift, "dataset", True)
        for name, shift in (("zone", [0.0, 0.0]), ("other", [3.0, 0.0]))
    ]
    scene = Scene("made", "two", apartment().root, tuple(rooms), THINGS)
    at = places()
    found = Facings(scene, at, T).headings([asking(("sofa", "left", True))], 0.0)
    assert found.possible.any()
    assert at[found.possible][:, 0].max() == 2.5, "not where the outlines overlap"


def test_without_bearings_nothing_is_asked_of_the_start() -> None:
    plain = asking(("sofa", "left", True))
    plain = plain.model_copy(update={"conditions": (Condition(label="rug", room=ZONE, truth=False),)})
    assert Facings(apartment(*THINGS), places(), T).headings([plain], 0.0) is None


@pytest.mark.parametrize("truth", [True, False])
def test_a_placed_program_is_as_it_says(truth: bool) -> None:
    scene = apartment(*THINGS)
    placer = placer_of(scene, grid_floor(8.0, 8.0, lambda x, z: any(_in(o, x, z) for o in THINGS)))
    asked = asking(("sofa", "ahead", truth))
    starts = set()
    for k in range(12):
        placed = placer.place(asked, f"id {k}", compass=False)
        heading = -math.degrees(placed.yaw)
        assert verdict(scene, "sofa", "ahead", placed.start, heading) == (1 if truth else -1)
        starts.add(placed.start.tobytes())
    assert len(starts) > 6


def _labelled(item, label: str):
    return type(item)(item.object_id, "zone", label, label, item.center, aabb=item.aabb)


def _in(item, x: float, z: float) -> bool:
    low, high = item.aabb
    return bool(low[0] - 0.1 < x < high[0] + 0.1 and low[2] - 0.1 < z < high[2] + 0.1)
