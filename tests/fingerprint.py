"""Golden keys and output hashes of a small corpus: they reveal a stage whose output changed although its version was
not raised.

A stage whose rows change while its key stays would leave old and new rows side by side in every store. So a test makes
a small corpus from scratch and compares: under an equal key, the rows must be equal. Decisions are compared exactly,
numbers by sums with a tolerance, so that the comparison holds on any processor and with any version of NumPy.
"""

from __future__ import annotations

import tempfile
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any, Final, TypeAlias

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from factory.commits import Commits
from factory.pins import build_aggregate
from factory.pipeline import Pipeline
from factory.receipt import Receipt
from factory.rows import logical_hash
from factory.run import run
from factory.snapshot import Snapshot
from factory.stage import Aggregate, Unit
from factory.store import LocalStore
from schemas.canonical import digest
from schemas.errors import ProofError

__all__ = ["ALL_UNITS", "Drift", "Fingerprints", "compare", "fingerprints", "table_fingerprint"]

ALL_UNITS: Final = "all units"
"""In place of a unit id: the aggregates, in place of stages."""

StageFingerprint: TypeAlias = Mapping[str, Any]
"""``key``, and a `TableFingerprint` of each table. The key covers the versions and parameters of the stage and of all
that it follows from, but no content: content may differ in the last bit of a number."""

Fingerprints: TypeAlias = Mapping[str, Mapping[str, StageFingerprint]]
"""Fingerprints by unit id and stage; plain JSON."""

TOLERANCE: Final = 1e-9
"""Share of a column's sum of magnitudes by which its checksum may differ. Another processor, or another version of
NumPy, rounds the last bit differently (1e-16); one coordinate of a thousand metres in all that moves by 1 mm is found
(1e-6)."""


@dataclass(frozen=True)
class Drift:
    """Differences between a corpus and its golden fingerprints.

    unbumped : ``unit: stage`` whose rows changed under an equal key: the stage's version must be raised. Of a unit only
        the first such stage is named, since later ones follow from it
    outdated : ``unit: stage`` whose key changed, or that is new or gone: the golden file must be written again
    """

    unbumped: tuple[str, ...]
    outdated: tuple[str, ...]


def fingerprints(pipeline: Pipeline, units: Iterable[Unit]) -> dict[str, dict[str, dict[str, Any]]]:
    """Process ``units`` from scratch in this process. Return, for each unit id and stage name, the stage's key under
    ``key`` and the fingerprint of each of its tables under the table's name; and of each aggregate, under `ALL_UNITS`,
    its key and the fingerprint of its ``rows``.

    Raises ``ProofError`` when a unit fails.
    """
    with tempfile.TemporaryDirectory(prefix="fingerprints-") as folder:
        store = LocalStore(folder, durable=False)
        report = run(pipeline, units, store)
        if report.failures:
            unit_id, failure = report.failures[0]
            raise ProofError(f"{unit_id} failed in {failure.stage}: {failure.exception}: {failure.message}")
        commits = Commits(store)
        receipts = list(Snapshot.open(store).index.receipts(pipeline))
        aggregates = {
            one.name: {
                "key": _aggregate_key(pipeline, one, receipts),
                "rows": table_fingerprint(build_aggregate(one, commits, receipts)[0]),
            }
            for one in pipeline.aggregates
        }
        found: dict[str, dict[str, dict[str, Any]]] = {}
        for receipt in receipts:
            keys = _stage_keys(pipeline, receipt, {name: one["key"] for name, one in aggregates.items()})
            found[receipt.unit_id] = {
                stage.stage: {
                    "key": keys[stage.stage],
                    **{
                        table.table: table_fingerprint(commits.table(stage.stage, stage.key.hex(), table.table))
                        for table in stage.tables
                    },
                }
                for stage in receipt.stages
            }
    return {**found, ALL_UNITS: aggregates} if aggregates else found


def _stage_keys(pipeline: Pipeline, receipt: Receipt, aggregates: Mapping[str, str]) -> dict[str, str]:
    keys: dict[str, str] = {}
    for stage in receipt.stages:
        needs = pipeline.stages[pipeline.position(stage.stage)].needs
        parts = [stage.code.hex(), stage.parameters.hex(), *keys.values(), *(aggregates[name] for name in needs)]
        keys[stage.stage] = digest(parts)
    return keys


