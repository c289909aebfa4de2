"""A scene beyond a limit is refused with both numbers, the place and the key; one at the limit is not."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from condvln.scene import Room, Scene, SceneObject
from condvln.scene.scene import check_limits
from schemas.config import LimitsConfig
from schemas.errors import LimitError

AT_LIMIT = LimitsConfig(
    objects_per_room=3, pairs_per_scene=13, objects_per_scene=5, rooms_per_scene=2, corners_per_room=4
)
"""What the scene of `scene` has, of each."""


def scene() -> Scene:
    """Two rooms of four corners, with three and two objects."""
    square = np.array([[0.0, 0.0], [0.0, 4.0], [4.0, 4.0], [4.0, 0.0]])
    rooms = tuple(Room(name, name, name, 0, 0.0, 3.0, square, "dataset", True) for name in ("hall", "study"))
    homes = ("hall", "hall", "hall", "study", "study")
    objects = tuple(SceneObject(f"o{k}", home, "chair", "chair", np.zeros(3)) for k, home in enumerate(homes))
    return Scene("procthor", "big", Path("/data"), rooms, objects)


def test_a_scene_at_every_limit_passes() -> None:
    check_limits(scene(), AT_LIMIT)


@pytest.mark.parametrize(
    ("key", "count", "place"),
    [
        ("objects_per_room", "3 objects", "room 'hall'"),
        ("pairs_per_scene", "13 pairs of objects that share a room", ""),
        ("objects_per_scene", "5 objects", ""),
        ("rooms_per_scene", "2 rooms", ""),
        ("corners_per_room", "4 corners of its outline", "room 'hall'"),
    ],
)
def test_one_more_than_a_limit_is_refused(key: str, count: str, place: str) -> None:
    limit = getattr(AT_LIMIT, key) - 1
    limits = AT_LIMIT.model_copy(update={key: limit})
    with pytest.raises(LimitError) as caught:
        check_limits(scene(), limits)
    error = caught.value
    assert error.exit_code == 3
    assert (error.where, error.place) == ("procthor/big", place)
    assert error.what == f"{count}, and limits.{key} is {limit}"
    assert f"Raise limits.{key}" in error.remedy


def test_the_fullest_room_is_named() -> None:
    whole = scene()
    moved = tuple(replace(o, room_id="study") if o.object_id in ("o1", "o2") else o for o in whole.objects)
    with pytest.raises(LimitError, match="room 'study': 4 objects"):
        check_limits(replace(whole, objects=moved), AT_LIMIT.model_copy(update={"objects_per_room": 1}))


def test_every_limit_is_checked() -> None:
    """No key of the section is without a case above."""
    cases = {"objects_per_room", "pairs_per_scene", "objects_per_scene", "rooms_per_scene", "corners_per_room"}
    assert set(LimitsConfig.model_fields) == cases
