"""Points of surfaces and floors, and whose of them decide."""

from __future__ import annotations

import dataclasses
import math
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.stats import binom

from condvln.episodes.floor import floor_points
from condvln.episodes.goals import blocked_footprints, wide_islands
from condvln.episodes.view import SceneView
from condvln.navigation.pathfinder import Pathfinder
from condvln.navigation.sight import Recognition, SightTarget, View, in_view, visible_extent
from condvln.scene import OrientedBox, Room, Scene
from condvln.scene.scene import STRUCTURE, SceneGeometry
from condvln.verify.footprints import Obstacles, ground_points
from condvln.verify.proof import find_navmesh
from condvln.verify.sight import (
    ODDS,
    OWN_POINTS,
    Eyes,
    Sight,
    evenly,
    in_front,
    in_range,
    much,
    rectangles,
)
from schemas.config import EpisodeConfig, PlacesConfig
from schemas.config.constants import LEVEL_CAMERA
from tests.condvln.episodes.floors import box, box_triangles, surfaces_of

F64 = NDArray[np.float64]
LEAST = 0.05


def square(side: float) -> np.ndarray:
    a, b, c, d = np.array([[0, 0, 0], [side, 0, 0], [side, 0, side], [0, 0, side]], float)
    return np.array([[a, b, c], [a, c, d]])


def test_points_lie_on_the_surface_and_as_many_on_equal_areas() -> None:
    points = evenly(square(2.0), 1024)
    assert (points[:, 1] == 0).all()
    assert ((points >= 0) & (points <= 2)).all()
    # Each of sixteen squares has its 64 of 1024, to within a few.
    counts, _, _ = np.histogram2d(points[:, 0], points[:, 2], bins=4, range=[[0, 2], [0, 2]])
    assert (np.abs(counts - 64) <= 9).all()
    pair = np.concatenate([square(1.0), square(3.0) + np.array([0.0, 5.0, 0.0])])
    assert (evenly(pair, 1000)[:, 1] == 0).sum() == 100


@pytest.mark.parametrize("least", [0.02, LEAST, 0.2])
def test_much_is_what_chance_makes_once_in_a_million_looks(least: float) -> None:
    shown, few = np.arange(1, 1000) / 1000, int(np.ceil(least * OWN_POINTS))
    enough = round(much(least, OWN_POINTS) * OWN_POINTS)

    def odds(hits: int) -> float:
        return float((binom.cdf(few - 1, OWN_POINTS, shown) * binom.sf(hits - 1, OWN_POINTS, shown)).max())

    assert odds(enough) <= ODDS < odds(enough - 1)


EYES: F64 = np.zeros((1, 3))
"""Two corners of a square of 2 m, 3 m ahead: 35° apart."""


@given(
    azimuths=st.lists(st.integers(-170, 170), min_size=1, max_size=6, unique=True),
    elevation=st.integers(-60, 60),
    hidden=st.sets(st.integers(0, 5)),
)
def test_the_rectangle_is_that_of_the_generator(azimuths: list[int], elevation: int, hidden: set[int]) -> None:
    a, e = np.radians(azimuths), np.radians(elevation + np.arange(len(azimuths)))
    points = np.stack([np.sin(a) * np.cos(e), np.sin(e), -np.cos(a) * np.cos(e)], axis=1) * 2.5
    mask = np.array([[k not in hidden for k in range(len(points))]])
    np.testing.assert_allclose(rectangles(EYES, points, mask), visible_extent(EYES, points, mask), atol=1e-9)


# -- looks: an eye at x = -1, a chest at x = 1, a vase behind it at x = 3 ---------------------------------------------

ROOM = Room("r", "kitchen", "kitchen", 0, 0.0, 2.5, None, "dataset", True)
EYE = Eyes(np.array([[-1.0, 0.5, 0.0]]))
WALL = (STRUCTURE, box_triangles((0.0, 0.0, -2.0), (0.01, 2.0, 2.0)))
FAR = (STRUCTURE, box_triangles((50.0, 0.0, 0.0), (51.0, 1.0, 1.0)))


def chest_and_vase() -> Scene:
    chest = dataclasses.replace(box("chest", 1.0, 0.0, half=0.5, top=1.0), object_id="chest", room_id="r")
    vase = dataclasses.replace(box("vase", 3.0, 0.0, half=0.1, top=0.9), object_id="vase", room_id="r")
    return Scene("made", "flat", Path("."), (ROOM,), (chest, vase))


