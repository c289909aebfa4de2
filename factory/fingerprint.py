"""Golden keys and output hashes of a small corpus: they reveal a stage whose output changed although its version was
not raised.

A stage whose rows change while its key stays would leave old and new rows side by side in every store, for ever. So a
test makes a small corpus from scratch and compares: under an equal key, the rows must be equal.
"""

from __future__ import annotations

import tempfile
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Final, TypeAlias

from factory.local_store import LocalStore
from factory.pipeline import Pipeline
from factory.run import run
from factory.snapshot import Snapshot
from factory.unit import Unit
from schemas.canonical import digest
from schemas.errors import ProofError

__all__ = ["ALL_UNITS", "Drift", "Fingerprints", "compare", "fingerprints"]

ALL_UNITS: Final = "all units"
"""In place of a unit id: the aggregates, in place of stages."""

StageFingerprint: TypeAlias = Mapping[str, str]
"""``key``, and the logical hash of each table. The key of an aggregate is of its version, its parameters, and the rows
that it is built from."""

Fingerprints: TypeAlias = Mapping[str, Mapping[str, StageFingerprint]]
"""Fingerprints by unit id and stage; plain JSON."""


@dataclass(frozen=True)
class Drift:
    """Differences between a corpus and its golden fingerprints.

    unbumped : ``unit: stage`` whose rows changed under an equal key: the stage's version must be raised
    outdated : ``unit: stage`` whose key changed, or that is new or gone: the golden file must be written again
    """

    unbumped: tuple[str, ...]
    outdated: tuple[str, ...]


def fingerprints(pipeline: Pipeline, units: Iterable[Unit]) -> dict[str, dict[str, dict[str, str]]]:
    """Process ``units`` from scratch in this process. Return, for each unit id and stage name, the stage's key under
    ``key`` and the hash of each of its tables under the table's name; and of each aggregate, under `ALL_UNITS`, its key
    and the hash of its ``rows``.

    Raises ``ProofError`` when a unit fails.
    """
    with tempfile.TemporaryDirectory(prefix="fingerprints-") as folder:
        store = LocalStore(folder, durable=False)
        report = run(pipeline, units, store)
        if report.failures:
            unit_id, failure = report.failures[0]
            raise ProofError(f"{unit_id} failed in {failure.stage}: {failure.exception}: {failure.message}")
        snapshot = Snapshot.open(store)
        index = snapshot.index()
        found = {
            receipt.unit_id: {
                stage.stage: {"key": stage.key.hex(), **{table.table: table.hash.hex() for table in stage.tables}}
                for stage in receipt.stages
            }
            for receipt in index.receipts(range(len(index)), pipeline)
        }
    aggregates = {}
    for one in pipeline.aggregates:
        rows = {unit_id: stages[one.after] for unit_id, stages in found.items() if one.after in stages}
        read = {unit_id: [tables.get(name) for name in one.tables] for unit_id, tables in rows.items()}
        key = digest({"version": one.version, "parameters": one.parameters(), "read": read})
        aggregates[one.name] = {"key": key, "rows": snapshot.manifest.aggregates[one.name]}
    return {**found, ALL_UNITS: aggregates} if aggregates else found


def compare(golden: Fingerprints, found: Fingerprints) -> Drift:
    """Return the differences between ``golden`` and ``found``."""
    unbumped: list[str] = []
    outdated: list[str] = []
    for unit_id in sorted({*golden, *found}):
        before, after = golden.get(unit_id, {}), found.get(unit_id, {})
        for stage in dict.fromkeys([*before, *after]):
            old, new = before.get(stage), after.get(stage)
            if old == new:
                continue
            same_key = old is not None and new is not None and old["key"] == new["key"]
            (unbumped if same_key else outdated).append(f"{unit_id}: {stage}")
    return Drift(tuple(unbumped), tuple(outdated))
