"""The chain of stages of one unit, used by planner and workers alike: the key of each stage, and the tables that it
reads.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from functools import partial

import pyarrow as pa

from factory.commits import Commits, Committed
from factory.key import Keyer, StageKey
from factory.pipeline import Pipeline
from factory.receipt import StageReceipt, TableReceipt
from factory.rows import logical_hash, parquet_table
from factory.unit import Unit
from schemas.errors import CorruptShardError, StoreError

__all__ = ["Chain", "SharedTables", "Upstream", "receipt_of"]

_RENEW = "Run condvln rebuild CONFIG, which restores it from the snapshot; if it can't, add --priors to build it again."


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
        self._tables = Upstream({name: self._loader(commits, name, found) for name, found in self.hashes.items()})

    @staticmethod
    def path(name: str, hash_: str) -> str:
        """Return the path of an aggregate in the store."""
        return f"aggregates/{name}/{hash_}.parquet"

    def _loader(self, commits: Commits, name: str, found: str) -> Callable[[], pa.Table]:
        def load() -> pa.Table:
            path = self.path(name, found)
            where = f"{commits.store.url}/{path}"
            try:
                table = parquet_table(commits.store.read(path), where)
            except (FileNotFoundError, CorruptShardError) as error:
                raise StoreError(
                    f"the pinned table {name!r} is missing or damaged", where=where, remedy=_RENEW
                ) from error
            if logical_hash(table)[0] != found:
                raise StoreError(f"the pinned table {name!r} differs from its hash", where=where, remedy=_RENEW)
            return table

        return load

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
        return Upstream({table: self._loader(table, position) for table, position in self._pipeline.visible(self.at)})

    def _loader(self, table: str, position: int) -> Callable[[], pa.Table]:
        def load() -> pa.Table:
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

        return load

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
    parts = commit.key_parts
    return StageReceipt(
        stage=commit.stage,
        key=bytes.fromhex(commit.key),
        code=bytes.fromhex(parts.code),
        inputs=bytes.fromhex(parts.inputs),
        parameters=bytes.fromhex(parts.parameters),
        dependencies=bytes.fromhex(parts.dependencies),
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
