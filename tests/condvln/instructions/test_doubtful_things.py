"""Things that people would not call by their label: parts of furniture, boxes of scans, boxes on the border of two
rooms.

Each case is one that a reader doubted; the numbers are those of the real scene.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from shapely import Polygon
from shapely import box as rectangle

from condvln.instructions.conditions import ConditionPool
from condvln.instructions.likeness import NO_BORDER, borders, mistakable, parts, share_inside, twins
from condvln.instructions.priors import PriorBits
from condvln.instructions.referents import Referents
from condvln.instructions.statements import statement_truths
from condvln.labels import vocabulary
from condvln.labels.lists import also_called, fixtures_of, required_in
from condvln.relations import relate_room, text_facts
from condvln.scene import Room, RoomArrays, Scene, SceneObject
from condvln.verify.phrases import Named, Phrase
from condvln.verify.referents import Problem, SceneReferents
from condvln.verify.surfaces import Shapes
from condvln.verify.words import words
from schemas.config import Thresholds

sys.path.insert(0, str(Path(__file__).parent))
from test_likeness import referents, thing

Point = Sequence[float]
T = Thresholds()

# A television stand of iTHOR's FloorPlan207 with a compartment, and a shelving unit across the room with its shelves.
STAND = thing("stand", "television stand", (1.37, 0.0, -0.85), (1.97, 0.75, 0.36))
COMPARTMENT = thing("part", "shelf", (1.39, 0.16, -0.38), (1.93, 0.73, -0.11))
UNIT = thing("unit", "shelving unit", (-1.95, 0.0, 1.25), (-1.63, 2.20, 1.93))
BOARD = thing("board", "shelf", (-1.91, 1.32, 1.29), (-1.63, 1.58, 1.90))
SHELF = thing("shelf", "shelf", (-1.91, 1.32, 3.29), (-1.63, 1.58, 3.90))


def named(found: Referents, name: str) -> bool:
    return bool(found.usable[found.arrays.object_ids.index(name)])


def proven(scene: Scene, label: str, room: str | None = None, qualifier=None) -> bool:
    """Whether the verifier finds the one object of a phrase."""
    phrase = Phrase(label, qualifier, None if room is None else Named(room, None))
    return not isinstance(SceneReferents(scene, T, 0.3, Shapes(Path())).thing(phrase), Problem)


def scene_of(family: str, things: Sequence[SceneObject], rooms: Sequence[Room] = ()) -> Scene:
    rooms = rooms or (Room("room", "kitchen", "kitchen", 0, 0.0, 2.5, None, "dataset", True),)
    return Scene(family, "made", Path(), tuple(rooms), tuple(things))


def test_a_compartment_of_furniture_is_not_named_and_confuses_nothing() -> None:
    found = referents([STAND, COMPARTMENT, UNIT, BOARD], "ithor")
    assert parts(found.arrays).tolist() == [True, True, False, False]  # board, part, stand, unit
    assert [named(found, name) for name in ("part", "board", "unit", "stand")] == [False, False, True, True]
    assert not found.lacks("shelf", vocabulary)
    for label, sure in (("shelf", False), ("shelving unit", True), ("television stand", True)):
        assert proven(scene_of("ithor", [STAND, COMPARTMENT, UNIT, BOARD]), label) is sure, label


def test_a_shelf_by_itself_is_named_beside_a_compartment() -> None:
    """People do not think of the compartment; but nobody says that no shelf is there."""
    found = referents([STAND, COMPARTMENT, SHELF], "ithor")
    assert [named(found, name) for name in ("part", "shelf")] == [False, True]
    assert proven(scene_of("ithor", [STAND, COMPARTMENT, SHELF]), "shelf")


@pytest.mark.parametrize(("depth", "part"), [(0.30, True), (0.60, True), (0.61, False)])
def test_half_of_a_drawer_inside_its_furniture_makes_it_a_part(depth: float, part: bool) -> None:
    desk = thing("desk", "desk", (0, 0, 0), (1.2, 0.75, 0.6))
    low = 0.3
    drawer = thing("drawer", "drawer", (0.1, 0.5, low), (0.5, 0.7, low + depth))
    found = referents([desk, drawer], "procthor")
    assert parts(found.arrays).tolist() == [False, part]
    assert named(found, "drawer") is not part
    assert proven(scene_of("procthor", [desk, drawer]), "drawer") is not part


KEYBOARD = thing("keyboard", "computer keyboard", (1.55, 0.64, -4.96), (1.89, 0.78, -4.49))
DESK_SCREEN = thing("screen", "television", (1.86, 0.82, -5.04), (2.06, 1.21, -4.43))
TALL_SCREEN = thing("screen", "television", (-0.44, 0.96, -4.76), (-0.18, 2.02, -3.99))
WALL_SCREEN = thing("screen", "television", (-2.15, 1.12, 2.03), (-0.36, 2.49, 2.22))


@pytest.mark.parametrize(
    ("family", "things", "sure"),
    [
        ("gibson", [DESK_SCREEN, KEYBOARD], False),  # a monitor, by what is before it
        ("gibson", [DESK_SCREEN], True),
        ("gibson", [TALL_SCREEN], False),  # no television is taller than wide
        ("gibson", [WALL_SCREEN, KEYBOARD], True),
        ("procthor", [DESK_SCREEN, KEYBOARD], True),
    ],
)
def test_a_screen_of_a_scan_that_may_be_a_monitor_is_no_television(
    family: str, things: list[SceneObject], sure: bool
) -> None:
    found = referents(things, family)
    assert found.nameable[found.arrays.object_ids.index("screen")] == sure
    assert not found.lacks("television", vocabulary)
    assert not found.lacks("monitor", vocabulary)
    assert proven(scene_of(family, things), "television") is sure


@pytest.mark.parametrize(
    ("label", "size", "sure"),
    [
        ("chair", (0.70, 0.94, 1.30), False),  # two stools of Gibson's building Cosmos
        ("chair", (0.43, 0.70, 1.08), False),
        ("bar stool", (1.08, 0.70, 0.43), False),
        ("chair", (0.87, 0.91, 1.12), True),  # large, but not long
        ("chair", (1.40, 0.97, 1.40), False),  # no chair is so large
        ("chair", (1.399, 0.97, 1.399), True),
        ("chair", (0.30, 0.94, 0.50), True),
        ("sofa", (0.70, 0.94, 1.30), True),
    ],
)
def test_a_long_chair_of_a_scan_may_be_two(label: str, size: Point, sure: bool) -> None:
    chair = thing("a", label, (0, 0, 0), size)
    for family in ("gibson", "mp3d", "ithor"):
        found = referents([chair], family)
        assert found.nameable.tolist() == [sure or family == "ithor"]
        assert proven(scene_of(family, [chair]), label) is (sure or family == "ithor")
    assert mistakable(found.arrays).tolist() == [not sure]


# Two chairs at a table of Gibson's building Allensville, one of them scanned from behind only.
WHOLE = thing("whole", "chair", (4.14, 0.02, -6.78), (4.93, 0.94, -6.06))
HALF = thing("half", "chair", (4.27, 0.02, -7.46), (4.77, 0.94, -7.17))


@pytest.mark.parametrize(
    ("family", "height", "told"),
    [("gibson", 0.94, False), ("gibson", 0.756, False), ("gibson", 0.755, True), ("ithor", 0.94, True)],
)
def test_things_of_one_height_are_not_compared_by_size_in_scans(family: str, height: float, told: bool) -> None:
    small = thing("half", "chair", (4.27, 0.02, -7.46), (4.77, height, -7.17))
    found = referents([WHOLE, small], family)
    ways = found.qualifications[found.arrays.object_ids.index("half")]
    assert ("smaller" in {q.predicate for q in ways}) is told
    assert proven(scene_of(family, [WHOLE, small]), "chair", None, ("smaller", ())) is told
    rival = ~np.eye(2, dtype=bool)
    assert twins(found.arrays, rival, np.zeros(2, dtype=bool)).any() == (height >= 0.756)


@pytest.mark.parametrize(("family", "told"), [("gibson", False), ("ithor", True)])
def test_in_scans_the_bigger_of_a_thing_and_a_piece_is_not_said(family: str, told: bool) -> None:
    whole = thing("whole", "chair", (4.41, 0.0, -3.86), (4.89, 0.91, -3.07))
    back = thing("back", "chair", (3.09, 0.69, -3.42), (3.49, 0.82, -3.04))  # 0.13 m high: what was scanned of a chair
    found = referents([whole, back], family)
    ways = found.qualifications[found.arrays.object_ids.index("whole")]
    assert ("bigger" in {q.predicate for q in ways}) is told
    assert proven(scene_of(family, [whole, back]), "chair", None, ("bigger", ())) is told


@pytest.mark.parametrize(("gap", "width", "one"), [(0.1, 0.35, True), (0.101, 0.35, False), (0.1, 0.351, False)])
def test_a_thin_box_beside_one_of_its_label_may_be_a_piece_of_it(gap: float, width: float, one: bool) -> None:
    whole = thing("a", "chair", (0, 0, 0), (0.7, 0.9, 0.7))
    thin = thing("b", "chair", (0, 0.1, 0.7 + gap), (0.7, 0.9, 0.7 + gap + width))
    bed = thing("z", "bed", (-4, 0, 3), (-2, 0.9, 5))
    found = referents([whole, thin, bed], "gibson")
    assert found.double.tolist() == [one, one, False]
    assert not referents([whole, thin, bed], "ithor").double.any()


@pytest.mark.parametrize(
    ("size", "alike"), [((0.87, 0.72, 0.69), True), ((1.0, 0.7, 0.5), True), ((1.01, 0.7, 0.5), False)]
)
def test_a_small_dining_table_may_be_called_a_side_table(size: Point, alike: bool) -> None:
    """A table against the wall with a microwave on it, in iTHOR's FloorPlan21."""
    table, side = thing("a", "dining table", (0, 0, 0), size), thing("b", "side table", (3, 0, 3), (3.5, 0.7, 3.5))
    found = referents([table, side], "ithor")
    assert found.unique.tolist() == [True, not alike]
    assert referents([table], "ithor").lacks("side table", vocabulary) is not alike
    assert proven(scene_of("ithor", [table, side]), "side table") is not alike


