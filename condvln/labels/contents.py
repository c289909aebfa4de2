"""Room types that show in what a room holds, read from ``room_contents.csv`` beside this module.

A region that its source calls "other room" has no word of its own, but people see a nave by its pews. The table lists
only things that decide: a bed does not, since people put beds in all kinds of rooms. ``beside`` is the type that
another room of the scene must have: where there is a nave, the room with the altar is the chancel.
"""

from __future__ import annotations

import csv
from collections import Counter
from collections.abc import Mapping, Sequence
from functools import cache
from importlib.resources import files
from typing import NamedTuple

from condvln.labels.lexicon import Vocabulary

__all__ = ["types_by_contents"]


class _Row(NamedTuple):
    room_type: str
    label: str
    least: int
    beside: str


def types_by_contents(
    types: Mapping[str, str], held: Mapping[str, Sequence[str]], vocabulary: Vocabulary
) -> dict[str, str]:
    """Return the type of each room of a scene by room id. A room whose type fits every room has the one type that shows
    in what it holds.

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
                    row.room_type
                    for row in _rows()
                    if bool(row.beside) == beside and counts[row.label] >= row.least and row.beside in {"", *known}
                }
                found[room_id] = shown.pop() if len(shown) == 1 else room_type
    return found


@cache
def _rows() -> tuple[_Row, ...]:
    text = files("condvln.labels").joinpath("room_contents.csv").read_text(encoding="utf-8")
    return tuple(
        _Row(row["room_type"], row["label"], int(row["least"]), row["beside"])
        for row in csv.DictReader(text.splitlines())
    )
