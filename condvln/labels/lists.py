"""What the package's lists say of labels: roles, sizes, confusions, fixtures, types of rooms by contents, worth."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from functools import cache
from typing import Final, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from condvln.labels.lexicon import Vocabulary
from condvln.own_tables import own_rows

__all__ = [
    "LEAST_WORTH",
    "Role",
    "SizeBounds",
    "UsualSize",
    "Worth",
    "also_called",
    "belongs_by",
    "fixtures_of",
    "goes_with",
    "have_role",
    "known_purposes",
    "labels_with_role",
    "plausible_sizes",
    "required_in",
    "types_by_contents",
    "usual_size",
    "worth",
]

Role = Literal[
    "carpet", "desktop", "fixed", "landmark", "low table", "part", "portable", "screen", "seat", "surface", "worktop"
]


@cache
def _rows(name: str) -> tuple[Mapping[str, str], ...]:
    return tuple(own_rows("condvln.labels", f"{name}.csv"))


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
    return frozenset(row["label"] for row in _rows("roles") if row["role"] == role)


def have_role(labels: Sequence[str], role: Role) -> NDArray[np.bool_]:
    """Return a mask (n,) of those of n canonical labels that have a role."""
    found = labels_with_role(role)
    return np.array([label in found for label in labels], dtype=np.bool_)


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
    """Return the bounds of the boxes that a label is trusted for in a scan, whose boxes were drawn by people or by a
    detector, by canonical label, from ``sizes.csv``; an empty cell sets no bound.

    The table was written by hand from the sizes of labelled models and of scans that people checked
    (``python -m benchmarks.label_sizes``). A label that is not in it is trusted whatever the size.
    """
    found = {}
    for row in _rows("sizes"):
        bounds = {name: float(row[name]) for name in SizeBounds._fields[:-1] if row[name]}
        found[row["label"]] = SizeBounds(**bounds, upright=row["upright"] == "yes")
    return found


class UsualSize(NamedTuple):
    """How large a usual object of some label appears from the side or, if it lies flat, from above.

    long, short : sides in metres of a rectangle
    flat : what it lies on: "floor" or "table"; empty if it does not lie flat
    """

    long: float
    short: float
    flat: str = ""


SMALL: Final = UsualSize(0.2, 0.12)
"""The size of an object of which nothing is known."""


@cache
def _usual_sizes() -> Mapping[str, UsualSize]:
    return {row["label"]: UsualSize(float(row["long"]), float(row["short"]), row["flat"]) for row in _rows("usual")}


def usual_size(label: str) -> UsualSize:
    """Return the size of a usual object with a canonical label, from ``usual.csv``. An unlisted label gives a small
    object.

    The table was written by hand: a small one of the sizes in which people have such a thing. It was compared with the
    25th percentile of the models of shared data, as far as these have the label (``python -m benchmarks.label_sizes``).
    """
    return _usual_sizes().get(label, SMALL)


class Worth(NamedTuple):
    """How natural it is to be sent to a thing, and to ask whether it is there, where it is, and in which state it is:
    from 0 (nobody would) to 1.
    """

    goto: float
    presence: float
    relation: float
    state: float


LEAST_WORTH: Final = 0.05
"""Worth from which on a label is asked about, or named as the thing that another is beside."""

UNLISTED: Final = Worth(goto=0.3, presence=0.3, relation=0.3, state=0.0)
"""The worth of a label of which nothing is known."""


@cache
def _worths() -> Mapping[tuple[str, str], Worth]:
    return {(row["label"], row["room"]): Worth(*(float(row[name]) for name in Worth._fields)) for row in _rows("worth")}


def worth(label: str, room_type: str) -> Worth:
    """Return the worth of a canonical label in a type of room, from ``worth.csv``, where an empty room stands for all
    that have no row of their own. The table was written by hand: see ``docs/language.md``.
    """
    found = _worths()
    return found.get((label, room_type)) or found.get((label, ""), UNLISTED)


@cache
def goes_with() -> Mapping[str, frozenset[str]]:
    """Return, by label, the other labels that serve a purpose with it, from ``affinity.csv``: a towel goes with the
    laundry basket and with the bathtub. The table was written by hand: see ``docs/language.md``.
    """
    return _joined(PARTS, PARTS)


@cache
def belongs_by() -> Mapping[str, frozenset[str]]:
    """Return, by label, the labels of the places where such a thing serves a purpose, from ``affinity.csv``: a chair by
    the desk. Whether it is there is worth asking.
    """
    return _joined(("thing",), ("place",))


@cache
def known_purposes() -> frozenset[str]:
    """Return the labels of which ``affinity.csv`` knows a purpose."""
    return frozenset(row["label"] for row in _rows("affinity"))


PARTS: Final = ("thing", "place")
"""What a label is in a purpose: something that one uses, or where one uses it."""


def _joined(own: Sequence[str], others: Sequence[str]) -> Mapping[str, frozenset[str]]:
    """Return, by label that is one of the parts `own` in a purpose, the other labels that are one of `others` in it."""
    members: dict[tuple[str, str], set[str]] = {}
    for row in _rows("affinity"):
        members.setdefault((row["purpose"], row["part"]), set()).add(row["label"])
    found: dict[str, set[str]] = {}
    for (purpose, part), labels in members.items():
        together = set().union(*(members.get((purpose, other), ()) for other in others))
        for label in labels if part in own else ():
            found.setdefault(label, set()).update(together - {label})
    return {label: frozenset(joined) for label, joined in found.items()}


@cache
def also_called(*, low: bool) -> Mapping[str, frozenset[str]]:
    """Return, by label, the other labels that some people would use for a thing with this label, from
    ``confusion.csv``: what one calls a bowl is a vase to another. `low` says whether the thing is no taller than its
    footprint is long.
    """
    found: dict[str, set[str]] = {}
    for row in _rows("confusion"):
        if low or row["low"] == "no":
            found.setdefault(row["other"], set()).add(row["label"])
    return {other: frozenset(labels) for other, labels in found.items()}


@cache
def fixtures_of(room_type: str) -> frozenset[str]:
    """Return the labels that a scan may lack in a room of a type though the real room has such a thing, from
    ``fixtures.csv``, where an empty room type stands for all.
    """
    return frozenset(row["label"] for row in _rows("fixtures") if row["room_type"] in ("", room_type))


@cache
def required_in(room_type: str) -> frozenset[str]:
    """Return the labels without which the annotation of a room of a type is taken to be incomplete: nobody sleeps in a
    bedroom without a bed.
    """
    return frozenset(
        row["label"] for row in _rows("fixtures") if row["room_type"] == room_type and row["required"] == "yes"
    )


def types_by_contents(
    types: Mapping[str, str], held: Mapping[str, Sequence[str]], vocabulary: Vocabulary
) -> dict[str, str]:
    """Return the type of each room of a scene by room id. A room whose type fits every room has the one type that shows
    in what it holds.

    ``room_contents.csv`` lists only things that decide: people see a nave by its pews, but put beds in all kinds of
    rooms. ``beside`` is the type that another room of the scene must have: where there is a nave, the room with the
    altar is the chancel.

    types : by room id, the type that the source gives; held : by room id, the labels of the room's objects
    """
    found = dict(types)
    # What needs no other room comes first.
    for beside in (False, True):
        known = set(found.values())
        for room_id, room_type in types.items():
            if vocabulary.room(found[room_id]).general:
                counts = Counter(held.get(room_id, ()))
                shown = {
                    row["room_type"]
                    for row in _rows("room_contents")
                    if bool(row["beside"]) == beside
                    and counts[row["label"]] >= int(row["least"])
                    and row["beside"] in {"", *known}
                }
                found[room_id] = shown.pop() if len(shown) == 1 else room_type
    return found
