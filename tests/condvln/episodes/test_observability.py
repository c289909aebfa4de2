"""Two rooms and a wall between them: what is seen from where follows from the plan."""

from __future__ import annotations

import dataclasses
import math
from pathlib import Path

import numpy as np
import pytest
import shapely
from hypothesis import given
from hypothesis import strategies as st

from condvln.episodes.floor import floor_points
from condvln.episodes.footprint import Footprint
from condvln.episodes.observability import Observation, Observer, common_prefix
from condvln.episodes.placing import Outlook
from condvln.episodes.view import SceneView
from condvln.navigation.pathfinder import Pathfinder
from condvln.navigation.sight import View, eyes_at
from condvln.samples import make_samples
from condvln.scene import Room, Scene, SceneObject
from condvln.scene.scene import STRUCTURE, SceneGeometry
from condvln.sources.registry import open_source
from condvln.sources.scene_source import Source
from schemas.config import EpisodeConfig, PlacesConfig
from schemas.config.constants import FLOOR_LIFT, FLOOR_POINTS, PREFIX_STRAY
from schemas.program import SHAPES, Anchor, Condition, Leaf, ObjectRef, Program, Qualifier, RoomRef
from tests.condvln.episodes.floors import box, box_triangles, grid_floor, inside, surfaces_of

PLACES, RULES = PlacesConfig(), EpisodeConfig()
WEST, EAST = RoomRef(room_id="west", label="kitchen"), RoomRef(room_id="east", label="bedroom")
# The wall stands at x = 4 and leaves a doorway from z = 3 to z = 4.
WALL = np.array([[4, 0, 0], [4, 0, 3], [4, 2.5, 3], [4, 2.5, 0]], float)
FLOOR = np.array([[0, 0, 0], [8, 0, 0], [8, 0, 4], [0, 0, 4]], float)


def thing(name: str, room: str, x: float, z: float, **shape: float) -> SceneObject:
    return dataclasses.replace(box(name.split("/")[0], x, z, **{"half": 0.2, **shape}), object_id=name, room_id=room)


OBJECTS = (
    thing("lamp", "west", 1, 1),
    thing("table", "west", 3, 1),
    thing("vase", "east", 5, 1),
    thing("bed", "east", 7, 1),
)


def two_rooms(*objects: SceneObject) -> Scene:
    rooms = [
        Room(name, label, label, 0, 0.0, 2.5, np.array([[x, 0], [x + 4, 0], [x + 4, 4], [x, 4.0]]), "dataset", True)
        for name, label, x in (("west", "kitchen", 0.0), ("east", "bedroom", 4.0))
    ]
    return Scene("made", "flat", Path("."), tuple(rooms), objects or OBJECTS)


def surfaces(scene: Scene, *, approximate: bool) -> SceneGeometry:
    """The wall and the floor, and every object's box as twelve triangles."""
    parts = [(STRUCTURE, (corners, np.array([[0, 1, 2], [0, 2, 3]]))) for corners in (WALL, FLOOR)]
    parts += [(k, box_triangles(*item.aabb)) for k, item in enumerate(scene.objects)]
    return surfaces_of(parts, approximate)


def floor_of(scene: Scene) -> Pathfinder:
    def solid(x: float, z: float) -> bool:
        return (abs(x - 4) < 0.125 and z < 3) or any(inside(o, x, z) for o in scene.objects)

    return grid_floor(8, 4, solid)


def present(label: str, room: RoomRef, *witnesses: str, near: str | None = None) -> Condition:
    qualifier = None if near is None else Qualifier(predicate="near", anchors=(Anchor(object_id=near, label=near),))
    return Condition(label=label, room=room, qualifier=qualifier, truth=bool(witnesses), witnesses=witnesses)


def asking(*conditions: Condition) -> Program:
    category = ("simple", "nested", "deep_nested")[len(conditions) - 1]
    leaves = [Leaf(moves=(ObjectRef(object_id=f"leaf {k}", label="x", room=WEST),)) for k in range(len(conditions) + 1)]
    return Program(category=category, conditions=conditions, branches=SHAPES[category].branches, leaves=tuple(leaves))


def ways(*paths: list[list[float]], yaw: float = 0.0) -> Outlook:
    """Leaves that are reached along these (x, z) corners, all from the first of the first."""
    corners = tuple(np.array([[x, 0.0, z] for x, z in path]) for path in paths)
    return Outlook(corners[0][0], yaw, corners)


def observed(
    program: Program,
    placement: Outlook,
    *objects: SceneObject,
    geometry: str = "exact",
    rules: EpisodeConfig = RULES,
) -> Observation:
    scene = two_rooms(*objects)
    known = None if geometry == "none" else surfaces(scene, approximate=geometry == "approximate")
    observer = Observer(scene, SceneView(scene, known), floor_of(scene), PLACES, rules)
    return observer.observe(program, placement)


