"""Points of surfaces and floors, and whose of them decide."""

from __future__ import annotations

import dataclasses
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import binom

from condvln.episodes.floor import floor_points
from condvln.episodes.goals import blocked_footprints, wide_islands
from condvln.episodes.view import SceneView
from condvln.navigation.occluders import BoxOccluders
from condvln.navigation.pathfinder import Pathfinder
from condvln.navigation.sight import View, in_view
from condvln.scene import OrientedBox, Room, Scene
from condvln.scene.geometry import STRUCTURE, SceneGeometry
from condvln.verify import sight as module
from condvln.verify.footprints import Obstacles
from condvln.verify.ground_points import ground_points
from condvln.verify.kernels.looking import in_front, in_range
from condvln.verify.proof import find_navmesh
from condvln.verify.sight import ODDS, OWN_POINTS, Eyes, Sight, _Points, evenly, much
from schemas.config import EpisodeConfig, PlacesConfig
from schemas.config.constants import FIRST_VIEW_DEGREES
from tests.condvln.episodes.floors import box, box_triangles, surfaces_of

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


def test_a_surface_without_area_has_points() -> None:
    assert (evenly(np.full((3, 3, 3), 2.0)) == 2.0).all()
    line = np.array([[[0, 0, 0], [1, 0, 0], [1, 0, 0]]], float)
    assert (evenly(line)[:, 1:] == 0).all()


@pytest.mark.parametrize("least", [0.02, LEAST, 0.2])
def test_much_is_what_chance_makes_once_in_a_million_looks(least: float) -> None:
    shown, few = np.arange(1, 1000) / 1000, int(np.ceil(least * OWN_POINTS))
    enough = round(much(least, OWN_POINTS) * OWN_POINTS)

    def odds(hits: int) -> float:
        return float((binom.cdf(few - 1, OWN_POINTS, shown) * binom.sf(hits - 1, OWN_POINTS, shown)).max())

    assert odds(enough) <= ODDS < odds(enough - 1)


def test_of_a_surface_nobody_can_contradict_little_or_all() -> None:
    assert much(0.0, OWN_POINTS) == 0.0
    assert much(1.0, OWN_POINTS) > 1.0


def seen(own: int, published: int) -> bool:
    where = _Points(np.zeros((128, 3)), 64, -1, LEAST)
    return where.is_seen(np.concatenate([np.arange(64) < own, np.arange(64) < published]))


def test_own_points_decide_where_they_are_sure_and_published_ones_between() -> None:
    enough = round(much(LEAST, 64) * 64)
    for own, published in product((0, 3, 4, enough - 1), (0, 3, 4, enough - 1)):
        assert seen(own, published) == (published >= 4), "neither is sure"
    assert all(seen(enough, published) for published in (0, 3, 64)), "points that miss what is in plain sight"
    assert not any(seen(own, published) for own in (0, 3) for published in (enough, 64)), "points of one visible spot"
    assert seen(4, 64)


def test_many_lines_together_are_judged_as_each_by_itself() -> None:
    draw = np.random.default_rng(4)
    for where in (_Points(np.zeros((128, 3)), 64, -1, LEAST), _Points(np.zeros((10, 3)), 0, -1, 0.8)):
        lines = draw.uniform(size=(300, len(where.points))) < draw.uniform(size=(300, 1)) ** 3
        lines[::3, : where.own] = draw.uniform(size=(100, where.own)) < 0.05
        found = where.are_seen(lines)
        assert found == [where.is_seen(line) for line in lines]
        assert len(set(found)) == 2


def test_floors_and_things_known_as_a_point_have_one_set_of_points() -> None:
    floor = _Points(np.zeros((10, 3)), 0, -1, 0.8)
    assert [floor.is_seen(np.arange(10) < count) for count in (0, 7, 8, 10)] == [False, False, True, True]
    point = _Points(np.zeros((1, 3)), 0, -1, LEAST)
    assert [point.is_seen(np.array([hit])) for hit in (False, True)] == [False, True]


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
    sought = [("thing", "chest"), ("thing", "vase"), ("floor", "r"), ("thing", "ghost"), ("floor", "cellar")]
    sight.look((one, EYE) for one in sought)
    sight.look((one, EYE) for one in sought)  # asked again, and cast once
    assert sight.approximate == (geometry is None or geometry.approximate)
    return {name: sight.is_seen((kind, name), EYE, yaw) for kind, name in sought}


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
    sight.look([(("thing", "counter"), eyes)])
    view = SceneView(scene)
    around = View(range=PlacesConfig().sight_range, pitch=FIRST_VIEW_DEGREES / 2)
    expected = view.seen(eyes.places, view.target("counter"), around).mean()
    assert sight.shares(("thing", "counter"), eyes)[-1] == round(float(expected), 3)