def room(name: str, label: str, low: tuple[float, float], high: tuple[float, float], floor: float = 0.0) -> Room:
    ring = np.array([low, (high[0], low[1]), high, (low[0], high[1])])
    return Room(name, label, label, 0, floor, floor + 2.5, ring, "dataset", True)


KITCHEN = room("kitchen", "garage", (-2.0, -2.0), (2.0, 0.97))
DINING = room("dining", "library", (-2.0, 0.8), (2.0, 4.0))
ABOVE = room("bedroom", "classroom", (-2.0, -2.0), (2.0, 4.0), floor=2.5)
BOWL = replace(thing("bowl", "bowl", (-0.415, 1.04, 0.91), (-0.045, 1.24, 1.23)), room_id="dining")


@pytest.mark.parametrize(
    ("label", "low", "own"),
    [
        ("bowl", (-0.415, 1.04, 0.91), False),  # between the kitchen and the dining room of Gibson's Benevolence
        ("bowl", (-0.415, 1.04, 0.938), False),
        ("bowl", (-0.415, 1.04, 0.939), True),  # less than a tenth of it
        ("bathtub", (-0.415, 0.04, 0.91), True),  # built in: its room is known
    ],
)
def test_a_thing_on_the_border_of_two_rooms_belongs_to_none(label: str, low: Point, own: bool) -> None:
    size = {"bowl": (0.37, 0.2, 0.32), "bathtub": (0.7, 0.5, 1.5)}[label]
    high = (low[0] + size[0], low[1] + size[1], low[2] + size[2])
    bowl = replace(thing("bowl", label, low, high), room_id="dining")
    table = replace(thing("table", "dining table", (-1, 0, 2), (1, 0.8, 3)), room_id="dining")
    fridge = replace(thing("fridge", "refrigerator", (-1.9, 0, -1.9), (-1, 1.8, -1)), room_id="kitchen")
    scene = scene_of("gibson", [bowl, table, fridge], [KITCHEN, DINING, ABOVE])
    found = borders(scene)
    assert set(found) == (set() if own else {"dining", "kitchen"})
    names = {}
    for one in scene.rooms:
        arrays = scene.arrays(one.room_id)
        facts = text_facts(relate_room(arrays, T), T)
        here = found.get(one.room_id, NO_BORDER)
        names[one.room_id] = Referents.of(one, arrays, facts, vocabulary, 0.3, "gibson", border=here)
    assert named(names["dining"], "bowl") is own
    assert names["kitchen"].lacks(label, vocabulary) is own
    assert names["bedroom"].lacks(label, vocabulary)
    assert not names["dining"].lacks(label, vocabulary)
    assert proven(scene, label, "library") is own
    assert not borders(replace(scene, family="procthor"))
    absent = SceneReferents(scene, T, 0.3, Shapes(Path())).claim(Phrase(label, None, Named("garage", None)))
    assert isinstance(absent, Problem) is not own


