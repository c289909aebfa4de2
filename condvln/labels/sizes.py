"""The sizes that a label is trusted for in a scan, whose boxes were drawn by people or by a detector."""

from __future__ import annotations

import csv
import math
from collections.abc import Mapping
from functools import cache
from importlib.resources import files
from typing import NamedTuple

__all__ = ["SizeBounds", "plausible_sizes"]


class SizeBounds(NamedTuple):
    """Bounds of the box of an object with some label.

    least, most : of the longest side in metres
    thickness : the greatest shortest side in metres
    low, high : the least and the greatest height in metres
    ratio : the greatest ratio of the sides of the footprint
    upright : the object is at least as tall as its footprint is long
    """

    least: float
    most: float
    thickness: float = math.inf
    low: float = 0.0
    high: float = math.inf
    ratio: float = math.inf
    upright: bool = False


@cache
def plausible_sizes() -> Mapping[str, SizeBounds]:
    """Return the bounds of the boxes of objects by canonical label, from ``sizes.csv``; an empty cell sets no bound.

    The table was written by hand from the sizes of labelled models and of scans that people checked
    (``python -m benchmarks.label_sizes``). A label that is not in it is trusted whatever the size.
    """
    text = files("condvln.labels").joinpath("sizes.csv").read_text(encoding="utf-8")
    return {
        row["label"]: SizeBounds(
            least=float(row["least"]),
            most=float(row["most"]),
            thickness=float(row["thickness"] or math.inf),
            low=float(row["low"] or 0.0),
            high=float(row["high"] or math.inf),
            ratio=float(row["ratio"] or math.inf),
            upright=row["upright"] == "yes",
        )
        for row in csv.DictReader(text.splitlines())
    }
