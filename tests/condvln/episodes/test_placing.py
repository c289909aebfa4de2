"""Goal points and placements on a floor made here: every rule re-checked by code of the test's own."""

from __future__ import annotations

from dataclasses import replace
from itertools import combinations
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from condvln.episodes.candidates import REASONS
from condvln.episodes.goals import blocked_footprints, goal_points
from condvln.episodes.placing import Placement, Rejected
from condvln.episodes.view import SceneView
from condvln.navigation.pathfinder import Pathfinder
from condvln.scene import Room, Scene
from condvln.scene.scene import STRUCTURE
from schemas.config import EpisodeConfig, GoalsConfig, PlacesConfig
from schemas.program import Program
from tests.condvln.episodes.floors import (
    RULE,
    apartment,
    box,
    box_triangles,
    grid_floor,
    inside,
    placer_of,
    program,
    surfaces_of,
)

PLACES, GOALS, RULES = PlacesConfig(), GoalsConfig(), EpisodeConfig()


OBJECTS = (box("sofa", 1, 1), box("sink", 7, 1), box("lamp", 7, 5), box("bed", 1, 5), box("table", 4, 3))


@pytest.fixture(scope="module")
def flat() -> tuple[Scene, Pathfinder]:
    scene = apartment(*OBJECTS)
    return scene, grid_floor(8, 6, lambda x, z: any(inside(o, x, z) for o in OBJECTS))


def test_goal_points_stand_around_the_box(flat) -> None:
    scene, pathfinder = flat
    for item in OBJECTS:
        points = goal_points(item, scene.rooms[0], pathfinder, PLACES, GOALS)
        assert 4 <= len(points) <= GOALS.points
        outside = np.maximum(np.abs(points - item.center)[:, [0, 2]] - 0.3, 0)
        reach = np.hypot(*outside.T)
        assert reach.max() <= GOALS.reach
        assert (np.diff(reach) >= 0).all(), "nearest to the box first"
        assert all(pathfinder.is_navigable(p) for p in points)
        np.testing.assert_array_equal(points, np.round(points, 3))


@pytest.mark.parametrize(("reach", "at_most"), [(0.25, 0.6), (0.5, 1.0), (0.8, 1.5), (1.6, 1.6), (0.05, 0.06)])
def test_rings_fill_the_reach_that_is_asked_for(reach: float, at_most: float) -> None:
    sofa = box("sofa", 4, 3)
    scene, rules = apartment(sofa), GoalsConfig(reach=reach, reach_at_most=at_most, points=200)

    def farthest(blocked: float) -> float:
        """Distance from the box of the farthest goal point, where the floor is solid up to `blocked` around it."""

        def solid(x: float, z: float) -> bool:
            return max(abs(x - 4), abs(z - 3)) < 0.3 + blocked

        points = goal_points(sofa, scene.rooms[0], grid_floor(8, 6, solid), PLACES, rules)
        outside = np.maximum(np.abs(points - sofa.center)[:, [0, 2]] - 0.3, 0)
        return float(np.hypot(*outside.T).max(initial=0.0))

    assert 0.9 * reach <= farthest(0.0) <= reach
    beyond = farthest(reach + 0.15)
    assert beyond <= at_most
    if at_most - reach > 0.4:  # the floor is made of squares of 0.25 m
        assert beyond > reach


def test_goal_points_keep_to_one_side_of_a_wall() -> None:
    picture = box("picture", 3.8, 3, half=0.05, bottom=1.2, top=1.8)
    # A wall x ∈ [4, 4.25) with a doorway at the far end only: its other side is near the picture, but a long way round.
    pathfinder = grid_floor(8, 6, lambda x, z: 4 < x < 4.25 and z < 5.5)
    points = goal_points(picture, apartment(picture).rooms[0], pathfinder, PLACES, GOALS)
    assert len(points)
    assert (points[:, 0] <= 4.0).all()
    through = grid_floor(8, 6, lambda x, z: False)
    assert (goal_points(picture, apartment(picture).rooms[0], through, PLACES, GOALS)[:, 0] > 4.0).any()


