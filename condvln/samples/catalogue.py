"""The kinds of objects in generated apartments, read from ``catalogue.csv``: label, sizes, shape, placement; and the
records of native formats, read from ``records.yaml``.

Every kind comes in a few sizes (variants), so that scenes share models as real datasets do. ``native_labels.csv`` has
the labels in the words of each source family: its class for exactly the labelled object if it has one (AI2-THOR's
``Fridge``, COCO's ``potted plant`` in Gibson, Matterport3D's raw categories), else the everyday word in its spelling.
"""

from __future__ import annotations

import sys
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from typing import Any, Final

import yaml

from condvln.own_tables import own_rows, own_text

__all__ = ["VARIANTS", "Kind", "NativeLabel", "catalogue", "class_ids", "native_labels", "record"]


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
    return {
        row["label"]: NativeLabel(row["ai2thor"], row["gibson"], row["mp3d"], int(row["mpcat40"]))
        for row in own_rows("condvln.samples", "native_labels.csv")
    }


VARIANTS: Final = 4
"""Number of sizes of each kind."""

ARTICULATED_SCALES: Final = (0.9, 0.96, 1.0, 1.1)
"""Scales of articulated kinds, which are one body scaled as a whole; they keep its half sizes in whole millimetres."""


@dataclass(frozen=True, slots=True)
class Kind:
    """One row of the catalogue; lengths are millimetres.

    Attributes
    ----------
    kind, label : its name in the catalogue, and the everyday word used as its class in every dataset
    sizes : (width, height, depth) of each variant, all even, so that half sizes are integers
    shape : name of its geometry in ``condvln.samples.models``
    hang : height of its lower edge if it hangs on a wall, else None
    front : depth kept free in front of it
    turns : may be placed at an angle that is not a multiple of 90°
    urdf : name of its articulated body, if it is one, with `scales` by variant
    number : position in the catalogue, from 1: the semantic id of its class is derived from it
    """

    kind: str
    label: str
    sizes: tuple[tuple[int, int, int], ...]
    shape: str
    hang: int | None
    front: int
    turns: bool
    urdf: str | None
    number: int

    @property
    def scales(self) -> tuple[float, ...]:
        """The uniform scales of an articulated kind, one for each of its variants."""
        return ARTICULATED_SCALES


def _millimetres(text: str) -> int:
    return round(float(text) * 1000)


def _stepped(span: str, share: float, step: int) -> int:
    low, high = (_millimetres(part) for part in span.split("-"))
    return round((low + (high - low) * share) / step) * step


def _sizes(row: dict[str, str]) -> tuple[tuple[int, int, int], ...]:
    if row["urdf"]:
        base = [_millimetres(row[axis].split("-")[0]) for axis in ("width", "height", "depth")]
        return tuple((round(base[0] * s), round(base[1] * s), round(base[2] * s)) for s in ARTICULATED_SCALES)
    # Boxes at free angles stay on the millimetre grid if half sizes are multiples of 25 mm (see layout.Yaw).
    plan_step = 50 if row["turns"] else 20
    sizes = []
    for variant in range(VARIANTS):
        # Width grows with the variant; the others vary independently of it.
        shares = variant / 3, (variant * 2 % 5) / 4, (variant * 3 % 4) / 3
        sizes.append(
            (
                _stepped(row["width"], shares[0], plan_step),
                _stepped(row["height"], shares[1], 20),
                _stepped(row["depth"], shares[2], plan_step),
            )
        )
    return tuple(sizes)


@cache
def catalogue() -> dict[str, Kind]:
    """Return all kinds by name, in the order of the file."""
    return {
        row["kind"]: Kind(
            kind=row["kind"],
            label=row["label"],
            sizes=_sizes(row),
            shape=row["shape"],
            hang=_millimetres(row["hang"]) if row["hang"] else None,
            front=_millimetres(row["front"]) if row["front"] else 0,
            turns=bool(row["turns"]),
            urdf=row["urdf"] or None,
            number=number,
        )
        for number, row in enumerate(own_rows("condvln.samples", "catalogue.csv"), start=1)
    }


def class_ids() -> dict[str, int]:
    """Return the semantic id of each label, from 1, the same for every dataset that is made."""
    return {name: number for number, name in enumerate(sorted({k.label for k in catalogue().values()}), start=1)}


@cache
def _records() -> dict[str, Any]:
    found: dict[str, Any] = yaml.safe_load(own_text("condvln.samples", "records.yaml"))
    return found


def record(form: str, **values: Any) -> dict[str, Any]:
    """Return the record `form` of ``records.yaml`` with each ``{name}`` replaced by the value of that name."""
    found: dict[str, Any] = _filled(_records()[form], values)
    return found


def _filled(part: Any, values: Mapping[str, Any]) -> Any:
    if isinstance(part, dict):
        # Keys that records share are one text, as in records written out in Python: pickles of them are alike.
        return {sys.intern(_filled(key, values)): _filled(own, values) for key, own in part.items()}
    if isinstance(part, list):
        return [_filled(own, values) for own in part]
    if not isinstance(part, str) or "{" not in part:
        return part
    return values[part[1:-1]] if part[1:-1] in values else part.format_map(values)
