"""Fixtures shared by all tests."""

from __future__ import annotations

import os
from pathlib import Path

import pytest
from hypothesis import HealthCheck, settings

# Deadlines are off because the machines are shared; numba's first call alone takes seconds.
settings.register_profile("condvln", deadline=None, suppress_health_check=[HealthCheck.too_slow], print_blob=True)
# CI draws the same examples every time, so that it judges the change and not the day; people draw new ones.
settings.register_profile("ci", settings.get_profile("condvln"), derandomize=True)
settings.load_profile("ci" if os.environ.get("CI") else "condvln")

REPOSITORY = Path(__file__).resolve().parents[1]


@pytest.fixture(scope="session")
def repository() -> Path:
    """Root folder of this checkout."""
    return REPOSITORY


@pytest.fixture(scope="session")
def real_data() -> Path:
    """Folder of the real datasets (CONDVLN_REAL_DATA, or ``shared/data`` beside the checkout)."""
    folder = Path(os.environ.get("CONDVLN_REAL_DATA", REPOSITORY.parent / "shared" / "data"))
    if not folder.is_dir():
        pytest.skip(
            "no real datasets here: set CONDVLN_REAL_DATA to the folder that holds replicacad/, navmesh_golden/ …"
        )
    return folder