STAYING = ways([[2, 2], [2, 3.5], [3, 3.5]], [[2, 2], [1, 2.5]])
INTO_THE_EAST = ways([[2, 3.5], [6, 3.5], [7, 2]], [[2, 3.5], [6, 3.5], [5.5, 2]])
SURFACES = pytest.mark.parametrize("geometry", ["exact", "approximate"])


@SURFACES
def test_from_the_start_on_the_way_or_only_by_a_detour(geometry) -> None:
    def level(condition: Condition, placement: Outlook) -> str:
        return observed(asking(condition), placement, geometry=geometry).observability

    assert level(present("lamp", WEST, "lamp"), STAYING) == "O0"
    assert level(present("vase", EAST, "vase"), STAYING) == "O2"
    assert level(present("vase", EAST, "vase"), INTO_THE_EAST) == "O1"
    # Absence: all of the near room is seen from its middle, of the far one only from within.
    assert level(present("sofa", WEST), STAYING) == "O0"
    assert level(present("sofa", EAST), STAYING) == "O2"
    assert level(present("sofa", EAST), INTO_THE_EAST) == "O1"


@SURFACES
def test_a_thing_at_the_feet_is_seen_from_farther_away_only(geometry) -> None:
    """No level camera sees it from the start, 66° below the eye; 1.9 m away it is 31° below."""
    boots = thing("boots", "west", 2, 1.5, half=0.1, top=0.1)
    away = ways([[2, 2], [2, 3.5], [3, 3.5]], [[2, 2], [2, 3.5], [1, 3.5]])
    there = asking(present("boots", WEST, "boots"))
    assert observed(there, away, boots, geometry=geometry).observability == "O1"
    # The floor at its feet hides nothing: absence is known at once.
    assert observed(asking(present("sofa", WEST)), away, boots, geometry=geometry).observability == "O0"


@SURFACES
@pytest.mark.parametrize(("yaw", "seen"), [(45.0, True), (20.0, True), (-10.0, False), (180.0, False)])
def test_the_first_view_is_79_degrees_wide(geometry, yaw, seen) -> None:
    placement = dataclasses.replace(STAYING, yaw=math.radians(yaw))
    found = observed(asking(present("lamp", WEST, "lamp")), placement, geometry=geometry)
    # The lamp stands to the north-west of the start: its middle at 45°, all of it between 30° and 60°.
    assert (found.observability, found.in_view) == ("O0", seen)


def test_a_room_is_overlooked_from_its_corner() -> None:
    def found(yaw: float) -> Observation:
        placement = ways([[0.05, 3.95], [1, 2]], [[0.05, 3.95], [2, 3]], yaw=yaw)
        return observed(asking(present("sofa", WEST)), placement, *OBJECTS[2:])

    # A first view that is level never shows the floor near the feet.
    assert not found(math.radians(-45)).in_view
    assert found(math.radians(135)).observability == "O0"


def test_the_worst_condition_that_the_gold_route_asks_decides() -> None:
    lamp, vase = present("lamp", WEST, "lamp"), present("vase", EAST, "vase")
    both = observed(asking(lamp, vase), ways([[2, 2], [3, 3]], [[2, 2], [1, 3]], [[2, 2], [1, 2]]))
    assert [(e.condition, e.observability) for e in both.evidence] == [(0, "O0"), (1, "O2")]
    assert both.observability == "O2"
    absent = present("sofa", WEST)
    one = observed(asking(absent, vase), ways([[2, 2], [3, 3]], [[2, 2], [1, 3]], [[2, 2], [1, 2]]))
    assert [(e.condition, e.observability) for e in one.evidence] == [(0, "O0")]
    assert one.observability == "O0"


@SURFACES
def test_a_relation_is_known_by_a_witness_and_its_anchor(geometry) -> None:
    screen = thing("screen", "west", 3, 2.2, half=0.3, top=2.4)
    scene = (*OBJECTS, screen, thing("lamp/2", "west", 3.6, 2.3))
    hidden = ways([[2, 2], [2, 2.1]], [[2, 2], [1.9, 2]])
    assert observed(asking(present("lamp", WEST, "lamp")), hidden, *scene, geometry=geometry).observability == "O0"
    assert observed(asking(present("lamp", WEST, "lamp/2")), hidden, *scene, geometry=geometry).observability == "O2"
    # One of two witnesses will do, but it must be seen with its anchor.
    either = asking(present("lamp", WEST, "lamp/2", "lamp", near="table"))
    assert observed(either, hidden, *scene, geometry=geometry).observability == "O0"
    behind = asking(present("lamp", WEST, "lamp", near="bed"))
    assert observed(behind, hidden, *scene, geometry=geometry).observability == "O2"