def test_an_object_is_seen_from_its_goal_points() -> None:
    # A pillar so narrow that the way round it is short: only sight tells its sides apart.
    picture = box("picture", 3.95, 3, half=0.05, bottom=1.2, top=1.8)
    pathfinder = grid_floor(8, 6, lambda x, z: 4 < x < 4.25 and 2.75 < z < 3.25)
    scene = apartment(picture)
    pillar = box_triangles([4.005, 0, 2.5], [4.25, 2.5, 3.5])
    view = SceneView(scene, surfaces_of([(STRUCTURE, pillar), (0, box_triangles(*picture.aabb))]))
    around = goal_points(picture, scene.rooms[0], pathfinder, PLACES, GOALS)
    assert (around[:, 0] > 4.25).any()
    seeing = goal_points(picture, scene.rooms[0], pathfinder, PLACES, GOALS, sight=(view, RULE))
    assert len(seeing) >= 3
    assert (seeing[:, 0] <= 4.0).all()
    assert len({*map(tuple, seeing)} & {*map(tuple, around)}) >= 3


def test_a_pillow_is_reached_from_either_side_of_its_bed() -> None:
    # A bed against the wall z = 0; the pillow is in the middle of its head, so the way round is long.
    bed, pillow = box("bed", 4, 1.3, half=1.1, top=0.5), box("pillow", 4, 0.5, half=0.35, bottom=0.5, top=0.6)
    pathfinder = grid_floor(8, 6, lambda x, z: 2.9 <= x <= 5.1 and z <= 2.4)
    scene = apartment(bed, pillow)
    shapes = [(0, box_triangles(*bed.aabb)), (1, box_triangles(*pillow.aabb))]
    wall = (STRUCTURE, box_triangles([0, 0, -0.2], [8, 2.5, 0]))
    rules = GoalsConfig(reach=0.5, reach_at_most=1.5)

    def sides(faces: list[tuple[int, np.ndarray]]) -> tuple[bool, bool]:
        view = SceneView(scene, surfaces_of(faces, approximate=True))
        x = goal_points(pillow, scene.rooms[0], pathfinder, PLACES, rules, sight=(view, RULE))[:, 0]
        return bool((x < 4).any()), bool((x > 4).any())

    assert sides([*shapes, wall]) == (True, True)
    # Where no wall is known, the far side may be another room.
    assert sorted(sides(shapes)) == [False, True]


def test_what_stands_under_a_shelf_is_no_stop_where_the_shelf_hides_it() -> None:
    shoe = box("shoe", 4, 3, half=0.1, bottom=0.7, top=1.0)
    scene, pathfinder = apartment(shoe), grid_floor(8, 6, lambda x, z: inside(shoe, x, z))
    own = (0, box_triangles(*shoe.aabb))
    wide, narrow = ((STRUCTURE, box_triangles([4 - x, 1.1, 3 - x], [4 + x, 1.15, 3 + x])) for x in (1.2, 0.15))
    chest = (STRUCTURE, box_triangles([3.8, 0.6, 2.8], [4.2, 1.1, 3.2]))

    def points(*around: tuple[int, Any]) -> NDArray[np.float64]:
        view = SceneView(scene, surfaces_of([own, *around]))
        return goal_points(shoe, scene.rooms[0], pathfinder, PLACES, GOALS, sight=(view, RULE))

    assert len(points()) == len(points(narrow)) == GOALS.points
    assert not len(points(wide))
    assert not len(points(chest))


