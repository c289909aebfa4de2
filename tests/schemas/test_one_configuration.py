"""Numbers of ``schemas.config`` have one name and one place, and no two classes are copies of each other; read from the
syntax trees, so that nothing has to be imported."""

from __future__ import annotations

from typing import get_args

from condvln.instructions.likeness import SCANS
from condvln.samples import FAMILIES as WRITERS
from condvln.scene.containment import SCANNED
from condvln.sources.family import FAMILIES, downloads
from condvln.sources.registry import READERS
from condvln.verify.containment import FROM_SCANS
from jobs.costs import COEFFICIENTS
from schemas.config import Family


def test_every_list_of_families_is_the_same() -> None:
    names = set(get_args(Family))
    assert names == set(FAMILIES) == set(READERS) == set(WRITERS)
    assert all(downloads(name) for name in names)
    assert {FAMILIES[name].costs_like or name for name in names} == set(COEFFICIENTS)


def test_the_lists_of_scans_agree() -> None:
    """Scans of real buildings are licensed and not composed; three places treat them otherwise than designed homes."""
    scans = {name for name, family in FAMILIES.items() if family.licensed}
    assert scans == set(SCANNED) == set(SCANS) == set(FROM_SCANS)
    assert not any(FAMILIES[name].composed for name in scans)
