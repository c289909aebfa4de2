"""Images of rooms that are known in closed form, and of scenes that every ray can be cast in."""

from __future__ import annotations

import math

import numpy as np
import pytest
import trimesh
from hypothesis import example, given, settings
from hypothesis import strategies as st

from condvln.scene.rotations import rotation_x, rotation_y, rotation_z
from condvln.sensors import measured_depth
from condvln.sensors.camera import camera_pose, panorama
from condvln.sensors.renderer import NEAR
from schemas.config import CameraConfig
from schemas.errors import UsageError
from tests.condvln.sensors.made_rooms import F64, box_triangles, rays, renderer_of
from tests.condvln.sensors.ray_caster import RayCaster

GREY = (0.4, 0.4, 0.4)
RED, GREEN, BLUE = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)
LOW, HIGH = np.array([-2.0, 0.0, -3.0]), np.array([3.0, 2.5, 4.0])

angles = st.floats(-180, 180)
shares = st.floats(0.05, 0.95)


def depth_in_box(eye: F64, directions: F64) -> F64:
    """Depth of the walls of the room from LOW to HIGH, seen from inside."""
    with np.errstate(divide="ignore", over="ignore"):
        walls = np.where(directions > 0, HIGH - eye, LOW - eye) / directions
    nearest: F64 = np.where(directions == 0, np.inf, walls).min(axis=-1)
    return nearest


@settings(max_examples=60, deadline=None)
@example(0.5, 0.25, 0.5, 0.0, 0.0, 87.0, 1, 67)
@given(shares, shares, shares, angles, st.floats(-90, 90), st.floats(20, 150), st.integers(1, 70), st.integers(1, 70))
def test_depth_in_a_room_is_the_closed_form(
    x: float, y: float, z: float, heading: float, down: float, hfov: float, width: int, height: int
) -> None:
    """Every pixel, edges too: no ray passes between two walls."""
    room = renderer_of((box_triangles(LOW, HIGH, inside=True), GREY))
    camera = CameraConfig(width=width, height=height, hfov=hfov, eye_height=0.0, look_down=down)
    position = LOW + np.array([x, y, z]) * (HIGH - LOW)
    eye, rotation = camera_pose(camera, position, math.radians(heading))
    frame = room.look(camera, position, math.radians(heading))
    expected = depth_in_box(eye, rays(camera, rotation))
    # What is nearer than NEAR along the axis is cut away; within the tolerance of NEAR both are right.
    seen, unseen = expected > NEAR + 1e-4, expected < NEAR - 1e-4
    np.testing.assert_allclose(frame.depth[seen], expected[seen], atol=1e-4, rtol=0)
    assert (frame.depth[unseen] == 0).all()
    assert (frame.rgb[seen] == 102).all()
    assert (frame.rgb[unseen] == 0).all()
    assert (frame.instance == 0).all()


@pytest.mark.parametrize("turned", [0.0, 1e-17, 1e-15, -1e-13, 1e-9])
def test_edges_along_the_image_s_rows_are_kept(turned: float) -> None:
    """A quarter turn in floating point leaves edges that are level but for the last digit: they end beyond any number
    of columns."""
    room = renderer_of((box_triangles(LOW, HIGH, inside=True), GREY))
    rng = np.random.default_rng(0)
    for quarter, down in ((k * math.pi / 2, d) for k in range(-4, 5) for d in (-90.0, 0.0, 30.0, 90.0)):
        camera = CameraConfig(width=1280, height=12, hfov=60.0, eye_height=0.0, look_down=down)
        position = LOW + rng.uniform(0.1, 0.9, 3) * (HIGH - LOW)
        eye, rotation = camera_pose(camera, position, quarter + turned)
        frame = room.look(camera, position, quarter + turned)
        np.testing.assert_allclose(frame.depth, depth_in_box(eye, rays(camera, rotation)), atol=1e-4, rtol=0)


