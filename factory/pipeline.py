"""A pipeline: stages in their order, the aggregates between them, and the tables to publish; and what a run needs to
know beside it.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field

import pyarrow as pa

from factory.stage import Aggregate, Stage
from factory.store import Store
from schemas.base import SCHEMA_VERSION
from schemas.errors import UsageError

__all__ = ["Pipeline", "RunContext", "TableSpec", "plain_name"]

_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.\-]{0,99}")


def plain_name(name: str) -> bool:
    """Whether ``name`` is a valid file or folder name everywhere: at most 100 ASCII letters, digits, ``_ . -``."""
    return _NAME.fullmatch(name) is not None


@dataclass(frozen=True)
class TableSpec:
    """The contract of one published table.

    schema : exactly the columns of every file
    sort_keys : columns that order the rows; together unique in the table
    """

    schema: pa.Schema
    sort_keys: tuple[str, ...]


@dataclass(frozen=True)
class Pipeline:
    """Stages, aggregates and published tables, checked on construction.

    Raises ``UsageError`` naming the part that does not fit (a repeated name, a table no stage writes, an aggregate
    that a stage needs before it can be there).
    """

    name: str
    stages: tuple[Stage, ...]
    tables: Mapping[str, TableSpec]
    aggregates: tuple[Aggregate, ...] = ()
    schema_version: str = SCHEMA_VERSION
    _order: Mapping[str, int] = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "_order", {stage.name: at for at, stage in enumerate(self.stages)})
        for kind, names in (
            ("stage", [stage.name for stage in self.stages]),
            ("aggregate", [aggregate.name for aggregate in self.aggregates]),
            ("table", [*self.tables]),
            ("pipeline", [self.name]),
            *(("table", [*stage.tables]) for stage in self.stages),
        ):
            for name in names:
                _require(plain_name(name), f"the {kind} name {name!r} is not a plain file name")
                _require(names.count(name) == 1, f"two {kind}s are called {name!r}")
        _require(bool(self.stages), "there is no stage")
        for aggregate in self.aggregates:
            _require(
                aggregate.after in self._order,
                f"aggregate {aggregate.name!r} follows a stage that is not in this pipeline",
            )
        for at, stage in enumerate(self.stages):
            for need in stage.needs:
                found = [a for a in self.aggregates if a.name == need and self._order[a.after] < at]
                _require(
                    bool(found), f"stage {stage.name!r} needs {need!r}, which no earlier stage or aggregate provides"
                )
            for table in stage.reads or ():
                _require(
                    any(table in earlier.tables for earlier in self.stages[:at]),
                    f"stage {stage.name!r} reads {table!r}, which no earlier stage writes",
                )
        for name, spec in self.tables.items():
            _require(bool(self.writers(name)), f"no stage writes the table {name!r}, which is published")
            _require(set(spec.sort_keys) <= set(spec.schema.names), f"table {name!r} lacks one of its sort keys")

    def position(self, stage: str) -> int:
        """Return the position of ``stage`` in the chain."""
        return self._order[stage]

    def writers(self, table: str) -> list[str]:
        """Return the stages that write a table; what they write is published together."""
        return [stage.name for stage in self.stages if table in stage.tables]

    def stage_tables(self, stage: Stage) -> tuple[tuple[str, TableSpec | None], ...]:
        """Return (name, contract) of each table of ``stage``; the contract is None for unpublished tables."""
        return tuple((name, self.tables.get(name)) for name in stage.tables)

    def visible(self, at: int) -> tuple[tuple[str, int], ...]:
        """Return the tables that the stage at position ``at`` reads, each as (table, position of its writer). If
        several stages write a table, its writer is the latest one before ``at``.
        """
        writers = {table: position for position, stage in enumerate(self.stages[:at]) for table in stage.tables}
        reads = self.stages[at].reads
        return tuple(
            sorted((table, position) for table, position in writers.items() if reads is None or table in reads)
        )


@dataclass(frozen=True)
class RunContext:
    """Parameters of a run; every worker receives them once.

    shared : hashes of the pinned aggregates
    quarantined : (stage, key) pairs not to be tried again
    retrying : units in quarantine are tried again: a success takes their record away
    deadline : seconds one unit may take; None for no limit
    memory : bytes that a process which works on units may hold; None for its share of the machine (``factory.machine``)
    name : of the run, in the names of its tasks (``condvln:<name>:<unit>``)
    """

    pipeline: Pipeline
    store: Store
    shared: Mapping[str, str] = field(default_factory=dict)
    quarantined: frozenset[tuple[str, str]] = frozenset()
    retrying: bool = False
    revision: str = ""
    deadline: float | None = None
    memory: int | None = None
    name: str = "run"
    token: str = ""
    """Name of the run. A unit that this run has quarantined is not tried again within the run."""


def _require(holds: bool, what: str) -> None:
    if not holds:
        raise UsageError(f"the pipeline does not fit together: {what}")
