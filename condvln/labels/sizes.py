"""The sizes that a label is trusted for in a scan, whose boxes were drawn by people or by a detector."""

from __future__ import annotations

import csv
from collections.abc import Mapping
from functools import cache
from importlib.resources import files

__all__ = ["plausible_sizes"]


@cache
def plausible_sizes() -> Mapping[str, tuple[float, float]]:
    """Return the least and the greatest longest side in metres of objects with a canonical label, from ``sizes.csv``.

    The table was written by hand from the sizes of labelled models and of scans that people checked
    (``python -m benchmarks.label_sizes``). A label that is not in it is trusted whatever the size.
    """
    text = files("condvln.labels").joinpath("sizes.csv").read_text(encoding="utf-8")
    return {row["label"]: (float(row["least"]), float(row["most"])) for row in csv.DictReader(text.splitlines())}