def test_depth_of_a_room_far_from_the_origin() -> None:
    away = np.array([1000.0, -40.0, 2000.0])
    room = renderer_of((box_triangles(LOW + away, HIGH + away, inside=True), GREY))
    camera = CameraConfig(width=160, height=120, hfov=79)
    position = away + np.array([0.5, 0.0, 0.5])
    eye, rotation = camera_pose(camera, position, 0.7)
    frame = room.look(camera, position, 0.7)
    np.testing.assert_allclose(frame.depth, depth_in_box(eye - away, rays(camera, rotation)), atol=1e-4, rtol=0)


@settings(max_examples=40, deadline=None)
@given(angles, angles, angles, st.floats(0.3, 6))
def test_depth_of_a_tilted_plane_is_the_closed_form(yaw: float, pitch: float, roll: float, distance: float) -> None:
    """Where it is seen at less than two degrees, the rounding of its corners counts."""
    turn = rotation_y(math.radians(yaw)) @ rotation_x(math.radians(pitch)) @ rotation_z(math.radians(roll))
    flat = np.array([[[-9.0, -9, 0], [9, -9, 0], [9, 9, 0]], [[-9.0, -9, 0], [9, 9, 0], [-9, 9, 0]]])
    plane = renderer_of((flat @ turn.T + np.array([0, 0, -distance]), GREY))
    camera = CameraConfig(width=40, height=30, hfov=79, eye_height=0.0)
    frame = plane.look(camera, [0, 0, 0])
    directions = rays(camera, np.eye(3))
    normal = turn[:, 2]
    with np.errstate(divide="ignore"):
        depth = (normal @ [0, 0, -distance]) / (directions @ normal)
    reached = np.abs(
        turn.T @ (directions * np.where(np.isfinite(depth), depth, 0)[..., None] - [0, 0, -distance]).reshape(-1, 3).T
    )
    on_it = (reached[:2] < 8.9).all(axis=0).reshape(depth.shape) & (depth > 0.011) & (directions @ normal < -0.03)
    np.testing.assert_allclose(frame.depth[on_it], depth[on_it], atol=1e-4, rtol=0)
    behind = (directions @ normal > 1e-9) | (depth < 0)
    assert (frame.depth[behind] == 0).all(), "a plane is seen from its front alone"


def test_depth_of_a_sphere_is_the_closed_form() -> None:
    """A fine mesh lies within its sagitta of the sphere; away from the outline that is what depth differs by."""
    ball = trimesh.creation.icosphere(subdivisions=4, radius=0.5)
    centre = np.array([0.2, 0.1, -2.0])
    frame = renderer_of((ball.triangles + centre, GREY)).look(CameraConfig(eye_height=0.0), [0, 0, 0])
    directions = rays(CameraConfig(), np.eye(3))
    a, b = (directions**2).sum(-1), directions @ centre
    root = b**2 - a * (centre @ centre - 0.25)
    inside = root > 0.2 * root.max()
    exact = (b[inside] - np.sqrt(root[inside])) / a[inside]
    edge = ball.edges_unique_length.max()
    sagitta = edge**2 / 3 / (2 * 0.5)
    error = frame.depth[inside] - exact
    assert inside.sum() > 2500
    assert error.min() > -1e-6
    assert error.max() < 2.5 * sagitta
    outside = root < -0.02
    assert (frame.depth[outside] == 0).all()
    # The mesh itself, to the last micrometre.
    few = directions.reshape(-1, 3)[::197]
    depth, _ = RayCaster(np.asarray(ball.triangles + centre)).first_front(np.zeros(3), few)
    np.testing.assert_allclose(frame.depth.reshape(-1)[::197], depth, atol=2e-6)


def signs() -> tuple[F64, ...]:
    """Boxes to the left (red), the right (green) and above (blue) of what is straight ahead."""
    return tuple(
        box_triangles(*corners)
        for corners in (
            ([-1.2, 1.0, -3.2], [-0.8, 1.5, -3.0]),
            ([0.8, 1.0, -3.2], [1.2, 1.5, -3.0]),
            ([-0.2, 2.0, -3.2], [0.2, 2.4, -3.0]),
        )
    )


