"""Looks whose outcome is known in closed form, and the two kinds of occluders against each other."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from condvln.navigation import occluders as occluders_module
from condvln.navigation.occluders import BoxOccluders, MeshOccluders, distances_to_hits
from condvln.navigation.sight import Recognition, View, eyes_at, visible_extent, visible_points
from condvln.navigation.surface_samples import box_samples
from schemas.errors import FormatError, UsageError

FAR = View(range=100.0)


def rectangle(a, b, c, d) -> tuple[np.ndarray, np.ndarray]:
    return np.array([a, b, c, d], float), np.array([[0, 1, 2], [0, 2, 3]])


def mesh_of(*parts) -> MeshOccluders:
    starts = np.cumsum([0] + [len(v) for v, _ in parts])
    vertices = np.concatenate([v for v, _ in parts])
    return MeshOccluders(vertices, np.concatenate([f + k for (_, f), k in zip(parts, starts, strict=False)]))


def box_mesh(low, high) -> tuple[np.ndarray, np.ndarray]:
    corner = np.array([[(low, high)[i >> k & 1][k] for k in range(3)] for i in range(8)], float)
    quads = [(0, 4, 6, 2), (1, 3, 7, 5), (0, 1, 5, 4), (2, 6, 7, 3), (0, 2, 3, 1), (4, 5, 7, 6)]
    return corner, np.array([t for a, b, c, d in quads for t in ((a, b, c), (a, c, d))])


def boxes_of(aabbs) -> BoxOccluders:
    low, high = np.moveaxis(np.asarray(aabbs, float), 1, 0)
    return BoxOccluders((low + high) / 2, (high - low) / 2)


def wall_with_gap_mesh() -> MeshOccluders:
    """The plane z = -2 with a gap from x = -0.5 to 0.5."""
    left = rectangle([-9, 0, -2], [-0.5, 0, -2], [-0.5, 3, -2], [-9, 3, -2])
    right = rectangle([0.5, 0, -2], [9, 0, -2], [9, 3, -2], [0.5, 3, -2])
    return mesh_of(left, right)


def wall_with_gap_boxes() -> BoxOccluders:
    return boxes_of([[[-9, 0, -2.0001], [-0.5, 3, -1.9999]], [[0.5, 0, -2.0001], [9, 3, -1.9999]]])


@pytest.mark.parametrize("wall", [wall_with_gap_mesh, wall_with_gap_boxes])
def test_through_a_gap(wall) -> None:
    """From the origin a point at depth 4 is seen when the ray passes the wall at half its x, within the gap."""
    x = np.arange(-3.0, 3.0, 0.013)
    points = np.stack([x, np.ones_like(x), np.full_like(x, -4.0)], axis=1)
    seen = visible_points(wall(), [[0, 1, 0]], points, FAR)[0]
    np.testing.assert_array_equal(seen, np.abs(x / 2) < 0.5)
    over = points + np.array([0, 6, 0])  # passes the wall 3 m above its 1 m
    assert visible_points(wall(), [[0, 1, 0]], over, FAR).all()


@pytest.mark.parametrize("wall", [wall_with_gap_mesh, wall_with_gap_boxes])
def test_the_surface_itself_is_seen_and_what_is_behind_is_not(wall) -> None:
    depth = np.array([-1.9, -2.0, -2.005, -2.05, -3.0])
    points = np.stack([np.full(5, 4.75), np.full(5, 1.5), depth], axis=1)
    seen = visible_points(wall(), [[4.75, 1.5, 0]], points, FAR)[0]  # along the normal, through the middle of the wall
    np.testing.assert_array_equal(seen, [True, True, True, False, False])


def test_a_look_along_an_edge_between_triangles_is_stopped() -> None:
    wall = mesh_of(rectangle([-1, 0, -2], [1, 0, -2], [1, 2, -2], [-1, 2, -2]))
    share = np.linspace(0.01, 0.99, 99)
    diagonal = np.stack([-1 + 2 * share, 2 * share, np.full(99, -2.0)], axis=1)
    eye = np.array([0.0, 1.0, 0.0])
    assert not visible_points(wall, [eye], eye + 2 * (diagonal - eye), FAR).any()


@given(
    heading=st.floats(-math.pi, math.pi),
    angle=st.floats(-180, 180),
    up=st.floats(-80, 80),
    fov=st.sampled_from([60.0, 90.0, 120.0]),
)
def test_field_of_view(heading: float, angle: float, up: float, fov: float) -> None:
    """Horizontally a wedge around the heading; vertically the height over the distance ahead."""
    turned = heading + math.radians(angle)
    flat = 2.0
    point = [[-flat * math.sin(turned), flat * math.tan(math.radians(up)), -flat * math.cos(turned)]]
    nothing = BoxOccluders(np.zeros((0, 3)), np.zeros((0, 3)))
    view = View(range=50, horizontal_fov=fov)
    if abs(abs(angle) - fov / 2) > 1e-6:
        assert visible_points(nothing, [[0, 0, 0]], point, view, [heading])[0, 0] == (abs(angle) < fov / 2)
    if abs(abs(up) - 40) > 1e-6:
        turning = View(range=50, pitch=40)
        assert visible_points(nothing, [[0, 0, 0]], point, turning)[0, 0] == (abs(up) < 40)
    ahead = math.cos(math.radians(angle))
    limit = ahead * math.tan(math.radians(40)) - abs(math.tan(math.radians(up)))
    if ahead > 0.01 and abs(limit) > 1e-6:
        level = View(range=50, vertical_fov=80)
        assert visible_points(nothing, [[0, 0, 0]], point, level, [heading])[0, 0] == (limit > 0)


@pytest.mark.parametrize(("distance", "seen"), [(4.99, True), (5.0, True), (5.01, False), (0.0, True)])
def test_range(distance: float, seen: bool) -> None:
    nothing = BoxOccluders(np.zeros((0, 3)), np.zeros((0, 3)))
    assert visible_points(nothing, [[1, 1, 1]], [[1 + distance, 1, 1]])[0, 0] == seen


def test_a_box_around_the_eye_or_the_point_hides_nothing() -> None:
    shelf = [[0, 0, -3], [2, 2, -2]]
    book, eye = np.array([[1.0, 1.0, -2.8]]), np.array([[1.0, 1.0, 0.0]])
    assert visible_points(boxes_of([shelf]), eye, book)[0, 0]
    assert visible_points(boxes_of([[[0, 0, -1], [2, 2, 1]]]), eye, book)[0, 0]
    assert not visible_points(boxes_of([[[0, 0, -2], [2, 2, -1]]]), eye, book)[0, 0]
    # Were it the object's own box, the point would lie behind its front.
    assert not visible_points(boxes_of([shelf]), eye, book, own=[0])[0, 0]


POINT = st.tuples(st.floats(-4, 4), st.floats(-2, 2), st.floats(-4, 4))
BOX = st.tuples(POINT, st.tuples(*[st.floats(0.1, 1.5)] * 3))


@given(boxes=st.lists(BOX, min_size=1, max_size=5), pairs=st.lists(st.tuples(POINT, POINT), min_size=1, max_size=20))
def test_triangles_and_boxes_agree_on_solids(boxes, pairs) -> None:
    """Where no end is in or at a box, and no ray brushes one, so that 1 mm more or less changes nothing."""
    centers, half = np.array([c for c, _ in boxes]), np.array([h for _, h in boxes])
    eyes, points = np.array(pairs).transpose(1, 0, 2)
    gaps = np.abs(np.concatenate([eyes, points])[:, None] - centers) - half
    clear = (gaps.max(axis=2) > 0.05).all(axis=1)
    use = clear[: len(pairs)] & clear[len(pairs) :]
    grown, shrunk = (BoxOccluders(centers, half + d).hidden(eyes, points) for d in (0.001, -0.001))
    use &= grown == shrunk
    mesh = mesh_of(*(box_mesh(c - h, c + h) for c, h in zip(centers, half, strict=True)))
    np.testing.assert_array_equal(mesh.hidden(eyes, points)[use], grown[use])
    np.testing.assert_array_equal(mesh.hidden(points, eyes)[use], grown[use])  # a look is the same both ways


@given(turns=st.integers(1, 3), heading=st.floats(-3, 3))
def test_turning_the_world_changes_nothing(turns: int, heading: float) -> None:
    rng = np.random.default_rng(7)
    low = rng.uniform(-4, 4, (12, 3))
    boxes, points, eyes = np.stack([low, low + 0.6], axis=1), rng.uniform(-5, 5, (60, 3)), rng.uniform(-5, 5, (8, 3))
    angle = turns * math.pi / 2
    turn = np.round([[math.cos(angle), 0, math.sin(angle)], [0, 1, 0], [-math.sin(angle), 0, math.cos(angle)]])
    view = View(range=6.0, horizontal_fov=90.0)
    here = visible_points(boxes_of(boxes), eyes, points, view, np.full(8, heading))
    middle, half = boxes.mean(axis=1), (boxes[:, 1] - boxes[:, 0]) / 2
    turned = BoxOccluders(middle @ turn.T, half, np.broadcast_to(turn, (12, 3, 3)))
    there = visible_points(turned, eyes @ turn.T, points @ turn.T, view, np.full(8, heading + angle))
    np.testing.assert_array_equal(here, there)


@pytest.mark.parametrize("kind", ["mesh", "box"])
def test_batches_give_what_single_looks_give(kind: str, monkeypatch: pytest.MonkeyPatch) -> None:
    rng = np.random.default_rng(3)
    low = rng.uniform(-4, 4, (20, 3))
    boxes = np.stack([low, low + rng.uniform(0.5, 2.0, (20, 3))], axis=1)
    around = mesh_of(*(box_mesh(a, b) for a, b in boxes)) if kind == "mesh" else boxes_of(boxes)
    eyes, points = rng.uniform(-5, 5, (15, 3)), rng.uniform(-5, 5, (40, 3))
    whole = visible_points(around, eyes, points, FAR)
    assert 0.1 < whole.mean() < 0.9
    singly = [[visible_points(around, [eye], [point], FAR)[0, 0] for point in points] for eye in eyes]
    np.testing.assert_array_equal(whole, singly)
    monkeypatch.setattr(occluders_module, "_RAYS", 7)
    np.testing.assert_array_equal(whole, visible_points(around, eyes, points, FAR))
    assert around.approximate == (kind == "box")


@pytest.mark.parametrize("seed", range(4))
def test_boxes_hide_what_one_of_them_hides(seed: int) -> None:
    """Also if the lines of an eye, which are tested among the boxes near them, are not asked one after the other."""
    rng = np.random.default_rng(seed)
    centers, half = rng.uniform(-4, 4, (40, 3)), rng.uniform(0, 0.8, (40, 3))
    axes = np.linalg.qr(rng.normal(size=(40, 3, 3)))[0]
    axes[::3] = np.eye(3)
    room = rng.choice([0.0, 0.5], 40)
    eyes = np.repeat(np.concatenate([rng.uniform(-4, 4, (20, 3)), centers[:4]]), 60, axis=0)
    points = rng.uniform(-5, 5, eyes.shape)
    points[::7] = (centers + axes[:, :, 0] * half[:, :1])[rng.integers(0, 40, len(points[::7]))]
    own = rng.integers(-1, 40, len(eyes))
    every = BoxOccluders(centers, half, axes, room).hidden(eyes, points, own)
    single = [
        BoxOccluders(centers[[b]], half[[b]], axes[[b]], room[[b]]).hidden(eyes, points, np.where(own == b, 0, -1))
        for b in range(40)
    ]
    np.testing.assert_array_equal(every, np.any(single, axis=0))
    assert 0.1 < every.mean() < 0.9
    order = rng.permutation(len(eyes))
    shuffled = BoxOccluders(centers, half, axes, room).hidden(eyes[order], points[order], own[order])
    np.testing.assert_array_equal(shuffled, every[order])


def test_sight_along_a_path() -> None:
    """Walking along x before the wall, a point behind the middle of the gap shows when the ray fits through."""
    x = np.arange(-6.0, 6.0, 0.1)
    path = eyes_at(np.stack([x, np.zeros_like(x), np.full_like(x, -1.0)], axis=1))
    assert path[0, 1] == 1.25
    points = [[0.0, 1.25, -3.0], [0.0, 1.25, -1.5], [0.0, 1.25, -9.0]]
    seen = visible_points(wall_with_gap_mesh(), path, points, View(range=5.0))
    # The ray crosses the wall halfway: |x| / 2 < 0.5. Before the wall only the 5 m count.
    expected = [np.argmax(np.abs(x / 2) < 0.5), np.argmax(np.hypot(x, 0.5) <= 5.0), 0]
    np.testing.assert_array_equal(seen.argmax(axis=0), expected)
    np.testing.assert_array_equal(seen.any(axis=0), [True, True, False])


def test_eyes_nowhere_see_nothing() -> None:
    wall = wall_with_gap_mesh()
    eyes = np.array([[0, 1, 0], [np.nan, np.nan, np.nan], [np.inf, 0, 0]])
    np.testing.assert_array_equal(visible_points(wall, eyes, [[0, 1, -1]])[:, 0], [True, False, False])
    assert visible_points(wall, np.zeros((0, 3)), [[0, 1, -1]]).shape == (0, 1)


@pytest.mark.parametrize(
    ("error", "call"),
    [
        (FormatError, lambda: MeshOccluders(np.zeros((3, 3)), np.zeros((0, 3), int))),
        (FormatError, lambda: MeshOccluders(np.zeros((3, 3)), [[0, 1, 3]])),
        (UsageError, lambda: BoxOccluders([[0, 0, 0]], [[1, -1, 1]])),
        (UsageError, lambda: BoxOccluders([[0, 0, 0]], np.zeros((2, 3)))),
        (UsageError, lambda: View(range=0)),
        (UsageError, lambda: View(horizontal_fov=200)),
        (UsageError, lambda: View(vertical_fov=0)),
        (UsageError, lambda: View(pitch=90)),
        (UsageError, lambda: visible_points(wall_with_gap_mesh(), [[0, 0, 0]], [[1, 0, 0]], View(horizontal_fov=90))),
        (UsageError, lambda: visible_points(wall_with_gap_mesh(), [[0, 0, 0]], [[1, 0, 0]], own=[1, 2])),
    ],
)
def test_bad_input(error, call) -> None:
    with pytest.raises(error):
        call()


def test_triangle_soup_against_plain_algebra() -> None:
    """Möller & Trumbore's test of every ray with every triangle, in double precision."""
    rng = np.random.default_rng(11)
    corners = rng.uniform(-3, 3, (150, 1, 3)) + rng.uniform(-1, 1, (150, 3, 3))
    eyes, points = rng.uniform(-4, 4, (2, 800, 3))
    away = points - eyes
    first, second = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    across = np.cross(away[:, None], second)
    det = np.einsum("tj,ktj->kt", first, across)
    start = eyes[:, None] - corners[:, 0]
    u = np.einsum("ktj,ktj->kt", start, across) / det
    side = np.cross(start, first)
    v = np.einsum("kj,ktj->kt", away, side) / det
    t = np.einsum("tj,ktj->kt", second, side) / det
    length = np.linalg.norm(away, axis=1)[:, None]

    def hidden(slack: float) -> np.ndarray:
        inside = (u >= -slack) & (v >= -slack) & (u + v <= 1 + slack)
        return (inside & (t * length > -slack) & (t * length < length - 0.01 + slack)).any(axis=1)

    sure = hidden(1e-4) == hidden(-1e-4)
    assert sure.mean() > 0.98
    ours = MeshOccluders(corners.reshape(-1, 3), np.arange(450).reshape(-1, 3)).hidden(eyes, points)
    np.testing.assert_array_equal(ours[sure], hidden(0.0)[sure])
    assert 0.2 < ours.mean() < 0.95


