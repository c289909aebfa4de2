"""What supports or surrounds an object of a room."""

from __future__ import annotations

import numpy as np

from condvln.scene import SceneObject
from condvln.verify.surroundings import Surroundings, Thing
from schemas.config import Thresholds


def made(count: int) -> list[Thing]:
    """Return objects of which many touch, overlap or contain others; some have no box, and some are said to be on
    another one.
    """
    drawn = np.random.default_rng(7)
    things = []
    for k in range(count):
        low = np.round(drawn.integers(0, 8, 3) / 4, 3)
        box = np.array([low, low + drawn.integers(1, 6, 3) / 4])
        item = SceneObject(
            f"thing:{k}",
            "room",
            "box",
            "box",
            box.mean(axis=0),
            aabb=None if k % 9 == 0 else box,
            receptacles=(f"thing:{k - 1}",) if k % 7 == 0 else (),
        )
        things.append(Thing.of(item, "box"))
    return things


def test_objects_that_share_no_ground_are_left_out_only_where_they_hold_nothing() -> None:
    things = made(60)
    room = Surroundings(things, 0.0, Thresholds())
    held = 0
    for inner in things:
        near = {thing.object_id for thing in room._beside(inner)}
        holding = {outer.object_id for outer in things if room._has(outer, inner)}
        assert holding <= near
        held += len(holding)
    assert held > 60
    assert any(len(room._beside(inner)) < 30 for inner in things)
