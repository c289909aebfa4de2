"""Where the presence of a label is true and where it is false, in the stagings of a layout that is a single room.

A single room has no other room from which to learn what it lacks, so its rows hold what is there, and what something
there might be called. The other stagings tell what it lacks.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass

import pyarrow as pa

from condvln.instructions.statement_rows import table_of
from condvln.labels import vocabulary

__all__ = ["StagedPresence"]


@dataclass(frozen=True, slots=True)
class StagedPresence:
    """The presence of those labels that some stagings have, and whose absence can be claimed of others.

    rows : a row for each staging and label, with the columns of ``PRIORS``
    counts : by type of room and label, the number of stagings in which presence is true and of those in which it is
        false
    """

    rows: pa.Table
    counts: Mapping[tuple[str, str], tuple[int, int]]

    @classmethod
    def of(cls, held: pa.Table, asked: Collection[tuple[str, str]]) -> StagedPresence:
        """Return the presence of labels in the stagings of a layout.

        Absence can't be claimed where a word for the label might name something that is there, be it hidden.

        Parameters
        ----------
        held : rows of presence about one layout, with the columns of ``PRIORS``; a row with an empty label stands for
            a room, one without counts for a label that something in it might be called
        asked : type of room and label, of labels whose presence may be asked
        """
        seen: dict[tuple[str, str, str], set[str]] = {}
        possible: dict[tuple[str, str, str], set[str]] = {}
        columns = (held[name].to_pylist() for name in ("layout", "staging", "room_type", "label", "n_true", "n_false"))
        for layout, staging, room_type, label, true, false in zip(*columns, strict=True):
            room = layout, staging, room_type
            if true:
                seen.setdefault(room, set()).add(label)
            if not false:
                possible.setdefault(room, set()).add(label)
        truths: dict[tuple[str, str], dict[tuple[str, str, str], bool]] = {}
        for room, words in possible.items():
            there = seen.get(room, set())
            for room_type, label in asked:
                if room_type == room[-1] and (label in there or not words & vocabulary.overlapping(label)):
                    truths.setdefault((room_type, label), {})[room] = label in there
        found = {key: known for key, known in sorted(truths.items()) if len({*known.values()}) == 2}
        rows = [
            (*room, label, "", "", False, int(true), int(not true), 0)
            for (_, label), known in found.items()
            for room, true in sorted(known.items())
        ]
        counts = {key: (sum(known.values()), len(known) - sum(known.values())) for key, known in found.items()}
        return cls(table_of(rows, held.schema), counts)
