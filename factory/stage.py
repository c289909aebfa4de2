"""The parts of a pipeline: units of work, stages, which derive tables from one unit's tables, and aggregates over all
units.

A unit is the smallest part of a corpus that is processed, stored, and processed again when its inputs change.

Subclass the protocols to inherit their defaults. Instances are pickled to the workers, so they hold parameters, not
open files. A stage is a pure function of what its key covers: the unit's id and inputs (or the tables it reads),
``parameters``, and of the shared tables only what ``dependencies`` tells. Change what it computes, and ``version``
must be raised by hand.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Literal, Protocol

import pyarrow as pa

from schemas.canonical import JSON
from schemas.errors import InputError

__all__ = ["Aggregate", "InputFile", "Stage", "StageOutput", "Unit", "Work"]


@dataclass(frozen=True, slots=True)
class InputFile:
    """One input that is part of the key: a file, or a record inside one (``houses.jsonl#12``).

    path : relative to the dataset's root, '/' between folders, so that a moved dataset keeps its keys
    size : bytes
    sha256 : of the content, hexadecimal
    """

    path: str
    size: int
    sha256: str


@dataclass(frozen=True, slots=True)
class Unit:
    """One unit of a run.

    unit_id : unique in a run; part of every key, since rows name the unit they belong to
    partition : folder ``source=<partition>`` that its rows are published in
    inputs : what its first stage (and every stage with ``reads_inputs``) is keyed on; order is free
    payload : handed to the stages as it is (root folder, scene name); never keyed
    costs : estimated CPU seconds by stage; one left out counts as free
    memory : estimated bytes at the peak
    fault : the unit could not even be listed: it is quarantined with this error, and so not lost
    """

    unit_id: str
    partition: str
    inputs: tuple[InputFile, ...] = ()
    payload: Mapping[str, JSON] = field(default_factory=dict)
    costs: Mapping[str, float] = field(default_factory=dict)
    memory: int = 256 * 1024 * 1024
    fault: InputError | None = None

    @property
    def cost(self) -> float:
        """Return the estimated CPU seconds of all stages."""
        return sum(self.costs.values())


@dataclass(frozen=True, slots=True)
class Work:
    """One unit, as a run hands it to a worker.

    fingerprint : hash of all that its chain can depend on (16 bytes)
    seconds : expected CPU seconds on this machine
    memory : expected peak in bytes
    """

    unit: Unit
    fingerprint: bytes
    seconds: float
    memory: int


@dataclass(slots=True)
class StageOutput:
    """The output of one stage for one unit.

    tables : one for each name in ``Stage.tables`` (a skipped output may leave some out: they count as empty)
    files : further files kept in the unit's folder (plain names), such as a built navmesh
    outcome : ``skipped`` ends the unit's chain well: what there is gets published, later stages don't run
    reason : why it was skipped
    measures : numbers worth recording in the commit; not published, not hashed
    """

    tables: dict[str, pa.Table] = field(default_factory=dict)
    files: dict[str, bytes] = field(default_factory=dict)
    outcome: Literal["ok", "skipped"] = "ok"
    reason: str = ""
    measures: dict[str, float] = field(default_factory=dict)


class Stage(Protocol):
    """One stage of the pipeline.

    name : plain name, the folder under ``units/``
    version : raised by hand whenever the output for equal inputs changes
    tables : names of the tables it writes; those a pipeline publishes have their schema there, others keep their own
    reads : names of earlier stages' tables it reads (it sees no others); None means all of them
    needs : names of the aggregates it reads
    reads_inputs : it reads the unit's source files too, and so is keyed on them (the first stage always is)
    """

    name: str
    version: int
    tables: tuple[str, ...]
    reads: tuple[str, ...] | None = None
    needs: tuple[str, ...] = ()
    reads_inputs: bool = False

    def parameters(self, unit: Unit) -> JSON:
        """Return all configuration that this stage reads for ``unit``, and nothing else: it is part of the key.

        Returning the same object for every unit makes planning faster.
        """
        return {}

    def dependencies(self, unit: Unit, upstream: Mapping[str, pa.Table], shared: Mapping[str, pa.Table]) -> JSON:
        """Return the part of ``shared`` that this unit's rows depend on. The returned value enters the unit's key in
        place of the whole shared tables.
        """
        return None

    def run(self, unit: Unit, upstream: Mapping[str, pa.Table], shared: Mapping[str, pa.Table]) -> StageOutput:
        """Compute the tables of ``unit``. Any error quarantines the unit, except ``TransientIOError``, which is
        retried.
        """
        ...


class Aggregate(Protocol):
    """A table computed from the outputs of one stage over all units; built once and then pinned until it is renewed.

    name : how stages name it in ``needs``
    version : raised by hand when ``build`` changes
    after : the stage whose outputs it reads
    tables : names of the tables it reads
    """

    name: str
    version: int
    after: str
    tables: tuple[str, ...]

    def parameters(self) -> JSON:
        """Return all configuration that ``build`` reads. A table that was pinned with other parameters is rebuilt."""
        return {}

    def build(self, tables: Iterator[tuple[str, Mapping[str, pa.Table]]]) -> pa.Table:
        """Fold the pairs ``(unit_id, tables)``, which come sorted by unit id, into one table."""
        ...
