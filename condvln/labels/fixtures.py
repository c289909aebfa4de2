"""What nearly every room of a type has, whether the annotation of a scan shows it or not.

``fixtures.csv`` lists a room type and a label a row; an empty room type stands for all. A room without a label that is
`required` is taken to be annotated only in part: nobody sleeps in a bedroom without a bed.
"""

from __future__ import annotations

import csv
from functools import cache
from importlib.resources import files

__all__ = ["fixtures_of", "required_in"]


@cache
def fixtures_of(room_type: str) -> frozenset[str]:
    """Return the labels that a scan may lack in a room of a type though the real room has such a thing."""
    return frozenset(label for of, label, _ in _rows() if of in ("", room_type))


@cache
def required_in(room_type: str) -> frozenset[str]:
    """Return the labels without which the annotation of a room of a type is taken to be incomplete."""
    return frozenset(label for of, label, required in _rows() if of == room_type and required)


@cache
def _rows() -> tuple[tuple[str, str, bool], ...]:
    text = files("condvln.labels").joinpath("fixtures.csv").read_text(encoding="utf-8")
    rows = csv.DictReader(text.splitlines())
    return tuple((row["room_type"], row["label"], row["required"] == "yes") for row in rows)