def test_a_word_that_may_mean_a_thing_on_the_border_is_used_in_neither_room() -> None:
    own = replace(thing("own", "bowl", (0, 0.9, -1), (0.3, 1.1, -0.7)), room_id="kitchen")
    sink = replace(thing("sink", "sink", (1, 0.7, -1), (1.5, 0.9, -0.5)), room_id="kitchen")
    scene = scene_of("gibson", [BOWL, own, sink], [KITCHEN, DINING])
    arrays = scene.arrays("kitchen")
    facts = text_facts(relate_room(arrays, T), T)
    found = Referents.of(KITCHEN, arrays, facts, vocabulary, 0.3, "gibson", border=borders(scene)["kitchen"])
    assert [named(found, name) for name in ("own", "sink")] == [False, True]
    assert not found.decides("bowl", vocabulary)
    assert not proven(scene, "bowl", "garage")
    assert proven(scene, "sink", "garage")
    about = Phrase("bowl", ("near", ("sink",)), Named("garage", None))
    assert isinstance(SceneReferents(scene, T, 0.3, Shapes(Path())).claim(about), Problem)


WHOLE_MM = st.integers(-3000, 3000)


@given(
    st.lists(st.tuples(WHOLE_MM, WHOLE_MM), min_size=3, max_size=7, unique=True),
    st.tuples(WHOLE_MM, WHOLE_MM, st.integers(1, 2000), st.integers(1, 2000)),
)
def test_the_share_inside_an_outline_is_that_of_shapely(ring: list[tuple[int, int]], box: tuple[int, ...]) -> None:
    outline = Polygon(ring)
    if not outline.is_valid:
        outline = outline.convex_hull
        if outline.geom_type != "Polygon":
            return
        ring = [(int(x), int(z)) for x, z in outline.exterior.coords[:-1]]
    x, z, wide, deep = box
    expected = outline.intersection(rectangle(x, z, x + wide, z + deep)).area / (wide * deep)
    low, high = np.array([x, z], dtype=float), np.array([x + wide, z + deep], dtype=float)
    assert share_inside(low, high, np.array(ring, dtype=float)) == pytest.approx(expected, abs=1e-9)