def test_a_thing_too_small_to_be_recognised_has_no_goal_points() -> None:
    pen, cup = box("pen", 4, 3, half=0.005, bottom=0.7, top=0.71), box("cup", 4, 3, half=0.04, bottom=0.7, top=0.8)
    for thing, count in ((pen, 0), (cup, GOALS.points)):
        scene, pathfinder = apartment(thing), grid_floor(8, 6, lambda x, z: inside(cup, x, z))
        view = SceneView(scene, surfaces_of([(0, box_triangles(*thing.aabb))]))
        assert len(goal_points(thing, scene.rooms[0], pathfinder, PLACES, GOALS, sight=(view, RULE))) == count


def test_an_object_in_the_middle_of_nothing_has_none(flat) -> None:
    scene, pathfinder = flat
    assert goal_points(box("moon", 40, 40), scene.rooms[0], pathfinder, PLACES, GOALS).shape == (0, 3)
    assert goal_points(box("chandelier", 4, 1, bottom=3, top=3.5), scene.rooms[0], pathfinder, PLACES, GOALS).shape == (
        0,
        3,
    )


def test_furniture_the_navmesh_ignores_is_found(flat) -> None:
    scene, pathfinder = flat
    assert blocked_footprints(scene, pathfinder, 0.2) == []
    rug = box("rug", 4, 1, half=0.8, top=0.02)
    shelf = box("shelf", 4, 5, half=0.4)
    picture = box("picture", 2.5, 3, bottom=1.2, top=1.8)
    fuller = apartment(*OBJECTS, rug, shelf, picture)
    found = blocked_footprints(fuller, pathfinder, 0.2)
    assert [item.object_id for item, _ in found] == ["shelf"]
    assert [item.object_id for item, _ in blocked_footprints(fuller, pathfinder, 0.01)] == ["rug", "shelf"]
    elsewhere = grid_floor(8, 6, lambda x, z: np.hypot(x - 4, z - 5) < 1.2)
    assert [item.object_id for item, _ in blocked_footprints(fuller, elsewhere, 0.2)] == [o.object_id for o in OBJECTS]


def check_walk(walk, start: np.ndarray, yaw: float, stops: np.ndarray, pathfinder: Pathfinder) -> None:
    """The actions replayed by the test's own kinematics end within 0.5 m of every stop in turn."""
    assert walk.actions[-1] == 0
    assert len(walk.locations) == int((walk.actions == 1).sum()) + 1
    at, heading, places = np.asarray(start, np.float32), yaw, [np.asarray(start, np.float32)]
    for action in walk.actions[:-1]:
        if action == 1:
            step = at + np.float32(0.25) * np.array([-np.sin(heading), 0, -np.cos(heading)], np.float32)
            at = pathfinder.try_step(at, step)
            places.append(at)
        else:
            heading += np.radians(15.0) if action == 2 else -np.radians(15.0)
    np.testing.assert_allclose(np.array(places), walk.locations, atol=2e-3)
    k = 0
    for place in places:
        if k < len(stops) and pathfinder.geodesic_distance(place, stops[k]) < 0.5:
            k += 1
    assert k == len(stops)
    assert pathfinder.geodesic_distance(at, stops[-1]) < 0.5


