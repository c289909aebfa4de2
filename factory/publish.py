"""Publishing: write a snapshot's files, its manifest and its unit index, then move the ref."""

from __future__ import annotations

import hashlib
import time
from collections.abc import Iterable, Iterator, Mapping
from typing import Final

from factory import machine
from factory.chain import SharedTables
from factory.commits import Commits, sealed
from factory.executor import Executor
from factory.index import Index
from factory.inventory import missing_parts
from factory.packing import PackJob, in_threads
from factory.pipeline import Pipeline, RunContext
from factory.receipt import Receipt
from factory.report import Progress, RunReport
from factory.snapshot import Composition, damaged_parts, manifest_path, read_manifest, read_ref, ref_path
from factory.store import Store
from schemas.errors import CorruptShardError, PublishConflictError
from schemas.snapshot import STORE_VERSION, PartRecord, PinnedTable, Published, Ref, SharedRecord

__all__ = ["Publisher", "published_index"]

HISTORY: Final = 50
"""Number of earlier states that a ref remembers; a sweep may keep that many snapshots."""


def published_index(pipeline: Pipeline, store: Store, ref: Ref | None) -> Index:
    """Return the unit index behind ``ref``, or an empty index if the published one is missing or damaged.

    Without it a run is slower, but nothing is lost: the commits are all there.
    """
    if ref is None:
        return Index.empty(pipeline)
    try:
        return Index.read(store, ref.index)
    except CorruptShardError:
        return Index.empty(pipeline, damaged=True)


