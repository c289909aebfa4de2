"""Expected draws beside their definition, scene by scene, and what fitted factors make of them."""

from __future__ import annotations

import itertools
from collections import defaultdict
from math import sqrt
from typing import NamedTuple

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from condvln.instructions.expected_draws import FULL_MASS, ExpectedDraws, fitted_log_factors
from condvln.instructions.statement_counts import numbered, of_each

PRESENCE = 2
"""The group of presence; 0 and 1 are groups of predicates."""


class Occurrence(NamedTuple):
    """A statement with one truth in a room. Each room holds one form of each group and definiteness."""

    scene: int
    room: int
    group: int
    definite: bool
    statement: int
    truth: bool
    weight: float


GROUP_WEIGHTS = (0.5, 0.3, 0.0)
ROOM_WEIGHTS = (1.0, 0.04)
PRESENCE_SHARE = 0.25
WEIGHTS = (0.02, 0.2, 0.5, 0.98)

occurrences = st.lists(
    st.builds(
        Occurrence,
        st.integers(0, 4),
        st.integers(0, 1),
        st.integers(0, PRESENCE),
        st.booleans(),
        st.integers(0, 5),
        st.booleans(),
        st.sampled_from(WEIGHTS),
    ),
    min_size=1,
    max_size=60,
    unique_by=lambda one: one[:-1],
)


def draws_of(rows: list[Occurrence]) -> ExpectedDraws:
    """Return the expected draws of whole scenes."""
    scene, place, group, definite, statement, truth, weight = map(np.array, zip(*rows, strict=True))
    room, _ = numbered(scene, place)
    form, _ = numbered(room, group, definite)
    kind, _ = numbered(room, group)
    scene_of_room = of_each(room, scene - scene.min())
    return ExpectedDraws(
        2 * statement + truth,
        weight,
        form=form,
        group_of_form=of_each(form, kind),
        room_of_group=of_each(kind, room),
        scene_of_room=scene_of_room,
        group_weights=of_each(kind, np.array(GROUP_WEIGHTS)[group]),
        presence=of_each(kind, np.where(group == PRESENCE, PRESENCE_SHARE, 0.0)),
        room_weights=of_each(room, np.array(ROOM_WEIGHTS)[place]),
    )


def defined(rows: list[Occurrence]) -> list[float]:
    """Return the draws of each occurrence by their definition.

    A scene chooses a room of which something can be asked by the room's weight, the room a group, the group a form by
    what it can be asked in either truth, the form a truth by a fair coin (counted as one draw of each truth), and then
    a statement by its weight.
    """
    rooms: dict[tuple[int, int], list[Occurrence]] = defaultdict(list)
    for one in rows:
        rooms[one.scene, one.room].append(one)

    def mass(form: list[Occurrence]) -> float:
        return min(sum(one.weight for one in form if one.truth is truth) for truth in (False, True))

    def forms(room: list[Occurrence], group: int) -> list[list[Occurrence]]:
        return [[o for o in room if o.group == group and o.definite is definite] for definite in (False, True)]

    chance: dict[tuple[tuple[int, int], int], float] = {}
    for place, room in rooms.items():
        masses = [sum(map(mass, forms(room, group))) for group in range(3)]
        usable = sum(weight for weight, own in zip(GROUP_WEIGHTS, masses, strict=True) if own > 0)
        asked = PRESENCE_SHARE * min(1.0, masses[PRESENCE])
        for group in range(3):
            part = (
                GROUP_WEIGHTS[group] * min(1.0, masses[group] / FULL_MASS) / usable if masses[group] and usable else 0
            )
            chance[place, group] = asked if group == PRESENCE else (1 - asked) * part
    whole = {place: sum(chance[place, group] for group in range(3)) for place in rooms}
    of_scene: dict[int, float] = defaultdict(float)
    for scene, room in rooms:
        of_scene[scene] += ROOM_WEIGHTS[room] if whole[scene, room] else 0.0
    for (scene, room), group in chance:
        if whole[scene, room]:
            chance[(scene, room), group] *= ROOM_WEIGHTS[room] / of_scene[scene] / whole[scene, room]
    found = []
    for one in rows:
        room = rooms[one.scene, one.room]
        group = forms(room, one.group)
        form, masses = group[one.definite], sum(map(mass, group))
        same = sum(other.weight for other in form if other.truth is one.truth)
        share = mass(form) / masses if masses else 0.0
        found.append(chance[(one.scene, one.room), one.group] * share * one.weight / same)
    return found


@given(occurrences)
def test_draws_are_as_defined(rows: list[Occurrence]) -> None:
    draws = draws_of(rows)
    assert draws.expected(draws.weights) == pytest.approx(defined(rows), abs=1e-12)


@given(occurrences, st.sets(st.integers(1, 4)), st.sampled_from((0.0, 30.0)))
def test_factors_do_not_depend_on_blocks(rows: list[Occurrence], cuts: set[int], added: float) -> None:
    rows.sort(key=lambda one: one.scene)
    excess = np.where(np.arange(6) % 2, 0.9, -0.9)
    bounds = [0, *sorted(cuts), 5]
    parts = [[o for o in rows if low <= o.scene < high] for low, high in itertools.pairwise(bounds)]
    blocks = [draws_of(part) for part in parts if part]
    whole = fitted_log_factors([draws_of(rows)], excess, added)
    assert fitted_log_factors(blocks, excess, added).tolist() == whole.tolist()


@pytest.mark.parametrize("aimed", [0.0, 0.9])
def test_the_excess_is_that_of_a_coin(aimed: float) -> None:
    """Of each pair of statements one is true where the other is false, so that all aims can be reached at once."""
    told = np.random.default_rng(3).random((40, 3)) < (0.75, 0.5, 0.4)
    rows = [
        Occurrence(k, 0, 0, False, 2 * pair + other, bool(told[k, pair]) is not bool(other), 0.3 + 0.1 * pair)
        for k, pair, other in np.ndindex(40, 3, 2)
    ]
    draws = draws_of(rows)
    own, signs = draws.code // 2, np.where(draws.code % 2, 1, -1)
    wanted = np.where(np.arange(6) % 2, -aimed, aimed)
    log_factors = fitted_log_factors([draws], wanted)
    drawn = draws.expected(draws.weights * np.exp2(signs * log_factors[own]))
    before = draws.expected(draws.weights)
    for statement in range(6):
        of = own == statement
        coin = sqrt((before[of] ** 2).sum()) / before[of].sum()
        found = (signs * drawn)[of].sum() / drawn[of].sum()
        assert found == pytest.approx(wanted[statement] * coin, abs=1e-6)
    assert abs((signs * before)[own == 0].sum()) > 0.2 * before[own == 0].sum(), "it was uneven"
    assert fitted_log_factors([draws], wanted, 1e9) == pytest.approx(0.0, abs=1e-6), "added scenes keep the weights"
