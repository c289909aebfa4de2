"""What an agent without pixels is told: closed forms in a drawn room, and errors that follow from a seed alone."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st

from condvln.scene import Room, Scene, SceneObject
from condvln.sensors import KnownMap, TextObservation, TextSensor, noisy_move, noisy_pose
from condvln.sensors.renderer import open_renderer
from condvln.sensors.text import TEXT_CAMERA, SeenThing, _room_at, noisy_sightings
from schemas.config import CameraConfig, NoiseConfig


def room(name: str, label: str, corners: list[list[float]], floor_y: float = 0.0) -> Room:
    return Room(name, label, label, 0, floor_y, floor_y + 2.5, np.array(corners), "dataset", True)


def thing(name: str, label: str, low: list[float], high: list[float], room_id: str = "a") -> SceneObject:
    box = np.array([low, high])
    return SceneObject(name, room_id, label, label, box.mean(axis=0), aabb=box)


LEFT = [[-4.0, -4.0], [0.0, -4.0], [0.0, 4.0], [-4.0, 4.0]]
RIGHT = [[0.0, -4.0], [4.0, -4.0], [4.0, 4.0], [0.0, 4.0]]
SCENE = Scene(
    "procthor",
    "drawn",
    Path("."),
    (room("a", "kitchen", LEFT), room("b", "bedroom", RIGHT)),
    (
        thing("chair", "chair", [-2.25, 0.5, -3.25], [-1.75, 1.5, -2.75]),
        thing("bed", "bed", [1.75, 0.5, -3.25], [2.25, 1.5, -2.75], "b"),
        thing("behind", "sofa", [-0.5, 0.5, 2.0], [0.5, 1.5, 3.0]),
        thing("under the bed", "cup", [1.9, 0.6, -3.4], [2.0, 0.7, -3.3], "b"),
        thing("wall", "wall", [-4.0, 0.0, -4.0], [4.0, 2.5, -3.9]),
        thing("far", "television", [-0.5, 0.5, -13.0], [0.5, 1.5, -12.5]),
    ),
)
SENSOR = TextSensor(SCENE, open_renderer(SCENE, None))


def told(observation: TextObservation) -> dict[str, SeenThing]:
    return {seen.label: seen for seen in observation.things}


def test_bearing_distance_and_room() -> None:
    seen = SENSOR.observe([0, 0, 0], 0.0)
    assert list(told(seen)) == ["chair", "bed"], "not what is behind, hidden, structure or too far"
    chair, bed = seen.things
    assert chair.distance == bed.distance == pytest.approx(math.hypot(1.75, 2.75), abs=0.03)
    assert -36 < chair.bearing < -31
    assert bed.bearing == pytest.approx(-chair.bearing, abs=0.3)
    assert (chair.room, bed.room) == ("kitchen", "bedroom")
    assert str(bed) == f"bed in the bedroom, {bed.distance:.1f} m, {bed.bearing:.0f}° to the right"
    # Turned to the left by 30°, all is 30° further to the right.
    turned = SENSOR.observe([0, 0, 0], math.radians(30)).things
    assert turned[0].label == "chair"
    assert turned[0].bearing == pytest.approx(chair.bearing + 30, abs=0.5)
    around = SENSOR.observe([-1, 0, 0], math.pi)
    assert list(told(around)) == ["sofa"]
    assert around.things[0].bearing == pytest.approx(-math.degrees(math.atan2(1, 2)), abs=2)
    assert str(around).startswith("You are in the kitchen.\nYou see:\n- sofa")


@settings(max_examples=30, deadline=None)
@given(st.floats(-60, 60), st.floats(-40, 40), st.floats(-60, 60))
def test_a_camera_that_is_turned_tells_the_same(heading: float, down: float, turn: float) -> None:
    """Bearings and distances are the agent's, whatever way its camera looks."""
    camera = TEXT_CAMERA.model_copy(update={"look_down": down, "turn": turn, "width": 256, "height": 256})
    there = told(TextSensor(SCENE, open_renderer(SCENE, None), camera).observe([0, 0, 0], math.radians(heading)))
    wide = CameraConfig(width=512, height=512, hfov=140, normalized=False)
    known = told(TextSensor(SCENE, open_renderer(SCENE, None), wide).observe([0, 0, 0], math.radians(heading)))
    for label in ("chair", "bed"):
        # Neither picture's edge cuts it: half of the turned one is 45°, of the wide one 70°.
        whole = label in there and label in known and abs(there[label].bearing) < 55
        if whole and abs(there[label].bearing + turn) < 35 and abs(down) < 20:
            assert there[label].bearing == pytest.approx(known[label].bearing, abs=1.5)
            assert there[label].distance == pytest.approx(known[label].distance, abs=0.1)