class Publisher:
    """Publishes under one ref, starting from the state of the ref when this object was created.

    old : that state; None when nothing was published yet
    """

    def __init__(self, context: RunContext, executor: Executor, progress: Progress, part_bytes: int) -> None:
        self._pipeline, self._store, self._ref = context.pipeline, context.store, context.name
        self._executor = executor
        self._progress = progress
        self._part_bytes = part_bytes
        self.old, self._token = read_ref(self._store, self._ref)
        self.manifest = read_manifest(self._store, self.old.snapshot_id) if self.old is not None else None
        """Manifest of the published snapshot; None where it is missing or damaged."""
        self._damaged: frozenset[str] = frozenset()

    def look(self) -> None:
        """List the store's files to find published files that are missing or cut short. These files will be rebuilt."""
        if self.old is not None:
            self._note(missing_parts(self._store, self.old.snapshot_id), "is missing or cut")

    def verify(self, commits: Commits, index: Index) -> None:
        """Read every file that the published snapshot depends on, including the files of its units. Files that differ
        from their hash will be rebuilt.
        """
        if self.old is None:
            return
        self._note(damaged_parts(self._store, self.old.snapshot_id), "differs from its hash")
        self._progress.phase("verified", len(index), 0.0)

        def check(receipt: Receipt) -> list[tuple[str, str, str]]:
            found = []
            for stage in receipt.stages:
                path = commits.damaged_file(stage.stage, stage.key.hex())
                if path is not None:
                    found.append((stage.stage, stage.key.hex(), path))
            return found

        receipts = index.receipts(self._pipeline)
        for damaged in in_threads(check, receipts):
            self._progress.step()
            for stage, key, path in damaged:
                commits.discard(stage, key)
                self._progress.note(f"{path} is missing or differs from its hash: it is rebuilt")

    def _note(self, paths: Iterable[str], what: str) -> None:
        found = sorted({*paths} - self._damaged)
        self._damaged |= {*found}
        for path in found:
            self._progress.note(f"{path} {what}: it is rebuilt")

    def sound(self) -> bool:
        """Whether a snapshot is published and no damage was found in it."""
        return self.old is not None and self.manifest is not None and not self._damaged

    def publish(
        self, index: Index, context: RunContext, report: RunReport, pinned: Mapping[str, PinnedTable]
    ) -> set[str]:
        """Publish the units of ``index``.

        pinned : the shared tables that they were made with, by name

        Committed files may turn out damaged on the way (they are removed): then the ids of their units are returned,
        and nothing is published.
        """
        composition = Composition.of(self._pipeline, index)
        damaged = self._write_parts(composition, context, pinned)
        if not damaged:
            report.snapshot_id = composition.snapshot_id
            self._swap(composition.snapshot_id, index.write(self._store), report)
        return damaged

    def _write_parts(
        self, composition: Composition, context: RunContext, pinned: Mapping[str, PinnedTable]
    ) -> set[str]:
        """Write the snapshot unless it exists. Return the ids of units whose committed files are damaged."""
        present = read_manifest(self._store, composition.snapshot_id) is not None
        if present:
            self._damaged |= {*missing_parts(self._store, composition.snapshot_id)}
        own = f"snapshots/{composition.snapshot_id}/"
        if present and not any(path.startswith(own) for path in self._damaged):
            if self.old is None or self.old.snapshot_id != composition.snapshot_id:
                # No ref may name it and its day be past: written again, it is too young for a sweep to take it now.
                path = manifest_path(composition.snapshot_id)
                self._store.write(path, self._store.read(path))
            return set()
        parts: dict[tuple[str, str], list[PartRecord]] = {key: [] for key in composition.hashes}
        jobs = [*composition.jobs(self._part_bytes)]
        self._progress.phase("files", len(jobs), 0.0)
        damaged: set[str] = set()
        for packed in self._executor.pack(context, self._carry_over(jobs, parts)):
            self._progress.step()
            damaged.update(packed.damaged)
            if packed.part is not None:
                parts[packed.table, packed.partition].append(packed.part)
        if damaged:
            return damaged
        provenance = {"revision": context.revision, **machine.library_versions()}
        shared = {name: self._keep(composition.snapshot_id, name, pinned[name]) for name in context.shared}
        manifest = composition.manifest(parts, context.shared, shared, provenance)
        self._store.write(manifest_path(composition.snapshot_id), sealed(manifest))
        return set()

    def _keep(self, snapshot_id: str, name: str, pinned: PinnedTable) -> SharedRecord:
        """Copy a shared table into the snapshot. Unlike a link, the copy survives damage to the original."""
        data = self._store.read(SharedTables.path(name, pinned.hash))
        path = f"_shared/{name}.parquet"  # readers that take each folder for a table leave out those with "_"
        self._store.write(f"snapshots/{snapshot_id}/{path}", data)
        sha256 = hashlib.sha256(data).hexdigest()
        return SharedRecord(**pinned.model_dump(), path=path, bytes=len(data), sha256=sha256)

    def _carry_over(
        self, jobs: Iterable[PackJob], parts: Mapping[tuple[str, str], list[PartRecord]]
    ) -> Iterator[PackJob]:
        """Yield the jobs whose files must be written. For each other job, a file of the published snapshot already
        holds the same rows: this file is copied and added to ``parts``.
        """
        before = self.manifest
        known = {}
        if before is not None:
            for table in before.tables.values():
                for partition in table.partitions.values():
                    known.update({part.content: part for part in partition.parts})
        for job in jobs:
            part = known.get(job.content)
            path = f"snapshots/{before.snapshot_id}/{part.path}" if before is not None and part is not None else ""
            if part is None or path in self._damaged:
                yield job
                continue
            try:
                if path != job.path:
                    self._store.copy(path, job.path)
            except FileNotFoundError:
                yield job
                continue
            moved = part.model_copy(update={"path": job.path.split("/", 2)[2]})
            parts[job.table, job.partition].append(moved)
            self._progress.step()

    def _swap(self, snapshot_id: str, index: str, report: RunReport) -> None:
        if self.old is not None and (self.old.snapshot_id, self.old.index) == (snapshot_id, index):
            return
        history: list[Published] = []
        if self.old is not None:
            last = Published(**self.old.model_dump(include=set(Published.model_fields)))
            # A snapshot stands in the history once, under its latest index.
            history = [state for state in (last, *self.old.history) if state.snapshot_id != snapshot_id]
        ref = Ref(
            name=self._ref,
            store_version=STORE_VERSION,
            snapshot_id=snapshot_id,
            index=index,
            generation=1 if self.old is None else self.old.generation + 1,
            published_at=time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime()),
            history=history[:HISTORY],
        )
        try:
            self._store.swap(ref_path(self._ref), sealed(ref), self._token)
        except PublishConflictError:
            now, _ = read_ref(self._store, self._ref)
            if now is None or now.snapshot_id != snapshot_id:
                report.snapshot_id = now.snapshot_id if now else None
                report.message = (
                    f"another run published {report.snapshot_id} as {self._ref!r} while this one made {snapshot_id}, "
                    "which is not published. Nothing is lost: run again, and only the difference is made."
                )
                self._progress.note(report.message)
            return
        report.published = True
