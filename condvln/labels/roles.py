"""What labels are good for as an anchor: fixed things, landmarks, portable ones, and those that things are put on."""

from __future__ import annotations

import csv
from functools import cache
from importlib.resources import files
from typing import Literal

__all__ = ["Role", "labels_with_role"]

Role = Literal["fixed", "landmark", "portable", "surface"]


@cache
def labels_with_role(role: Role) -> frozenset[str]:
    """Canonical labels of a role.

    fixed : built in or too heavy to move, so that smaller or larger things are said to be near it
    landmark : the same where it is large (`LANDMARK_SIZE`): a statue, not a figurine
    portable : carried about, so that nothing is found by it, whatever its size
    surface : things are put on it, so that people ask whether something is
    """
    text = files("condvln.labels").joinpath("roles.csv").read_text(encoding="utf-8")
    return frozenset(row["label"] for row in csv.DictReader(text.splitlines()) if row["role"] == role)
