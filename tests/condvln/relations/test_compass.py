"""Sectors and canonical predicates at their exact edges."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from condvln.relations.directions import (
    CANONICAL,
    SECTORS,
    canonical_codes,
    sector_deviation,
    sectors,
)


def sector(azimuth: float) -> str:
    return SECTORS[int(sectors(np.array(azimuth)))]


@pytest.mark.parametrize(
    ("azimuth", "name"),
    [
        (0.0, "east"),
        (22.5, "north-east"),
        (np.nextafter(22.5, 0.0), "east"),
        (-22.5, "east"),
        (np.nextafter(-22.5, -90.0), "south-east"),
        (45.0, "north-east"),
        (67.5, "north"),
        (90.0, "north"),
        (112.5, "north-west"),
        (135.0, "north-west"),
        (157.5, "west"),
        (180.0, "west"),
        (-180.0, "west"),
        (-157.5, "south-west"),
        (np.nextafter(-157.5, -180.0), "west"),
        (-112.5, "south"),
        (-90.0, "south"),
        (-67.5, "south-east"),
    ],
)
def test_sectors_are_closed_below_and_open_above(azimuth: float, name: str) -> None:
    assert sector(azimuth) == name


@given(st.floats(-180, 180))
def test_a_sector_is_that_of_the_nearest_centre(azimuth: float) -> None:
    deviation = np.array([sector_deviation(np.array(azimuth), k) for k in range(len(SECTORS))])
    assert deviation[int(sectors(np.array(azimuth)))] == pytest.approx(deviation.min(), abs=1e-9)
    assert deviation.min() <= 22.5
    assert np.sort(deviation)[:2].sum() == pytest.approx(45.0, abs=1e-9)


def code(azimuth: float, elevation: float, dy: float) -> int:
    return int(canonical_codes(np.array(azimuth), np.array(elevation), np.array(dy), 22.5))


@pytest.mark.parametrize(
    ("elevation", "predicate"),
    [
        (0.0, "east of"),
        (np.nextafter(22.5, 0.0), "east of"),
        (22.5, "east-and-up of"),
        (89.0, "east-and-up of"),
        (np.nextafter(-22.5, 0.0), "east of"),
        (-22.5, "east-and-down of"),
    ],
)
def test_level_is_open_at_both_ends(elevation: float, predicate: str) -> None:
    assert CANONICAL[code(10.0, elevation, np.sign(elevation))] == predicate
