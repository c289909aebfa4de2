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