SINK = thing("sink", "sink", (1.0, 0.7, 1.0), (1.6, 0.95, 1.5))
FRIDGE = thing("fridge", "refrigerator", (-2.0, 0.0, -2.0), (-1.3, 1.8, -1.3))
PLANT = thing("plant", "plant", (0.0, 1.43, 0.0), (0.3, 1.81, 0.3))


def claimed_absent(scene: Scene, label: str) -> bool:
    """Whether the verifier agrees that there is no such thing."""
    found = SceneReferents(scene, T, 0.3, Shapes(Path())).claim(Phrase(label, None, None))
    return not isinstance(found, Problem) and not found.truth


@pytest.mark.parametrize(
    ("things", "label", "sure"),
    [
        ([FRIDGE, PLANT], "sink", False),  # a kitchen of Gibson whose scan shows four things
        ([FRIDGE, PLANT], "bowl", False),  # who left out the sink may have left out a bowl
        ([FRIDGE, SINK, PLANT], "bowl", True),
        ([FRIDGE, SINK, PLANT], "oven", False),
        ([FRIDGE, SINK, PLANT], "ceiling lamp", False),
        ([FRIDGE, SINK, PLANT], "bed", True),
    ],
)
def test_no_scan_shows_that_a_room_lacks_what_every_such_room_has(
    things: list[SceneObject], label: str, sure: bool
) -> None:
    for family in ("gibson", "mp3d", "hm3d"):
        assert referents(things, family).lacks(label, vocabulary) is sure, family
        assert claimed_absent(scene_of(family, things), label) is sure, family
    assert referents(things, "procthor").lacks(label, vocabulary)
    assert claimed_absent(scene_of("procthor", things), label)