def _aggregate_key(pipeline: Pipeline, one: Aggregate, receipts: Iterable[Receipt]) -> str:
    last = pipeline.position(one.after)
    read = {
        receipt.unit_id: [
            [stage.code.hex(), stage.parameters.hex()]
            for stage in receipt.stages
            if pipeline.position(stage.stage) <= last
        ]
        for receipt in receipts
    }
    return digest({"version": one.version, "parameters": one.parameters(), "read": read})


def table_fingerprint(table: pa.Table) -> dict[str, Any]:
    """Return ``exact``, a hash of everything in ``table`` but its floating-point numbers, and of these ``numbers``: for
    each column, the sum of values times fixed weights, and the sum of magnitudes.
    """
    exact: dict[str, pa.Array] = {}
    numbers: dict[str, list[float]] = {}
    for name, column in zip(table.column_names, table.columns, strict=True):
        whole = pa.concat_arrays(column.chunks) if column.num_chunks else pa.array([], column.type)
        for place, leaf in _leaves(name, whole):
            if not pa.types.is_floating(leaf.type):
                exact[place] = leaf
                continue
            values = leaf.cast(pa.float64()).to_numpy(zero_copy_only=False)
            finite = np.isfinite(values)
            exact[place] = pa.array(
                np.where(finite, 0, np.where(np.isnan(values), 1, np.sign(values) + 3)).astype("i1")
            )
            values = np.where(finite, values, 0.0)
            weights = 1 + np.arange(len(values)) * 7919 % 1009 / 1009
            numbers[place] = [float(values @ weights), float(np.abs(values).sum())]
    # One table a leaf: leaves of nested columns have lengths of their own.
    hashes = {place: logical_hash(pa.table({place: leaf}))[0] for place, leaf in exact.items()}
    return {"exact": digest(hashes), "numbers": numbers}


def _leaves(place: str, array: pa.Array) -> Iterator[tuple[str, pa.Array]]:
    """Yield the flat arrays that ``array`` is made of, with a name for each."""
    if pa.types.is_dictionary(array.type):
        array = array.dictionary_decode()
    if pa.types.is_struct(array.type):
        yield f"{place}?", array.is_valid()
        for field, child in zip(array.type, array.flatten(), strict=True):
            yield from _leaves(f"{place}.{field.name}", child)
    elif pa.types.is_list(array.type) or pa.types.is_large_list(array.type) or pa.types.is_fixed_size_list(array.type):
        yield f"{place}#", pc.list_value_length(array)
        yield from _leaves(f"{place}[]", array.flatten())
    else:
        if pa.types.is_floating(array.type):
            yield f"{place}?", array.is_valid()
        yield place, array


def compare(golden: Fingerprints, found: Fingerprints) -> Drift:
    """Return the differences between ``golden`` and ``found``."""
    unbumped: list[str] = []
    outdated: list[str] = []
    for unit_id in sorted({*golden, *found}):
        before, after = golden.get(unit_id, {}), found.get(unit_id, {})
        blamed = False
        for stage in dict.fromkeys([*before, *after]):
            old, new = before.get(stage), after.get(stage)
            if old is None or new is None or old["key"] != new["key"]:
                outdated.append(f"{unit_id}: {stage}")
            elif not blamed and not _same_rows(old, new):
                unbumped.append(f"{unit_id}: {stage}")
                # Aggregates stand beside one another, stages follow from one another.
                blamed = unit_id != ALL_UNITS
    return Drift(tuple(unbumped), tuple(outdated))


def _same_rows(old: StageFingerprint, new: StageFingerprint) -> bool:
    """Return whether all tables of a stage are the same but for the last bits of numbers."""
    if old.keys() != new.keys():
        return False
    for name in old.keys() - {"key"}:
        one, two = old[name], new[name]
        if one["exact"] != two["exact"] or one["numbers"].keys() != two["numbers"].keys():
            return False
        for place, (sum_before, scale) in one["numbers"].items():
            sum_after, scale_after = two["numbers"][place]
            if abs(sum_after - sum_before) > TOLERANCE * max(scale, scale_after):
                return False
    return True
