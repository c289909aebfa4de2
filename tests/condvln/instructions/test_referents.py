"""Every name of an object or room fits it and nothing else: proven by going through all pairs one by one."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from itertools import combinations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from condvln.instructions.balance import SHARED_WORD_WEIGHT, RoomWords
from condvln.instructions.predicates import PREDICATE_GROUPS
from condvln.instructions.referents import Referents, meant_by, object_refs, room_refs
from condvln.labels import vocabulary
from condvln.labels.lists import labels_with_role
from condvln.relations import PAIR_PREDICATES
from condvln.scene import Room, RoomArrays, SceneObject, round_mm
from schemas.program import SUPERLATIVES, RoomRef

ONE_ANCHOR = (*PAIR_PREDICATES, "closest to")

LABELS = ("chair", "armchair", "lamp", "floor lamp", "bed", "sofa", "wall", "table", "desk", "no such thing")


@dataclass(frozen=True)
class MadeFacts:
    status: dict[str, NDArray[np.int8]]
    margin: dict[str, NDArray[np.float64]]
    size: dict[str, NDArray[np.int8]] | None = None
    middle: NDArray[np.int8] | None = None  # (n, n, n): i between a and b
    denied: Mapping[str, NDArray[np.bool_]] = field(default_factory=dict)
    excluded: Mapping[str, NDArray[np.bool_]] = field(default_factory=dict)

    def closest(self, rival: NDArray[np.bool_]) -> tuple[NDArray[np.int8], NDArray[np.float64]]:
        return self.status["closest to"], self.margin["closest to"]

    def sizes(self, rival: NDArray[np.bool_]) -> dict[str, NDArray[np.int8]]:
        return {p: np.zeros(len(rival), np.int8) for p in SUPERLATIVES} if self.size is None else self.size

    def between(self, pairs: NDArray[np.intp]) -> tuple[NDArray[np.int8], NDArray[np.float64]]:
        n = len(self.status["near"])
        middle = np.full((n, n, n), -1, np.int8) if self.middle is None else self.middle
        found = middle[:, pairs[:, 0], pairs[:, 1]]
        return found, np.ones(found.shape)


def made_room(
    room_id: str,
    label: str,
    labels: list[str],
    *,
    complete: bool = True,
    size: float = 1.0,
    hidden: tuple[int, ...] = (),
    without_extent: tuple[int, ...] = (),
) -> tuple[Room, RoomArrays]:
    room = Room(room_id, label, label, 0, 0.0, 2.5, None, "dataset", complete)
    half = np.full(3, size / 2)
    objects = [
        SceneObject(
            f"{room_id}_{k:02}",
            room_id,
            x,
            x,
            np.zeros(3),
            aabb=None if k in without_extent else np.array([-half, half]),
            hidden=k in hidden,
        )
        for k, x in enumerate(labels)
    ]
    return room, RoomArrays.of(room_id, objects)


def no_facts(n: int) -> MadeFacts:
    status = {p: np.full((n, n), -1, np.int8) for p in ONE_ANCHOR}
    size = {p: np.zeros(n, np.int8) for p in SUPERLATIVES}
    return MadeFacts(status, {p: np.zeros((n, n)) for p in ONE_ANCHOR}, size, np.full((n, n, n), -1, np.int8))


@st.composite
def rooms_with_facts(draw: st.DrawFn) -> Referents:
    labels = draw(st.lists(st.sampled_from(LABELS), min_size=1, max_size=9))
    rng = np.random.default_rng(draw(st.integers(0, 2**32)))
    n = len(labels)
    # Mostly false, as in real rooms; else no qualifier would ever exclude all rivals.
    values = [-1, -1, -1, 0, 1]
    status = {p: rng.choice(values, size=(n, n)).astype(np.int8) for p in ONE_ANCHOR}
    margin = {p: rng.uniform(0.5, 2.0, size=(n, n)) for p in ONE_ANCHOR}
    size = {p: rng.choice([-1, 0, 0, 1], size=n).astype(np.int8) for p in SUPERLATIVES}
    middle = rng.choice(values, size=(n, n, n)).astype(np.int8)
    for table in status.values():
        np.fill_diagonal(table, 0)
    some = st.lists(st.integers(0, n - 1), max_size=2).map(tuple)
    room, arrays = made_room("r", "bedroom", labels, hidden=draw(some), without_extent=draw(some))
    return Referents.of(room, arrays, MadeFacts(status, margin, size, middle), vocabulary, 0.3)


def rivals_of(referents: Referents, i: int) -> list[int]:
    labels = referents.arrays.labels
    return [
        j
        for j in range(len(labels))
        if j != i
        and not referents.arrays.objects[j].hidden
        and (labels[j] in vocabulary.overlapping(labels[i]) or labels[i] in vocabulary.overlapping(labels[j]))
    ]


def ways_of(referents: Referents, i: int) -> set[tuple[str, tuple[int, ...]]]:
    """All (predicate, anchors) that make i unique, by definition."""
    labels, facts = referents.arrays.labels, referents.facts
    objects, n = referents.arrays.objects, len(labels)
    rivals = rivals_of(referents, i)
    if not vocabulary.fit_for_text(labels[i]) or not rivals or objects[i].hidden:
        return set()
    # All things are of one size, if any, so that each is an anchor of the others unless it is carried about.
    anchors = [
        a
        for a in range(n)
        if vocabulary.fit_for_text(labels[a])
        and not objects[a].hidden
        and objects[a].box is not None
        and not rivals_of(referents, a)
        and labels[a] not in labels_with_role("portable")
        and a != i
        and (objects[i].box is not None or labels[a] in labels_with_role("fixed"))
    ]
    ways = {(p, (a,)): [facts.status[p][j, a] for j in [i, *rivals]] for p in ONE_ANCHOR for a in anchors}
    ways |= {
        ("between", pair): [facts.between(np.array([pair]))[0][j, 0] for j in [i, *rivals]]
        for pair in combinations(anchors, 2)
    }
    found = {way for way, (own, *others) in ways.items() if own == 1 and all(status == -1 for status in others)}
    return found | {(p, ()) for p in SUPERLATIVES if facts.size[p][i] == 1}


@given(rooms_with_facts())
def test_names_fit_one_object_only(referents: Referents) -> None:
    for i, label in enumerate(referents.arrays.labels):
        seen = not referents.arrays.objects[i].hidden
        unique = seen and vocabulary.fit_for_text(label) and not rivals_of(referents, i)
        ways = ways_of(referents, i)
        taken = [(q.predicate, q.anchors) for q in referents.qualifications[i]]
        assert referents.unique[i] == unique
        assert set(taken) <= ways, "a qualifier must be necessary and sufficient"
        assert len(set(taken)) == len(taken)
        assert referents.usable[i] == (unique or bool(ways)), "what can be told apart is not given up"


def test_a_room_is_not_named_by_what_may_be_hidden_in_another_or_has_no_extent() -> None:
    here = made_room("a", "bedroom", ["bed", "piano"])
    for labels, hidden, names in ((["bed"], (), 1), (["bed", "piano"], (1,), 0), (["bed", "piano"], (), 0)):
        other = made_room("b", "bedroom", labels, hidden=hidden)
        rooms = [Referents.of(*each, no_facts(len(each[1])), vocabulary, 0.3) for each in (here, other)]
        assert len(room_refs(rooms, vocabulary).get("a", ())) == names
    pointlike = made_room("a", "bedroom", ["bed", "piano"], without_extent=(1,))
    rooms = [Referents.of(*x, no_facts(len(x[1])), vocabulary, 0.3) for x in (pointlike, made_room("b", "bedroom", []))]
    assert [ref.anchor_label for ref in room_refs(rooms, vocabulary)["a"]] == ["bed"]


@given(rooms_with_facts())
def test_qualifiers_come_in_order_of_preference_and_margin(referents: Referents) -> None:
    groups = list(PREDICATE_GROUPS)
    group_of = {p: g for g, predicates in PREDICATE_GROUPS.items() for p in predicates}
    for i, taken in enumerate(referents.qualifications):
        ranks = [groups.index(group_of[q.predicate]) for q in taken]
        assert ranks == sorted(ranks)
        if "far from" in {q.predicate for q in taken}:
            assert {p for p, _ in ways_of(referents, i)} == {"far from"}
        for group, predicates in PREDICATE_GROUPS.items():
            kept = [q.margin for q in taken if q.predicate in predicates]
            passed_over = [
                referents.facts.margin[p][i, a[0]] if p in ONE_ANCHOR else 1.0 if a else 0.0
                for p, a in ways_of(referents, i)
                if p in predicates and (p, a) not in {(q.predicate, q.anchors) for q in taken}
            ]
            assert kept == sorted(kept, reverse=True)
            if kept and passed_over:
                assert min(kept) >= max(passed_over), group


def test_small_and_portable_things_are_never_anchors() -> None:
    room = Room("r", "bedroom", "bedroom", 0, 0.0, 2.5, None, "dataset", True)
    sizes = {
        "a": ("lamp", 0.4),
        "b": ("lamp", 0.4),
        "c": ("ashtray", 0.1),
        "d": ("desk", 2.0),
        "e": ("stool", 0.35),
        "f": ("bicycle", 1.5),
        "g": ("sink", 0.2),
    }
    objects = [
        SceneObject(k, "r", x, x, np.zeros(3), aabb=np.array([np.full(3, -s / 2), np.full(3, s / 2)]))
        for k, (x, s) in sizes.items()
    ]
    facts = no_facts(7)
    facts.status["near"][0, 2:] = 1
    referents = Referents.of(room, RoomArrays.of("r", objects), facts, vocabulary, 0.3)
    assert referents.anchors.tolist() == [3, 4, 6], "the desk, the stool, and the sink, which is fixed"
    assert referents.suits[0].tolist() == [False, True, False, True, False, True, True], "the larger, or the fixed"
    near = {q.anchors for q in referents.qualifications[0] if q.predicate == "near"}
    assert near == {(3,), (6,)}


@pytest.mark.parametrize(("label", "size", "suits"), [
    ("sculpture", 0.9, True), ("sculpture", 0.8, False), ("podium", 0.5, True), ("stool", 1.2, False),
])  # fmt: skip
def test_a_statue_is_a_landmark_and_a_figurine_is_not(label: str, size: float, suits: bool) -> None:
    """Of a larger thing beside it: an armchair is found by a statue or a podium, not by a figurine or a stool."""
    room = Room("r", "other room", "other room", 0, 0.0, 2.5, None, "dataset", True)
    sides = {"a": ("armchair", 1.3), "b": (label, size)}
    objects = [
        SceneObject(k, "r", x, x, np.zeros(3), aabb=round_mm([np.full(3, -s / 2), np.full(3, s / 2)]))
        for k, (x, s) in sides.items()
    ]
    referents = Referents.of(room, RoomArrays.of("r", objects), no_facts(2), vocabulary, 0.3)
    assert referents.anchors.tolist() == [0, 1]
    assert bool(referents.suits[0, 1]) is suits


@given(rooms_with_facts())
def test_refs_say_what_the_qualification_says(referents: Referents) -> None:
    ids, labels = referents.arrays.object_ids, referents.arrays.labels
    name = RoomRef(room_id="r", label="bedroom")
    for i in range(len(ids)):
        refs = object_refs(referents, i, name)
        assert bool(refs) == referents.usable[i]
        for ref in refs:
            assert (ref.object_id, ref.label, ref.room) == (ids[i], labels[i], name)
            assert (ref.qualifier is None) == referents.unique[i]
            if ref.qualifier is not None:
                anchors = [ids.index(name) for name in ref.qualifier.anchor_ids]
                assert ref.qualifier.anchor_labels == tuple(labels[anchor] for anchor in anchors)
                assert all(referents.unique[anchor] for anchor in anchors)


def named(*rooms: tuple[str, list[str], bool]) -> dict[str, tuple[RoomRef, ...]]:
    made = [made_room(f"r{k}", label, labels, complete=complete) for k, (label, labels, complete) in enumerate(rooms)]
    referents = [Referents.of(room, arrays, no_facts(len(arrays)), vocabulary, 0.3) for room, arrays in made]
    return room_refs(referents, vocabulary)


def test_a_room_alone_of_its_type_goes_by_its_label() -> None:
    refs = named(("kitchen", ["sink"], True), ("bathroom", ["sink"], False))
    assert refs["r0"] == (RoomRef(room_id="r0", label="kitchen"),)
    assert refs["r1"] == (RoomRef(room_id="r1", label="bathroom"),)


def test_rooms_of_one_type_go_by_what_only_one_of_them_has() -> None:
    refs = named(("bedroom", ["bed", "piano", "chair"], True), ("bedroom", ["bed", "armchair", "desk"], True))
    assert {r.anchor_label for r in refs["r0"]} == {"piano"}, "a bed is in both; an armchair may be called a chair"
    assert {r.anchor_label for r in refs["r1"]} == {"desk"}
    assert refs["r0"][0].anchor_id == "r0_01"


@pytest.mark.parametrize(
    "rooms",
    [
        [("bedroom", ["bed"], True), ("bedroom", ["bed"], True)],
        # two pianos: "the piano" does not fit
        [("bedroom", ["piano", "piano"], True), ("bedroom", ["bed", "bed"], True)],
        # the other bedroom may hold a piano that nobody annotated
        [("bedroom", ["piano"], False), ("bedroom", ["desk"], False)],
        [("unlabelled room", ["piano"], True), ("unlabelled room", ["desk"], True)],
        # "the room" might be any of them
        [("other room", ["bed"], True), ("unlabelled room", ["bed"], True)],
    ],
)
def test_rooms_that_cannot_be_told_apart_are_not_named(rooms: list[tuple[str, list[str], bool]]) -> None:
    assert named(*rooms) == {}


def test_room_types_that_share_a_word_count_as_one() -> None:
    assert "entryway" in vocabulary.overlapping_rooms("hallway")
    refs = named(("hallway", ["mirror", "bench"], True), ("entryway", ["mirror", "coat rack"], True))
    assert refs["r0"][0].anchor_label == "bench"
    assert refs["r1"][0].anchor_label == "coat rack"


def test_a_room_of_no_type_goes_by_what_no_other_room_of_any_type_has() -> None:
    refs = named(("other room", ["piano", "sink"], True), ("kitchen", ["sink"], True), ("porch", ["bench"], True))
    assert {r.anchor_label for r in refs["r0"]} == {"piano"}
    assert refs["r1"] == (RoomRef(room_id="r1", label="kitchen"),), "a kitchen would not be called a room of no type"


LANDMARKS = ("piano", "bathtub", "bed", "desk", "toilet", "refrigerator")
ROOM_TYPES = ("kitchen", "bedroom", "hallway", "entryway", "other room", "unlabelled room", "apartment", "no such room")


@given(st.lists(st.lists(st.sampled_from(ROOM_TYPES), min_size=1, max_size=len(LANDMARKS)), min_size=1, max_size=4))
def test_rooms_are_expected_to_be_asked_about_as_they_can_be_named(scenes: list[list[str]]) -> None:
    """A room that only an object could tell counts as such, whether or not it has one."""
    scene = np.repeat(np.arange(len(scenes)), [*map(len, scenes)]).astype(np.int32)
    types = np.array([ROOM_TYPES.index(one) for own in scenes for one in own], np.int32)
    weights = RoomWords(ROOM_TYPES, vocabulary).weights(scene, types)
    for k, own in enumerate(scenes):
        by_label = named(*((one, [], True) for one in own))
        by_landmark = named(*((one, [mark], True) for one, mark in zip(own, LANDMARKS, strict=False)))
        rooms = [f"r{number}" for number in range(len(own))]
        wanted = [1.0 if room in by_label else SHARED_WORD_WEIGHT * (room in by_landmark) for room in rooms]
        assert weights[scene == k].tolist() == wanted


def test_what_a_nameless_thing_may_be_names_no_other_room() -> None:
    made = [made_room("r0", "bedroom", ["piano", "vase"]), made_room("r1", "bedroom", ["decoration", "bed"])]
    referents = [Referents.of(room, a, no_facts(len(a)), vocabulary, 0.3, "mp3d") for room, a in made]
    assert {r.anchor_label for r in room_refs(referents, vocabulary)["r0"]} == {"piano"}, "a decoration may be a vase"


def test_a_single_room_needs_no_name() -> None:
    assert named(("apartment", ["sofa"], True)) == {"r0": (RoomRef(room_id="r0", label="apartment"),)}


SOME_LABELS = st.sampled_from(
    ("bed", "lamp", "table", "desk", "side table", "counter", "vase", "bowl", "no such label")
)


@given(
    st.lists(SOME_LABELS, max_size=5),
    st.lists(st.tuples(SOME_LABELS, st.frozensets(SOME_LABELS, max_size=3)), max_size=6),
)
def test_a_word_means_what_is_or_may_be_called_so(words: list[str], things: list[tuple[str, frozenset[str]]]) -> None:
    found = meant_by(words, [label for label, _ in things], [may_be for _, may_be in things], vocabulary)
    assert found.shape == (len(words), len(things))
    for word, row in zip(words, found.tolist(), strict=True):
        assert row == [bool(vocabulary.overlapping(word) & {label, *may_be}) for label, may_be in things]
