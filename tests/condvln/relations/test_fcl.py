"""FCL measures surfaces on the path of ``condvln generate``, and nothing that proves the results uses it."""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from dataclasses import replace

import fcl
import numpy as np
import pytest

from condvln.relations import relate_room
from condvln.scene import OrientedBox, RoomArrays, SceneObject
from condvln.scene.rotations import rotation_y
from schemas.config import Thresholds


def test_relations_of_turned_boxes_are_measured_by_fcl(
    monkeypatch: pytest.MonkeyPatch,
    make: Callable[..., SceneObject],
    room_of: Callable[[Sequence[SceneObject]], RoomArrays],
) -> None:
    items = [make(name, (x, 0, 0), (0.5, 0.5, 0.5)) for name, x in (("a", 0.0), ("b", 1.4), ("c", 9.0))]
    turned = [replace(o, obb=OrientedBox(o.center, np.full(3, 0.3), rotation_y(np.pi / 4))) for o in items]
    asked = []
    measure = fcl.distance
    monkeypatch.setattr(fcl, "distance", lambda *pair: asked.append(pair) or measure(*pair))
    surface = relate_room(room_of(turned), Thresholds()).surface
    assert len(asked) == 1, "one pair is within reach"
    assert surface[0, 1] == round(1.4 - 0.6 * np.sqrt(2), 3)
    assert "fcl" in sys.modules
