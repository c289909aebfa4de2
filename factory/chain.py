"""The chain of stages of one unit, used by planner and workers alike: the key of each stage, and the tables that it
reads.

A key is the hash of everything that a stage's output depends on. It is made of four parts, so that a plan can say which
one changed:

code : the stage's name and version, the major schema version, the schemas of the tables it publishes
inputs : the unit's files (path, size, SHA-256) for the first stage and those with ``reads_inputs``; for the others the
    logical hashes of the upstream tables they read, so that an upstream stage that ran again and gave the same rows
    makes nothing stale (early cut-off)
parameters : what ``Stage.parameters`` returns
dependencies : what ``Stage.dependencies`` returns, for stages that need shared tables

The unit's id is in the key too: rows carry it, and two units of the same bytes must not fall together.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any

import pyarrow as pa

from factory.commits import Commits, Committed
from factory.pipeline import Pipeline
from factory.receipt import StageReceipt, TableReceipt
from factory.rows import logical_hash, parquet_table, schema_hash
from factory.stage import Unit
from schemas.canonical import JSON, canonical_json
from schemas.errors import CorruptShardError, StoreError

__all__ = ["Chain", "Keyer", "SharedTables", "StageKey", "Upstream", "receipt_of"]


def _hash(value: JSON) -> bytes:
    return hashlib.sha256(canonical_json(value)).digest()[:16]


@dataclass(frozen=True, slots=True)
class StageKey:
    """The key of one stage of one unit, and the parts that it is computed from; key and parts have 16 bytes each."""

    key: bytes
    code: bytes
    inputs: bytes
    parameters: bytes
    dependencies: bytes

    @property
    def hex(self) -> str:
        """Return the key in hexadecimal, as the store names it."""
        return self.key.hex()


class Keyer:
    """Computes the keys of all stages of one pipeline, and caches what is the same for all units."""

    def __init__(self, pipeline: Pipeline) -> None:
        self._pipeline = pipeline
        self._code = [self._code_of(at) for at in range(len(pipeline.stages))]
        self._remembered: list[tuple[JSON, bytes] | None] = [None] * len(pipeline.stages)

    def _code_of(self, at: int) -> bytes:
        stage = self._pipeline.stages[at]
        schemas = {name: schema_hash(spec.schema) for name, spec in self._pipeline.stage_tables(stage) if spec}
        major = self._pipeline.schema_version.split(".")[0]
        return _hash({"stage": stage.name, "version": stage.version, "schema": major, "tables": schemas})

    def code(self, at: int) -> bytes:
        """Return the code part of the key of the stage at position ``at``."""
        return self._code[at]

    def reads_inputs(self, at: int) -> bool:
        """Whether the key of the stage at position ``at`` covers the unit's files."""
        return at == 0 or self._pipeline.stages[at].reads_inputs

    def inputs(self, unit: Unit) -> bytes:
        """Hash the unit's files."""
        return _hash(sorted((file.path, file.size, file.sha256) for file in unit.inputs))

    def parameters(self, unit: Unit, at: int) -> bytes:
        """Hash the parameters of the stage at position ``at``. The hash is cached as long as the stage returns the same
        object.
        """
        value = self._pipeline.stages[at].parameters(unit)
        known = self._remembered[at]
        if known is not None and known[0] is value:
            return known[1]
        found = _hash(value)
        self._remembered[at] = (value, found)
        return found

    def fingerprint(self, unit: Unit, shared: Mapping[str, str], stages: int | None = None) -> bytes:
        """Hash everything that the unit's whole chain of stages can depend on. The content of shared tables enters by
        their hashes, given by name in ``shared``.

        Equal fingerprints mean equal keys of every stage, by purity; nothing needs to be read to know it. The converse
        does not hold: a changed shared table may leave every key as it was. A shared table that is not pinned yet makes
        a fingerprint that equals no earlier one.
        """
        count = len(self._pipeline.stages) if stages is None else stages
        state = hashlib.sha256()
        # Each part has a fixed length or is framed by its own, so that no two chains feed the same bytes.
        for text in (unit.unit_id, unit.partition):
            data = text.encode("utf-8", "surrogatepass")
            state.update(len(data).to_bytes(4, "little") + data)
        state.update(self.inputs(unit))
        for at, stage in enumerate(self._pipeline.stages[:count]):
            state.update(b"\1" + self._code[at] + self.parameters(unit, at) + bytes([self.reads_inputs(at)]))
            for need in stage.needs:
                state.update(b"\2" + bytes.fromhex(shared.get(need, "")))
        return state.digest()[:16]

    def key(self, unit: Unit, at: int, upstream: Mapping[str, str], dependencies: JSON) -> StageKey:
        """Compute the key of the stage at position ``at``.

        upstream : logical hashes of the tables it reads, by name
        dependencies : what the stage returned; ignored unless it needs shared tables
        """
        read: dict[str, JSON] = {}
        if at > 0:
            read["tables"] = dict(upstream)
        if self.reads_inputs(at):
            read["files"] = self.inputs(unit).hex()
        inputs, parameters = _hash(read), self.parameters(unit, at)
        depends = _hash(dependencies if self._pipeline.stages[at].needs else None)
        parts = [unit.unit_id, *(part.hex() for part in (self._code[at], inputs, parameters, depends))]
        return StageKey(_hash(parts), self._code[at], inputs, parameters, depends)


