"""Every name of an object or room fits it and nothing else: proven by going through all pairs one by one."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from condvln.instructions.predicates import PREDICATE_GROUPS, PREDICATES
from condvln.instructions.referents import Referents, object_refs, room_refs
from condvln.labels import vocabulary
from condvln.scene import Room, RoomArrays, SceneObject
from schemas.program import RoomRef

LABELS = ("chair", "armchair", "lamp", "floor lamp", "bed", "sofa", "wall", "table", "desk", "no such thing")


@dataclass(frozen=True)
class MadeFacts:
    status: dict[str, NDArray[np.int8]]
    margin: dict[str, NDArray[np.float64]]


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
    return MadeFacts({p: np.full((n, n), -1, np.int8) for p in PREDICATES}, {p: np.zeros((n, n)) for p in PREDICATES})


@st.composite
def rooms_with_facts(draw: st.DrawFn) -> Referents:
    labels = draw(st.lists(st.sampled_from(LABELS), min_size=1, max_size=9))
    rng = np.random.default_rng(draw(st.integers(0, 2**32)))
    n = len(labels)
    # Mostly false, as in real rooms; else no qualifier would ever exclude all rivals.
    status = {p: rng.choice([-1, -1, -1, 0, 1], size=(n, n)).astype(np.int8) for p in PREDICATES}
    margin = {p: rng.uniform(0.5, 2.0, size=(n, n)) for p in PREDICATES}
    for table in status.values():
        np.fill_diagonal(table, 0)
    some = st.lists(st.integers(0, n - 1), max_size=2).map(tuple)
    room, arrays = made_room("r", "bedroom", labels, hidden=draw(some), without_extent=draw(some))
    return Referents.of(room, arrays, MadeFacts(status, margin), vocabulary, 0.3)


def rivals_of(referents: Referents, i: int) -> list[int]:
    labels = referents.arrays.labels
    return [
        j
        for j in range(len(labels))
        if j != i
        and not referents.arrays.objects[j].hidden
        and (labels[j] in vocabulary.overlapping(labels[i]) or labels[i] in vocabulary.overlapping(labels[j]))
    ]


def ways_of(referents: Referents, i: int) -> set[tuple[str, int]]:
    """All (predicate, anchor) that make i unique, by definition."""
    labels, status = referents.arrays.labels, referents.facts.status
    objects = referents.arrays.objects
    rivals = rivals_of(referents, i)
    if not vocabulary.fit_for_text(labels[i]) or not rivals or objects[i].hidden:
        return set()
    return {
        (p, a)
        for p in PREDICATES
        for a in range(len(labels))
        if vocabulary.fit_for_text(labels[a])
        and not objects[a].hidden
        and objects[a].box is not None
        and not rivals_of(referents, a)
        and status[p][i, a] == 1
        and all(status[p][j, a] == -1 for j in rivals)
    }


@given(rooms_with_facts())
def test_names_fit_one_object_only(referents: Referents) -> None:
    for i, label in enumerate(referents.arrays.labels):
        seen = not referents.arrays.objects[i].hidden
        unique = seen and vocabulary.fit_for_text(label) and not rivals_of(referents, i)
        ways = ways_of(referents, i)
        taken = [(q.predicate, q.anchor) for q in referents.qualifications[i]]
        assert referents.unique[i] == unique
        assert set(taken) <= ways, "a qualifier must be necessary and sufficient"
        assert len(set(taken)) == len(taken)
        assert referents.usable[i] == (unique or bool(ways)), "what can be told apart is not given up"


def test_a_hidden_object_is_never_named_and_spoils_no_name() -> None:
    room, arrays = made_room("r", "bedroom", ["bed", "lamp", "lamp", "lamp"], hidden=(1, 3))
    referents = Referents.of(room, arrays, no_facts(4), vocabulary, 0.3)
    assert referents.unique.tolist() == [True, False, True, False]
    assert referents.usable.tolist() == [True, False, True, False]


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
                referents.facts.margin[p][i, a]
                for p, a in ways_of(referents, i)
                if p in predicates and (p, a) not in {(q.predicate, q.anchor) for q in taken}
            ]
            assert kept == sorted(kept, reverse=True)
            if kept and passed_over:
                assert min(kept) >= max(passed_over), group


def test_small_anchors_only_for_want_of_larger_ones() -> None:
    room = Room("r", "bedroom", "bedroom", 0, 0.0, 2.5, None, "dataset", True)
    sizes = {"a": ("lamp", 0.4), "b": ("lamp", 0.4), "c": ("book", 0.1), "d": ("bed", 2.0)}
    objects = [
        SceneObject(k, "r", x, x, np.zeros(3), aabb=np.array([np.full(3, -s / 2), np.full(3, s / 2)]))
        for k, (x, s) in sizes.items()
    ]
    facts = no_facts(4)
    facts.status["near"][0, [2, 3]] = 1
    facts.margin["near"][0, 2] = 9.0
    anchors = [
        q.anchor for q in Referents.of(room, RoomArrays.of("r", objects), facts, vocabulary, 0.3).qualifications[0]
    ]
    assert anchors == [3, 2], "the bed before the book, whatever the margins"


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
                anchor = ids.index(ref.qualifier.anchor_id)
                assert ref.qualifier.anchor_label == labels[anchor]
                assert referents.unique[anchor]


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


def test_what_a_nameless_thing_may_be_names_no_other_room() -> None:
    made = [made_room("r0", "bedroom", ["piano", "vase"]), made_room("r1", "bedroom", ["decoration", "bed"])]
    referents = [Referents.of(room, a, no_facts(len(a)), vocabulary, 0.3, "mp3d") for room, a in made]
    assert {r.anchor_label for r in room_refs(referents, vocabulary)["r0"]} == {"piano"}, "a decoration may be a vase"


def test_a_single_room_needs_no_name() -> None:
    assert named(("apartment", ["sofa"], True)) == {"r0": (RoomRef(room_id="r0", label="apartment"),)}
