"""Publishing: a snapshot's files, its manifest, its unit index, and at last the ref."""

from __future__ import annotations

import time
from collections.abc import Iterable, Iterator, Mapping
from typing import Final

import pyarrow as pa

from factory import machine
from factory.context import RunContext
from factory.executor import Executor
from factory.faults import FaultPlan
from factory.index import Index
from factory.packing import PackJob, bucket_count
from factory.pipeline import Pipeline
from factory.report import Progress, RunReport
from factory.snapshot import Composition, damaged_parts, manifest_path, read_manifest, read_ref, ref_path
from factory.store import Store
from schemas.errors import CorruptShardError, PublishConflictError
from schemas.snapshot import PartRecord, Published, Ref

__all__ = ["Publisher", "published_index"]

HISTORY: Final = 50
"""Earlier states that a ref remembers; a sweep may keep that many snapshots."""


def published_index(pipeline: Pipeline, store: Store, ref: Ref | None) -> Index:
    """The unit index behind ``ref``; an empty one where it is gone or damaged.

    Without it a run is slower, but nothing is lost: the commits are all there.
    """
    if ref is None:
        return Index.empty(pipeline)
    try:
        return Index.read(store, ref.index)
    except CorruptShardError:
        return Index.empty(pipeline)


class Publisher:
    """Publishes under one ref, from the state that the ref had when this was made.

    old : that state; None when nothing was published yet
    """

    def __init__(
        self,
        pipeline: Pipeline,
        store: Store,
        ref: str,
        executor: Executor,
        progress: Progress,
        faults: FaultPlan,
        part_bytes: int,
    ) -> None:
        self._pipeline = pipeline
        self._store = store
        self._ref = ref
        self._executor = executor
        self._progress = progress
        self._faults = faults
        self._part_bytes = part_bytes
        self.old, self._token = read_ref(store, ref)
        self._damaged: frozenset[str] = frozenset()

    def index(self) -> Index:
        """The published unit index."""
        return published_index(self._pipeline, self._store, self.old)

    def verify(self) -> None:
        """Read every published file again; those that differ from their hash will be made anew."""
        if self.old is not None:
            self._damaged = frozenset(damaged_parts(self._store, self.old.snapshot_id))
            for path in sorted(self._damaged):
                self._progress.note(f"{path} differs from its hash: made again")

    def sound(self) -> bool:
        """Whether something is published and, as far as was looked, whole."""
        if self.old is None or self._damaged:
            return False
        return read_manifest(self._store, self.old.snapshot_id) is not None

    def publish(self, index: pa.Table, context: RunContext, report: RunReport) -> set[str]:
        """Publish the units of ``index``.

        Committed files may turn out damaged on the way (they are removed): then the ids of their units are returned,
        and nothing is published.
        """
        composition = Composition.of(self._pipeline, index)
        damaged = self._write_parts(composition, context)
        if not damaged:
            self._faults.reach("snapshot-before-index")
            report.snapshot_id = composition.snapshot_id
            self._swap(composition.snapshot_id, Index.write(self._store, index), report)
        return damaged

    def _write_parts(self, composition: Composition, context: RunContext) -> set[str]:
        """Write the snapshot, unless it is there; returns ids of units whose committed files are damaged."""
        if not self._damaged and read_manifest(self._store, composition.snapshot_id) is not None:
            if self.old is None or self.old.snapshot_id != composition.snapshot_id:
                # No ref may name it and its day be past: written again, it is too young for a sweep to take it now.
                path = manifest_path(composition.snapshot_id)
                self._store.write(path, self._store.read(path))
            return set()
        parts: dict[tuple[str, str], list[PartRecord]] = {key: [] for key in composition.members}
        self._faults.reach("snapshot-before-parts")
        jobs = self._carry_over(composition.jobs(self._part_bytes), parts)
        files = sum(bucket_count(members, self._part_bytes) for members in composition.members.values())
        self._progress.phase("files", files, 0.0)
        damaged: set[str] = set()
        for packed in self._executor.pack(context, jobs):
            self._progress.step()
            damaged.update(packed.damaged)
            if packed.part is not None:
                parts[packed.table, packed.partition].append(packed.part)
        if damaged:
            return damaged
        provenance = {"revision": context.revision, **machine.library_versions()}
        manifest = composition.manifest(parts, context.shared, provenance)
        self._faults.reach("snapshot-before-manifest")
        path = manifest_path(composition.snapshot_id)
        data = manifest.model_dump_json(indent=1).encode()
        self._store.write(path, data)
        return set()

    def _carry_over(
        self, jobs: Iterable[PackJob], parts: Mapping[tuple[str, str], list[PartRecord]]
    ) -> Iterator[PackJob]:
        """Take files over from the published snapshot where the same rows are in them; yields the others."""
        before = read_manifest(self._store, self.old.snapshot_id) if self.old else None
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
            snapshot_id=snapshot_id,
            index=index,
            generation=1 if self.old is None else self.old.generation + 1,
            published_at=time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime()),
            history=history[:HISTORY],
        )
        self._faults.reach("snapshot-before-ref")
        try:
            self._store.swap(ref_path(self._ref), ref.model_dump_json(indent=1).encode(), self._token)
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
        self._faults.reach("snapshot-after-ref")