_RENEW = (
    "Run condvln generate CONFIG, which restores it from the snapshot; if it can't, add --priors to build it again."
)


class Upstream(Mapping[str, pa.Table]):
    """Tables by name, each loaded when it is first read."""

    def __init__(self, loaders: Mapping[str, Callable[[], pa.Table]]) -> None:
        self._loaders = loaders
        self._loaded: dict[str, pa.Table] = {}

    def __getitem__(self, name: str) -> pa.Table:
        if name not in self._loaded:
            self._loaded[name] = self._loaders[name]()
        return self._loaded[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._loaders)

    def __len__(self) -> int:
        return len(self._loaders)


class SharedTables:
    """The pinned aggregates of a run. Their hashes are known from the start; the table of an aggregate is read from the
    store when a stage asks for it.

    hashes : name of the aggregate → logical hash
    """

    def __init__(self, commits: Commits, hashes: Mapping[str, str]) -> None:
        self.hashes = dict(hashes)
        self._commits = commits
        self._tables = Upstream({name: partial(self._read, name, found) for name, found in self.hashes.items()})

    @staticmethod
    def path(name: str, hash_: str) -> str:
        """Return the path of an aggregate in the store."""
        return f"aggregates/{name}/{hash_}.parquet"

    def _read(self, name: str, found: str) -> pa.Table:
        path = self.path(name, found)
        where = f"{self._commits.store.url}/{path}"
        try:
            table = parquet_table(self._commits.store.read(path), where)
        except (FileNotFoundError, CorruptShardError) as error:
            raise StoreError(f"the pinned table {name!r} is missing or damaged", where=where, remedy=_RENEW) from error
        if logical_hash(table)[0] != found:
            raise StoreError(f"the pinned table {name!r} differs from its hash", where=where, remedy=_RENEW)
        return table

    def of(self, names: tuple[str, ...]) -> Mapping[str, pa.Table]:
        """Return the tables with these names, each loaded when it is first read."""
        return Upstream({name: partial(self._tables.__getitem__, name) for name in names})


class Chain:
    """The chain of stages of one unit: which of them are done, and what the next one reads.

    Stages may be known from a commit, from an earlier snapshot's index, or made just now; in the last case their tables
    are at hand, otherwise they are read from the store when a later stage asks.

    discard : remove commits that turn out damaged, so that they are rebuilt; False where nothing may be written
    """

    def __init__(
        self,
        pipeline: Pipeline,
        keyer: Keyer,
        commits: Commits,
        shared: SharedTables,
        unit: Unit,
        *,
        discard: bool = True,
    ) -> None:
        self._discard = discard
        self._pipeline = pipeline
        self._keyer = keyer
        self._commits = commits
        self._shared = shared
        self._unit = unit
        self._in_memory: dict[tuple[str, int], pa.Table] = {}
        self.done: list[StageReceipt] = []

    @property
    def at(self) -> int:
        """Return the position of the next stage."""
        return len(self.done)

    def key(self) -> StageKey:
        """Compute the key of the next stage."""
        stage = self._pipeline.stages[self.at]
        hashes = {table: self._hash(table, position) for table, position in self._pipeline.visible(self.at)}
        depends = None
        if stage.needs:
            depends = stage.dependencies(self._unit, self.upstream(), self.shared())
        return self._keyer.key(self._unit, self.at, hashes, depends)

    def _hash(self, table: str, position: int) -> str:
        return next(t.hash.hex() for t in self.done[position].tables if t.table == table)

    def upstream(self) -> Mapping[str, pa.Table]:
        """Return the tables that the next stage reads."""
        visible = self._pipeline.visible(self.at)
        return Upstream({table: partial(self._table, table, position) for table, position in visible})

    def _table(self, table: str, position: int) -> pa.Table:
        if (table, position) not in self._in_memory:
            done = self.done[position]
            try:
                found = self._commits.table(done.stage, done.key.hex(), table, self._hash(table, position))
            except CorruptShardError:
                if self._discard:
                    self._commits.discard(done.stage, done.key.hex())
                raise
            self._in_memory[table, position] = found
        return self._in_memory[table, position]

    def shared(self) -> Mapping[str, pa.Table]:
        """Return the aggregates that the next stage needs."""
        return self._shared.of(self._pipeline.stages[self.at].needs)

    def add(self, receipt: StageReceipt, tables: Mapping[str, pa.Table] | None = None) -> None:
        """Record that the next stage is done. ``tables`` are its tables by name, if they are in memory."""
        for name, table in (tables or {}).items():
            self._in_memory[name, self.at] = table
        self.done.append(receipt)


def receipt_of(committed: Committed, *, made: bool) -> StageReceipt:
    """Convert a commit to a receipt."""
    commit = committed.commit
    parts: dict[str, Any] = {name: bytes.fromhex(part) for name, part in commit.key_parts.model_dump().items()}
    return StageReceipt(
        **parts,
        stage=commit.stage,
        key=bytes.fromhex(commit.key),
        seconds=commit.seconds,
        peak_rss=commit.peak_rss,
        made=made,
        skipped=commit.outcome == "skipped",
        cpu_seconds=commit.cpu_seconds,
        tables=tuple(
            TableReceipt(name, bytes.fromhex(record.logical_hash), record.rows, record.logical_bytes)
            for name, record in commit.tables.items()
        ),
        stored=committed.stored,
    )