def recheck(placement: Placement, made: Program, pathfinder: Pathfinder, tau: float) -> None:
    """The rules of placement again, one by one, from the pathfinder alone."""
    low, high = RULES.distance_single_room

    def to_any(a: np.ndarray, points: np.ndarray) -> float:
        return min(pathfinder.geodesic_distance(a, p) for p in points)

    start = placement.start
    assert pathfinder.is_navigable(start)
    assert pathfinder.island_radius(start) >= PLACES.island_radius
    for leaf, placed in zip(made.leaves, placement.leaves, strict=True):
        assert placed.objects == tuple(m.object_id for m in leaf.moves)
        direct = to_any(start, placed.goals)
        assert low <= direct <= high
        assert placed.geodesic_distance == direct
        at, total = start, 0.0
        for stop in placed.route.stops:
            assert pathfinder.geodesic_distance(start, stop) > 2 * tau
            total += pathfinder.geodesic_distance(at, stop)
            at = stop
        assert placed.route.length == pytest.approx(total, abs=1e-6)
        assert pathfinder.geodesic_distance(start, placed.goals[0]) == placed.geodesic_distance
        before = placed.route.stops[-2] if len(placed.route.stops) > 1 else start
        ways = [pathfinder.geodesic_distance(before, point) for point in placed.goals]
        np.testing.assert_array_equal(placed.goals[int(np.argmin(ways))], placed.route.stops[-1])
        path = placed.route.path
        np.testing.assert_allclose(path[0], start, atol=1e-3)
        np.testing.assert_allclose(path[-1], placed.route.stops[-1], atol=1e-3)
        walked = np.linalg.norm(np.diff(path, axis=0), axis=1).sum()
        assert walked == pytest.approx(placed.route.length, abs=0.02)
        assert 2 * placed.steps <= RULES.max_steps
        check_walk(placed.walk, start, placement.yaw, placed.route.stops, pathfinder)
    for one, other in combinations(placement.leaves, 2):
        assert min(to_any(p, other.goals) for p in one.goals) >= 2 * tau + PLACES.leaf_gap
    for one in placement.leaves:
        for other in placement.leaves:
            if one is other:
                continue
            for a, b in zip(one.route.path[:-1], one.route.path[1:], strict=True):
                for t in np.linspace(0, 1, 25):
                    assert np.linalg.norm(a + t * (b - a) - other.goals, axis=1).min() >= tau


def test_every_rule_holds_for_every_leaf(flat) -> None:
    scene, pathfinder = flat
    placer = placer_of(scene, pathfinder)
    placed, reasons = 0, set()
    for made in (
        program(("sofa",), ("sink",)),
        program(("table", "sofa"), ("lamp",)),
        program(("sofa",), ("sink",), ("lamp",)),
        program(("bed",), ("table", "sink"), ("lamp",), ("sofa",)),
    ):
        for k in range(6):
            try:
                placement = placer.place(made, f"i{k}", compass=k % 2 == 0)
            except Rejected as rejected:
                reasons.add(rejected.reason)
                continue
            placed += 1
            recheck(placement, made, pathfinder, PLACES.success_distance_single_room)
            if k % 2 == 0:
                assert (np.degrees(placement.yaw) / 45) == pytest.approx(round(np.degrees(placement.yaw) / 45))
    assert placed >= 12
    assert reasons <= set(REASONS)


def test_stop_counts_against_the_step_ceiling(flat) -> None:
    scene, pathfinder = flat
    made = program(("sofa",), ("sink",))
    steps = max(leaf.steps for leaf in placer_of(scene, pathfinder).place(made, "i", compass=False).leaves)
    just = RULES.model_copy(update={"max_steps": 2 * steps})
    placement = placer_of(scene, pathfinder, just).place(made, "i", compass=False)
    assert max(leaf.steps for leaf in placement.leaves) == steps
    reasons = set()
    for ceiling in range(2 * steps - 2, 10, -2):
        tight = RULES.model_copy(update={"max_steps": ceiling})
        try:
            placement = placer_of(scene, pathfinder, tight).place(made, "i", compass=False)
        except Rejected as rejected:
            reasons.add(rejected.reason)
            break
        assert max(2 * leaf.steps for leaf in placement.leaves) <= ceiling
    assert reasons == {"over_step_budget"}