def test_conditions_ask_for_no_fixture_of_a_scan_with_either_truth() -> None:
    """If only the presence of a sink could be asked for, the answer would always be yes."""
    bits = PriorBits({"kitchen": frozenset(vocabulary.labels)}, {"kitchen": frozenset(vocabulary.labels)}, {})
    asked = {}
    for family in ("gibson", "procthor"):
        pool = ConditionPool.of(referents([FRIDGE, SINK, PLANT], family), bits, ["bed", "oven"], vocabulary).presence
        asked[family] = {truth: {q.label for q in questions} for truth, questions in pool.questions.items()}
    assert asked["gibson"] == {True: {"plant"}, False: {"bed"}}
    assert asked["procthor"] == {True: {"plant", "refrigerator", "sink"}, False: {"bed", "oven"}}


VASE = thing("vase", "vase", (1.78, 0.78, 0.45), (1.93, 0.85, 0.60))  # of a ProcTHOR house: as low as a bowl


@pytest.mark.parametrize(("height", "sure"), [(0.07, False), (0.15, False), (0.151, True), (0.4, True)])
def test_nobody_says_that_there_is_no_bowl_beside_a_vase_as_low_as_a_bowl(height: float, sure: bool) -> None:
    vase = thing("vase", "vase", (1.78, 0.78, 0.45), (1.93, 0.78 + height, 0.60))
    found = referents([vase, FRIDGE], "procthor")
    assert found.lacks("bowl", vocabulary) is sure
    assert claimed_absent(scene_of("procthor", [vase, FRIDGE]), "bowl") is sure
    assert named(found, "vase")
    assert proven(scene_of("procthor", [vase, FRIDGE]), "vase")


def test_a_low_vase_is_no_rival_of_a_bowl() -> None:
    bowl = thing("bowl", "bowl", (0.0, 0.8, 0.0), (0.2, 0.9, 0.2))
    assert named(referents([VASE, bowl], "procthor"), "bowl")
    assert proven(scene_of("procthor", [VASE, bowl]), "bowl")


@pytest.mark.parametrize("family", ["gibson", "procthor"])
def test_in_a_scan_no_bowl_near_the_fridge_is_denied_beside_a_low_vase(family: str) -> None:
    bowls = [thing(f"bowl{k}", "bowl", (3.0 + k, 0.8, 3.0), (3.2 + k, 0.9, 3.2)) for k in range(2)]
    sink = thing("sink", "sink", (8.0, 0.8, 8.0), (8.5, 1.0, 8.4))  # without one, a scan's kitchen is incomplete
    for close, sure in ((True, family == "procthor"), (False, True)):
        x = -1.2 if close else 4.5
        vase = thing("vase", "vase", (x, 0.78, -1.6), (x + 0.15, 0.85, -1.45))
        things = [*bowls, vase, FRIDGE, sink]
        (truths,) = (t for t in statement_truths(referents(things, family), vocabulary) if t.predicate == "near")
        anchor = truths.anchor_keys(referents(things, family).arrays.labels)
        assert truths.false[truths.labels.index("bowl"), anchor.index("refrigerator")] == sure
        about = Phrase("bowl", ("near", ("refrigerator",)), None)
        found = SceneReferents(scene_of(family, things), T, 0.3, Shapes(Path())).claim(about)
        assert isinstance(found, Problem) is not sure


