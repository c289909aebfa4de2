"""A unit of work: the smallest part of a corpus that is processed, stored, and processed again when its inputs
change."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from factory.record import Record
from schemas.canonical import JSON
from schemas.errors import InputError

__all__ = ["InputFile", "Unit", "Work"]


@dataclass(frozen=True, slots=True)
class InputFile(Record):
    """One input that is part of the key: a file, or a record inside one (``houses.jsonl#12``).

    path : relative to the dataset's root, '/' between folders, so that a moved dataset keeps its keys
    size : bytes
    sha256 : of the content, hexadecimal
    """

    path: str
    size: int
    sha256: str


@dataclass(frozen=True, slots=True)
class Unit(Record):
    """One unit of a run.

    unit_id : unique in a run; part of every key, since rows name the unit they belong to
    partition : folder ``source=<partition>`` that its rows are published in
    inputs : what its first stage (and every stage with ``reads_inputs``) is keyed on; order is free
    payload : handed to the stages as it is (root folder, scene name); never keyed
    costs : estimated CPU seconds on the reference machine (``factory.machine``), by stage; one left out counts as free
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
        """Return the estimated CPU seconds of all stages on the reference machine."""
        return sum(self.costs.values())


@dataclass(frozen=True, slots=True)
class Work(Record):
    """One unit, as a run hands it to a worker.

    fingerprint : hash of all that its chain can depend on (16 bytes)
    seconds : expected CPU seconds on this machine
    memory : expected peak in bytes
    """

    unit: Unit
    fingerprint: bytes
    seconds: float
    memory: int