def test_a_relation_is_refuted_by_all_that_could_hold_it() -> None:
    never = RULES.model_copy(update={"floor_seen": 2.0})
    refuted = asking(present("lamp", WEST, near="table"))
    assert observed(refuted, STAYING, rules=never).observability == "O0"
    screen = thing("screen", "west", 3, 2.2, half=0.3, top=2.4)
    hidden = ways([[2, 2], [2, 2.1]], [[2, 2], [1.9, 2]])
    unseen = (*OBJECTS, screen, thing("lamp/2", "west", 3.6, 2.3))
    assert observed(refuted, hidden, *unseen, rules=never).observability == "O2"
    # Where nothing of the label is there, only the floor tells.
    assert observed(asking(present("sofa", WEST, near="table")), STAYING, rules=never).observability == "O2"
    assert observed(asking(present("sofa", WEST, near="table")), STAYING).observability == "O0"


def test_a_relation_is_refuted_by_nameless_things_too() -> None:
    """A "stand" may be a coat rack: who has not seen it does not know that no coat rack is near the table."""
    never = RULES.model_copy(update={"floor_seen": 2.0})
    refuted = asking(present("coat rack", WEST, near="table"))
    hidden = ways([[2, 2], [2, 2.1]], [[2, 2], [1.9, 2]])
    seen = (*OBJECTS, thing("coat rack", "west", 1, 2.5))
    assert observed(refuted, hidden, *seen, rules=never).observability == "O0"
    screen = thing("screen", "west", 3, 2.2, half=0.3, top=2.4)
    assert observed(refuted, hidden, *seen, screen, rules=never).observability == "O0"
    stand = thing("stand", "west", 3.6, 2.3)
    assert observed(refuted, hidden, *seen, screen, stand, rules=never).observability == "O2"


def test_without_surfaces_boxes_hide_and_walls_do_not() -> None:
    vase = asking(present("vase", EAST, "vase"))
    assert observed(vase, STAYING, geometry="none").observability == "O0"
    assert observed(vase, STAYING, geometry="none").approximate
    assert observed(vase, STAYING, geometry="approximate").approximate
    assert not observed(vase, STAYING, geometry="exact").approximate
    screen = thing("screen", "west", 3, 1.6, half=0.5, top=2.4)
    assert observed(vase, STAYING, *OBJECTS, screen, geometry="none").observability == "O2"


def test_a_shelf_s_box_does_not_hide_what_stands_in_it() -> None:
    shelf, cup = (
        thing("shelf", "west", 1, 1, half=0.5, top=2.0),
        thing("cup", "west", 1, 1, half=0.05, bottom=1, top=1.1),
    )
    asked = asking(present("cup", WEST, "cup"))
    assert observed(asked, STAYING, shelf, cup, geometry="approximate").observability == "O0"
    assert observed(asked, STAYING, shelf, cup, geometry="exact").observability == "O2", "a closed surface does"


def test_an_object_of_unknown_extent_is_looked_for_at_its_centre() -> None:
    bare = dataclasses.replace(thing("cup", "west", 1, 1), aabb=None)
    scene = two_rooms(bare)
    np.testing.assert_array_equal(SceneView(scene).target("cup").samples, bare.center[None])


def test_each_is_judged_as_if_alone() -> None:
    scene = two_rooms()
    conditions = [present(o.label, WEST if o.room_id == "west" else EAST, o.object_id) for o in OBJECTS]
    placed = [(asking(c), way) for c in (*conditions, present("sofa", EAST)) for way in (STAYING, INTO_THE_EAST)]
    view, floor = SceneView(scene, surfaces(scene, approximate=False)), floor_of(scene)
    shared = Observer(scene, view, floor, PLACES, RULES)
    together = [shared.observe(*one) for one in placed]
    assert together == [Observer(scene, view, floor, PLACES, RULES).observe(*one) for one in placed]
    assert {o.observability for o in together} == {"O0", "O1", "O2"}


corner = st.tuples(st.floats(-5, 5), st.floats(-5, 5))