@given(
    point=st.tuples(*[st.floats(-1.5, 1.5)] * 3),
    half=st.tuples(*[st.floats(0.1, 1.0)] * 3),
    turn=st.floats(-math.pi, math.pi),
    tilt=st.floats(-0.2, 0.2),
    headroom=st.floats(0.01, 1.0),
)
def test_a_box_with_headroom_hides_nothing_straight_above_it(point, half, turn, tilt, headroom) -> None:
    """Held against small steps straight down from the point, each asked whether it is in the box."""
    cos, sin, up, down = math.cos(turn), math.sin(turn), math.cos(tilt), math.sin(tilt)
    axes = np.array([[cos, 0, sin], [0, 1, 0], [-sin, 0, cos]]) @ np.array([[1, 0, 0], [0, up, -down], [0, down, up]])
    below = np.array(point) - np.linspace(0.0, headroom, 2001)[:, None] * [0.0, 1.0, 0.0]
    margins = (np.abs(below @ axes) - half).max(axis=1)
    if 0.005 < margins.min() < 0.015:
        return  # within the 1 cm of the surface that counts as touching, or close to it
    # From below and outside of the box, so that it stands in the way of what is above it.
    eyes = np.array([[0.0, -5.0, 0.0]])
    solid, frame = (BoxOccluders([[0, 0, 0]], [half], [axes], room) for room in (None, [headroom]))
    hidden = bool(solid.hidden(eyes, np.array([point]))[0])
    assert bool(frame.hidden(eyes, np.array([point]))[0]) == (hidden and margins.min() >= 0.01)


