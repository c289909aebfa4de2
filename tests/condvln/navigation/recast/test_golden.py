"""Whole builds against navmeshes that Habitat's own builder made."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from condvln.navigation.navmesh_file import compare_navmeshes, read_navmesh
from condvln.navigation.recast import build_navmesh

NAMES = ["apt1", "apt2", *(f"s{k}" for k in range(30))]
PROFILES = {"habitat>=0.3.4": ".navmesh", "habitat<=0.3.3": ".profile-0.3.3.navmesh"}


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("profile", PROFILES)
def test_every_byte_is_habitats(real_data: Path, name: str, profile: str) -> None:
    folder = real_data / "navmesh_golden" / "build"
    golden = read_navmesh(folder / (name + PROFILES[profile]))
    with np.load(folder / f"{name}.npz") as mesh:
        built = build_navmesh(mesh["vertices"], mesh["faces"], golden.settings, profile)
    assert built.to_bytes() == golden.to_bytes(), str(compare_navmeshes(built, golden))
