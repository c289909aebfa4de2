"""Where the presence of a label is true and where it is false, in the stagings of a layout that is a single room.

A single room has no other room from which to learn what it lacks, so its rows hold only what is there. The other
stagings tell what it lacks.
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

        Absence can't be claimed where a word for the label might name something that is there.

        Parameters
        ----------
        held : rows of presence about one layout, with the columns of ``PRIORS``
        asked : type of room and label, of labels whose presence may be asked
        """
        labels: dict[tuple[str, str, str], set[str]] = {}
        columns = (held[name].to_pylist() for name in ("layout", "staging", "room_type", "label", "n_true"))
        for layout, staging, room_type, label, there in zip(*columns, strict=True):
            if there:
                labels.setdefault((layout, staging, room_type), set()).add(label)
        truths: dict[tuple[str, str], dict[tuple[str, str, str], bool]] = {}
        for room, there in labels.items():
            for room_type, label in asked:
                if room_type == room[-1] and (label in there or not there & vocabulary.overlapping(label)):
                    truths.setdefault((room_type, label), {})[room] = label in there
        found = {key: seen for key, seen in sorted(truths.items()) if len({*seen.values()}) == 2}
        rows = [
            (*room, label, "", "", False, int(true), int(not true), 0)
            for (_, label), seen in found.items()
            for room, true in sorted(seen.items())
        ]
        counts = {key: (sum(seen.values()), len(seen) - sum(seen.values())) for key, seen in found.items()}
        return cls(table_of(rows, held.schema), counts)
