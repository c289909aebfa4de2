"""Fixtures for the tests of all folders of ``condvln``."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from tests.condvln.glb_boxes import box_glb


@pytest.fixture(scope="session")
def glb_of_box() -> Callable[..., bytes]:
    return box_glb
