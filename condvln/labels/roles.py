"""The roles of labels as anchors of a qualifier: fixed objects, landmarks, portable objects, supporting surfaces."""

from __future__ import annotations

import csv
from functools import cache
from importlib.resources import files
from typing import Literal

__all__ = ["Role", "labels_with_role"]

Role = Literal["fixed", "landmark", "portable", "surface", "worktop"]


@cache
def labels_with_role(role: Role) -> frozenset[str]:
    """Return the canonical labels of a role, from ``roles.csv``.

    fixed : built in or too heavy to move, so that text may use it as an anchor for objects of any size
    landmark : like fixed, if the object is at least `LANDMARK_SIZE` large: a statue, not a figurine
    portable : often carried about, so that text never uses it as an anchor
    surface : things are put on it, so that text may ask whether something is on it
    worktop : called a counter where it is as high as one (`COUNTER_HEIGHT`) and as large
    """
    text = files("condvln.labels").joinpath("roles.csv").read_text(encoding="utf-8")
    return frozenset(row["label"] for row in csv.DictReader(text.splitlines()) if row["role"] == role)
