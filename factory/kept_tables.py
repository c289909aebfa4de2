"""Tables that a process made in an early pass of a run, kept for a later pass of the same run.

The first pass of a run makes what an aggregate counts, and the next pass reads the same tables again. A process that
still has them need not read, decode and hash their files.
"""

from __future__ import annotations

from typing import Final

import pyarrow as pa

__all__ = ["KEPT_BYTES", "KeptTables", "kept_tables"]

KEPT_BYTES: Final = 16 << 20
"""Bytes of the tables that a process keeps; those of a scene take 20 to 200 kB. The rest is read from the store."""


class KeptTables:
    """Tables by the path of their file and the logical hash of their rows, up to ``limit`` bytes together."""

    def __init__(self, limit: int = KEPT_BYTES) -> None:
        self._left = limit
        self._tables: dict[tuple[str, str], pa.Table] = {}

    def put(self, path: str, rows_hash: str, table: pa.Table) -> None:
        """Keep a table until it is taken, if there is room for it."""
        if (path, rows_hash) not in self._tables and table.nbytes <= self._left:
            self._left -= table.nbytes
            self._tables[path, rows_hash] = table

    def take(self, path: str, rows_hash: str) -> pa.Table | None:
        """Return a kept table, which is then no longer kept; None if it is not here."""
        table = self._tables.pop((path, rows_hash), None)
        if table is not None:
            self._left += table.nbytes
        return table


_of_run: dict[str, KeptTables] = {}
"""In a process that works on units: the tables of the run that it serves, by the run's name."""


def kept_tables(run: str) -> KeptTables:
    """Return the tables that this process keeps for a run; those of another run are forgotten. Work without the name of
    a run shares nothing.
    """
    if run not in _of_run:
        _of_run.clear()
        if not run:
            return KeptTables()
        _of_run[run] = KeptTables()
    return _of_run[run]