def test_both_programs_know_the_same_other_names() -> None:
    pairs = {
        (label, other, low)
        for low in (False, True)
        for other, labels in also_called(low=low).items()
        for label in labels
    }
    assert len(pairs) > 400
    for label, other, low in sorted(pairs):
        assert vocabulary.fit_for_text(label), label
        assert other in vocabulary.labels, other
        assert other not in vocabulary.overlapping(label), (label, other)
        item = thing("a", other, (0, 0, 0), (0.4, 0.3 if low else 0.5, 0.4))
        assert not referents([item], "procthor").lacks(label, vocabulary), (label, other)
        assert not claimed_absent(scene_of("procthor", [item]), label), (label, other)


def test_fixtures_are_of_known_labels_and_rooms() -> None:
    assert all(vocabulary.fit_for_text(label) for label in fixtures_of("kitchen") | fixtures_of("no such room"))
    assert {"sink", "refrigerator"} == required_in("kitchen") < fixtures_of("kitchen")
    assert not required_in("")
    for room_type, labels in words().fixtures.items():
        assert not room_type or room_type in vocabulary.room_labels
        assert set(labels) <= fixtures_of(room_type)
        assert {label for label, required in labels.items() if required} == required_in(room_type)


# A seating group of ReplicaCAD's staging 08, on one rug: the armchairs are 2.9 m from the sofa.
COUCH = thing("sofa", "sofa", (-0.555, 0.0, -0.595), (1.595, 0.8, 0.395))
SEAT = thing("seat", "armchair", (0.38, 0.0, 3.255), (1.18, 0.76, 3.965))
CARPET = thing("rug", "rug", (-1.06, -0.01, 0.325), (1.58, 0.01, 3.275))
TABLE = thing("table", "coffee table", (0.085, 0.0, 1.125), (1.335, 0.4, 1.915))


@pytest.mark.parametrize(
    ("middle", "denied"),
    [
        ((), True),
        ((CARPET,), False),
        ((TABLE,), False),
        ((replace(TABLE, label="table"),), True),
        # Up to 0.25 m from the rug, and up to 1.5 m from the coffee table; the seat begins at 3.255.
        ((thing("rug", "rug", (-1.06, -0.01, 0.325), (1.58, 0.01, 3.255 - 0.24)),), False),
        ((thing("rug", "rug", (-1.06, -0.01, 0.325), (1.58, 0.01, 3.255 - 0.26)),), True),
        ((thing("table", "coffee table", (0.085, 0.0, 1.125), (1.335, 0.4, 3.255 - 1.49)),), False),
        ((thing("table", "coffee table", (0.085, 0.0, 1.125), (1.335, 0.4, 3.255 - 1.51)),), True),
    ],
)
def test_in_a_seating_group_nothing_is_said_to_be_not_close(middle: Sequence[SceneObject], denied: bool) -> None:
    things = [COUCH, SEAT, *middle]
    arrays = RoomArrays.of("room", things, 0.0)
    near = text_facts(relate_room(arrays, T), T).status["near"]
    one, other = arrays.object_ids.index("seat"), arrays.object_ids.index("sofa")
    assert near[one, other] == near[other, one] == (-1 if denied else 0)
    things = [replace(item, raw_label=item.label) for item in things]
    about = Phrase("armchair", ("near", ("sofa",)), None)
    found = SceneReferents(scene_of("replicacad", things), T, 0.3, Shapes(Path())).claim(about)
    assert isinstance(found, Problem) is not denied