def test_rays_meet_the_plane_of_their_triangle_within_its_corners() -> None:
    rng = np.random.default_rng(8)
    triangles = rng.normal(size=(400, 3, 3))
    triangles[:50] *= [1.0, 0.0, 1.0]  # level, as the rays below: no intersection with the plane
    eyes, direction = rng.normal(size=(2, 400, 3))
    direction[:100, 1] = 0.0
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    for eye, way, corners, found in zip(
        eyes, direction, triangles, distances_to_hits(eyes, direction, triangles), strict=True
    ):
        a, b, c = corners
        normal = np.cross(b - a, c - a)
        along = (corners - eye) @ way
        facing = normal @ way
        plane = normal @ (a - eye) / facing if facing else along.max()
        assert found == pytest.approx(np.clip(plane, along.min(), along.max()), rel=1e-9, abs=1e-9)


# -- how large a thing appears -----------------------------------------------------------------------------------------


def on_a_sphere(azimuths, elevations) -> np.ndarray:
    """Points 1 m from the origin at these degrees: azimuth clockwise from -z, elevation upwards."""
    a, e = np.radians(azimuths), np.radians(elevations)
    return np.stack([np.sin(a) * np.cos(e), np.sin(e), -np.cos(a) * np.cos(e)], axis=1)