def sees(
    geometry: SceneGeometry | None,
    structure: tuple[str, ...] = (),
    frames: tuple[str, ...] = (),
    yaw: float | None = None,
) -> dict[str, bool]:
    sight = Sight(
        chest_and_vase(),
        geometry,
        lambda item: item.object_id in structure,
        lambda item: item.object_id in frames,
        lambda room_id: np.array([[0.4, 0.05, 0.0], [0.4, 0.05, 1.0], [9.0, 0.05, 0.0], [-2.0, 0.05, 0.0]]),
        PlacesConfig(),
        EpisodeConfig(floor_seen=0.7),
    )
    sought = [("thing", "chest", 0.0), ("thing", "vase", 0.0), ("thing", "ghost", 0.0)]
    sought += [("floor", "r", 5.0), ("floor", "cellar", 5.0)]
    sight.look((one, EYE) for one in sought)
    sight.look((one, EYE) for one in sought)  # asked again, and cast once
    assert sight.approximate == (geometry is None or geometry.approximate)
    return {one[1]: sight.is_seen(one, EYE, yaw) for one in sought}


def overlapping_parts() -> st.SearchStrategy[tuple[OrientedBox, ...]]:
    """Boxes such as the arms of a counter, which meet, cross or hold each other."""
    numbers = st.integers(-4, 4).map(lambda number: number / 8)
    middle = st.tuples(numbers, numbers, numbers)
    half = st.tuples(*[st.integers(1, 4).map(lambda number: number / 8)] * 3)
    part = st.builds(lambda at, size: OrientedBox(np.array(at), np.array(size), np.eye(3)), middle, half)
    return st.lists(part, min_size=2, max_size=3).map(tuple)


@given(parts=overlapping_parts(), place=st.tuples(*[st.floats(-3.0, 3.0)] * 3))
def test_published_points_are_seen_as_the_generator_sees_them(
    parts: tuple[OrientedBox, ...], place: tuple[float, float, float]
) -> None:
    """A point where boxes of an object meet lies on the box that it was chosen from; the other boxes may hide it."""
    whole = dataclasses.replace(box("counter", 0.0, 0.0, half=1.0, top=1.0), object_id="counter", parts=parts)
    scene, eyes = Scene("made", "flat", Path("."), (), (whole,)), Eyes(np.array([place]))
    none: Any = lambda item: False  # noqa: E731
    sight = Sight(scene, None, none, none, lambda room_id: np.empty((0, 3)), PlacesConfig(), EpisodeConfig())
    sight.look([(("thing", "counter", 0.0), eyes)])
    view = SceneView(scene)
    around = View(range=PlacesConfig().sight_range, pitch=LEVEL_CAMERA[1] / 2)
    expected = view.seen(eyes.places, view.target("counter"), around).mean()
    assert sight.shares(("thing", "counter", 0.0), eyes)[-1] == round(float(expected), 3)


def test_frames_show_what_the_generator_s_level_camera_shows() -> None:
    """The first frame by which a thing is recognised in one, or a floor is seen in several together."""
    floor = np.stack(np.meshgrid(np.arange(-2, 6, 0.4), [0.05], np.arange(-3, 3, 0.4)), -1).reshape(-1, 3)
    none: Any = lambda item: False  # noqa: E731
    places, rules = PlacesConfig(), EpisodeConfig(floor_seen=0.5)
    scene = chest_and_vase()
    sight = Sight(scene, None, none, none, lambda room_id: floor, places, rules)
    view, rule = SceneView(scene), Recognition.of(places, rules)
    wide, high = LEVEL_CAMERA
    draw, found = np.random.default_rng(3), Counter[str]()
    for _ in range(200):
        eyes, yaws = draw.uniform([-1, 1.2, -2], [5, 1.3, 2], (8, 3)), draw.uniform(0, 6, 8)
        for name in ("chest", "vase", "r"):
            room = name == "r"
            target = SightTarget(floor) if room else view.target(name)
            assert target is not None
            camera = View(range=6.0 if room else places.sight_range, horizontal_fov=wide, vertical_fov=high)
            seen = view.seen(eyes, target, View(range=camera.range)) & in_view(eyes, target.samples, camera, yaws)
            if room:
                known = np.logical_or.accumulate(seen, axis=0).mean(axis=1) >= rules.floor_seen
            else:
                known = rule.holds(seen, visible_extent(eyes, target.samples, seen))
            expected = int(known.argmax()) if known.any() else None
            found[name] += expected is not None
            sought = ("floor", "r", 6.0) if room else ("thing", name, 0.0)
            assert sight.first_frame(sought, eyes, yaws) == expected
    assert min(found.values()) > 20, found
    assert max(found.values()) < 200, found


def test_boxes_hide_where_surfaces_are_not_known() -> None:
    assert sees(None) == {"chest": True, "vase": False, "r": True, "ghost": False, "cellar": False}
    assert sees(None, structure=("chest",))["vase"], "the box about a room's walls is no body"
    assert sees(surfaces_of([FAR], approximate=True)) == sees(None)


