"""``condvln status``: print what is published, the quarantine with causes, the last runs, and the drift of the
priors.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, Final

from factory.snapshot import Snapshot
from factory.status import AggregateDrift, RefStatus, StoreStatus, drift, store_status
from factory.store import Store
from jobs.funnel import add_funnel
from jobs.progress import LOGS
from jobs.report import Report, Section
from jobs.workspace import Target, pins_of
from schemas.errors import CorruptShardError, UsageError
from schemas.snapshot import RunRecord, SnapshotManifest
from schemas.unit import QuarantineRecord

__all__ = ["target_status"]

HISTORY_SHOWN: Final = 5
"""Number of earlier snapshots listed for each ref."""

OUTCOMES: Final = {0: "done", 3: "with quarantine", 4: "stopped over budget"}

DAMAGED: Final = 3
"""Exit code if published files are missing or damaged."""

MIB: Final = 2**20


def target_status(target: Target, *, measure_drift: bool = False, sizes: bool = False) -> Report:
    """Report the state of a store: all its refs, the requested one first.

    measure_drift : build the pinned tables again over what is published, and compare (reads every unit once)
    sizes : list every file of the store
    """
    store = target.store()
    found = store_status(store, sizes=sizes)
    chosen = [status for status in found.refs if status.ref.name == target.name] if target.name else [*found.refs]
    own = chosen[0] if len(chosen) == 1 else None
    report = Report(_document(found, own), [f"store {found.url}"])
    if target.name is not None and own is None:
        report.lines.append(f"nothing is published as {target.name!r} yet")
    if not found.refs and target.name is None:
        report.lines.append("nothing is published yet")
    report.lines += [_line(status) for status in found.refs]
    _tell_damage(report, found)
    report.sections.append(_snapshots(found.refs))
    if own is not None and own.manifest is not None:
        report.sections += [*_contents(own.manifest)]
        try:
            add_funnel(report, Snapshot.open(store, own.ref.name))
        except CorruptShardError as error:
            report.lines.append(f"no funnel: {error}")
            report.exit_code = DAMAGED
    report.sections.append(_quarantine(found.quarantine))
    report.sections.append(_runs(found.runs))
    report.sections.append(_pins(store, found, report))
    if measure_drift:
        report.sections.append(_drift(target, store, report))
    if sizes:
        rows = [(kind, count, round(found.bytes[kind] / MIB, 1)) for kind, count in sorted(found.files.items())]
        report.sections.append(Section("Sizes", ("folder", "files", "MiB"), [*rows]))
        report.document["sizes"] = {kind: {"files": n, "bytes": found.bytes[kind]} for kind, n in found.files.items()}
    return report


def _document(found: StoreStatus, own: RefStatus | None) -> dict[str, Any]:
    return {
        "store": found.url,
        "ref": None if own is None else own.ref.model_dump(mode="json"),
        "snapshot": None if own is None or own.manifest is None else own.manifest.model_dump(mode="json"),
        "refs": [status.ref.model_dump(mode="json") for status in found.refs],
        "quarantine": [record.model_dump(mode="json") for record in found.quarantine],
        "runs": [record.model_dump(mode="json") for record in found.runs],
    }


def _line(status: RefStatus) -> str:
    ref, manifest = status.ref, status.manifest
    head = f"{ref.name} → snapshot {ref.snapshot_id} (generation {ref.generation}, {ref.published_at})"
    if manifest is None:
        return f"{head}: its manifest is missing or damaged"
    return f"{head}: scenes " + ", ".join(f"{n} {status}" for status, n in sorted(manifest.units.items()))


def _tell_damage(report: Report, found: StoreStatus) -> None:
    """Report which published files are missing or damaged, with the remedy, and set the exit code."""
    lines = [line for status in found.refs for line in status.damaged]
    lines += [
        f"{found.url}/refs/{name}.json is missing, although a run published it: "
        "the next run publishes the committed results again"
        for name in found.unpublished
    ]
    report.document["damaged"] = lines
    if lines:
        report.lines += [f"DAMAGED: {line}" for line in lines]
        report.lines.append(
            "Run condvln generate CONFIG, which rebuilds what is missing or cut (--verify reads every file)"
        )
        report.exit_code = DAMAGED


def _snapshots(refs: tuple[RefStatus, ...]) -> Section:
    rows = [
        (state.snapshot_id, status.ref.name, state.generation, state.published_at)
        for status in refs
        for state in [status.ref, *status.ref.history[:HISTORY_SHOWN]]
    ]
    return Section("Snapshots", ("snapshot", "ref", "generation", "published"), [*rows])


def _contents(manifest: SnapshotManifest) -> Iterator[Section]:
    files = {
        name: [part for partition in table.partitions.values() for part in partition.parts]
        for name, table in manifest.tables.items()
    }
    rows = [
        (name, table.rows, len(table.partitions), len(files[name]), sum(p.bytes for p in files[name]) / MIB)
        for name, table in sorted(manifest.tables.items())
    ]
    yield Section("Tables", ("table", "rows", "sources", "files", "MiB"), [*rows])
    costs = [
        (name, s.version, s.units, s.skipped, s.rows, s.seconds, round(s.peak_rss / MIB))
        for name, s in manifest.stages.items()
    ]
    yield Section("Stages", ("stage", "version", "scenes", "skipped", "rows", "seconds", "peak MiB"), [*costs])


def _quarantine(records: tuple[QuarantineRecord, ...]) -> Section:
    rows = [
        (r.unit_id, r.stage, r.cause, r.attempts, round(r.peak_rss / MIB), r.recorded_at, f"{r.exception}: {r.message}")
        for r in records
    ]
    return Section("Quarantine", ("scene", "stage", "cause", "attempts", "peak MiB", "at", "because of"), [*rows])


def _runs(records: tuple[RunRecord, ...]) -> Section:
    rows = [
        (
            r.started_at,
            r.ref,
            OUTCOMES.get(r.exit_code, str(r.exit_code)) + (", published" if r.published else ""),
            round(r.seconds, 1),
            r.counts.get("made", 0),
            r.counts.get("fresh", 0) + r.counts.get("reused", 0),
            r.counts.get("quarantined", 0),
            f"{LOGS}/{r.started_at}-{r.token}.jsonl",
        )
        for r in records
    ]
    return Section("Runs", ("started", "ref", "outcome", "seconds", "made", "as before", "quarantined", "log"), [*rows])


def _pins(store: Store, found: StoreStatus, report: Report) -> Section:
    """Return the report's section of pinned tables: the number of scenes that each was built from, and the number
    published now. A difference is a cheap sign of drift.
    """
    now = {
        status.ref.name: max((s.units - s.skipped for s in status.manifest.stages.values()), default=0)
        for status in found.refs
        if status.manifest is not None
    }
    rows, document = [], []
    for ref, pin in pins_of(store):
        for name, pinned in sorted(pin.tables.items()):
            rows.append((name, ref, pinned.units, now.get(ref), pinned.rows, pinned.hash))
            document.append({"name": name, "ref": ref, **pinned.model_dump(mode="json"), "units_now": now.get(ref)})
    report.document["pinned"] = document
    return Section("Pinned", ("table", "ref", "built from", "scenes now", "rows", "hash"), [*rows])


def _drift(target: Target, store: Store, report: Report) -> Section:
    if target.config is None:
        raise UsageError("--drift needs a configuration, whose stages it runs", remedy="Name the YAML file.")
    from jobs.pipeline import build_pipeline  # the science, needed for this alone

    found: tuple[AggregateDrift, ...] = drift(build_pipeline(target.config), store, target.config.name)
    report.document["drift"] = [
        {"name": d.name, "rows": d.rows, "rows_now": d.rows_now, "differing": d.differing, "units_now": d.units_now}
        for d in found
    ]
    rows = [(d.name, d.rows, d.rows_now, d.differing, d.units, d.units_now) for d in found]
    return Section("Drift", ("table", "rows", "rows now", "differing", "built from", "scenes now"), [*rows])