@settings(max_examples=100, deadline=None)
@given(st.floats(-5, 5), st.floats(-5, 5))
def test_the_room_is_the_one_underfoot(x: float, z: float) -> None:
    found = _room_at(SCENE.rooms, np.array([x, 0.0, z]))
    inside = [r.room_id for r in SCENE.rooms if shapely.Polygon(r.polygon).contains(shapely.Point(x, z))]
    if inside:
        assert found.room_id == inside[0]
    elif not any(shapely.Polygon(r.polygon).covers(shapely.Point(x, z)) for r in SCENE.rooms):
        assert found is None


def test_the_room_of_two_storeys_is_on_one_s_own() -> None:
    upper = room("c", "attic", LEFT, floor_y=3.0)
    assert [getattr(_room_at((*SCENE.rooms, upper), np.array([-1, y, 0])), "label", "") for y in (0.1, 2.9)] == [
        "kitchen",
        "attic",
    ]


def test_the_map_remembers() -> None:
    known = KnownMap()
    for x in (-0.5, 0.0, 0.5, 0.5):
        known.add(SENSOR.observe([x, 0, 0], 0.0), [x, 0, 0], 0.0)
    assert known.rooms == ["kitchen", "bedroom"]
    labels = [label for label, *_ in known.things]
    assert sorted(labels) == ["bed", "chair"]
    for label, _, x, z in known.things:
        assert math.hypot(x - (2 if label == "bed" else -2), z + 3) < 0.6
    assert str(known) == "Rooms so far: kitchen, bedroom.\nSeen in the kitchen: chair.\nSeen in the bedroom: bed."


MANY = [SeenThing(f"thing {k}", "kitchen", float(k), 1.0) for k in range(40)]
LABELS = [f"thing {k}" for k in range(50)]


def seen_with(seed: int = 3, **noise: float) -> list[SeenThing]:
    return noisy_sightings(MANY, NoiseConfig(**noise), LABELS, TEXT_CAMERA, seed, ("episode", 5))


def test_noise_follows_from_the_seed_and_grows() -> None:
    assert seen_with() == MANY
    assert seen_with(missed=1.0) == []
    assert seen_with(missed=0.3) == seen_with(missed=0.3)
    assert seen_with(missed=0.3) != seen_with(4, missed=0.3)
    # What a small share loses, a larger one loses too.
    assert {t.label for t in seen_with(missed=0.5)} < {t.label for t in seen_with(missed=0.2)} < {t.label for t in MANY}
    wrong = seen_with(confused=1.0)
    assert [t.bearing for t in wrong] == [t.bearing for t in MANY]
    assert not any(a.label == b.label for a, b in zip(wrong, MANY, strict=True))
    assert {t.label for t in wrong} <= set(LABELS)
    ghost = seen_with(false=1.0)[-1]
    assert len(seen_with(false=1.0)) == 41
    assert abs(ghost.bearing) <= 45
    assert ghost.label in LABELS


def test_shares_of_errors_are_what_was_asked() -> None:
    kept = sum(len(seen_with(seed, missed=0.25)) for seed in range(100)) / 4000
    assert kept == pytest.approx(0.75, abs=0.03)
    ghosts = sum(len(seen_with(seed, false=0.4)) - 40 for seed in range(400)) / 400
    assert ghosts == pytest.approx(0.4, abs=0.08)


def test_noisy_poses_and_moves() -> None:
    quiet, loud = NoiseConfig(), NoiseConfig(position=0.2, heading=5.0, step=0.1, turn=0.05)
    place, heading = noisy_pose([1, 2, 3], 0.5, quiet, 0)
    assert place.tolist() == [1, 2, 3]
    assert heading == pytest.approx(0.5)
    assert noisy_move(0.25, 0.2, quiet, 0) == (0.25, 0.2)
    poses = [noisy_pose([1, 2, 3], 0.5, loud, 0, (k,)) for k in range(500)]
    offsets = np.array([p - [1, 2, 3] for p, _ in poses])
    np.testing.assert_allclose(offsets.std(axis=0), [0.2, 0, 0.2], atol=0.02)
    assert np.degrees(np.std([h for _, h in poses])) == pytest.approx(5, abs=0.5)
    moves = np.array([noisy_move(0.25, math.pi / 12, loud, 0, (k,)) for k in range(500)])
    np.testing.assert_allclose(moves.std(axis=0) / [0.25, math.pi / 12], [0.1, 0.05], rtol=0.15)
    np.testing.assert_allclose(moves.mean(axis=0), [0.25, math.pi / 12], rtol=0.02)