@given(st.lists(st.lists(corner, min_size=1, max_size=4), min_size=2, max_size=4))
def test_nowhere_on_the_prefix_are_two_ways_a_step_apart(tails) -> None:
    paths = [np.array([[0.0, 0.0, 0.0], *([x, 0.0, z] for x, z in tail)]) for tail in tails]
    prefix = common_prefix(paths)
    lengths = [np.concatenate([[0], np.cumsum(np.linalg.norm(np.diff(p, axis=0), axis=1))]) for p in paths]
    end = np.linalg.norm(np.diff(prefix, axis=0), axis=1).sum()
    assert end <= min(length[-1] for length in lengths) + 1e-9

    def at(k: int, s: float) -> np.ndarray:
        return np.array([np.interp(s, lengths[k], paths[k][:, axis]) for axis in range(3)])

    # Between the places compared both ways go on by at most 0.05 m each.
    for s in np.linspace(0, end, 40):
        gaps = [np.linalg.norm(at(0, s) - at(k, s)) for k in range(len(paths))]
        assert max(gaps) <= PREFIX_STRAY + 0.1 + 1e-9
    if end < min(length[-1] for length in lengths) - 0.051:
        beyond = [at(k, end + 0.05) for k in range(len(paths))]
        assert max(np.linalg.norm(a - b) for a in beyond for b in beyond) > PREFIX_STRAY - 1e-6


def test_floor_points_cover_the_free_floor_of_a_room() -> None:
    scene = two_rooms()
    pathfinder = floor_of(scene)
    for room in scene.rooms:
        points = floor_points(scene, room, pathfinder, (0,))
        assert 0.75 * FLOOR_POINTS <= len(points) <= 1.1 * FLOOR_POINTS
        np.testing.assert_allclose(points[:, 1], FLOOR_LIFT)
        low, high = room.polygon.min(axis=0), room.polygon.max(axis=0)
        assert ((points[:, [0, 2]] > low) & (points[:, [0, 2]] < high)).all()
        assert not any(inside(o, x, z, -0.06) for o in scene.objects for x, _, z in points)
        # Evenly spread: each quarter has a quarter, less what furniture takes of it.
        east, south = points[:, 0] > (low + high)[0] / 2, points[:, 2] > (low + high)[1] / 2
        counts = [int((east == a).astype(int) @ (south == b).astype(int)) for a in (0, 1) for b in (0, 1)]
        assert min(counts) >= 0.17 * FLOOR_POINTS
        assert max(counts) <= 0.28 * FLOOR_POINTS
    carpet = thing("carpet", "west", 1, 3, half=0.9)
    fewer = floor_points(scene, scene.rooms[0], pathfinder, (0,), [(carpet, Footprint.of(carpet))])
    assert not any(inside(carpet, x, z) for x, _, z in fewer)
    assert len(fewer) < len(floor_points(scene, scene.rooms[0], pathfinder, (0,)))


def test_a_room_that_cannot_be_stood_in_is_asked_for_all_of_its_floor() -> None:
    scene = two_rooms()
    nowhere = dataclasses.replace(scene.rooms[0], polygon=np.array([[20, 0], [24, 0], [24, 4], [20, 4.0]]))
    points = floor_points(scene, nowhere, floor_of(scene), (0,))
    assert len(points) == FLOOR_POINTS


NO_FLOOR = grid_floor(1, 1, lambda x, z: False)
"""Nobody can stand in the houses here, so that all of a room's floor is asked for."""


def walls_hide(source: Source, scene_id: str) -> None:
    """A house's walls hide nothing of a convex room from within it, and most of what is in other rooms."""
    scene = source.read(scene_id)
    walled, open_plan = SceneView(scene, source.geometry(scene)), SceneView(scene)
    assert walled.approximate
    rng = np.random.default_rng(0)
    elsewhere = np.zeros(2, int)
    for room in scene.rooms:
        points = floor_points(scene, room, NO_FLOOR, ())
        eyes = eyes_at(points[rng.permutation(len(points))[:6]], PLACES.eye_height)
        outline = shapely.Polygon(room.polygon)
        convex = outline.area > 0.999 * outline.convex_hull.area
        for item in scene.objects:
            target = walled.target(item.object_id)
            seen, more = (view.seen(eyes, target, View(range=100.0)) for view in (walled, open_plan))
            assert not (seen & ~more).any()
            if item.room_id != room.room_id:
                elsewhere += [seen.any(axis=1).sum(), more.any(axis=1).sum()]
            elif convex:
                np.testing.assert_array_equal(seen.any(axis=1), more.any(axis=1))
    assert elsewhere[0] <= 0.5 * elsewhere[1]


def test_walls_of_a_made_house_hide_its_other_rooms(tmp_path: Path) -> None:
    make_samples(tmp_path, family="procthor", scenes=2, seed=3)
    source = open_source("procthor", tmp_path)
    for handle in source.handles():
        walls_hide(source, handle.scene_id)


def test_walls_of_real_houses_hide_their_other_rooms(real_data: Path) -> None:
    source = open_source("procthor", real_data / "procthor")
    for handle in source.handles()[:6:3]:
        walls_hide(source, handle.scene_id)