def test_left_is_left_up_is_up_and_red_is_red() -> None:
    left, right, above = signs()
    scene = renderer_of(
        (box_triangles(LOW, HIGH, inside=True)[:0], GREY),
        (left, RED),
        (right, GREEN),
        (above, BLUE),
        labels=("sofa", "bed", "lamp"),
    )
    camera = CameraConfig(width=90, height=60, hfov=70)
    frame = scene.look(camera, [0, 0, 0])
    for instance, colour, label in ((1, RED, "sofa"), (2, GREEN, "bed"), (3, BLUE, "lamp")):
        rows, columns = np.nonzero(frame.instance == instance)
        assert len(rows) > 20
        assert (frame.rgb[rows, columns] == np.array(colour) * 255).all()
        assert {scene.labels[k - 1] for k in frame.label[rows, columns]} == {label}
        if instance == 3:
            assert rows.max() < 30
            assert abs(columns.mean() - 44.5) < 1
        else:
            assert (columns.max() < 45) == (instance == 1)
    assert (frame.rgb[frame.instance == 0] == 0).all()
    assert (frame.depth[frame.instance == 0] == 0).all()
    # To turn left moves everything to the right; to look down moves it up; from the back the boxes are behind.
    turned = scene.look(camera, [0, 0, 0], math.radians(15))
    assert np.nonzero(turned.instance == 1)[1].mean() > np.nonzero(frame.instance == 1)[1].mean() + 10
    lower = scene.look(camera.model_copy(update={"look_down": 10.0}), [0, 0, 0])
    assert np.nonzero(lower.instance == 1)[0].mean() < np.nonzero(frame.instance == 1)[0].mean() - 8
    assert not scene.look(camera, [0, 0, 0], math.pi).instance.any()
    # A step to the right, as an agent that faces north goes east.
    moved = scene.look(camera, [1.0, 0, 0])
    assert np.nonzero(moved.instance == 2)[1].mean() == pytest.approx(44.5, abs=1)


def test_the_views_of_a_panorama_follow_those_of_the_simulator() -> None:
    """View 12 is straight ahead at the horizon, 13 is 30° to its right, 0 is 30° lower, 24 is 30° higher."""
    cameras = panorama(64, 48)
    assert list(cameras)[::12] == ["rgb_00", "rgb_12", "rgb_24"]
    assert len(cameras) == 36

    def ahead(name: str) -> F64:
        return np.asarray(-camera_pose(cameras[name], [0, 0, 0], 0.0)[1][:, 2])

    half, whole = 0.5, math.sqrt(0.75)
    np.testing.assert_allclose(ahead("rgb_12"), [0, 0, -1], atol=1e-12)
    np.testing.assert_allclose(ahead("rgb_13"), [half, 0, -whole], atol=1e-12)
    np.testing.assert_allclose(ahead("rgb_00"), [0, -half, -whole], atol=1e-12)
    np.testing.assert_allclose(ahead("rgb_24"), [0, half, -whole], atol=1e-12)
    tall = 2 * math.degrees(math.atan(math.tan(math.radians(cameras["rgb_00"].hfov) / 2) * 48 / 64))
    assert tall == pytest.approx(60)


def clutter(seed: int, count: int = 150) -> F64:
    """(count, 3, 3) triangles of all sizes around the origin, some of them through the eye's plane."""
    rng = np.random.default_rng(seed)
    middle = rng.uniform(-4, 4, (count, 1, 3))
    return np.asarray(middle + rng.normal(size=(count, 3, 3)) * 10 ** rng.uniform(-1.5, 0.7, (count, 1, 1)))