@given(
    middle=st.floats(-180.0, 180.0),
    azimuths=st.lists(st.floats(-89.0, 89.0), min_size=1, max_size=9),
    tilt=st.floats(-40.0, 40.0),
    eye=st.tuples(*[st.floats(-5.0, 5.0)] * 3),
)
def test_the_extent_is_the_rectangle_of_azimuth_and_elevation_in_any_direction(middle, azimuths, tilt, eye) -> None:
    """Also across the direction +z, where azimuths change their sign."""
    elevations = np.linspace(tilt - 3.0, tilt + 3.0, len(azimuths))
    samples = on_a_sphere(middle + np.array(azimuths), elevations)
    (found,) = visible_extent([eye], samples + np.array(eye), np.ones((1, len(samples))))
    wide = np.ptp(azimuths) * np.cos(np.radians(np.abs(elevations).min()))
    expected = sorted([wide, 6.0 if len(azimuths) > 1 else 0.0])
    np.testing.assert_allclose(found, expected, atol=1e-6)


def test_what_is_all_round_is_wide_and_what_is_hidden_does_not_count() -> None:
    ring = on_a_sphere(np.arange(0, 360, 10), np.zeros(36))
    seen = np.ones((3, 36), bool)
    seen[1, 5:] = False
    seen[2] = False
    np.testing.assert_allclose(visible_extent(np.zeros((3, 3)), ring, seen), [[0, 350], [0, 40], [0, 0]], atol=1e-9)
    assert visible_extent([[np.nan] * 3], ring, np.zeros((1, 36))).tolist() == [[0, 0]]


@given(hidden=st.sets(st.integers(0, 63)), eye=st.tuples(st.floats(-4.0, 4.0), st.just(1.25), st.floats(2.0, 9.0)))
def test_a_thing_that_is_partly_hidden_never_appears_larger(hidden, eye) -> None:
    """So an eye that would not recognise the whole thing needs no rays."""
    samples, seen = box_samples([0, 1, 0], [0.3, 0.5, 0.2]), np.ones((1, 64), bool)
    whole = visible_extent([eye], samples, seen)
    seen[0, list(hidden)] = False
    assert (visible_extent([eye], samples, seen) <= whole + 1e-9).all()


@pytest.mark.parametrize(
    ("extent", "count", "recognised"),
    [((2.5, 4.0), 5, True), ((2.4, 9.0), 5, False), ((3.0, 3.9), 5, False), ((9.0, 9.0), 4, False)],
)
def test_a_thing_is_recognised_if_enough_of_it_is_seen_and_that_is_large_enough(extent, count, recognised) -> None:
    rule = Recognition(View(), 0.05, 2.5, 4.0)
    assert rule.holds(np.arange(100)[None] < count, np.array([extent])).tolist() == [recognised]
