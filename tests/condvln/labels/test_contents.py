"""A room without a type of its own has the type that shows in what it holds; the verifier decides the same. What is
worth going to and worth asking about.
"""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from condvln.labels import vocabulary
from condvln.labels.lists import UNLISTED, _rows, belongs_by, goes_with, types_by_contents, worth
from condvln.verify.words import words

PEWS = ("pew",) * 3
HELD = st.lists(st.sampled_from(["pew", "altar", "toilet", "treadmill", "sink", "bed"]), max_size=8)
TYPES = st.sampled_from(["other room", "nave", "kitchen", "unlabelled room"])


@pytest.mark.parametrize(
    ("types", "held", "expected"),
    [
        (("other room",), (PEWS,), ("nave",)),
        (("other room",), (PEWS[1:],), ("other room",)),
        (("lounge",), (PEWS,), ("lounge",)),
        (("other room", "other room"), (PEWS, ("altar", "altar")), ("nave", "chancel")),
        # Without a nave it is any room with an altar, perhaps a shrine at home.
        (("other room", "kitchen"), (("altar",), PEWS), ("other room", "kitchen")),
        (("other room",), (("toilet", "sink"),), ("bathroom",)),
        (("other room",), (("toilet", "washing machine"),), ("other room",)),
        (("other room",), ((),), ("other room",)),
    ],
)
def test_types_show_in_contents(
    types: tuple[str, ...], held: tuple[tuple[str, ...], ...], expected: tuple[str, ...]
) -> None:
    names = [f"r{k}" for k in range(len(types))]
    found = types_by_contents(dict(zip(names, types, strict=True)), dict(zip(names, held, strict=True)), vocabulary)
    assert tuple(found.values()) == expected


def test_every_type_and_label_of_the_table_is_in_the_vocabulary() -> None:
    for room_type, label, least, beside in words()._contents:
        assert vocabulary.room(room_type).fit_for_text
        assert not vocabulary.room(room_type).general
        assert vocabulary.fit_for_text(label)
        assert least >= 1
        assert not beside or beside in vocabulary.room_labels


@given(st.lists(st.tuples(TYPES, HELD), min_size=1, max_size=4))
def test_rooms_with_a_type_keep_it_and_order_does_not_matter(rooms: list[tuple[str, list[str]]]) -> None:
    types = {f"r{k}": room_type for k, (room_type, _) in enumerate(rooms)}
    held = {f"r{k}": labels for k, (_, labels) in enumerate(rooms)}
    found = types_by_contents(types, held, vocabulary)
    assert all(found[name] == room_type for name, room_type in types.items() if room_type != "other room")
    turned = types_by_contents(
        dict(reversed(types.items())), {name: labels[::-1] for name, labels in held.items()}, vocabulary
    )
    assert turned == found


def test_what_goes_together_is_known_and_mutual() -> None:
    rows = [(row["purpose"], row["label"], row["part"]) for row in _rows("affinity")]
    assert rows == sorted({*rows}), "each once, in order"
    assert {label for _, label, _ in rows} <= {*vocabulary.labels}
    assert {part for _, _, part in rows} == {"thing", "place"}
    together = goes_with()
    assert all(label in together[other] and label != other for label in together for other in together[label])
    assert "washing machine" in together["towel"]
    assert "television" not in together["towel"]
    assert all(places <= together[thing] for thing, places in belongs_by().items())
    assert "desk" in belongs_by()["book"]
    assert "book" not in belongs_by().get("desk", ())


def test_each_label_has_a_worth_between_0_and_1() -> None:
    rows = [(row["label"], row["room"]) for row in _rows("worth")]
    assert rows == sorted({*rows}), "each once, in order"
    assert {label for label, room in rows if not room} == {*vocabulary.labels}
    assert {label for label, _ in rows} == {*vocabulary.labels}
    assert {room for _, room in rows} <= {"", *vocabulary.room_labels}
    assert all(0.0 <= value <= 1.0 for row in rows for value in worth(*row))
    assert worth("no such label", "kitchen") == UNLISTED
    assert worth("refrigerator", "kitchen").presence < worth("refrigerator", "garage").presence
    for silly in ("pen", "plunger", "faucet", "potato", "toilet paper roll", "light switch"):
        assert worth(silly, "bathroom").goto == 0.0
