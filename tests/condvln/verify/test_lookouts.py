"""Where an episode is looked around from, against closed forms and the factory's places."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from condvln.episodes.observability import common_prefix
from condvln.verify import observability
from condvln.verify.observability import measured, stands
from schemas.config.constants import EYE_SPACING, PREFIX_SAMPLES


def way(*corners: tuple[float, float]) -> np.ndarray:
    return np.array([[x, 0.0, z] for x, z in corners])


def shared_length(ways: list[np.ndarray]) -> float:
    return observability.shared_length(*measured(ways))


def test_ways_at_a_right_angle_part_a_step_s_diagonal_after_the_fork() -> None:
    # At s beyond the fork they are √2 s apart: 0.212 m at 0.15 m, 0.283 m at 0.2 m.
    ways = [way((0, 0), (2, 0), (2, 3)), way((0, 0), (2, 0), (5, 0))]
    assert shared_length(ways) == pytest.approx(2.15)
    assert shared_length(ways[::-1]) == pytest.approx(2.15)
    (places,) = stands(ways)
    np.testing.assert_allclose(np.diff(np.linspace(0, 2.15, 6)), 0.43)
    np.testing.assert_allclose(places[:5], way(*((0.43 * k, 0) for k in range(5))), atol=1e-12)
    np.testing.assert_allclose(places[5], [2.0, 0.0, 0.15], atol=1e-12)


def test_ways_to_opposite_sides_share_their_start() -> None:
    ways = [way((0, 0), (9, 0)), way((0, 0), (-9, 0)), way((0, 0), (0, 9))]
    assert shared_length(ways) == pytest.approx(0.1)
    assert shared_length([way((0, 0), (0, 0)), way((0, 0), (4, 0))]) == 0.0


def test_the_same_way_is_shared_to_the_shortest_end() -> None:
    ways = [way((0, 0), (1.23, 0)), way((0, 0), (7, 0))]
    assert shared_length(ways) == pytest.approx(1.23)


def test_a_whole_number_of_looks_may_be_cut_in_either_number_of_parts() -> None:
    assert [len(places) for places in stands([way((0, 0), (1.5, 0))] * 2)] == [4, 5]
    assert [len(places) for places in stands([way((0, 0), (1.4, 0))] * 2)] == [4]


corner = st.tuples(st.floats(-5, 5), st.floats(-5, 5)).map(lambda at: (round(at[0], 3), round(at[1], 3)))


@settings(max_examples=200)
@given(st.lists(st.lists(corner, min_size=1, max_size=4), min_size=2, max_size=4), st.lists(corner, max_size=2))
def test_the_places_are_the_factory_s(tails, shared) -> None:
    ways = [way((0, 0), *shared, *tail) for tail in tails]
    prefix = common_prefix(ways)
    answers = stands(ways)
    sides = np.linalg.norm(np.diff(prefix, axis=0), axis=1)
    assert sides.sum() == pytest.approx(shared_length(ways), abs=PREFIX_SAMPLES / 1e6)
    walked = np.concatenate([[0.0], np.cumsum(sides)])
    count = max(1, int(np.ceil(walked[-1] / EYE_SPACING)))
    at = np.linspace(0.0, walked[-1], count + 1)
    theirs = np.stack([np.interp(at, walked, prefix[:, axis]) for axis in range(3)], axis=1)
    (fitting,) = [places for places in answers if len(places) == len(theirs)]
    np.testing.assert_allclose(fitting, theirs, atol=1e-9)
