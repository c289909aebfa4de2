"""The catalogue's labels in the words of each source family, from ``native_labels.csv``.

If a family has a class for exactly the labelled object, this class is used (AI2-THOR's ``Fridge``, COCO's ``potted
plant`` in Gibson, Matterport3D's raw categories); otherwise the everyday word in the family's spelling.
"""

from __future__ import annotations

import csv
from dataclasses import dataclass
from functools import cache
from importlib import resources

__all__ = ["NativeLabel", "native_labels"]


@dataclass(frozen=True, slots=True)
class NativeLabel:
    """One label in the words of AI2-THOR, Gibson and Matterport3D, with Matterport's mpcat40 index."""

    ai2thor: str
    gibson: str
    mp3d: str
    mpcat40: int


@cache
def native_labels() -> dict[str, NativeLabel]:
    """Return the native labels, keyed by the catalogue's labels."""
    text = resources.files("condvln.samples").joinpath("native_labels.csv").read_text(encoding="utf-8")
    return {
        row["label"]: NativeLabel(row["ai2thor"], row["gibson"], row["mp3d"], int(row["mpcat40"]))
        for row in csv.DictReader(text.splitlines())
    }
