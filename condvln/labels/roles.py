"""The roles of labels: fixed and portable objects, landmarks, supporting surfaces, parts of furniture and others."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from functools import cache
from importlib.resources import files
from typing import Literal

import numpy as np
from numpy.typing import NDArray

__all__ = ["Role", "have_role", "labels_with_role"]

Role = Literal[
    "carpet", "desktop", "fixed", "landmark", "low table", "part", "portable", "screen", "seat", "surface", "worktop"
]


@cache
def labels_with_role(role: Role) -> frozenset[str]:
    """Return the canonical labels of a role, from ``roles.csv``.

    carpet : things that stand on it, or at its edge, form a group
    desktop : stands before a computer's monitor, and so tells it from a television
    fixed : built in or too heavy to move, so that text may use it as an anchor for objects of any size
    landmark : like fixed, if the object is at least `LANDMARK_SIZE` large: a statue, not a figurine
    low table : things that stand around it form a group
    part : belongs to the furniture that its box is inside of, so that text does not name it there
    portable : often carried about, so that text never uses it as an anchor
    screen : a television or a monitor, which boxes of a scan do not distinguish
    seat : seats one person, so that a long box of a scan may be two
    surface : things are put on it, so that text may ask whether something is on it
    worktop : called a counter where it is as high as one (`COUNTER_HEIGHT`) and as large, and a side table where it is
        short (`SIDE_TABLE_LENGTH`)
    """
    text = files("condvln.labels").joinpath("roles.csv").read_text(encoding="utf-8")
    return frozenset(row["label"] for row in csv.DictReader(text.splitlines()) if row["role"] == role)


def have_role(labels: Sequence[str], role: Role) -> NDArray[np.bool_]:
    """Return a mask (n,) of those of n canonical labels that have a role. For a room's labels, `numpy.isin` would take
    twenty times as long.
    """
    found = labels_with_role(role)
    return np.array([label in found for label in labels], dtype=np.bool_)
