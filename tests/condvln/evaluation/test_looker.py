"""The agent that looks: no truth reaches it, it judges rightly what it sees whole, and its errors nest."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import get_args

import numpy as np
import pytest
import shapely
from scipy.sparse.csgraph import dijkstra
from shapely import Polygon
from typer.testing import CliRunner

from condvln.evaluation.looker import Looker, LookingAgent, read_text
from condvln.evaluation.looker.approach import approach
from condvln.evaluation.looker.exploring import Explorer, Here
from condvln.evaluation.looker.eyes import GHOST, LOOKUP_CELL, Eyes, Look, RoomLookup, SeenView
from condvln.evaluation.looker.floor_map import HALF, FloorMap, Ground, least_costs
from condvln.evaluation.looker.memory import GRAIN, Compared, Memory, Referents, Thing, _by_boxes, holds, ranked
from condvln.evaluation.scene_views import SceneViews
from condvln.evaluation.score import score
from condvln.evaluation.split import Export
from condvln.evaluation.walker import heading_of
from condvln.instructions import reading_of
from condvln.instructions.rendering import heading_name
from condvln.instructions.text_reading import Phrase, Place
from condvln.relations import relate_room, text_facts
from condvln.scene import RoomArrays, SceneObject
from jobs.command import app
from schemas.config import LookerConfig, NoiseConfig, Thresholds
from schemas.program import Predicate

T = Thresholds()


@pytest.fixture(scope="module")
def views(made: tuple[Export, Path]) -> SceneViews:
    return SceneViews({"replicacad": made[1]})


def test_it_walks_to_the_right_leaf_by_what_it_sees(made: tuple[Export, Path], views: SceneViews) -> None:
    agent = LookingAgent(views)
    tasks = [task for task in made[0].tasks("train") if task.axes["category"] == "simple"][:4]
    walks = {task: agent.walk(task, made[0].pathfinder(task)) for task in tasks}
    assert len(walks) == 4
    for task, walk in walks.items():
        # Its answers are those of the geometry, and each was asked for.
        assert walk.leaf == task.gold_leaf
        assert {k: task.program.conditions[k].truth for k in walk.verdicts} == walk.verdicts
        assert set(walk.verdicts) == set(task.program.route()[0])
        assert not walk.forced
    reached = [score(task, walk.prediction, made[0].pathfinder(task)).csr_all for task, walk in walks.items()]
    assert np.mean(reached) >= 0.75


def test_no_truth_reaches_it(made: tuple[Export, Path], views: SceneViews) -> None:
    agent = LookingAgent(views)
    for task in made[0].tasks("train")[:2]:
        flipped = tuple(
            condition.model_copy(update={"truth": not condition.truth, "witnesses": ()})
            for condition in task.program.conditions
        )
        other = replace(
            task,
            program=task.program.model_copy(update={"conditions": flipped}),
            gold_leaf=(task.gold_leaf + 1) % task.n_leaves,
            leaves=tuple(replace(leaf, goals=leaf.goals + 1, subgoals=leaf.subgoals + 1) for leaf in task.leaves),
            reference=task.reference[::-1],
            success_distance=9.0,
        )
        one, two = (agent(each, made[0].pathfinder(task), 3) for each in (task, other))
        np.testing.assert_array_equal(one.positions, two.positions)
        assert one.stopped == two.stopped


def test_it_reads_the_program_of_every_text(made: tuple[Export, Path]) -> None:
    for task in made[0].tasks("train"):
        read = read_text(task.text)
        assert replace(read, heading=None) == reading_of(task.program)
        if read.heading is not None:
            degrees = -math.degrees(2 * math.atan2(task.start_rotation[1], task.start_rotation[3])) % 360
            assert read.heading == heading_name(round(degrees, 3) % 360)


def test_greater_shares_of_errors_keep_the_errors_of_smaller_ones(made: tuple[Export, Path], views: SceneViews) -> None:
    task = made[0].tasks("train")[0]
    view = views(str(task.axes["scene"]))
    seen = {}
    for share in (0.0, 0.2, 0.5):
        noise = NoiseConfig(missed=share, confused=share, false=share)
        eyes = Eyes(view.scene, view.renderer, LookerConfig(noise=noise))
        eyes.begin(5, "episode")
        looks = [eyes(task.start, heading) for heading in (0.0, 0.4)]
        assert looks[0].things.keys() == looks[1].things.keys()
        seen[share] = {number: label for number, (label, _) in looks[0].things.items()}
    truth = seen[0.0]
    assert truth
    assert {number: view.scene.objects[number].label for number in truth} == truth
    missing = {share: set(truth) - set(found) for share, found in seen.items()}
    assert missing[0.0] <= missing[0.2] <= missing[0.5] != set()
    confused = {
        share: {n: label for n, label in found.items() if n in truth and label != truth[n]}
        for share, found in seen.items()
    }
    assert confused[0.5]
    # What is taken for something else stays so, unless it is missed.
    assert not confused[0.0]
    assert {n: confused[0.5][n] for n in confused[0.2] if n in seen[0.5]} == {
        n: label for n, label in confused[0.2].items() if n in seen[0.5]
    }
    ghosts = {share: {n for n in found if n >= GHOST} for share, found in seen.items()}
    assert ghosts[0.0] <= ghosts[0.2] <= ghosts[0.5] != set()


def surface(low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """Cubes of the surface of a box, as `Thing` keeps them."""
    axes = [np.arange(round(a / GRAIN), round(b / GRAIN)) for a, b in zip(low, high, strict=True)]
    grid = np.stack([axis.ravel() for axis in np.meshgrid(*axes, indexing="ij")], axis=1)
    ends = np.array([[axis[0], axis[-1]] for axis in axes])
    outside = ((grid == ends[:, 0]) | (grid == ends[:, 1])).any(axis=1)
    cells = grid[outside] + (1 << 13)
    return np.sort((cells[:, 0] * (1 << 14) + cells[:, 1]) * (1 << 14) + cells[:, 2])


def test_judgement_is_that_of_the_geometry_where_all_is_seen() -> None:
    rng = np.random.default_rng(4)
    decided: dict[str, set[int]] = {}
    for _ in range(16):
        low = rng.integers(0, 110, (6, 3)) * [1, 0.2, 1] // 1 * GRAIN
        low[:3, 1] = 0
        high = low + rng.integers(3, 22, (6, 3)) * GRAIN
        objects = [
            SceneObject(f"o{k}", "r", "x", "x", center=(a + b) / 2, aabb=np.array([a, b]))
            for k, (a, b) in enumerate(zip(low, high, strict=True))
        ]
        arrays = RoomArrays.of("r", objects, 0.0)
        facts = text_facts(relate_room(arrays, T), T)
        things = [Thing(k, "x", 0, surface(a, b), 1.0, 0) for k, (a, b) in enumerate(zip(low, high, strict=True))]
        predicates = ("near", "far from", "north of", "south-east of", "west of", "higher than", "lower than")
        for predicate in predicates:
            status = facts.status[predicate]
            for i, j in zip(*np.nonzero(status), strict=True):
                sure = holds(predicate, things[i], [things[j]], 0.0, T)
                assert (sure > 0) == (status[i, j] == 1), (predicate, low[[i, j]], high[[i, j]], sure)
                decided.setdefault(predicate, set()).add(int(status[i, j]))
    assert all(found == {1, -1} for found in decided.values()), decided
    assert len(decided) == len(predicates)


@pytest.mark.parametrize("predicate", get_args(Predicate))
def test_every_predicate_has_a_measure(predicate: Predicate) -> None:
    """Every object at hand is judged; an unknown predicate has no bounds to be judged by."""
    low = np.array([[0.0, 0, 0], [2, 0, 0], [4, 0, 0]])
    things = [Thing(k, "x", 0, surface(a, a + 0.5 * (k + 1)), 1.0, 0) for k, a in enumerate(low)]
    if predicate in Compared:
        assert ranked(predicate, things[:2], things[2:])
    else:
        assert np.isfinite(holds(predicate, things[1], [things[0], things[2]], 0.0, T))


def test_what_has_no_measure_of_its_own_is_judged_by_the_boxes_of_what_is_seen() -> None:
    rng, decided = np.random.default_rng(4), set()
    for room in (40, 160) * 8:
        low = rng.integers(0, (room, 40, room), (6, 3)) * GRAIN
        high = low + rng.integers(3, 22, (6, 3)) * GRAIN
        boxes = [*zip(low, high, strict=True)]
        objects = [SceneObject(f"o{k}", "", "", "", (a + b) / 2, np.array([a, b])) for k, (a, b) in enumerate(boxes)]
        facts = text_facts(relate_room(RoomArrays.of("", objects, 0.0), T), T)
        things = [Thing(k, "x", 0, surface(a, b), 1.0, 0) for k, (a, b) in enumerate(boxes)]
        for predicate in ("near", "far from", "higher than", "lower than", "above", "below"):
            status = facts.status[predicate]
            for i, j in zip(*np.nonzero(status), strict=True):
                spare = _by_boxes(predicate, things[i], things[j], T)
                assert spare >= -1e-6 if status[i, j] == 1 else spare < 0, (predicate, boxes[i], boxes[j])
                decided.add((predicate, int(status[i, j])))
    assert len(decided) == 12


def test_directions_count_from_north_as_the_text_said() -> None:
    east = Thing(0, "x", 0, surface(np.array([1.0, 0, -0.2]), np.array([1.4, 0.4, 0.2])), 1.0, 0)
    middle = Thing(1, "x", 0, surface(np.array([-0.2, 0, -0.2]), np.array([0.2, 0.4, 0.2])), 1.0, 0)
    # What is to the right of one who faces north-east is to the south-east.
    assert holds("south-east of", east, [middle], 45.0, T) > 20
    assert holds("east of", east, [middle], 0.0, T) > 20
    assert holds("west of", east, [middle], 180.0, T) > 20
    assert holds("right", east, [], None, T) == pytest.approx(45, abs=0.1)
    assert holds("left", east, [], None, T) < 0


def test_ways_are_those_of_dijkstra() -> None:
    rng = np.random.default_rng(0)
    for _ in range(5):
        cost = np.where(rng.random((14, 17)) < 0.3, np.inf, rng.choice([1.0, 1.5, 6.0], (14, 17))).astype(np.float32)
        cost[3, 4] = 1.0
        graph = np.zeros((cost.size, cost.size))
        for a in range(14):
            for b in range(17):
                for p, q in ((a + i, b + j) for i in (-1, 0, 1) for j in (-1, 0, 1) if i or j):
                    if not (0 <= p < 14 and 0 <= q < 17 and np.isfinite(cost[p, q]) and np.isfinite(cost[a, b])):
                        continue
                    straight = a == p or b == q
                    start = (a, b) == (3, 4)
                    if straight or start or (np.isfinite(cost[a, q]) and np.isfinite(cost[p, b])):
                        graph[a * 17 + b, p * 17 + q] = cost[p, q] * (1 if straight else math.sqrt(2))
        distance, before = least_costs(cost, 3 * 17 + 4)
        distance = distance.ravel()
        np.testing.assert_allclose(distance, dijkstra(graph, indices=3 * 17 + 4), rtol=1e-5)
        assert ((before >= 0) == (np.isfinite(distance) & (np.arange(cost.size) != 3 * 17 + 4))).all()


def view_of(depth: np.ndarray, room: int) -> Look:
    """A look in one direction at an angle of view of 90°, all of whose points are in one room."""
    rays = (2 * np.arange(len(depth)) + 1 - len(depth)) / len(depth)
    rooms = np.full(depth.shape, room, np.int16)
    view = SeenView(depth.astype(np.float32), rooms, rays, -rays, 0.0, 1.25)
    return Look((view,), np.zeros((0, 3)), np.zeros(0, np.int64), {}, {}, room)


def test_a_wall_ahead_is_where_it_is() -> None:
    """A flat wall 2 m ahead of an agent that faces along +x."""
    n = 64
    rows = -(2 * np.arange(n) + 1 - n) / n
    with np.errstate(divide="ignore"):
        floor = np.where(rows < 0, 1.25 / -rows, np.inf)
    own = FloorMap()
    own.add(view_of(np.minimum(np.full((n, n), 2.0), floor[:, None]), 7), 0.0, 0.0, -math.pi / 2, 10.0)
    ground = own.ground(0.0, 0.0)
    np.testing.assert_array_equal(ground.tall, ground.shut)
    wall = ground.places(*np.nonzero(ground.shut))
    assert wall[:, 0] == pytest.approx(np.full(len(wall), 2.05), abs=0.11)
    assert (wall[:, 1].min(), wall[:, 1].max()) == pytest.approx((-1.95, 1.95))
    inside = ground.places(*np.nonzero(~ground.unseen & ~ground.shut))
    # Open floor is a triangle before the wall, as wide as it is far.
    assert (np.abs(inside[:, 1]) <= np.abs(inside[:, 0]) + 0.1 + 1e-9).all()
    middle = np.array([0.0, 0.05])
    ahead = [ground.cell(x, middle[1]) for x in np.arange(0.15, 1.8, 0.1)]
    assert not any(ground.unseen[cell] or ground.shut[cell] for cell in ahead)
    assert not ground.open_between(middle, np.array([3.5, 0.05]), among=ground.shut)
    assert ground.open_between(middle, np.array([1.9, 0.05]), among=ground.shut)
    assert set(ground.region[~ground.unseen].tolist()) == {7}


def floor_with_a_bed(unseen_left: bool) -> Ground:
    """4 × 4 m of floor around the start with a bed of 1.6 × 2 m, whose left side may be unseen."""
    size = 40
    shut, unseen = np.zeros((size, size), bool), np.zeros((size, size), bool)
    shut[12:28, :20] = True
    shut[0], shut[-1], shut[:, 0], shut[:, -1] = True, True, True, True
    if unseen_left:
        unseen[1:12, 1:20] = True
    passable = ~(shut | unseen)
    cost = np.where(passable, 1.0, np.inf).astype(np.float32)
    tall = shut.copy()
    tall[12:28, 1:20] = False
    room = np.zeros((size, size), np.int16)
    near = np.where(unseen, np.inf, 1.0).astype(np.float32)
    corner = (HALF - 20, HALF - 20)
    return Ground(corner, passable, cost, shut, tall, unseen, np.zeros_like(shut), room, room, near)


def pillow(left: float) -> Thing:
    """A pillow of 0.3 × 0.3 m at the head of that bed."""
    low = np.array([left, 0.5, -1.8])
    return Thing(3, "pillow", 0, surface(low, low + np.array([0.3, 0.1, 0.3])), 1.0, 0)


def test_it_stops_on_the_side_where_it_comes_from() -> None:
    ground = floor_with_a_bed(unseen_left=False)
    for x in (-1.5, 1.5):
        found = approach(pillow(-0.15), ground, ground.ways_from(x, 1.5), np.array([x, 1.5]))
        assert found.final
        assert np.sign(found.place[0]) == np.sign(x)
        # Over a low bed it sees the pillow; nothing nearer to it can be entered.
        assert abs(found.place[0]) == pytest.approx(0.85, abs=0.21)


def test_it_looks_at_the_unseen_side_of_a_bed_before_it_stops() -> None:
    thing = pillow(-0.6)
    here = np.array([1.5, 1.5])
    ground = floor_with_a_bed(unseen_left=True)
    found = approach(thing, ground, ground.ways_from(*here), here)
    assert not found.final
    assert found.place[0] < -0.8
    # What it has looked at in vain, or may look at no more, it takes as it is.
    for looked in ([found.place], None):
        given = approach(thing, ground, ground.ways_from(*here), here, looked=looked)
        assert given.final
    seen = floor_with_a_bed(unseen_left=False)
    found = approach(thing, seen, seen.ways_from(*here), here)
    assert found.final
    assert found.place[0] < -0.8
    # A place that could not be reached is not tried again.
    other = approach(thing, seen, seen.ways_from(*here), here, given_up=[found.place])
    assert np.hypot(*(other.place - found.place)) > 0.3


def test_it_looks_for_a_nearer_place_where_the_known_one_is_barely_near_enough() -> None:
    ground = floor_with_a_bed(unseen_left=False)
    ground.unseen[16:28, 20:26] = True
    ground.passable[16:28, 20:26] = False
    ground.cost[16:28, 20:26] = np.inf
    low = np.array([0.1, 0.5, -0.5])
    thing = Thing(3, "pillow", 0, surface(low, low + np.array([0.3, 0.1, 0.3])), 1.0, 0)
    here = np.array([1.5, -1.0])
    found = approach(thing, ground, ground.ways_from(*here), here)
    assert not found.final
    found = approach(thing, ground, ground.ways_from(*here), here, looked=None)
    assert found.final
    assert found.place[0] > 0.8


def test_a_place_to_look_from_can_be_reached() -> None:
    thing = pillow(-0.6)
    here = np.array([1.5, 1.5])
    looked_from = 0
    for seed in range(40):
        ground = floor_with_a_bed(unseen_left=False)
        hidden = np.random.default_rng(seed).uniform(size=ground.shut.shape) < 0.35
        hidden[:, 30:] = False
        ground.unseen[hidden & ~ground.shut] = True
        ground.passable[ground.unseen] = False
        ground.cost[ground.unseen] = np.inf
        known_ways = ground.ways_from(*here)
        found = approach(thing, ground, known_ways, here)
        if found is not None and not found.final:
            looked_from += 1
            assert np.isfinite(known_ways.distance[ground.cell(*found.place.tolist())])
    assert looked_from > 10


def test_it_goes_nearer_to_a_thing_that_it_sees_from_afar() -> None:
    ground, here = two_ways_on()
    sink = Phrase("sink")
    far = Thing(0, "sink", 1, surface(np.array([5.0, 0.5, -0.1]), np.array([5.2, 0.7, 0.1])), 4.0, 0)
    assert approach(far, ground, here.ways, here.place) is None
    explorer = Explorer(Referents(Memory(), None, 3.0), 3.0)
    place = explorer.nearer(far, sink, here)
    np.testing.assert_allclose(place, [1.45, 0.0], atol=0.06)
    there = Here(place, 0.0, ground, ground.ways_from(*place.tolist()))
    # There, only what it has not seen yet can help; and it goes there only once.
    for pose in (there, here):
        onward = explorer.nearer(far, sink, pose)
        assert ground.frontier[ground.cell(*onward.tolist())]
        explorer.give_up(place)
    ground.frontier[:] = ground.unseen[:] = False
    assert explorer.nearer(far, sink, there) is None


def test_it_goes_round_to_the_room_of_a_thing_that_it_sees_but_can_not_come_near() -> None:
    """A wall without a door is between it and a sink close to the wall; unseen floor is at the left."""
    ground, _ = two_ways_on()
    ground.shut[20] = ground.tall[20] = True
    ground.passable[19:22] = False
    ground.cost[19:22] = np.inf
    pose = np.array([-0.6, 0.0])
    here = Here(pose, 0.0, ground, ground.ways_from(*pose))
    sink = Thing(0, "sink", 1, surface(np.array([1.9, 0.5, -0.1]), np.array([2.1, 0.7, 0.1])), 2.5, 0)
    memory = Memory()
    memory.rooms.update({0: "living room", 1: "kitchen"})
    explorer = Explorer(Referents(memory, None, 3.0), 3.0)
    place = explorer.nearer(sink, Phrase("sink", room=Place("kitchen")), here)
    np.testing.assert_allclose(place[0], -1.65, atol=0.06)  # not to the wall, which is nearer to the sink


def test_it_does_not_stop_behind_the_wall_on_which_a_thing_hangs() -> None:
    """Beside a wall, cells behind it may have the number of the room before it."""
    ground = floor_with_a_bed(unseen_left=False)
    ground.shut[1:39, 1:39] = ground.tall[1:39, 1:39] = False
    ground.shut[20] = ground.tall[20] = True
    ground.passable[1:39, 1:39] = True
    ground.passable[20] = False
    ground.cost[:] = np.where(ground.passable, 1.0, np.inf)
    ground.passable[30:, 1:3] = False
    ground.region[:20], ground.region[20:] = 0, 1
    ground.region[21, 18] = 0
    painting = Thing(0, "painting", 0, surface(np.array([-0.1, 1.3, -0.5]), np.array([-0.05, 1.8, 0.0])), 1.5, 0)
    behind = np.array([0.5, -0.15])
    assert approach(painting, ground, ground.ways_from(*behind), behind) is None
    before = np.array([-1.0, -0.15])
    found = approach(painting, ground, ground.ways_from(*before), before)
    assert found.place[0] < 0


def two_ways_on() -> tuple[Ground, Here]:
    """The start is in the middle of 4 × 4 m of floor with unseen floor on the left, 1.7 m away, and on the right, 1.5 m
    away.
    """
    ground = floor_with_a_bed(unseen_left=False)
    for mask in (ground.shut, ground.tall):
        mask[:] = False
    ground.unseen[:3] = ground.unseen[35:] = True
    ground.passable[:] = ~ground.unseen
    ground.cost[:] = np.where(ground.unseen, np.inf, 1.0)
    ground.frontier[3] = ground.frontier[34] = True
    ground.region[:20], ground.region[20:] = 0, 1
    pose = np.array([0.0, 0.0])
    return ground, Here(pose, 0.0, ground, ground.ways_from(*pose))


def test_floor_beside_a_wall_is_not_taken_for_that_of_the_room_behind(
    made: tuple[Export, Path], views: SceneViews
) -> None:
    scene = views(str(made[0].tasks("train")[0].axes["scene"])).scene
    lookup = RoomLookup(scene)
    rooms = [(k, Polygon(room.polygon)) for k, room in enumerate(scene.rooms) if room.polygon is not None]
    assert len(rooms) > 2
    floor = scene.rooms[0].floor_y
    corners = np.concatenate([room.polygon for room in scene.rooms if room.polygon is not None])
    flat = np.random.default_rng(3).uniform(corners.min(axis=0), corners.max(axis=0), (4000, 2))
    points = np.insert(flat, 1, floor, axis=1)
    exact, inner = lookup(points, floor), lookup(points, floor, inner=True)
    assert set(inner.tolist()) == {-1, *(k for k, _ in rooms)}
    beside = np.zeros(len(points), int)
    for number, found, point in zip(exact.tolist(), inner.tolist(), shapely.points(flat), strict=True):
        away = min((room.distance(point) for k, room in rooms if k != number), default=math.inf)
        if away < LOOKUP_CELL / 2:
            assert found == -1
            beside[0] += 1
        elif away > 3 * LOOKUP_CELL:
            assert found == number
            beside[1] += 1
    assert beside[0] > 50
    assert beside[1] > 1000


def test_what_is_known_of_a_cell_s_room_stays_where_a_view_does_not_tell() -> None:
    axis = np.arange(-2.95, 3.0, 0.1)
    floor = np.stack([grid.ravel() for grid in np.meshgrid(axis, axis)], axis=1)
    own = FloorMap()
    own.reveal(floor, np.full(len(floor), 3, np.int16))
    for room, known in ((-1, {3}), (5, {3, 5})):
        own.add(view_of(np.full((8, 8), 1.5), room), 0.0, 0.0, 0.0, 10.0)
        assert set(own.ground(0.0, 0.0).region.ravel().tolist()) - {-1} == known


def test_it_guesses_nothing_about_a_room_that_it_has_not_found(made: tuple[Export, Path], views: SceneViews) -> None:
    for task in made[0].tasks("train"):
        view = views(str(task.axes["scene"]))
        eyes = Eyes(view.scene, view.renderer, LookerConfig())
        eyes.begin(0, "")
        look = eyes(task.start, heading_of(task.start_rotation))
        first = task.program.conditions[task.program.branches[0].condition]
        if first.room.label not in look.rooms.values():
            break
    else:
        pytest.fail("each first condition is about a room in view")
    looker = Looker(task.text, 500, LookerConfig(patience=0.0))
    looker.act(np.zeros(3), 0.0, lambda: look, False)
    assert not looker.verdicts


def test_the_command_walks_it_with_errors_and_refuses_what_it_cannot_read(
    made: tuple[Export, Path], tmp_path: Path
) -> None:
    runner = CliRunner()
    manifest = tmp_path / "export" / "manifest" / "train.jsonl"
    manifest.parent.mkdir(parents=True)
    rows = (made[0].folder / "manifest" / "train.jsonl").read_bytes().splitlines(keepends=True)
    manifest.write_bytes(b"".join(rows[::5]))
    words = ["walk", str(tmp_path / "export"), "train", "--agent", "looker", "--out", str(tmp_path / "looker.json")]
    for wrong in (
        [],
        ["--scenes", "replicacad"],
        ["--scenes", f"replicacad={made[1]}", "--looker", "noise.missed=2"],
        ["--scenes", f"replicacad={made[1]}", "--looker", "colour=red"],
        ["--scenes", f"replicacad={made[1]}", "--looker", "noise"],
    ):
        assert runner.invoke(app, [*words, *wrong]).exit_code == 1
    result = runner.invoke(
        app, [*words, "--scenes", f"replicacad={made[1]}", "--looker", "noise.missed=1", "--looker", "patience=0.1"]
    )
    assert result.exit_code == 0, result.output
    assert f"{len(rows[::5])} predictions of looker" in result.output