@pytest.mark.parametrize("seed", range(4))
def test_any_triangles_are_seen_as_rays_meet_them(seed: int) -> None:
    """Far, near, behind, across the near plane, edge-on: the nearest front face is what is drawn."""
    triangles = clutter(seed)
    scene = renderer_of((triangles[:0], GREY), *((t[None], GREY) for t in triangles))
    camera = CameraConfig(width=36, height=28, hfov=100, eye_height=0.0, look_down=13.0)
    eye, rotation = camera_pose(camera, [0.1, 0.2, 0.3], 0.4)
    frame = scene.frame(camera, eye, rotation)
    single = triangles.astype(np.float32).astype(np.float64)
    depth, found = RayCaster(single).first_front(eye, rays(camera, rotation).reshape(-1, 3))
    depth = depth.reshape(frame.depth.shape)
    same = (frame.instance == found.reshape(depth.shape) + 1) & (np.abs(frame.depth - depth) < 1e-4)
    assert same.mean() > 0.998
    assert (frame.instance > 0).mean() > 0.3


def test_the_order_of_the_triangles_does_not_matter() -> None:
    triangles = clutter(9, 400)
    colours = np.random.default_rng(1).uniform(size=(400, 3))
    camera = CameraConfig(width=64, height=48, hfov=90, eye_height=0.0)
    frames = []
    for order in (np.arange(400), np.random.default_rng(2).permutation(400)):
        scene = renderer_of((triangles[:0], GREY), *((triangles[[k]], tuple(colours[k])) for k in order))
        frames.append(scene.look(camera, [0, 0, 0]))
        again = scene.look(camera, [0, 0, 0])
        assert (again.rgb == frames[-1].rgb).all()
    np.testing.assert_array_equal(frames[0].rgb, frames[1].rgb)
    np.testing.assert_array_equal(frames[0].depth, frames[1].depth)


def test_nothing_is_seen_of_nothing() -> None:
    frame = renderer_of((np.zeros((0, 3, 3)), GREY)).look(CameraConfig(width=5, height=4), [0, 0, 0])
    assert not frame.depth.any()
    assert not frame.rgb.any()
    assert not frame.instance.any()


def test_depth_is_clipped_and_normalized_as_habitat_does_it() -> None:
    metres = np.array([[0.0, 0.2, 5.0, 12.0]], np.float32)
    np.testing.assert_allclose(measured_depth(CameraConfig(), metres), [[0, 0.02, 0.5, 1]])
    near = CameraConfig(min_depth=0.5, max_depth=5.0, normalized=False)
    np.testing.assert_allclose(measured_depth(near, metres), [[0.5, 0.5, 5, 5]])
    scaled = CameraConfig(min_depth=0.5, max_depth=5.0)
    np.testing.assert_allclose(measured_depth(scaled, metres), [[0, 0, 1, 1]])
    free = CameraConfig(max_depth=None, normalized=False)
    assert (measured_depth(free, metres) == metres).all()
    with pytest.raises(ValueError, match="cannot be normalized"):
        CameraConfig(max_depth=None)
    with pytest.raises(ValueError, match="must be above min_depth"):
        CameraConfig(min_depth=10.0)


def test_an_observation_has_what_the_preset_names() -> None:
    room = renderer_of((box_triangles(LOW, HIGH, inside=True), GREY))
    seen = room.observe(
        {
            "rgb": CameraConfig(width=8, height=6),
            "depth": CameraConfig(),
            "instance_2": CameraConfig(width=3, height=2),
        },
        [0, 0, 0],
    )
    assert {name: (value.shape, value.dtype.name) for name, value in seen.items()} == {
        "rgb": ((6, 8, 3), "uint8"),
        "depth": ((256, 256), "float32"),
        "instance_2": ((2, 3), "int32"),
    }
    assert float(seen["depth"].max()) <= 1
    with pytest.raises(UsageError, match="must begin with rgb"):
        room.observe({"colour": CameraConfig()}, [0, 0, 0])
    with pytest.raises(UsageError, match="position and rotation must be finite"):
        room.look(CameraConfig(), [0, math.nan, 0])