@pytest.mark.parametrize(
    ("objects", "leaves", "changed", "reason"),
    [
        (("a", "b", "far"), (("a",), ("far",)), {}, "object_without_goal_point"),
        (("a", "beside a"), (("a",), ("beside a",)), {}, "leaves_too_close"),
        (("a", "b", "beside b"), (("a",), ("beside b", "b")), {}, "moves_too_close"),
        (("a", "b"), (("a",), ("b",)), {"distance_single_room": (7.0, 10.0)}, "no_start_in_range"),
        (("a", "b"), (("a",), ("b",)), {"max_steps": 10}, "over_step_budget"),
        (("a", "b"), (("a",), ("b",)), {"island_radius": 50.0}, "no_start"),
    ],
)
def test_reasons(objects, leaves, changed, reason) -> None:
    places = {"a": (1, 1), "b": (7, 5), "beside a": (1.8, 1), "beside b": (7, 4.2), "far": (60, 60)}
    scene = apartment(*(box(name, *places[name]) for name in objects))
    pathfinder = grid_floor(8, 6, lambda x, z: any(inside(o, x, z) for o in scene.objects))
    rules = EpisodeConfig(**{k: v for k, v in changed.items() if k in EpisodeConfig.model_fields})
    stood = PlacesConfig(**{k: v for k, v in changed.items() if k in PlacesConfig.model_fields})
    placer = placer_of(scene, pathfinder, rules, stood, seed=0)
    with pytest.raises(Rejected) as caught:
        placer.place(program(*leaves), "i", compass=False)
    assert caught.value.reason == reason


def test_long_detours_are_refused_where_there_are_several_rooms() -> None:
    """A hall of 40 m with a at one end: from a start near c the way past a is much longer than the way to c."""
    objects = box("a", 1, 1), box("b", 38, 2), box("c", 20, 10)
    one = apartment(*objects)
    pathfinder = grid_floor(40, 12, lambda x, z: any(inside(o, x, z) for o in one.objects))
    room = Room("other", "kitchen", "kitchen", 0, 0.0, 2.5, None, "dataset", True)
    several = replace(one, rooms=(*one.rooms, room))
    assert one.single_room
    assert not several.single_room
    made, wide = program(("a", "c"), ("b",)), EpisodeConfig(distance=(2.0, 40.0), distance_single_room=(2.0, 40.0))
    for scene in (one, several):
        placer = placer_of(scene, pathfinder, wide, seed=0)
        lengths = []
        for k in range(12):
            leaf, _ = placer.place(made, f"{k}", compass=False).leaves
            lengths.append((leaf.route.length, leaf.geodesic_distance))
        kept = [route <= 2 * direct + 4 for route, direct in lengths]
        assert all(kept) == (scene is several)
    tight = wide.model_copy(update={"detour_factor": 1.0, "detour_slack": 0.5})
    with pytest.raises(Rejected) as caught:
        placer_of(several, pathfinder, tight, seed=0).place(made, "i", compass=False)
    assert caught.value.reason == "detour"


def test_a_corridor_past_one_leaf_to_the_other_is_refused() -> None:
    # Both objects stand along a corridor 0.75 m wide: whoever comes from the open end passes the first.
    scene = apartment(box("a", 3, 0.4, half=0.1, bottom=0.6), box("b", 6, 0.4, half=0.1, bottom=0.6))
    pathfinder = grid_floor(8, 2, lambda x, z: z > 0.75 and x > 1.5)
    placer = placer_of(scene, pathfinder, seed=0)
    with pytest.raises(Rejected) as caught:
        placer.place(program(("a",), ("b",)), "i", compass=False)
    assert caught.value.reason in {"path_enters_other_leaf", "no_start_in_range"}


def test_order_of_calls_changes_nothing(flat) -> None:
    scene, pathfinder = flat
    programs = [program(("sofa",), ("sink",)), program(("bed",), ("lamp",)), program(("table", "sofa"), ("lamp",))]
    one = placer_of(scene, pathfinder)
    other = placer_of(scene, pathfinder)
    first = [one.place(p, f"{k}", compass=False) for k, p in enumerate(programs)]
    second = [other.place(p, f"{k}", compass=False) for k, p in reversed(list(enumerate(programs)))][::-1]
    for a, b in zip(first, second, strict=True):
        np.testing.assert_array_equal(a.start, b.start)
        assert a.yaw == b.yaw
