"""What nobody sees is not spoken of, spoils no name, and blocks claims of absence."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from condvln.instructions.conditions import ConditionPool
from condvln.instructions.predicates import PREDICATES
from condvln.instructions.priors import PriorBits
from condvln.instructions.referents import Referents, object_refs
from condvln.instructions.statements import statement_truths
from condvln.labels import vocabulary
from condvln.scene import RoomArrays
from condvln.scene.scene import Sightings
from schemas.program import RoomRef
from tests.condvln.instructions.test_referents import LABELS, MadeFacts, made_room

ROOM = RoomRef(room_id="r", label="bedroom")


@st.composite
def half_seen_rooms(draw: st.DrawFn) -> tuple[Referents, Referents, Referents]:
    """A room with what is unseen, the same room without these things, and with them seen."""
    labels = draw(st.lists(st.sampled_from(LABELS), min_size=2, max_size=9))
    out = np.array(draw(st.lists(st.booleans(), min_size=len(labels), max_size=len(labels))), dtype=bool)
    rng = np.random.default_rng(draw(st.integers(0, 2**32)))
    n = len(labels)
    status = {p: rng.choice([-1, -1, -1, 0, 1], size=(n, n)).astype(np.int8) for p in PREDICATES}
    margin = {p: rng.uniform(0.5, 2.0, size=(n, n)) for p in PREDICATES}
    room, arrays = made_room("r", "bedroom", labels)
    sightings = Sightings(frozenset(np.array(arrays.object_ids)[out].tolist()))
    facts = MadeFacts(status, margin)
    kept = np.flatnonzero(~out)
    fewer = RoomArrays.of("r", [arrays.objects[k] for k in kept])
    fewer_facts = MadeFacts(*({p: t[p][np.ix_(kept, kept)] for p in PREDICATES} for t in (status, margin)))
    return (
        Referents.of(room, arrays, facts, vocabulary, 0.3, sightings=sightings),
        Referents.of(room, fewer, fewer_facts, vocabulary, 0.3),
        Referents.of(room, arrays, facts, vocabulary, 0.3),
    )


@given(half_seen_rooms())
def test_names_are_those_of_the_room_without_what_is_unseen(rooms) -> None:
    partly, without, _ = rooms
    names = {name: k for k, name in enumerate(without.arrays.object_ids)}
    for k, name in enumerate(partly.arrays.object_ids):
        if name in names:
            assert object_refs(partly, k, ROOM) == object_refs(without, names[name], ROOM)
        else:
            assert not partly.usable[k]
            assert not partly.nameable[k]


@given(half_seen_rooms())
def test_a_relation_is_true_by_what_is_seen_and_false_by_all(rooms) -> None:
    partly, without, whole = rooms
    ids = partly.arrays.object_ids
    of_all = {t.predicate: t for t in statement_truths(whole, vocabulary)}
    of_seen = {t.predicate: t for t in statement_truths(without, vocabulary)}
    for truths in statement_truths(partly, vocabulary):
        seen = of_seen[truths.predicate]
        assert truths.labels == seen.labels
        anchors = [tuple(ids[a] for a in those) for those in truths.anchors]
        assert anchors == [tuple(without.arrays.object_ids[a] for a in those) for those in seen.anchors]
        np.testing.assert_array_equal(truths.true, seen.true)
        assert not (truths.false & ~seen.false).any()
        if truths.predicate not in of_all:
            continue  # with all things seen none is alone under its label
        every = of_all[truths.predicate]
        rows = [every.labels.index(label) for label in truths.labels]
        known = {tuple(whole.arrays.object_ids[a] for a in those): k for k, those in enumerate(every.anchors)}
        for column, anchor in enumerate(anchors):
            if anchor in known:
                np.testing.assert_array_equal(truths.false[:, column], every.false[rows, known[anchor]])


def _absent(labels: list[str], sightings: Sightings) -> set[str]:
    room, arrays = made_room("r", "bedroom", labels)
    n = len(labels)
    facts = MadeFacts(*({p: np.zeros((n, n), kind) for p in PREDICATES} for kind in (np.int8, float)))
    bits = PriorBits({"bedroom": frozenset(LABELS)}, {"bedroom": frozenset(LABELS)}, {})
    referents = Referents.of(room, arrays, facts, vocabulary, 0.3, sightings=sightings)
    presence = ConditionPool.of(referents, bits, LABELS, vocabulary).presence
    return set() if presence is None else {q.label for q in presence.questions[False]}


@pytest.mark.parametrize("kind", ["unseen", "doubtful"])
def test_nothing_is_said_to_be_absent_that_is_there_unseen(kind: str) -> None:
    sightings = Sightings(**{kind: frozenset({"r_01"})})
    assert "lamp" in _absent(["bed", "desk"], Sightings())
    assert "lamp" not in _absent(["bed", "lamp"], sightings)
    assert not _absent(["bed", "armchair"], sightings) & {"chair", "armchair"}


def test_a_word_that_might_mean_a_doubtful_thing_is_not_used() -> None:
    room, arrays = made_room("r", "bedroom", ["armchair", "chair", "bed"])
    facts = MadeFacts(*({p: np.zeros((3, 3), kind) for p in PREDICATES} for kind in (np.int8, float)))
    doubtful = Referents.of(room, arrays, facts, vocabulary, 0.3, sightings=Sightings(doubtful=frozenset({"r_01"})))
    assert doubtful.unique.tolist() == [False, False, True]
    unseen = Referents.of(room, arrays, facts, vocabulary, 0.3, sightings=Sightings(unseen=frozenset({"r_01"})))
    assert unseen.unique.tolist() == [True, False, True]


def test_what_a_shut_container_hides_is_unseen() -> None:
    room, arrays = made_room("r", "bedroom", ["armchair", "chair", "bed"])
    shut = RoomArrays.of("r", [dataclasses.replace(o, hidden=o.label == "chair") for o in arrays.objects])
    facts = MadeFacts(*({p: np.zeros((3, 3), kind) for p in PREDICATES} for kind in (np.int8, float)))
    assert Referents.of(room, shut, facts, vocabulary, 0.3).unique.tolist() == [True, False, True]
