"""Objects cut at the borders of regions are whole again; things that only stand beside each other are not joined."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from condvln.scene import OrientedBox, Room, SceneObject, round_mm
from condvln.scene.boxes import aabb_of, box_corners, rounded_box
from condvln.sources.mp3d import joined_slices

BORDERS = (0.0, 3.0)
"""Three regions side by side along x, divided here."""


def regions() -> dict[str, Room]:
    edges = [-5.0, *BORDERS, 8.0]
    rooms = {}
    for k, (left, right) in enumerate(pairwise(edges)):
        corners = np.array([[left, -5.0], [left, 5.0], [right, 5.0], [right, -5.0]])
        rooms[f"r{k}"] = Room(f"r{k}", "k", "kitchen", 0, 0.0, 3.0, corners, "dataset", True)
    return rooms


def thing(name: str, room: str, low: list[float], high: list[float], label: str = "sofa") -> SceneObject:
    box = round_mm(np.array([low, high]))
    half = (box[1] - box[0]) / 2
    obb = rounded_box(OrientedBox(box.mean(axis=0), half, np.eye(3)))
    return SceneObject(name, room, label, label, round_mm(box.mean(axis=0)), aabb=box, obb=obb)


def cut(low: list[float], high: list[float]) -> list[SceneObject]:
    """The slices of a box, one in each region that it reaches into."""
    edges = [-np.inf, *BORDERS, np.inf]
    slices = []
    for k, (left, right) in enumerate(pairwise(edges)):
        x0, x1 = max(low[0], left), min(high[0], right)
        if x1 - x0 > 0.01:
            slices.append(thing(f"s{k}", f"r{k}", [x0, low[1], low[2]], [x1, high[1], high[2]]))
    return slices


side = st.floats(0.1, 2.5)
place = st.floats(-3.0, 5.0)


@given(place, st.floats(-2.0, 2.0), st.floats(0.05, 5.0), side, side, st.randoms(use_true_random=False))
def test_a_box_cut_at_borders_is_whole_again(
    x: float, z: float, length: float, height: float, depth: float, rng
) -> None:
    low, high = [x, 0.0, z], [x + length, height, z + depth]
    slices = cut(low, high)
    rng.shuffle(slices)
    (item,), said = joined_slices(slices, regions())
    np.testing.assert_allclose(item.aabb[:, 1:], np.array([low, high])[:, 1:], atol=1e-3)
    # Less than a centimetre in a region is no slice there.
    np.testing.assert_allclose(item.aabb[:, 0], [low[0], high[0]], atol=0.012)
    np.testing.assert_allclose(aabb_of(box_corners(item.obb)), item.aabb, atol=2e-3)
    np.testing.assert_allclose(item.center, item.aabb.mean(axis=0), atol=2e-3)
    assert bool(said) == (len(slices) > 1)
    widest = max(slices, key=lambda one: float(one.aabb[1, 0] - one.aabb[0, 0]))
    longest = float(widest.aabb[1, 0] - widest.aabb[0, 0])
    ties = [one.room_id for one in slices if abs(float(one.aabb[1, 0] - one.aabb[0, 0]) - longest) < 1e-6]
    assert item.room_id in ties, "the region that holds most of it"


@given(st.floats(0.06, 2.0), side, side, st.floats(-2.0, 2.0))
def test_things_apart_stay_two(gap: float, height: float, depth: float, z: float) -> None:
    left = thing("a", "r0", [-1.0, 0.0, z], [-gap / 2, height, z + depth])
    right = thing("b", "r1", [gap / 2, 0.0, z], [1.0, height, z + depth])
    items, said = joined_slices([left, right], regions())
    assert [item.object_id for item in items] == ["a", "b"]
    assert not said


@pytest.mark.parametrize(
    ("other", "why"),
    [
        (thing("b", "r0", [0.0, 0.0, 0.0], [1.0, 1.0, 1.0]), "of one region: two sofas that touch"),
        (thing("b", "r1", [0.0, 0.0, 0.0], [1.0, 1.0, 1.0], "chair"), "of another label"),
        (thing("b", "r1", [0.0, 0.0, 0.9], [1.0, 1.0, 1.9]), "around the corner: the sections don't fit"),
        (thing("b", "r1", [0.0, 2.0, 0.0], [1.0, 3.0, 1.0]), "above it"),
    ],
)
def test_what_is_no_slice(other: SceneObject, why: str) -> None:
    one = thing("a", "r0", [-1.0, 0.0, 0.0], [0.0, 1.0, 1.0])
    items, said = joined_slices([one, other], regions())
    assert len(items) == 2, why
    assert not said


def test_things_of_one_label_far_from_the_border_are_not_slices() -> None:
    """Annotated in a region that they are not in: they touch each other, but not each other's region."""
    one = thing("a", "r0", [-3.0, 0.0, 0.0], [-2.0, 1.0, 1.0])
    other = thing("b", "r1", [-2.0, 0.0, 0.0], [-1.0, 1.0, 1.0])
    assert len(joined_slices([one, other], regions())[0]) == 2


def test_structure_and_catch_alls_go_on() -> None:
    walls = cut([-1.0, 0.0, 0.0], [5.0, 2.5, 0.2])
    assert len(joined_slices(walls, regions(), frozenset({"sofa"}))[0]) == 3


def test_slices_on_other_levels_are_others() -> None:
    rooms = regions()
    rooms["r1"] = Room("r1", "k", "kitchen", 1, 3.0, 6.0, rooms["r1"].polygon, "dataset", True)
    assert len(joined_slices(cut([-1.0, 0.0, 0.0], [2.0, 1.0, 1.0]), rooms)[0]) == 2
