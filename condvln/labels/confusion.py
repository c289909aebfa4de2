"""Labels that people disagree about: what one calls a bowl is a vase to another.

``confusion.csv`` lists directed pairs: some people would say `label` for a thing whose label is `other`. Where `low` is
yes, they do so only if the thing is no taller than its footprint is long.
"""

from __future__ import annotations

import csv
from collections.abc import Mapping
from functools import cache
from importlib.resources import files

__all__ = ["also_called"]


@cache
def also_called(*, low: bool) -> Mapping[str, frozenset[str]]:
    """Return, by label, the other labels that some people would use for a thing with this label. `low` tells whether
    the thing is no taller than its footprint is long.
    """
    text = files("condvln.labels").joinpath("confusion.csv").read_text(encoding="utf-8")
    found: dict[str, set[str]] = {}
    for row in csv.DictReader(text.splitlines()):
        if low or row["low"] == "no":
            found.setdefault(row["other"], set()).add(row["label"])
    return {other: frozenset(labels) for other, labels in found.items()}
