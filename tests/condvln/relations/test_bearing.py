"""Left, right, ahead and behind against shapes on the ground, over more than 100,000 pairs of a start and a thing."""

from __future__ import annotations

import math

import numpy as np
import pytest
import shapely

from condvln.relations.directions import BEARING_DEGREES, bearing_status, sighted
from condvln.scene import SceneObject
from condvln.verify.standpoint import Standpoint
from condvln.verify.surroundings import Thing
from schemas.config import Thresholds

T = Thresholds()
FAR = 1000.0
BOXES, STARTS = 300, 100
"""30,000 pairs of a start and a thing, each in all four directions."""


def wedges(places: np.ndarray, axes: np.ndarray, half_width: float) -> np.ndarray:
    """A triangle for each place: all that lies within `half_width` degrees of an axis (clockwise from north)."""
    angles = np.radians(axes[:, None] + np.array([-half_width, half_width]))
    tips = places[:, None] + FAR * np.stack([np.sin(angles), -np.cos(angles)], axis=-1)
    return shapely.polygons(np.concatenate([places[:, None], tips], axis=1))


@pytest.fixture(scope="module")
def drawn() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Starts (n, 3), boxes (n, 2, 3), headings (n,), the same for `STARTS` in a row; some starts are in their box."""
    rng = np.random.default_rng(7)
    starts = np.round(rng.uniform(-5.0, 5.0, (BOXES * STARTS, 3)), 3)
    starts[:, 1] = 0.0
    corner = np.round(rng.uniform(-5.0, 5.0, (BOXES, 3)), 3)
    boxes = np.stack([corner, np.round(corner + rng.uniform(0.02, 2.5, (BOXES, 3)), 3)], axis=1)
    return starts, boxes.repeat(STARTS, axis=0), rng.uniform(-180.0, 180.0, BOXES).repeat(STARTS)


def by_shapes(starts: np.ndarray, boxes: np.ndarray, headings: np.ndarray, direction: str) -> np.ndarray:
    ground, axes = starts[:, [0, 2]], headings + BEARING_DEGREES[direction]
    footprints = shapely.box(boxes[:, 0, 0], boxes[:, 0, 2], boxes[:, 1, 0], boxes[:, 1, 2])
    centres = boxes.mean(axis=1)[:, [0, 2]]
    middles = shapely.points(centres)
    narrow, wide = wedges(ground, axes, T.bearing_true), wedges(ground, axes, T.bearing_false)
    clear = ~shapely.intersects(footprints, shapely.points(ground))
    clear &= np.linalg.norm(centres - ground, axis=1) >= T.bearing_distance
    true = clear & shapely.contains(narrow, middles) & shapely.covers(wide, footprints)
    false = clear & ~shapely.intersects(wide, middles) & ~shapely.intersects(narrow, footprints)
    return true.astype(int) - false.astype(int)


@pytest.mark.parametrize("direction", BEARING_DEGREES)
def test_generator_agrees_with_shapes_on_every_pair(drawn, direction: str) -> None:
    starts, boxes, headings = drawn
    expected = by_shapes(starts, boxes, headings, direction)
    found = np.concatenate(
        [
            bearing_status(sighted(starts[k : k + STARTS], boxes[k], T), direction, headings[k : k + 1], T)[:, 0]
            for k in range(0, len(starts), STARTS)
        ]
    )
    assert np.flatnonzero(found != expected).tolist() == []
    shares = [(expected == value).mean() for value in (1, 0, -1)]
    assert min(shares) > 0.05, "each verdict is tried often, dead zones too"


@pytest.mark.parametrize("direction", BEARING_DEGREES)
def test_verifier_agrees_with_shapes_on_every_pair(drawn, direction: str) -> None:
    starts, boxes, headings = (part[::11] for part in drawn)
    expected = by_shapes(starts, boxes, headings, direction)
    for k, (start, box, heading) in enumerate(zip(starts, boxes, headings, strict=True)):
        yaw = -math.radians(heading)
        point = Standpoint(1000.0 * start[0], 0.0, 1000.0 * start[2], (-math.sin(yaw), -math.cos(yaw)))
        item = SceneObject("a", "r", "lamp", "lamp", box.mean(axis=0), aabb=box)
        assert point.judge(direction, Thing.of(item, "lamp"), T).verdict == expected[k], k


def test_the_directions_are_a_person_s() -> None:
    """Facing north (−Z) at the origin: east is right, and a turn to the left brings it behind."""
    east = np.array([[2.9, 0.0, -0.1], [3.1, 1.0, 0.1]])
    seen = sighted(np.zeros((1, 3)), east, T)
    facing = {"north": 0.0, "east": 90.0, "south": 180.0, "west": -90.0}
    said = {
        name: [d for d in BEARING_DEGREES if bearing_status(seen, d, [heading], T)[0, 0] == 1]
        for name, heading in facing.items()
    }
    assert said == {"north": ["right"], "east": ["ahead"], "south": ["left"], "west": ["behind"]}


def test_a_thing_is_in_one_direction_at_most_and_turning_the_agent_turns_them(drawn) -> None:
    starts, boxes, headings = (part[::60] for part in drawn)
    ring = ("ahead", "right", "behind", "left")
    for start, box, heading in zip(starts, boxes, headings, strict=True):
        seen = sighted(start[None], box, T)
        status = [int(bearing_status(seen, d, [heading], T)[0, 0]) for d in ring]
        assert status.count(1) <= 1
        if 1 in status:
            assert status[(status.index(1) + 2) % 4] == -1, "what is ahead is surely not behind"
        turned = [int(bearing_status(seen, d, [heading - 90.0], T)[0, 0]) for d in ring]
        assert turned == [status[-1], *status[:-1]]