def test_many_walks_of_a_scene_keep_few_lines_of_sight(monkeypatch: pytest.MonkeyPatch) -> None:
    """What is forgotten is cast again, with the same answers."""

    def faced() -> tuple[list[bool], int]:
        none: Any = lambda item: False  # noqa: E731
        floor: Any = lambda room_id: np.empty((0, 3))  # noqa: E731
        sight = Sight(chest_and_vase(), None, none, none, floor, PlacesConfig(), EpisodeConfig())
        draw = np.random.default_rng(3)
        walks = [draw.uniform([-1, 1.2, -2], [5, 1.3, 2], (20, 3)) for _ in range(30)]
        found, most = [], 0
        for eyes in [*walks, *walks]:
            for name in ("chest", "vase"):
                found.append(sight.is_faced(("thing", name), eyes[:2], draw.uniform(0, 6, 2), 60.0))
                sight.is_faced(("thing", name), eyes, np.zeros(20), 60.0)
                most = max(most, sum(row.size for lines in sight._lines.values() for row in lines.seen.values()))
        return found, most

    unbounded, all_of_them = faced()
    monkeypatch.setattr(module, "LINES_KEPT", 10_000)
    bounded, few = faced()
    assert bounded == unbounded
    assert {True, False} <= {*bounded}
    # The bound, and the lines of the call that went over it.
    assert few <= 10_000 + 22 * 128 < all_of_them


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


@pytest.mark.parametrize("eyes", [1, 7, 40, 700])
def test_things_are_met_together_as_by_each_eye_alone(eyes: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Around a wall that hides a vase from half of the room, and all but the top of another one."""
    monkeypatch.setattr(module, "EYES_AT_ONCE", 16)
    monkeypatch.setattr(module, "RAYS_AT_ONCE", 512)
    wall = dataclasses.replace(box("wall", 1.0, 0.3, 0.2, 0.0, 2.0), object_id="wall", room_id="r")
    vase = dataclasses.replace(box("vase", 1.6, 0.0, 0.2, 0.5, 1.5), object_id="vase", room_id="r")
    lamp = dataclasses.replace(box("lamp", 1.6, 0.5, 0.2, 0.5, 2.5), object_id="lamp", room_id="r")
    scene = Scene("made", "flat", Path("."), (ROOM,), (wall, vase, lamp))
    nothing = np.empty((0, 3))
    sight = Sight(
        scene, None, lambda item: False, lambda item: False, lambda room_id: nothing, PlacesConfig(), EpisodeConfig()
    )
    rng = np.random.default_rng(eyes)
    places = rng.uniform([-1.0, 1.0, -1.0], [0.5, 1.4, 1.0], (eyes, 3))
    boxes = BoxOccluders.of_aabbs([x.box for x in scene.objects])
    things = [(x.object_id, sight.surface(x.object_id, 64 + 8 * k)) for k, x in enumerate(scene.objects)]
    shown = []
    for number, (_, points) in enumerate(things):
        lines = np.repeat(places, len(points), axis=0), np.tile(points, (eyes, 1))
        free = ~boxes.hidden(*lines, np.full(len(lines[0]), number))
        shown.append(int(free.reshape(eyes, -1).any(axis=0).sum()))
    assert 0 < shown[1] < 72
    for more in (-1, 0, 1):
        asked = [count + more for count in shown]
        assert sight.met(things, places, asked) == [more <= 0] * 3
    assert sight.met(things, places, [count + k % 2 for k, count in enumerate(shown)]) == [True, False, True]
    assert sight.met(things, places[:0], [1, 1, 1]) == [False] * 3


def test_kernels_look_as_the_arrays_of_all_pairs_say() -> None:
    """Bit for bit, also at the bounds of the view, for targets side by side, and for an eye without a place."""
    rng = np.random.default_rng(5)
    level, ahead = View(range=2.5, pitch=45.0), View(range=2.5, horizontal_fov=90.0, vertical_fov=90.0)
    eyes = [rng.integers(-2, 3, (n, 3)).astype(float) for n in (3, 1, 40)]
    points = [np.concatenate([rng.integers(-2, 3, (n, 3)), rng.normal(size=(n, 3))]) for n in (20, 64, 1)]
    eyes[2][0] = np.nan
    views = [level, View(range=2.5), level]
    expected = np.concatenate([in_view(*one).ravel() for one in zip(eyes, points, views, strict=True)])
    ends = [np.cumsum([len(one) for one in those]) for those in (eyes, points)]
    slopes = np.array([np.tan(np.radians(45.0)), np.inf, np.tan(np.radians(45.0))])
    pair, eye, point = in_range(np.concatenate(eyes), np.concatenate(points), *ends, slopes, 2.5)
    np.testing.assert_array_equal(pair, np.flatnonzero(expected))
    of = np.repeat(np.arange(3), [len(one) * len(its) for one, its in zip(eyes, points, strict=True)])[pair]
    np.testing.assert_array_equal(np.searchsorted(ends[0], eye, side="right"), of)
    np.testing.assert_array_equal(np.searchsorted(ends[1], point, side="right"), of)
    for yaw in (0.0, 0.7, -2.0, np.pi / 2):
        seen = in_front(eyes[0][0], points[1], float(np.sin(yaw)), float(np.cos(yaw)), 2.5, *[np.tan(np.pi / 4)] * 2)
        np.testing.assert_array_equal(seen, in_view(eyes[0][:1], points[1], ahead, [yaw])[0])