def test_drawn_walls_hide_and_exact_surfaces_alone_do() -> None:
    walled = sees(surfaces_of([WALL], approximate=True))
    assert walled == {"chest": False, "vase": False, "r": False, "ghost": False, "cellar": False}
    assert sees(surfaces_of([WALL])) == walled
    # Exact surfaces that hold no chest: it is looked for at its box, and hides nothing.
    assert sees(surfaces_of([FAR])) == {"chest": True, "vase": True, "r": True, "ghost": False, "cellar": False}
    scene = chest_and_vase()
    meshes = [(k, box_triangles(*item.aabb)) for k, item in enumerate(scene.objects)]
    assert sees(surfaces_of(meshes)) == sees(None)


def test_the_first_view_is_ahead() -> None:
    east, west = -np.pi / 2, np.pi / 2
    assert sees(None, yaw=east)["chest"]
    assert not sees(None, yaw=west)["chest"]
    # Of the four points of the floor three are in range, and one of these lies behind.
    assert not sees(None, yaw=east)["r"]


def test_floors_are_the_factory_s(made_export) -> None:
    places = PlacesConfig()
    kinds = set()
    for run in made_export.runs:
        scene = made_export.scenes[run.scene_id]
        pathfinder: Pathfinder = find_navmesh(scene, made_export.folder, run.rows[0].manifest.navmesh).pathfinder
        theirs = blocked_footprints(scene, pathfinder, 0.2)
        ours = Obstacles(scene, pathfinder, 0.2).grounds
        for room in scene.rooms:
            kinds.add(room.polygon is None)
            np.testing.assert_allclose(
                ground_points(scene, room, pathfinder, places.island_radius, ours),
                floor_points(scene, room, pathfinder, wide_islands(pathfinder, places), theirs),
                atol=1e-9,
            )
    assert kinds


def test_a_frame_hides_nothing_of_what_is_on_it() -> None:
    shelf = dataclasses.replace(box("shelf", 1.0, 0.0, 0.5, 0.0, 2.0), object_id="shelf", room_id="r")
    vase = dataclasses.replace(box("vase", 1.3, 0.0, 0.1, 2.02, 2.12), object_id="vase", room_id="r")
    scene = Scene("made", "flat", Path("."), (ROOM,), (shelf, vase))
    for frames, seen in (((), False), (("shelf",), True)):
        sight = Sight(
            scene,
            None,
            lambda item: False,
            lambda item, frames=frames: item.object_id in frames,
            lambda room_id: np.empty((0, 3)),
            PlacesConfig(),
            EpisodeConfig(),
        )
        assert sight.met([("vase", sight.surface("vase", 64))], np.array([[0.0, 1.25, 0.0]]), [1]) == [seen]


def test_views_are_those_of_the_generator() -> None:
    """Also at the bounds of the view, and for an eye without a place."""
    rng = np.random.default_rng(5)
    ahead = View(range=2.5, horizontal_fov=90.0, vertical_fov=90.0)
    eyes = rng.integers(-2, 3, (40, 3)).astype(float)
    points = np.concatenate([rng.integers(-2, 3, (64, 3)), rng.normal(size=(64, 3))])
    eyes[0] = np.nan
    for view, slope in ((View(range=2.5, pitch=45.0), np.tan(np.radians(45.0))), (View(range=2.5), np.inf)):
        np.testing.assert_array_equal(in_range(eyes, points, 2.5, slope), in_view(eyes, points, view))
    yaws = rng.choice([0.0, 0.7, -2.0, np.pi / 2], len(eyes))
    seen = in_front(eyes, points, yaws, 2.5, *[np.tan(np.pi / 4)] * 2)
    np.testing.assert_array_equal(seen, in_view(eyes, points, ahead, yaws))


@pytest.mark.parametrize("turns", range(8))
def test_points_exactly_on_the_border_of_a_view_are_inside(turns: int) -> None:
    """An agent that looks along a multiple of 45° has borders along the axes, on which corners of boxes lie exactly."""
    yaw = turns * math.pi / 4
    # The two borders of a view of 90°, in the exact directions of the axes and diagonals.
    steps = [(round(math.sin(step * math.pi / 4)), round(math.cos(step * math.pi / 4))) for step in range(8)]
    ways = np.array([steps[(turns + side) % 8] for side in (1, -1)], float)
    eye = np.array([-1.76, 1.35, -0.349])
    lengths = np.arange(1, 4000) / 1000.0
    offsets = np.concatenate([np.stack([-x * lengths, 0 * lengths, -z * lengths], 1) for x, z in ways])
    points = eye + offsets
    view = View(range=10.0, horizontal_fov=90.0, vertical_fov=90.0)
    assert in_view(eye[None], points, view, [yaw]).all()
    assert in_front(eye[None], points, np.array([yaw]), 10.0, 1.0, math.tan(math.pi / 4)).all()
